"""Records of small surveys, and their digests."""

import errno
import io
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from pfwd_device.jobs import Jobs
from pfwd_device.recording import (
    DropRecord,
    ReboundRecord,
    SpareFolder,
    Storage,
    Survey,
    SurveyWriter,
    check,
    read_survey,
    recover,
)
from pfwd_device.recording.drop_file import drop_digest
from pfwd_device.recording.framing import Damage, Frame, RecordKind, scan
from tests.campaigns import noted_disk, power_loss
from tests.campaigns.noted_disk import NotingStorage
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


def record_of(number: int, samples: int = 96) -> DropRecord:
    """Return the n-th drop of a survey, always the same one."""
    return make_record(number, np.random.default_rng(number), samples)


def open_survey(folder: Path, *, publish: bool = False, **options: Any) -> SurveyWriter:
    """Open a survey without a reserve that makes files of drops in this process, if it does."""
    options = {"jobs": Jobs(0), "reserve_bytes": 0} | options
    return SurveyWriter.open(folder, publish=publish, **options)


def make_survey(folder: Path, drops: int = 3, *, extras: bool = True) -> dict[int, str]:
    """Record a survey and close it; return the digests of its drops by number."""
    recorded = {}
    with open_survey(folder, publish=True, reserve_bytes=4096) as writer:
        writer.add_point("P 1", {"plate_radius_m": 0.15})
        for number in range(1, drops + 1):
            record = record_of(number, 32)
            recorded[writer.save_drop(record)] = drop_digest(record, 0)
        if extras:
            writer.note_event("gap", {"samples": 12})
            writer.edit("note", "wet", number=1)
            writer.save_result(1, {"modulus_pa": 45e6, "seed": 1})
            capture = writer.open_capture("link", {"url": "socket://x"})
            capture.write("from", b"\x00\x01\x02")
    return recorded


def journal_of(survey: Path) -> Path:
    return survey / "journal" / "0001.pfwdj"


def flip(path: Path, at: int, bits: int = 1) -> None:
    """Turn bits of one byte of a file."""
    data = bytearray(path.read_bytes())
    data[at] ^= bits
    path.write_bytes(data)


def frames_of(survey: Path, kind: RecordKind) -> list[Frame]:
    """Return the intact records of a kind in a journal."""
    frames, _ = scan_bytes(journal_of(survey).read_bytes())
    return [frame for frame in frames if frame.kind == kind]


def save(writer: SurveyWriter, number: int) -> str:
    """Save the drop of a number; return its digest."""
    record = record_of(number)
    assert writer.save_drop(record) == number
    return drop_digest(record, 0)


def digests(survey: Path | Survey) -> dict[int, str]:
    content = survey if isinstance(survey, Survey) else read_survey(survey)
    return {drop.number: drop_digest(drop.read(), 0) for drop in content.drops}


def assert_recovered(survey: Path, spare: SpareFolder, expected: dict[int, str]) -> None:
    """Recover a survey; each drop is in its folder then, as it was, and nothing is left to do."""
    report = recover(survey, spare=spare)
    assert report.ok, report.damaged
    assert digests(survey) == expected
    assert check(survey, spare=spare).ok
    assert recover(survey, spare=spare).actions == ()


def interrupted_recoveries(
    run: Path, every: int, spare: SpareFolder | None = None
) -> Iterator[Path]:
    """Recover the survey of a run, and yield folders as a kill and a power cut leave them then."""
    before = noted_disk.take(run)
    storage = NotingStorage(run)
    recover(run / "survey", storage, jobs=Jobs(0), spare=spare)
    for index, _, disk in power_loss.follow(storage.notes, before):
        if index % every == 0:
            rng = np.random.default_rng(index)
            for number, state in enumerate([disk.killed(), disk.power_cut(rng)]):
                folder = run.parent / f"{index}-{number}"
                folder.mkdir()
                noted_disk.put(state, folder)
                yield folder
                shutil.rmtree(folder)
    assert len(storage.notes) > 40


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
