"""Records of small surveys, and their digests."""

import errno
import io
from pathlib import Path

import numpy as np

from pfwd_device.recording import ReboundRecord, Storage, SurveyWriter, read_survey
from pfwd_device.recording.drop_file import drop_digest
from pfwd_device.recording.framing import Damage, Frame, scan
from tests.campaigns.power_loss import make_record


def scan_bytes(data: bytes) -> tuple[list[Frame], list[Damage]]:
    """Return the records and the damaged parts of a journal or capture."""
    items = list(scan(io.BytesIO(data)))
    return (
        [item for item in items if isinstance(item, Frame)],
        [item for item in items if isinstance(item, Damage)],
    )


def a_rebound(sample: int = 7000) -> ReboundRecord:
    return ReboundRecord(0.41, 912.5, sample, np.arange(12, dtype=np.int32).reshape(4, 3))


def save(writer: SurveyWriter, number: int) -> str:
    """Save the drop of a number; return its digest."""
    record = make_record(number, np.random.default_rng(number))
    assert writer.save_drop(record) == number
    return drop_digest(record, 0)


def digests(folder: Path) -> dict[int, str]:
    return {drop.number: drop_digest(drop.read(), 0) for drop in read_survey(folder).drops}


class Refusing(Storage):
    """A disk that takes nothing below a folder."""

    def __init__(self, folder: Path, number: int = errno.ENOSPC) -> None:
        self.folder: Path | None = None
        self._below = folder
        self._number = number
        self._paths: dict[int, Path] = {}

    def refuse(self, refused: bool = True) -> None:
        self.folder = self._below if refused else None

    def open(self, path: Path, *, create: bool = False) -> int:
        if create:
            self._may_refuse(path)
        descriptor = super().open(path, create=create)
        self._paths[descriptor] = path
        return descriptor

    def pwrite(self, descriptor: int, data: memoryview, offset: int) -> int:
        self._may_refuse(self._paths[descriptor])
        return super().pwrite(descriptor, data, offset)

    def _may_refuse(self, path: Path) -> None:
        if self.folder is not None and self.folder in path.parents:
            raise OSError(self._number, "refused")
