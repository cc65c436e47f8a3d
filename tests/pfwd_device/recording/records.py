"""Records of small surveys, and their digests."""

from pathlib import Path

import numpy as np

from pfwd_device.recording import Rebound, SurveyWriter, read_survey
from pfwd_device.recording.drop_file import drop_digest
from tests.campaigns.power_loss import make_record


def a_rebound(sample: int = 7000) -> Rebound:
    return Rebound(0.41, 912.5, sample, np.arange(12, dtype=np.int32).reshape(4, 3))


def save(writer: SurveyWriter, number: int) -> str:
    """Save the drop of a number; return its digest."""
    record = make_record(number, np.random.default_rng(number))
    assert writer.save_drop(record) == number
    return drop_digest(record, 0)


def digests(folder: Path) -> dict[int, str]:
    return {drop.number: drop_digest(drop.read(), 0) for drop in read_survey(folder).drops}
