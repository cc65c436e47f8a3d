"""A simulated instrument that makes ten drops a second, for the campaign of faults."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from simulators.instrument import SimulatedInstrument, serve

HASTY: dict[str, Any] = {
    "base": "default",
    "drops": {"interval": 2.0, "bounces": [0, 0], "jitter": 0.1, "first": 1.0},
}
RATE = 20.0


@contextlib.contextmanager
def hasty_instrument(seed: int, **more: Any) -> Iterator[SimulatedInstrument]:
    """Serve an instrument that makes a drop every 0.1 s, without end."""
    with serve(HASTY | more, seed=seed, rate=RATE, listen="tcp://127.0.0.1:0") as instrument:
        yield instrument
