"""Trial of a data logger on hardware: what to send to the project."""

import time
from typing import Any

import numpy as np

from pfwd.session.live import LiveFeed
from pfwd.session.setup_file import MeasuringSetup
from pfwd.version import __version__
from pfwd_device.acquisition.items import Connected, Disconnected, Gap, RateDeviation, Samples
from pfwd_device.identity import Identity, identity_as_dict
from pfwd_device.wire.messages import Event, Refusal

MAX_STATISTICS_SAMPLES = 200_000
"""Number of latest samples of which the statistics are computed."""


def try_logger(url: str, setup: MeasuringSetup, seconds: float) -> dict[str, Any]:
    """Return what a logger sent in some seconds, as JSON values.

    Parameters
    ----------
    url : str
        Port of the logger.
    setup : MeasuringSetup
        Declares the logger and its channels.
    seconds : float, s

    Raises
    ------
    PortError, DeviceRefused
        If the port cannot be opened, or the logger refuses the setup.
    """
    feed = LiveFeed(url, setup)
    identity: Identity | None = None
    events: list[str] = []
    parts: list[np.ndarray[Any, np.dtype[np.int32]]] = []
    count, missing, stored, runs = 0, 0, 0, set()
    began: float | None = None
    try:
        feed.open()
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            match item := feed.next(left):
                case Connected():
                    identity = item.identity
                case Samples():
                    began = began or item.received
                    count += len(item.counts)
                    runs.add(item.stream)
                    parts.append(item.counts)
                    stored += len(item.counts)
                    while stored - len(parts[0]) > MAX_STATISTICS_SAMPLES:
                        stored -= len(parts.pop(0))
                case Gap():
                    missing += item.length
                case Disconnected():
                    events.append(f"connection lost: {item.reason}")
                case Event() | Refusal():
                    events.append(item.text)
                case RateDeviation():
                    events.append(f"sampling rate off by {100 * item.deviation:.3g} %")
        passed = 0.0 if began is None else time.monotonic() - began
        counters = feed.counters()
    finally:
        feed.close()
    table = np.concatenate(parts) if parts else np.zeros((0, 0), np.int32)
    names = [] if identity is None else [channel.name for channel in identity.channels]
    return {
        "program": __version__,
        "setup": setup.text,
        "identity": None if identity is None else identity_as_dict(identity),
        "seconds": passed,
        "samples": count,
        "rate_by_this_computer_hz": count / passed if passed else None,
        "missing_samples": missing,
        "runs": len(runs),
        "events": events,
        "counters": counters,
        "channels": [
            {
                "name": name,
                "mean_counts": float(column.mean()),
                "noise_counts": float(column.std()),
                "smallest": int(column.min()),
                "largest": int(column.max()),
            }
            for name, column in zip(names, table.T, strict=False)
        ],
    }
