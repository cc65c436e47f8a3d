"""Surveys of a few small drops, for tests that need no result."""

from pathlib import Path
from typing import Any

import numpy as np

from pfwd_device import Drop
from pfwd_device.recording import DropRecord, SurveyWriter


def write_small_survey(folder: Path, *points: str, **declared: Any) -> Path:
    """Write a drop of four samples for each point."""
    with SurveyWriter.open(folder, publish=False) as writer:
        for point in points:
            drop = Drop(1, np.arange(4.0), np.zeros(4), ())
            writer.save_drop(DropRecord(point, drop, declared=declared))
    return folder
