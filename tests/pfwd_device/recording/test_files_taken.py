"""Files of a survey that others delete, replace, move or cut while it is being written."""

import contextlib
import errno
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pfwd_device.errors import RecordingError, SurveyLocked
from pfwd_device.recording import (
    DropRecord,
    FilesRewritten,
    Rebound,
    SpareFolder,
    Storage,
    SurveyFilesRemoved,
    SurveyMovedAway,
    SurveyWriter,
    check,
    read_drop_file,
    read_survey,
    recover,
)
from pfwd_device.recording.drop_file import drop_digest
from pfwd_device.recording.publishing import InlinePublisher
from tests.campaigns.power_loss import make_record
from tests.pfwd_device.recording.records import digests, save

pytestmark = pytest.mark.posix  # Windows refuses to delete, rename or replace a file that is open


def replace_by_copy(path: Path) -> None:
    """As programs that synchronise folders do, restores and editors: a copy, renamed over it."""
    copy = path.with_name("copy")
    shutil.copy2(path, copy)
    os.replace(copy, path)


def replace_folder_by_copy(path: Path) -> None:
    copy = path.with_name("copy")
    shutil.copytree(path, copy, ignore=shutil.ignore_patterns("*.lock", ".*"))
    while copy.exists():
        delete(path)
        with contextlib.suppress(OSError):  # the writer was faster and has begun it anew
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
    "journal replaced": lambda survey: replace_by_copy(survey / "journal" / "0001.pfwdj"),
    "journal deleted": lambda survey: (survey / "journal" / "0001.pfwdj").unlink(),
    "journal's folder deleted": lambda survey: delete(survey / "journal"),
    "ledger replaced": lambda survey: replace_by_copy(survey / "acknowledged.txt"),
    "ledger deleted": lambda survey: (survey / "acknowledged.txt").unlink(),
    "lock deleted": lambda survey: (survey / "survey.lock").unlink(),
    "lock replaced": lambda survey: replace_by_copy(survey / "survey.lock"),
    "journal cut": lambda survey: os.truncate(survey / "journal" / "0001.pfwdj", 1000),
    "journal emptied": lambda survey: os.truncate(survey / "journal" / "0001.pfwdj", 0),
    "ledger cut": lambda survey: os.truncate(survey / "acknowledged.txt", 60),
    "journal written to": lambda survey: append(survey / "journal" / "0001.pfwdj", b"x" * 500),
    "journal written over": lambda survey: write_over(survey / "journal" / "0001.pfwdj", 1000, 300),
    "journal's first record written over": (
        lambda survey: write_over(survey / "journal" / "0001.pfwdj", 0, 60)
    ),
    "ledger written over": lambda survey: write_over(survey / "acknowledged.txt", 70, 20),
    "ledger written to": lambda survey: append(survey / "acknowledged.txt", b"1 2 3\n"),
    "drop files deleted": lambda survey: shutil.rmtree(survey / "drops", ignore_errors=True),
}


def append(path: Path, data: bytes) -> None:
    with path.open("ab") as stream:
        stream.write(data)


def open_writer(folder: Path) -> SurveyWriter:
    return SurveyWriter.open(folder, publisher=InlinePublisher(Storage()), reserve_bytes=0)


@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.parametrize("publish", [False, True])
def test_nothing_acknowledged_is_lost(tmp_path: Path, attack: str, publish: bool) -> None:
    survey = tmp_path / "survey"
    expected = {}
    with open_writer(survey) as writer:
        for number in range(1, 9):
            if number in (4, 7):
                ATTACKS[attack](survey)
                shutil.rmtree(tmp_path / "moved", ignore_errors=True)
            expected[number] = save(writer, number)
            if publish:
                writer.publish(number)
            if number == 2:
                writer.edit("note", "wet", number=1)
                writer.save_result(1, {"modulus_pa": 45e6})
            # Acknowledged is what others can find, at every moment.
            assert digests(survey) == {n: expected[n] for n in range(1, number + 1)}
    told = writer.take_reports()
    if attack != "drop files deleted":
        assert any(isinstance(report, SurveyFilesRemoved) for report in told)
        assert not any(r.lost for r in told if isinstance(r, FilesRewritten))
    again = recover(survey)
    assert again.ok, again.damaged
    assert check(survey).ok
    assert digests(survey) == expected
    assert read_survey(survey).drops[0].notes == ("wet",)
    assert len(read_survey(survey).drops[0].results) == 1


@pytest.mark.parametrize("attack", ["folder deleted", "journal replaced", "journal cut"])
def test_what_is_taken_away_is_put_back_before_the_next_drop(tmp_path: Path, attack: str) -> None:
    survey = tmp_path / "survey"
    with open_writer(survey) as writer:
        expected = {number: save(writer, number) for number in (1, 2, 3)}
        ATTACKS[attack](survey)
        writer.maintain()
        told = writer.take_reports()
        assert [type(report) for report in told] == [SurveyFilesRemoved, FilesRewritten]
        assert "NOT SAFE" in told[0].text
        assert digests(survey) == expected
        writer.maintain()
        assert writer.take_reports() == []


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
def test_times_of_files_alone_raise_no_alarm(tmp_path: Path, storage: Storage) -> None:
    survey = tmp_path / "survey"
    helper = InlinePublisher(storage)
    with SurveyWriter.open(survey, storage=storage, publisher=helper, reserve_bytes=0) as writer:
        for number in range(1, 6):
            save(writer, number)
            writer.publish(number)
            writer.maintain()
        assert writer.take_reports() == []
    assert check(survey).ok
    assert len(list((survey / "journal").iterdir())) == 1


def test_what_changes_times_and_no_bytes_raises_no_alarm(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    with open_writer(survey) as writer:
        save(writer, 1)
        for path in (survey / "journal" / "0001.pfwdj", survey / "acknowledged.txt"):
            os.utime(path, (1, 1))
            writer.maintain()
            path.chmod(0o600)
            writer.maintain()
            write_over(path, 10, 5)
            write_over(path, 10, 5)  # back again
            writer.maintain()
        save(writer, 2)
        assert writer.take_reports() == []
    assert len(list((survey / "journal").iterdir())) == 1


def test_what_was_lost_before_raises_no_alarm(tmp_path: Path) -> None:
    """Records that nobody could restore are named by every check, not by every drop."""
    survey = tmp_path / "survey"
    with open_writer(survey) as writer:
        for number in (1, 2, 3):
            save(writer, number)
        shutil.rmtree(survey / "drops")
    journal = survey / "journal" / "0001.pfwdj"
    for path in (survey / "drops").glob("*.h5"):
        path.unlink()
    data = bytearray(journal.read_bytes())
    data[1000] ^= 1
    journal.write_bytes(data)
    with open_writer(survey) as writer:
        assert not writer.recovery.ok
        os.utime(journal, (1, 1))
        save(writer, 4)
        writer.maintain()
        assert writer.take_reports() == []


def test_a_record_of_an_earlier_day_that_is_written_over_is_told(tmp_path: Path) -> None:
    """It is not in memory any more: what cannot be written again is named at once."""
    survey = tmp_path / "survey"
    with open_writer(survey) as writer:
        for number in (1, 2, 3):
            save(writer, number)
    with open_writer(survey) as writer:
        write_over(survey / "journal" / "0001.pfwdj", 1000, 300)
        save(writer, 4)
        taken, again = writer.take_reports()
        assert isinstance(taken, SurveyFilesRemoved)
        assert "NOT SAFE" in taken.text
        assert "overwritten by another program" in taken.text
        assert isinstance(again, FilesRewritten)
        assert again.lost == ("drop P 1/1",)
    assert recover(survey).ok  # from its file
    assert check(survey).ok


def test_a_close_puts_back_what_was_taken_after_the_last_drop(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    with open_writer(survey) as writer:
        expected = {1: save(writer, 1)}
        writer.save_result(1, {"modulus_pa": 45e6})
        shutil.rmtree(survey)
    assert digests(survey) == expected
    assert check(survey).ok


def test_older_copies_of_journal_and_ledger_are_completed(tmp_path: Path) -> None:
    """As a restore of a backup does; the records after it must not be believed to be whole."""
    survey = tmp_path / "survey"
    with open_writer(survey) as writer:
        expected = {1: save(writer, 1)}
        shutil.copytree(survey, tmp_path / "backup")
        expected |= {number: save(writer, number) for number in (2, 3, 4)}
        for name in ("journal/0001.pfwdj", "acknowledged.txt"):
            os.replace(tmp_path / "backup" / name, survey / name)
        expected[5] = save(writer, 5)
        assert digests(survey) == expected
    assert check(survey).ok


def test_a_cut_journal_is_written_again_from_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond what memory holds, what cannot be written again is named at once, not later."""
    from pfwd_device.recording import record_log

    survey = tmp_path / "survey"
    monkeypatch.setattr(record_log, "RECENT_BYTES", 12_000)
    with open_writer(survey) as writer:
        for number in range(1, 11):
            save(writer, number)
        os.truncate(survey / "journal" / "0001.pfwdj", 0)
        writer.maintain()
        (lost,) = [r.lost for r in writer.take_reports() if isinstance(r, FilesRewritten)]
        there = set(digests(survey))
        assert {3, 10} & there == {10}
        named = {f"drop P 1/{number}" for number in range(1, 11) if number not in there}
        assert named <= set(lost)
    assert not check(survey).ok


def test_another_survey_in_the_place_is_not_written_to(tmp_path: Path) -> None:
    survey, other = tmp_path / "survey", tmp_path / "other"
    with open_writer(other) as writer:
        theirs = {1: save(writer, 1)}
    with open_writer(survey) as writer:
        save(writer, 1)
        os.rename(survey, tmp_path / "moved")
        os.rename(other, survey)
        with pytest.raises(RecordingError, match="records of another program"):
            writer.save_drop(make_record(2, np.random.default_rng(2)))
    assert digests(survey) == theirs
    assert check(survey).ok


def test_a_second_writer_is_kept_out_though_the_lock_is_gone(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
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


def test_the_first_writer_stops_where_a_second_one_goes_on(tmp_path: Path) -> None:
    """Lock and journal replaced: nothing keeps the second one out, and it is not written over."""
    survey = tmp_path / "survey"
    with open_writer(survey) as writer:
        save(writer, 1)
        replace_by_copy(survey / "journal" / "0001.pfwdj")
        (survey / "survey.lock").unlink()
        with subprocess.Popen(
            [sys.executable, "-c", SECOND, str(survey)],
            cwd=Path(__file__).parents[3],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        ) as second:
            assert second.stdout is not None
            assert second.stdout.readline() == "2\n"
            with pytest.raises(SurveyLocked, match=f"got another: pid {second.pid}"):
                writer.save_drop(make_record(2, np.random.default_rng(2)))
            second.communicate("\n")
    theirs = drop_digest(make_record(9, np.random.default_rng(9)), 0)
    assert digests(survey)[2] == theirs
    assert recover(survey).ok


def test_a_journal_that_others_have_written_to_is_left_alone(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    with open_writer(survey) as writer:
        save(writer, 1)
        append(survey / "journal" / "0001.pfwdj", b"somebody's")
        before = (survey / "journal" / "0001.pfwdj").read_bytes()
        save(writer, 2)
        assert (survey / "journal" / "0001.pfwdj").read_bytes() == before
        assert (survey / "journal" / "0002.pfwdj").exists()


def test_a_journal_with_a_second_name_is_not_appended_to(tmp_path: Path) -> None:
    """A backup made of links has the journal's own file: it must stay as it was made."""
    survey = tmp_path / "survey"
    with open_writer(survey) as writer:
        save(writer, 1)
        os.link(survey / "journal" / "0001.pfwdj", tmp_path / "backup")
        before = (tmp_path / "backup").read_bytes()
        save(writer, 2)
        assert writer.take_reports() == []
    assert (tmp_path / "backup").read_bytes() == before
    assert check(survey).ok


def test_someone_who_takes_the_files_away_again_and_again_is_told_of(tmp_path: Path) -> None:
    survey = tmp_path / "survey"

    class Fast(Storage):
        def sync(self, descriptor: int) -> None:
            super().sync(descriptor)
            if taking:
                shutil.rmtree(survey / "journal", ignore_errors=True)

    taking: list[bool] = []
    with SurveyWriter.open(survey, storage=Fast(), publish=False, reserve_bytes=0) as writer:
        save(writer, 1)
        taking.append(True)
        with pytest.raises(RecordingError):
            writer.save_drop(make_record(2, np.random.default_rng(2)))
        taking.clear()
        assert writer.save_drop(make_record(2, np.random.default_rng(2))) == 2
    assert len(digests(survey)) == 2
    assert check(survey).ok


def test_a_survey_is_not_begun_on_another_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A memory stick that was pulled: what is made in its place would be hidden by it later."""
    from pfwd_device.recording import record_log

    survey = tmp_path / "stick" / "survey"
    with open_writer(survey) as writer:
        save(writer, 1)
        shutil.rmtree(survey)
        monkeypatch.setattr(record_log, "_disk_of", lambda folder: -1)
        with pytest.raises(RecordingError, match="on another disk than before"):
            writer.save_drop(make_record(2, np.random.default_rng(2)))
        assert not survey.exists()


def test_a_descriptor_that_cannot_be_closed_leaves_no_lock(tmp_path: Path) -> None:
    class Failing(Storage):
        def close(self, descriptor: int) -> None:
            super().close(descriptor)
            if failing:
                raise OSError(5, "input/output error")

    failing: list[bool] = []
    writer = SurveyWriter.open(tmp_path / "s", storage=Failing(), publish=False, reserve_bytes=0)
    save(writer, 1)
    failing.append(True)
    writer.close()
    failing.clear()
    with SurveyWriter.open(tmp_path / "s", publish=False, reserve_bytes=0) as again:
        assert again.drops_acknowledged == 1


def test_the_file_of_a_drop_is_made_again(
    tmp_path: Path, new_record: Callable[[int], DropRecord]
) -> None:
    survey = tmp_path / "survey"
    with open_writer(survey) as writer:
        for number in (1, 2):
            writer.save_drop(new_record(number))
            writer.publish(number)
        while not (survey / "drops" / "drop-000002.h5").exists():
            assert writer.publishing_failures == {}
        delete(survey)
        writer.save_drop(new_record(3))
    assert sorted(path.name for path in (survey / "drops").glob("*.h5")) == [
        f"drop-00000{number}.h5" for number in (1, 2, 3)
    ]
    assert check(survey).ok


def test_a_journal_that_is_cut_while_a_record_is_written(tmp_path: Path) -> None:
    survey = tmp_path / "survey"

    class Cut(Storage):
        def sync(self, descriptor: int) -> None:
            super().sync(descriptor)
            if cuts and os.fstat(descriptor).st_size > 2000:
                cuts.pop()
                os.truncate(survey / "journal" / "0001.pfwdj", 0)

    cuts: list[bool] = []
    with SurveyWriter.open(survey, storage=Cut(), publish=False, reserve_bytes=0) as writer:
        expected = {1: save(writer, 1)}
        cuts.append(True)
        expected[2] = save(writer, 2)
        assert cuts == []
        assert digests(survey) == expected
    assert check(survey).ok


@pytest.mark.parametrize("number", [errno.EIO, errno.ESTALE])
def test_a_file_that_cannot_be_looked_at_is_refused_in_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    """What the system says of a failing disk ends no measurement: it is an error of recording."""
    survey = tmp_path / "survey"
    exists = Path.exists

    def failing(path: Path) -> bool:
        if path.parent.name in ("results", "captures") or path.name == "acknowledged.txt":
            raise OSError(number, os.strerror(number))
        return exists(path)

    with open_writer(survey) as writer:
        save(writer, 1)
        with monkeypatch.context() as patch:
            patch.setattr(Path, "exists", failing)
            with pytest.raises(RecordingError, match=os.strerror(number)):
                writer.save_result(1, {"modulus_pa": 45e6})
            with pytest.raises(RecordingError, match=os.strerror(number)):
                writer.open_capture("link", {})
    with monkeypatch.context() as patch:
        patch.setattr(Path, "exists", failing)
        for action in (SurveyWriter.open, recover):
            with pytest.raises(RecordingError, match=os.strerror(number)):
                action(survey)
    assert check(survey).ok


def test_a_lock_that_cannot_be_released_is_no_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_a_rebound_that_was_written_again_is_in_its_drop_s_file(tmp_path: Path) -> None:
    """Its record stands elsewhere in the new journal than in the one that was deleted."""
    survey = tmp_path / "survey"
    with open_writer(survey) as writer:
        save(writer, 1)
        writer.note_event("gap", {"samples": 7})
        writer.save_rebound(1, Rebound(0.4, 900.0, 4242, np.ones((4, 3), np.int32)))
        (survey / "journal" / "0001.pfwdj").unlink()
        save(writer, 2)
        writer.publish(1)
    read = read_survey(survey)
    assert [event["details"] for event in read.events] == [{"samples": 7}]
    assert read.drops[0].file is not None
    for record in (read.drops[0].read(), read_drop_file(read.drops[0].file)):
        assert [rebound.first_sample for rebound in record.rebounds] == [4242]


def test_an_earlier_segment_is_held_open_too(tmp_path: Path) -> None:
    """It was written by a program before, so that nothing of it is in memory."""
    survey = tmp_path / "survey"

    def opened() -> SurveyWriter:
        return SurveyWriter.open(survey, publish=False, reserve_bytes=0)

    with opened() as writer:
        expected = {1: save(writer, 1)}
    os.link(survey / "journal" / "0001.pfwdj", tmp_path / "backup")
    with opened() as writer:
        expected[2] = save(writer, 2)
    assert (survey / "journal" / "0002.pfwdj").exists()
    with opened() as writer:
        (survey / "journal" / "0001.pfwdj").unlink()
        (tmp_path / "backup").unlink()
        expected[3] = save(writer, 3)
        # The segment in hand is what is looked at, so that it has to go as well.
        (survey / "journal" / "0002.pfwdj").unlink()
        expected[4] = save(writer, 4)
    assert check(survey).ok
    assert digests(survey) == expected


@pytest.mark.parametrize("last_check", [True, False], ids=["seen by the last check", "by the end"])
def test_a_survey_that_is_moved_away_at_the_end_is_not_begun_anew(
    tmp_path: Path, last_check: bool
) -> None:
    survey, spare = tmp_path / "survey", SpareFolder(tmp_path / "spare")
    publisher = InlinePublisher(Storage())
    with SurveyWriter.open(survey, publisher=publisher, reserve_bytes=0, spare=spare) as writer:
        expected = {number: save(writer, number) for number in (1, 2)}
        writer.expect_end()
        survey.rename(tmp_path / "moved")
        assert writer.scarce_drops() is None  # a folder that is gone is no full disk
        if last_check:
            writer.maintain()
            writer.maintain()
            assert [type(report) for report in writer.take_reports()] == [SurveyMovedAway]
            with pytest.raises(RecordingError, match="moved away while the session ended"):
                writer.save_result(1, {"modulus_pa": 45e6})
            with pytest.raises(RecordingError, match="moved away while the session ended"):
                writer.note_event("lost")
    told = writer.take_reports()
    assert [type(report) for report in told] == ([] if last_check else [SurveyMovedAway])
    assert not survey.exists()
    assert not (tmp_path / "spare").exists()
    assert recover(tmp_path / "moved").ok
    assert digests(tmp_path / "moved") == expected


def test_a_drop_that_comes_at_the_end_is_saved_where_the_survey_was(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    with open_writer(survey) as writer:
        expected = {1: save(writer, 1)}
        writer.expect_end()
        survey.rename(tmp_path / "moved")
        writer.maintain()
        expected[2] = save(writer, 2)  # it has to be somewhere, and said to be
        told = [type(report) for report in writer.take_reports()]
    assert told == [SurveyMovedAway, SurveyFilesRemoved, FilesRewritten]
    assert digests(survey) == expected


def test_a_survey_that_is_deleted_at_the_end_is_written_again(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    with open_writer(survey) as writer:
        expected = {number: save(writer, number) for number in (1, 2)}
        writer.expect_end()
        delete(survey)
    assert [type(report) for report in writer.take_reports()] == [
        SurveyFilesRemoved,
        FilesRewritten,
    ]
    assert digests(survey) == expected
