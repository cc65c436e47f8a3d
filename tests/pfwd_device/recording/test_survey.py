"""A survey written, continued and read: what is saved is there, once, and as it was."""

from pathlib import Path

import pytest

from pfwd_device.errors import RecordingError, StorageFull
from pfwd_device.jobs import Jobs
from pfwd_device.recording import (
    DropRecord,
    Storage,
    check,
    read_drop_file,
    read_survey,
    recover,
)
from pfwd_device.recording.drop_file import drop_digest
from tests.pfwd_device.recording.records import a_rebound, open_survey, record_of


def test_everything_comes_back(tmp_path: Path) -> None:
    folder = tmp_path / "deep" / "er" / "survey ü"
    with open_survey(folder, publish=True) as writer:
        assert writer.add_point("P 1", {"plate_radius_m": 0.15}) == "P 1"
        assert writer.next_number("P 1") == 1
        numbers = [writer.save_drop(record_of(n)) for n in (1, 2, 11)]
        writer.save_rebound(1, a_rebound(7000))
        writer.save_rebound(1, a_rebound(9000))
        writer.edit("note", "wet", number=2)
        writer.edit("discard", number=2)
        writer.edit("discard", number=1)
        writer.edit("restore", number=1)
        writer.edit("target", "D1", point="P 1")
        writer.edit("declared", {"operator": "ü"}, point="P 1")
        writer.note_event("gap", {"samples": 12})
        writer.save_check({"zero": 3})
        results = [writer.save_result(2, {"modulus_pa": value}) for value in (1.0, 2.0)]
        assert writer.next_number("P 1") == 3
    assert numbers == [1, 2, 3]
    survey = read_survey(folder)
    assert [point.name for point in survey.points] == ["P 1", "P 2"]
    first = survey.points[0]
    assert first.declared == {"plate_radius_m": 0.15, "operator": "ü"}
    assert first.target == "D1"
    assert [(d.number, d.drop, d.discarded, d.notes) for d in first.drops] == [
        (1, 1, False, ()),
        (2, 2, True, ("wet",)),
    ]
    assert first.drops[1].results == tuple(results)
    assert [path.name for path in results] == ["drop-000002-1.json", "drop-000002-2.json"]
    assert [event["details"] for event in survey.events] == [{"samples": 12}]
    assert [entry["details"] for entry in survey.checks] == [{"zero": 3}]
    assert survey.damage == ()
    for drop, original in zip(survey.drops, (1, 2, 11), strict=True):
        record = drop.read()
        saved = record_of(original)
        complete = DropRecord(
            saved.point, saved.drop, saved.counts, saved.declared, saved.metadata, record.rebounds
        )
        assert drop_digest(record, 0) == drop_digest(complete, 0)
        assert drop.file is not None
        assert drop_digest(read_drop_file(drop.file), 0) == drop_digest(record, 0)
    assert [r.first_sample for r in survey.drops[0].read().rebounds] == [7000, 9000]
    report = check(folder)
    assert (report.ok, report.damaged, report.notes, report.closed) == (True, (), (), True)
    assert (report.drops_acknowledged, report.drops_published) == (3, 3)


def test_a_survey_is_continued(tmp_path: Path) -> None:
    for number in range(1, 5):
        with open_survey(tmp_path, publish=True) as writer:
            assert writer.points == (() if number == 1 else ("P 1",))
            assert writer.next_number("P 1") == number
            assert writer.save_drop(record_of(number)) == number
            assert writer.recovery.ok
            assert writer.recovery.actions == ()
    report = check(tmp_path)
    assert report.ok
    assert report.drops_published == 4
    assert len(read_survey(tmp_path).drops) == 4


def test_a_drop_is_never_recorded_twice(tmp_path: Path) -> None:
    with open_survey(tmp_path, publish=True) as writer:
        assert writer.save_drop(record_of(1)) == 1
        assert writer.save_drop(record_of(1)) == 1
        assert writer.find_key("7/1/1") == 1
    with open_survey(tmp_path, publish=True) as writer:
        assert writer.save_drop(record_of(1)) == 1
        assert writer.drops_acknowledged == 1
        same_number = DropRecord("P 1", record_of(1).drop)
        with pytest.raises(RecordingError, match=r"drop P 1/1: .* the next free number is 2"):
            writer.save_drop(same_number)
        with pytest.raises(RecordingError, match="key of a drop: expected text, got int"):
            writer.save_drop(DropRecord("P 1", record_of(2).drop, metadata={"key": 3}))
    assert len(read_survey(tmp_path).drops) == 1


def test_a_rebound_after_publication_is_read(tmp_path: Path) -> None:
    with open_survey(tmp_path, publish=True) as writer:
        writer.save_drop(record_of(1))
        writer.save_rebound(1, a_rebound(7000))
    with open_survey(tmp_path, publish=True) as writer:
        writer.save_rebound(1, a_rebound(9000))
    drop = read_survey(tmp_path).drops[0]
    assert drop.file is not None
    assert [r.first_sample for r in read_drop_file(drop.file).rebounds] == [7000]
    assert [r.first_sample for r in drop.read().rebounds] == [7000, 9000]
    assert recover(tmp_path, jobs=Jobs(0)).actions == ()
    assert check(tmp_path).ok


def test_missing_drops_and_points_are_refused(tmp_path: Path) -> None:
    with open_survey(tmp_path, publish=True) as writer:
        writer.save_drop(record_of(1))
        with pytest.raises(RecordingError, match="recorded drop, got 9"):
            writer.save_rebound(9, a_rebound(1))
        with pytest.raises(RecordingError, match="recorded drop, got 9"):
            writer.save_result(9, {})
        with pytest.raises(RecordingError, match="one of the survey's points, got 'Q'"):
            writer.edit("note", "x", point="Q")
        with pytest.raises(RecordingError, match="expected a point or the number"):
            writer.edit("note", "x")
        with pytest.raises(RecordingError, match="expected one of note, target"):
            writer.edit("delete", number=1)
        with pytest.raises(RecordingError, match="at most 65536 bytes"):
            writer.edit("note", "x" * 70_000, number=1)
    with pytest.raises(RecordingError, match="expected an open survey, got a closed one"):
        writer.save_drop(record_of(2))
    for action in (read_survey, check, recover):
        with pytest.raises(RecordingError, match="expected the folder of a survey, got no survey"):
            action(tmp_path / "none")


def test_a_newer_survey_is_not_touched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pfwd_device.recording.recovery.FORMAT_VERSION", 3)
    with open_survey(tmp_path, publish=True) as writer:
        writer.save_drop(record_of(1))
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file() and p.suffix}
    for action in (read_survey, check, recover, open_survey):
        with pytest.raises(RecordingError, match=r"format version 2, got 3"):
            action(tmp_path)
    assert {p: p.read_bytes() for p in before if p.name != "writer.txt"} == {
        p: data for p, data in before.items() if p.name != "writer.txt"
    }


class SmallDisk(Storage):
    free = 0

    def free_bytes(self, path: Path) -> int:
        return self.free


def test_a_filling_disk_is_announced_then_refused(tmp_path: Path) -> None:
    disk = SmallDisk()
    disk.free = 10**9
    with open_survey(tmp_path, publish=True, storage=disk) as writer:
        writer.save_drop(record_of(1, 32))  # takes 4096 bytes in all
        assert writer.scarce_drops() is None
        writer.check_room()
        disk.free = 199 * 10**6
        assert writer.scarce_drops() == writer.free_drops() == 199 * 10**6 // 4096
        disk.free = 15 * 4096
        with pytest.raises(StorageFull, match="room for 20 drops before arming, got room for"):
            writer.check_room()


def test_the_reserve_is_of_real_blocks(tmp_path: Path) -> None:
    with open_survey(tmp_path, reserve_bytes=2**20):
        status = (tmp_path / "reserve").stat()
        assert status.st_size == 2**20
        if hasattr(status, "st_blocks"):
            assert status.st_blocks * 512 >= 2**20
