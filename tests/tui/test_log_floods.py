"""``pfwd log`` with an instrument that says the same without end."""

import signal
import threading
import time
from pathlib import Path

import pytest

from pfwd_device.wire.messages import Event, EventKind, InstrumentMessage
from tests.tui.console import PATIENCE, checked, running
from tests.tui.flooding import flooding

LONGEST_END = 5.0
"""s from the signal; a service that is stopped waits for it."""

FLOOD = 6.0
"""s of it."""


def flooded(
    url_and_instrument: tuple[object, str], survey: Path, *options: str, **flood: object
) -> tuple[float, str]:
    """How long the end took, and what had been printed."""
    instrument, url = url_and_instrument
    with running("log", url, "-o", survey, *options) as process:
        printed: list[str] = []

        def read() -> None:
            printed.extend(process.communicate(timeout=PATIENCE))

        reader = threading.Thread(target=read)
        reader.start()
        until = time.monotonic() + PATIENCE
        while not (survey / "log" / "pfwd.log").exists() and time.monotonic() < until:
            time.sleep(0.05)
        time.sleep(1.5)
        for name, value in flood.items():
            setattr(instrument, name, value)
        time.sleep(FLOOD)
        told = time.monotonic()
        process.send_signal(signal.SIGTERM)
        reader.join()
        took = time.monotonic() - told
        assert process.returncode == 0, printed[1]
    assert checked(survey)["ok"]
    return took, "".join(printed)


@pytest.mark.posix
@pytest.mark.parametrize("rate", [0.0, pytest.param(1.0, marks=pytest.mark.slow)])
def test_a_flood_of_triggers_does_not_hold_up_the_end(rate: float, tmp_path: Path) -> None:
    with flooding(rate) as instrument:
        took, text = flooded(instrument, tmp_path / "s", kinds=[EventKind.TRIGGER])
        assert instrument[0].said > 10_000
    assert took < LONGEST_END
    assert len(text) < 100_000


@pytest.mark.slow
@pytest.mark.posix
@pytest.mark.parametrize("kind", [EventKind.LOW_BATTERY, EventKind.BOOT])
def test_a_flood_of_events_is_a_few_lines(kind: EventKind, tmp_path: Path) -> None:
    with flooding() as instrument:
        took, text = flooded(instrument, tmp_path / "s", "--no-invert", kinds=[kind])
        assert instrument[0].said > 10_000
    assert took < LONGEST_END
    said = {EventKind.LOW_BATTERY: "battery", EventKind.BOOT: "the instrument restarted"}[kind]
    assert said in text
    assert "more messages of the instrument about" in text
    assert len(text.splitlines()) < 60


@pytest.mark.slow
@pytest.mark.posix
def test_a_flood_of_connections_is_a_few_lines_and_records(tmp_path: Path) -> None:
    with flooding() as instrument:
        anew: list[InstrumentMessage] = [
            Event(EventKind.BOOT, 0), instrument[0].scenario.device.identity(10_000.0)
        ]  # fmt: skip
        took, text = flooded(instrument, tmp_path / "s", "--no-invert", messages=anew)
    assert took < LONGEST_END
    assert len(text.splitlines()) < 120
    assert sum(path.stat().st_size for path in (tmp_path / "s" / "journal").iterdir()) < 200_000
