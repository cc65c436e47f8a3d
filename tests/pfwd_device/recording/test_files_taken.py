"""Files of a survey that others delete, replace, move or cut while it is being written."""

import contextlib
import errno
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from pfwd_device.errors import RecordingError, SurveyLocked
from pfwd_device.jobs import Jobs
from pfwd_device.recording import (
    SpareFolder,
    Storage,
    SurveyNotSafe,
    SurveyWriter,
    check,
    read_drop_file,
    read_survey,
    recover,
)
from pfwd_device.recording.drop_file import drop_digest
from pfwd_device.recording.storage import MAX_TRUSTED_WRITE_S
from tests.pfwd_device.recording.records import (
    a_rebound,
    assert_recovered,
    digests,
    flip,
    interrupted_recoveries,
    journal_of,
    make_survey,
    open_survey,
    record_of,
    save,
)

pytestmark = pytest.mark.posix  # Windows refuses to delete, rename or replace a file that is open


def replace_by_copy(path: Path) -> None:
    """Rename a copy over a file, as editors, restores and synchronising programs do."""
    copy = path.with_name("copy")
    shutil.copy2(path, copy)
    os.replace(copy, path)


def replace_folder_by_copy(path: Path) -> None:
    copy = path.with_name("copy")
    shutil.copytree(path, copy, ignore=shutil.ignore_patterns("*.lock", ".*"))
    while copy.exists():
        delete(path)
        with contextlib.suppress(OSError):  # the publisher was faster and has made a file
            os.rename(copy, path)


def delete(path: Path) -> None:
    """Away at once: the publisher may be at its next file."""
    os.rename(path, path.with_name("deleted"))
    shutil.rmtree(path.with_name("deleted"))


def write_over(path: Path, at: int, length: int) -> None:
    """Other bytes in place, the length as it was."""
    with path.open("r+b") as stream:
        stream.seek(at)
        old = stream.read(length)
        assert len(old) == length
        stream.seek(at)
        stream.write(bytes(byte ^ 0x15 for byte in old))


ATTACKS: dict[str, Callable[[Path], None]] = {
    "folder deleted": delete,
    "folder moved away": lambda survey: os.rename(survey, survey.with_name("moved")),
    "folder replaced by its copy": replace_folder_by_copy,
    "journal replaced": lambda survey: replace_by_copy(journal_of(survey)),
    "journal deleted": lambda survey: (journal_of(survey)).unlink(),
    "journal's folder deleted": lambda survey: delete(survey / "journal"),
    "ledger replaced": lambda survey: replace_by_copy(survey / "acknowledged.txt"),
    "ledger deleted": lambda survey: (survey / "acknowledged.txt").unlink(),
    "lock deleted": lambda survey: (survey / "survey.lock").unlink(),
    "lock replaced": lambda survey: replace_by_copy(survey / "survey.lock"),
    "journal cut": lambda survey: os.truncate(journal_of(survey), 1000),
    "journal emptied": lambda survey: os.truncate(journal_of(survey), 0),
    "ledger cut": lambda survey: os.truncate(survey / "acknowledged.txt", 60),
    "journal written to": lambda survey: append(journal_of(survey), b"x" * 500),
    "journal written over": lambda survey: write_over(journal_of(survey), 1000, 300),
    "journal's first record written over": (lambda survey: write_over(journal_of(survey), 0, 60)),
    "ledger written over": lambda survey: write_over(survey / "acknowledged.txt", 70, 20),
    "ledger written to": lambda survey: append(survey / "acknowledged.txt", b"1 2 3\n"),
    "drop files deleted": lambda survey: shutil.rmtree(survey / "drops", ignore_errors=True),
}


def append(path: Path, data: bytes) -> None:
    with path.open("ab") as stream:
        stream.write(data)


def open_writer(folder: Path, spare: SpareFolder | None = None) -> SurveyWriter:
    return open_survey(folder, spare=spare, publish=True)


def everywhere(survey: Path, spare: SpareFolder) -> dict[int, str]:
    """Return the digests of the drops that are in the survey's folder or in the spare folder."""
    drops: dict[int, str] = {}
    for folder in [survey, *(spare.root.iterdir() if spare.root.exists() else ())]:
        with contextlib.suppress(RecordingError):  # there is no survey any more
            for drop in read_survey(folder).drops:
                with contextlib.suppress(RecordingError):  # a damaged drop
                    drops[drop.number] = drop_digest(drop.read(), 0)
    return drops


REPAIRED = ("drop files deleted", "lock deleted", "lock replaced")
"""Attacks that endanger no record: drop files are remade, and a new lock is locked."""


@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.parametrize(
    ("publish", "killed"),
    [
        *((False, True), (True, False)),
        *(pytest.param(each, each, marks=pytest.mark.slow) for each in (False, True)),
    ],
)
def test_no_acknowledged_drop_is_lost(
    tmp_path: Path, survey: Path, spare: SpareFolder, attack: str, publish: bool, killed: bool
) -> None:
    expected = {}
    with open_writer(survey, spare) as writer:
        for number in range(1, 9):
            if number in (4, 7):
                with contextlib.suppress(FileNotFoundError):  # it is away since the first time
                    ATTACKS[attack](survey)
                shutil.rmtree(tmp_path / "moved", ignore_errors=True)
            expected[number] = save(writer, number)
            if publish:
                writer.publish(number)
            if number == 2:
                writer.edit("note", "wet", number=1)
                writer.save_result(1, {"modulus_pa": 45e6})
            # Acknowledged is what others can find, at every moment.
            assert everywhere(survey, spare) == expected
            assert read_all(writer) == expected
        if killed:
            writer._records.close()  # as the system does it, without writing
    reports = [report for report in writer.take_reports() if isinstance(report, SurveyNotSafe)]
    assert bool(reports) == (attack not in REPAIRED)
    assert all("NOT SAFE" in report.text and not report.lost for report in reports)
    assert_recovered(survey, spare, expected)
    first = read_survey(survey).drops[0]
    assert (first.notes, len(first.results)) == (("wet",), 1)


def read_all(writer: SurveyWriter) -> dict[int, str]:
    return {drop.number: drop_digest(drop.read(), 0) for drop in writer.contents().drops}


@pytest.mark.parametrize("attack", ["folder deleted", "journal replaced", "journal cut"])
def test_deleted_drops_are_in_the_spare_folder(
    survey: Path, spare: SpareFolder, attack: str
) -> None:
    with open_writer(survey, spare) as writer:
        expected = {number: save(writer, number) for number in (1, 2, 3)}
        ATTACKS[attack](survey)
        writer.maintain()
        (report,) = writer.take_reports()
        assert report.drops == (0 if attack == "journal replaced" else 3)  # the copy is intact
        assert everywhere(survey, spare) == expected
        writer.maintain()
        assert writer.take_reports() == []


@pytest.mark.parametrize("attack", ["folder deleted", "journal written over"])
def test_without_a_spare_folder_no_drop_is_acknowledged_any_more(survey: Path, attack: str) -> None:
    with open_writer(survey) as writer:
        save(writer, 1)
        ATTACKS[attack](survey)
        for _ in range(2):
            writer.maintain()
        (report,) = writer.take_reports()
        assert report.spare is None
        with pytest.raises(RecordingError, match=f"{survey}: "):
            writer.save_drop(record_of(2))
        assert writer.drops_acknowledged == 1


class TickingStorage(Storage):
    """Stamps that say nothing: another one at every look, as if somebody wrote all the time."""

    looks = 0

    def stamp(self, descriptor: int) -> tuple[int, int]:
        self.looks += 1
        return self.looks, self.looks


class CoarseStorage(Storage):
    """Times in steps of 2 s, as FAT has them."""

    def stamp(self, descriptor: int) -> tuple[int, int]:
        step = 2 * 10**9
        first, second = super().stamp(descriptor)
        return first // step * step, second // step * step


@pytest.mark.parametrize("storage", [TickingStorage(), CoarseStorage()])
def test_times_of_files_alone_raise_no_alarm(survey: Path, storage: Storage) -> None:
    with open_survey(survey, storage=storage, publish=True) as writer:
        for number in range(1, 6):
            save(writer, number)
            writer.publish(number)
            writer.maintain()
        assert writer.take_reports() == []
    assert check(survey).ok
    assert len(list((survey / "journal").iterdir())) == 1


def test_records_lost_before_raise_no_alarm(survey: Path) -> None:
    """Records that nobody could restore are named by every check, not by every drop."""
    make_survey(survey, extras=False)
    shutil.rmtree(survey / "drops")
    flip(journal_of(survey), 1000)
    with open_writer(survey) as writer:
        assert not writer.recovery.ok
        os.utime(journal_of(survey), (1, 1))
        save(writer, 4)
        writer.maintain()
        assert writer.take_reports() == []


def test_an_overwritten_earlier_record_is_reported(survey: Path, spare: SpareFolder) -> None:
    """It is not in memory any more: what cannot be read is named at once."""
    with open_writer(survey) as writer:
        for number in (1, 2, 3):
            save(writer, number)
    with open_writer(survey, spare) as writer:
        write_over(journal_of(survey), 1000, 300)
        save(writer, 4)
        (report,) = writer.take_reports()
        assert "overwritten by another program" in report.text
        assert report.lost == ("drop P 1/1",)
    assert recover(survey, spare=spare).ok  # from its file
    assert check(survey, spare=spare).ok


def test_files_deleted_before_the_close_are_detected(survey: Path, spare: SpareFolder) -> None:
    with open_writer(survey, spare) as writer:
        expected = {1: save(writer, 1)}
        writer.save_result(1, {"modulus_pa": 45e6})
        shutil.rmtree(survey)
    assert not survey.exists()
    assert everywhere(survey, spare) == expected
    assert_recovered(survey, spare, expected)
    assert len(read_survey(survey).drops[0].results) == 1


def test_older_copies_are_completed(tmp_path: Path, survey: Path, spare: SpareFolder) -> None:
    """A restored backup; the records after it must not be believed to be intact."""
    with open_writer(survey, spare) as writer:
        expected = {1: save(writer, 1)}
        shutil.copytree(survey, tmp_path / "backup")
        expected |= {number: save(writer, number) for number in (2, 3, 4)}
        for name in ("journal/0001.pfwdj", "acknowledged.txt"):
            os.replace(tmp_path / "backup" / name, survey / name)
        expected[5] = save(writer, 5)
        assert everywhere(survey, spare) == expected
    with open_writer(survey, spare) as writer:  # the next start
        assert writer.recovery.ok
    assert digests(survey) == expected
    assert check(survey, spare=spare).ok


def test_a_cut_journal_is_saved(
    survey: Path, spare: SpareFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond what memory holds, what cannot be read is named at once, not later."""
    from pfwd_device.recording import record_log

    monkeypatch.setattr(record_log, "RECENT_BYTES", 12_000)
    with open_writer(survey, spare) as writer:
        for number in range(1, 11):
            save(writer, number)
        os.truncate(journal_of(survey), 0)
        writer.maintain()
        (report,) = writer.take_reports()
        present = set(everywhere(survey, spare))
        assert {3, 10} & present == {10}
        named = {f"drop P 1/{number}" for number in range(1, 11) if number not in present}
        assert named <= set(report.lost)


def test_another_survey_in_the_place_is_not_written_to(tmp_path: Path, spare: SpareFolder) -> None:
    survey, stranger = tmp_path / "survey", tmp_path / "other"
    with open_writer(stranger) as writer:
        theirs = {1: save(writer, 1)}
    with open_writer(survey, spare) as writer:
        expected = {1: save(writer, 1)}
        os.rename(survey, tmp_path / "moved")
        os.rename(stranger, survey)
        before = (journal_of(survey)).read_bytes()
        expected[2] = save(writer, 2)
        assert (journal_of(survey)).read_bytes() == before
    assert digests(survey) == theirs
    assert check(survey, spare=spare).ok
    assert_recovered(tmp_path / "moved", spare, expected)


def test_a_second_writer_is_refused_without_the_lock_file(survey: Path) -> None:
    with open_writer(survey) as writer:
        expected = {1: save(writer, 1)}
        (survey / "survey.lock").unlink()
        for action in (SurveyWriter.open, recover):
            with pytest.raises(SurveyLocked, match="has the journal open"):
                action(survey)
        assert "a program is writing the survey" in check(survey).notes
        expected[2] = save(writer, 2)
    assert digests(survey) == expected
    assert check(survey).ok


SECOND = """
import sys
import numpy as np
from tests.campaigns.power_loss import make_record
from pfwd_device.recording import SurveyWriter
with SurveyWriter.open(sys.argv[1], publish=False, reserve_bytes=0) as writer:
    print(writer.save_drop(make_record(9, np.random.default_rng(9))), flush=True)
    sys.stdin.readline()
"""


def test_a_second_writer_sends_the_first_to_the_spare(survey: Path, spare: SpareFolder) -> None:
    """Lock and journal replaced: nothing keeps the second one out, and it is not written over."""
    with open_writer(survey, spare) as writer:
        expected = {1: save(writer, 1)}
        replace_by_copy(journal_of(survey))
        (survey / "survey.lock").unlink()
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        command = [sys.executable, "-c", SECOND, str(survey)]
        with subprocess.Popen(command, cwd=Path(__file__).parents[3], **pipes) as second:
            assert second.stdout.readline() == "2\n"
            expected[3] = save(writer, 2)
            second.communicate("\n")
    expected[2] = drop_digest(record_of(9), 0)
    assert_recovered(survey, spare, expected)


def test_a_journal_with_a_second_name_is_not_appended_to(tmp_path: Path, survey: Path) -> None:
    """A backup made of links has the journal's own file: it must stay as it was made."""
    with open_writer(survey) as writer:
        save(writer, 1)
        os.link(journal_of(survey), tmp_path / "backup")
        before = (tmp_path / "backup").read_bytes()
        save(writer, 2)
        assert writer.take_reports() == []
    assert (tmp_path / "backup").read_bytes() == before
    assert check(survey).ok


def test_a_failing_close_leaves_no_lock(tmp_path: Path) -> None:
    class Failing(Storage):
        def close(self, descriptor: int) -> None:
            super().close(descriptor)
            if failing:
                raise OSError(5, "input/output error")

    failing: list[bool] = []
    writer = open_survey(tmp_path / "s", storage=Failing())
    save(writer, 1)
    failing.append(True)
    writer.close()
    failing.clear()
    with open_survey(tmp_path / "s") as second:
        assert second.drops_acknowledged == 1


@pytest.mark.parametrize("attack", ["cut", "written over"])
def test_a_journal_that_changes_is_noticed(survey: Path, spare: SpareFolder, attack: str) -> None:
    """Times of the file after the own write do not show the write of the other program."""

    class Changing(Storage):
        def pwrite(self, descriptor: int, data: memoryview, offset: int) -> int:
            if attacks == ["written over"]:
                attacks.clear()
                write_over(journal_of(survey), 1000, 300)
                time.sleep(2 * MAX_TRUSTED_WRITE_S)
            return super().pwrite(descriptor, data, offset)

        def sync(self, descriptor: int) -> None:
            super().sync(descriptor)
            if attacks == ["cut"] and os.fstat(descriptor).st_size > 2000:
                attacks.clear()
                os.truncate(journal_of(survey), 0)

    attacks: list[str] = []
    with open_survey(survey, storage=Changing(), spare=spare) as writer:
        expected = {1: save(writer, 1)}
        attacks.append(attack)
        expected[2] = save(writer, 2)
        assert attacks == []
        assert everywhere(survey, spare) == expected
    assert_recovered(survey, spare, expected)


@pytest.mark.parametrize("every", [9, pytest.param(1, marks=pytest.mark.slow)])
def test_an_interrupted_merge_is_repeated(tmp_path: Path, every: int) -> None:
    run, survey = tmp_path / "run", tmp_path / "run" / "survey"
    spare = SpareFolder(run / "spare")
    with open_survey(survey, spare=spare) as writer:
        expected = {number: save(writer, number) for number in (1, 2, 3, 4)}
        os.truncate(journal_of(survey), 9000)
        expected[5] = save(writer, 5)
    for folder in interrupted_recoveries(run, every, spare):
        second = SpareFolder(folder / "spare")
        assert recover(folder / "survey", jobs=Jobs(0), spare=second).ok
        assert digests(folder / "survey") == expected
        assert check(folder / "survey", spare=second).ok


def test_an_inaccessible_file_is_a_recording_error(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error of the system is an error of recording, which does not end a measurement."""
    exists = Path.exists

    def failing(path: Path) -> bool:
        if path.parent.name in ("results", "captures") or path.name == "acknowledged.txt":
            raise OSError(errno.ESTALE, "stale")
        return exists(path)

    with open_writer(survey) as writer:
        save(writer, 1)
        with monkeypatch.context() as patch:
            patch.setattr(Path, "exists", failing)
            with pytest.raises(RecordingError, match="stale"):
                writer.save_result(1, {"modulus_pa": 45e6})
            with pytest.raises(RecordingError, match="stale"):
                writer.open_capture("link", {})
    with monkeypatch.context() as patch:
        patch.setattr(Path, "exists", failing)
        for action in (SurveyWriter.open, recover):
            with pytest.raises(RecordingError, match="stale"):
                action(survey)
    assert check(survey).ok


def test_a_lock_that_stays_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from filelock import FileLock

    release = FileLock.release

    def failing(self: FileLock, force: bool = False) -> None:
        release(self, force)
        raise OSError(errno.EIO, "input/output error")

    writer = open_writer(tmp_path / "survey")
    save(writer, 1)
    monkeypatch.setattr(FileLock, "release", failing)
    writer.close()
    assert recover(tmp_path / "survey").ok


def test_events_and_rebounds_are_read_in_the_spare_folder(survey: Path, spare: SpareFolder) -> None:
    """Its record stands elsewhere there than in the journal that was deleted."""
    with open_writer(survey, spare) as writer:
        save(writer, 1)
        writer.note_event("gap", {"samples": 7})
        writer.save_rebound(1, a_rebound(4242))
        (journal_of(survey)).unlink()
        save(writer, 2)
        writer.save_rebound(2, a_rebound(4242))
        contents = writer.contents()
        assert [event["details"] for event in contents.events] == [{"samples": 7}]
        assert [len(drop.read().rebounds) for drop in contents.drops] == [1, 1]
    assert recover(survey, spare=spare).ok
    for drop in read_survey(survey).drops:
        assert drop.file is not None
        for record in (drop.read(), read_drop_file(drop.file)):
            assert [rebound.first_sample for rebound in record.rebounds] == [4242]


def test_an_earlier_segment_is_held_open(tmp_path: Path, survey: Path, spare: SpareFolder) -> None:
    """It was written by a program before, so that nothing of it is in memory."""
    with open_writer(survey) as writer:
        expected = {1: save(writer, 1)}
    os.link(journal_of(survey), tmp_path / "backup")
    with open_writer(survey) as writer:
        expected[2] = save(writer, 2)
    assert (survey / "journal" / "0002.pfwdj").exists()
    with open_writer(survey, spare) as writer:
        (tmp_path / "backup").unlink()
        (journal_of(survey)).unlink()
        expected[3] = save(writer, 3)
        (survey / "journal" / "0002.pfwdj").unlink()
        expected[4] = save(writer, 4)
        assert everywhere(survey, spare) == expected
    assert_recovered(survey, spare, expected)


@pytest.mark.parametrize("is_last", [True, False], ids=["by the close", "by the check"])
def test_a_survey_moved_at_the_end_stays_so(
    tmp_path: Path, spare: SpareFolder, is_last: bool
) -> None:
    survey, moved = tmp_path / "survey", tmp_path / "moved"
    with open_writer(survey, spare) as writer:
        expected = {number: save(writer, number) for number in (1, 2)}
        survey.rename(moved)
        assert writer.scarce_drops() is None  # a folder that is gone is no full disk
        if not is_last:
            writer.maintain()
            expected[3] = save(writer, 3)
    (report,) = writer.take_reports()
    assert "was deleted or moved" in report.text
    assert not survey.exists()
    assert_recovered(moved, spare, expected)
