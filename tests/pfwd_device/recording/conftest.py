"""Small surveys, and records that are compared bit by bit."""

from collections.abc import Callable
from pathlib import Path

import pytest

from pfwd_device.recording import DropRecord, SpareFolder
from pfwd_device.recording.drop_file import drop_digest
from tests.pfwd_device.recording.records import open_survey, record_of


@pytest.fixture
def new_record() -> Callable[[int], DropRecord]:
    """Makes the n-th drop of a survey, always the same one."""
    return lambda number: record_of(number, 32)


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    """Folder of a survey, which is not there yet."""
    return tmp_path / "survey"


@pytest.fixture
def spare(tmp_path: Path) -> SpareFolder:
    return SpareFolder(tmp_path / "spare")


@pytest.fixture
def new_survey(
    tmp_path: Path, new_record: Callable[[int], DropRecord]
) -> Callable[..., dict[int, str]]:
    """Records a closed survey; gives the digests of its drops by number."""

    def make(folder: Path | None = None, drops: int = 3, *, extras: bool = True) -> dict[int, str]:
        digests = {}
        folder = folder or tmp_path / "survey"
        with open_survey(folder, publish=True, reserve_bytes=4096) as writer:
            writer.add_point("P 1", {"plate_radius_m": 0.15})
            for number in range(1, drops + 1):
                record = new_record(number)
                digests[writer.save_drop(record)] = drop_digest(record, 0)
            if extras:
                writer.note_event("gap", {"samples": 12})
                writer.edit("note", "wet", number=1)
                writer.save_result(1, {"modulus_pa": 45e6, "seed": 1})
                capture = writer.open_capture("link", {"url": "socket://x"})
                capture.write("from", b"\x00\x01\x02")
        return digests

    return make
