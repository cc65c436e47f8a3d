"""Damage of single files: seen by check, survived by readers, mended where a second copy is."""

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from pfwd_device.errors import RecordingError
from pfwd_device.jobs import Jobs
from pfwd_device.recording import DropRecord, RecoveryReport, Storage, check, read_survey, recover
from pfwd_device.recording.drop_file import drop_digest
from pfwd_device.recording.files import set_aside
from pfwd_device.recording.framing import RecordKind
from pfwd_device.recording.index import build_index
from pfwd_device.recording.journal import open_segment
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.lock import SurveyLock
from pfwd_device.recording.record_log import RecordFiles, RecordLog
from tests.pfwd_device.recording.records import (
    a_rebound,
    flip,
    frames_of,
    journal_of,
    make_survey,
    open_survey,
    record_of,
)

# Locks, the holder's name and the reserve say nothing of what was recorded.
UNIMPORTANT = {"survey.lock", "publish.lock", "writer.txt", "reserve"}


def content(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in UNIMPORTANT
    }


def mend(folder: Path) -> RecoveryReport:
    return recover(folder, jobs=Jobs(0))


def readable(folder: Path) -> dict[int, str]:
    """Digests of the drops that can be read."""
    digests = {}
    for drop in read_survey(folder).drops:
        try:
            record = drop.read()
        except RecordingError:
            continue
        digests[drop.number] = drop_digest(record, 0)
    return digests


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    """A survey of one drop in a few hundred bytes, published, closed."""
    with open_survey(tmp_path / "tiny", publish=True) as writer:
        writer.save_drop(record_of(1, 2))
        writer.save_result(1, {"a": 1})
        writer.open_capture("x", {}).write("from", b"abc")
    return tmp_path / "tiny"


def damages(data: bytes, step: int) -> Iterator[bytes]:
    for position in range(0, len(data), step):
        broken = bytearray(data)
        broken[position] ^= 1 << position % 8
        yield bytes(broken)
        yield data[:position]
    yield data + b"\0"
    yield data[:-1]


@pytest.mark.parametrize("step", [13, pytest.param(1, marks=pytest.mark.slow)])
def test_check_sees_any_damage_of_any_file(tiny: Path, step: int) -> None:
    assert check(tiny).ok
    files = content(tiny)
    folders = {name.split("/")[0] for name in files}
    assert folders == {"journal", "acknowledged.txt", "drops", "results", "captures"}
    for name, data in files.items():
        for broken in damages(data, step if len(data) < 5000 else 997):
            (tiny / name).write_bytes(broken)
            report = check(tiny)
            assert report.damaged, name
            assert not report.ok
        (tiny / name).unlink()
        assert check(tiny).damaged
        (tiny / name).write_bytes(data)
        assert check(tiny).ok


@pytest.mark.parametrize("step", [127, pytest.param(5, marks=pytest.mark.slow)])
def test_damage_loses_no_published_drop(tmp_path: Path, step: int) -> None:
    original = tmp_path / "survey"
    digests = make_survey(tmp_path / "survey", drops=2)
    copy = tmp_path / "copy"
    for name, data in content(original).items():
        # A drop file is whole or not, wherever it was hit.
        for broken in damages(data, 97 * step if name.endswith(".h5") else 5 * step):
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(original, copy)
            (copy / name).write_bytes(broken)
            assert readable(copy) == digests, name
            report = mend(copy)
            assert readable(copy) == digests, name
            assert not any("drop" in text and "drops" not in text for text in report.damaged), name
            after = check(copy)
            assert (after.damaged, after.drops_published) == (report.damaged, 2), name
            assert mend(copy).actions == ()
            if broken and not name.startswith(("captures", "journal")):
                # What was cut off is in a folder of its own; else it is where it was.
                moved = b"".join(path.read_bytes() for path in (copy / "damaged").iterdir())
                assert moved or broken in (copy / name).read_bytes()


def test_a_drop_lost_in_both_places_is_named(survey: Path) -> None:
    digests = make_survey(survey, drops=3)
    flip_drop(survey, 2)
    (survey / "drops" / "drop-000002.h5").unlink()
    assert any("drop P 1/2" in text for text in check(survey).damaged)
    report = mend(survey)
    assert report.damaged == ("drop P 1/2 is lost",)
    assert (report.drops_acknowledged, report.drops_published) == (3, 2)
    assert not report.ok
    assert readable(survey) == {n: d for n, d in digests.items() if n != 2}
    assert read_survey(survey).damage == ("drop P 1/2 is lost",)
    second_check = check(survey)
    assert "drop P 1/2 is lost" in second_check.damaged
    assert second_check.drops_acknowledged == 3
    with open_survey(survey) as writer:
        assert writer.next_number("P 1") == 4
        with pytest.raises(RecordingError, match="the next free number is 4"):
            writer.save_drop(DropRecord("P 1", record_of(2).drop))
        assert writer.save_drop(record_of(4)) == 4


def test_a_damaged_drop_is_restored_from_its_file(survey: Path) -> None:
    digests = make_survey(survey, drops=3)
    flip_drop(survey, 3)
    assert [drop.source for drop in read_survey(survey).drops] == ["journal", "journal", "file"]
    report = recover(survey)  # with the child process
    assert (report.recovered, report.ok) == (1, True)
    assert "drop 3 restored from its file" in report.actions
    assert {d.source for d in read_survey(survey).drops} == {"journal"}
    assert readable(survey) == digests
    assert (check(survey).ok, check(survey).recovered) == (True, 1)


def test_a_survey_of_drop_files_alone_comes_back(survey: Path) -> None:
    digests = make_survey(survey, drops=3)
    identity = read_survey(survey).survey_id
    shutil.rmtree(survey / "journal")
    (survey / "acknowledged.txt").unlink()
    assert readable(survey) == digests
    assert recover(survey, jobs=Jobs(0)).recovered == 3
    assert readable(survey) == digests
    assert read_survey(survey).survey_id == identity
    assert check(survey).ok


def test_files_that_nobody_listed_are_named(survey: Path) -> None:
    make_survey(survey)
    (survey / "drops" / ".drop-000009.h5.tmp").write_bytes(b"half")
    (survey / "results" / "drop-000002-1.json").write_bytes(b"{}")
    (survey / "drops" / "drop-000009.h5").write_bytes(b"what is this")
    names = ["drops/.drop-000009.h5.tmp", "drops/drop-000009.h5", "results/drop-000002-1.json"]
    assert [text.split()[0] for text in check(survey).damaged] == names
    mend(survey)
    assert check(survey).ok
    moved = {path.read_bytes() for path in (survey / "damaged").iterdir()}
    assert moved == {b"half", b"what is this"}
    assert [path.name for path in read_survey(survey).drops[1].results] == ["drop-000002-1.json"]


def test_records_of_another_survey_are_refused(tmp_path: Path) -> None:
    digests = make_survey(tmp_path / "survey")
    make_survey(tmp_path / "other", drops=2)
    journal = tmp_path / "survey" / "journal" / "0001.pfwdj"
    foreign = (tmp_path / "other" / "journal" / "0001.pfwdj").read_bytes()
    journal.write_bytes(journal.read_bytes() + foreign)
    assert any("a record of another survey" in text for text in check(tmp_path / "survey").damaged)
    assert readable(tmp_path / "survey") == digests
    mend(tmp_path / "survey")
    assert check(tmp_path / "survey").ok


def test_paths_in_a_journal_stay_in_the_survey(tmp_path: Path) -> None:
    make_survey(tmp_path / "survey")
    layout, storage = Layout(tmp_path / "survey"), Storage()
    index = build_index(layout)
    entries = [entry for _, entry in sorted(index.entries.items())]
    lock = SurveyLock(layout, storage)
    continued = (1, open_segment(layout, 1, storage))
    home = RecordFiles(layout, index.survey, storage, entries=entries, continued=continued)
    log = RecordLog(layout, index.survey, storage, home, lock)
    for path in ("../outside.json", "results/../../outside.json", "/etc/x", "results\\x.json"):
        log.append(RecordKind.FILE, {"path": path, "size": 2, "sha256": "0" * 64, "content": "{}"})
    log.close()
    lock.release()
    mend(tmp_path / "survey")
    assert not (tmp_path / "outside.json").exists()
    assert set(build_index(layout).files) == set(index.files)


@pytest.mark.parametrize("name", ["journal/0001.pfwdj", "acknowledged.txt"])
def test_a_file_of_noise_is_read(survey: Path, name: str) -> None:
    (survey / "journal").mkdir(parents=True)
    (survey / name).write_bytes(np.random.default_rng(0).bytes(50_000))
    assert read_survey(survey).points == ()
    assert not check(survey).ok
    mend(survey)
    with open_survey(survey) as writer:
        assert writer.save_drop(record_of(1)) == 1
    moved = [path for path in (survey / "damaged").iterdir() if path.stat().st_size == 50_000]
    assert len(moved) == 1


def flip_drop(survey: Path, number: int) -> None:
    """Turn one bit in the payload of a drop's record."""
    drop = frames_of(survey, RecordKind.DROP)[number - 1]
    flip(journal_of(survey), drop.offset + drop.length // 2, 4)


def test_no_file_in_damaged_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "results").mkdir()
    path = tmp_path / "results" / "a.json"
    for data in (b"one", b"two", b"one", b""):
        path.write_bytes(data)
        set_aside(Layout(tmp_path), Storage(), path)
        assert not path.exists()
    moved = {path.name: path.read_bytes() for path in (tmp_path / "damaged").iterdir()}
    assert moved == {"a.json": b"one", "a.json-2": b"two", "a.json-3": b""}


def samples_of_rebounds(survey: Path) -> list[list[int]]:
    drops = read_survey(survey).drops
    return [sorted(rebound.first_sample for rebound in drop.read().rebounds) for drop in drops]


@pytest.mark.parametrize("damaged", [(0,), (1,), (0, 1, 2)])
def test_rebounds_that_only_a_drop_file_holds_come_back(
    survey: Path, damaged: tuple[int, ...]
) -> None:
    """A rebound comes after its drop, in a record of its own, and the file is made after both."""
    with open_survey(survey, publish=True) as writer:
        for number in (1, 2):
            writer.save_drop(record_of(number))
        for number, sample in ((1, 7000), (1, 9000), (2, 7000)):
            writer.save_rebound(number, a_rebound(sample))
    before = samples_of_rebounds(survey)
    rebounds = frames_of(survey, RecordKind.REBOUND)
    for index in damaged:
        flip(journal_of(survey), rebounds[index].offset + 60)
    assert not check(survey).ok
    report = mend(survey)
    assert report.ok, report.damaged
    assert sum("restored from its file" in text for text in report.actions) == len(damaged)
    assert check(survey).ok
    assert samples_of_rebounds(survey) == before
    assert mend(survey).actions == ()


def test_a_lost_rebound_is_named(survey: Path) -> None:
    with open_survey(survey) as writer:
        writer.save_drop(record_of(1))
        writer.save_rebound(1, a_rebound())
    (rebound,) = frames_of(survey, RecordKind.REBOUND)
    flip(journal_of(survey), rebound.offset + 60)
    report = mend(survey)
    assert [text for text in report.damaged if "(rebound) is lost" in text]
