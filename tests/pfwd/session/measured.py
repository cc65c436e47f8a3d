"""Surveys that a session without inversion records from a script."""

from pathlib import Path
from typing import Any

from pfwd_device.recording import SurveyWriter
from tests.pfwd.scripted_feed import Log, ScriptedFeed, began, pieces, run, stream


def record(folder: Path, *parts: Any, log: Log | None = None, **plan: Any) -> Log:
    """Record what a script sends into the survey of a folder; return what was reported."""
    log = Log() if log is None else log
    with SurveyWriter.open(folder, publish=False) as writer:
        run(ScriptedFeed(*parts), log, writer, **plan)
    return log


def drops(*peaks: float, run: int = 1) -> list[Any]:
    """Run of samples with a drop every 3 s, the first after 1 s; the peaks are in N."""
    pulses = [(1.0 + 3 * number, peak) for number, peak in enumerate(peaks)]
    return [began(run), *pieces(stream(3.0 * len(peaks) + 1, pulses, seed=run), run)]
