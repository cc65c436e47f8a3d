"""The spare folder: a second place for drops that the survey's own folder does not take."""

import errno
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from pfwd_device.errors import RecordingError, StorageFull
from pfwd_device.recording import SpareFolder, Storage, SurveyWriter, check, read_survey, recover
from tests.campaigns.power_loss import make_record
from tests.pfwd_device.recording.records import (
    Refusing,
    a_rebound,
    assert_recovered,
    digests,
    journal_of,
    open_survey,
    record_of,
    save,
)


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    return tmp_path / "site 1"


@pytest.fixture
def disk(survey: Path) -> Refusing:
    return Refusing(survey)


@pytest.fixture
def divided(survey: Path, disk: Refusing, spare: SpareFolder) -> dict[int, str]:
    """Record drop 1 in the survey's folder and drop 2 in the spare folder; return their digests."""
    with open_writer(survey, disk, spare) as writer:
        recorded = {1: save(writer, 1)}
        disk.refuse()
        recorded[2] = save(writer, 2)
        writer.save_rebound(2, a_rebound())
        writer.edit("note", "the first", number=2)
    disk.refuse(False)
    return recorded


def open_writer(survey: Path, disk: Storage, spare: SpareFolder | None) -> SurveyWriter:
    return open_survey(survey, storage=disk, spare=spare, publish=True)


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO, errno.EROFS])
def test_a_drop_that_home_refuses_is_in_the_spare_folder_at_once(
    survey: Path, spare: SpareFolder, number: int
) -> None:
    disk = Refusing(survey, number)
    writer = open_writer(survey, disk, spare)
    expected = {1: save(writer, 1)}
    assert writer.spare_folder_of(1) is None
    disk.refuse()
    expected |= {n: save(writer, n) for n in (2, 3)}
    (part,) = spare.root.iterdir()
    assert writer.spare_folder_of(2) == part
    assert part.name == f"site-1-{writer.survey_id}"
    assert digests(part) == {n: expected[n] for n in (2, 3)}
    (report,) = writer.take_reports()
    assert f"NOT SAFE: {survey}" in report.text
    assert str(part) in report.text
    writer.close()
    assert digests(survey) == {1: expected[1]}
    damaged = check(survey, spare=spare).damaged
    assert [text for text in damaged if "P 1/2 is only in the spare folder" in text]
    disk.refuse(False)
    assert any("2 drops" in text for text in recover(survey, spare=spare).actions)
    assert_recovered(survey, spare, expected)
    files = sorted(path.name for path in (survey / "drops").iterdir())
    assert files == [f"drop-00000{n}.h5" for n in (1, 2, 3)]


def test_records_about_a_drop_are_merged(survey: Path, spare: SpareFolder, disk: Refusing) -> None:
    with open_writer(survey, disk, spare) as writer:
        save(writer, 1)
        disk.refuse()
        save(writer, 2)
        writer.save_rebound(2, a_rebound())
        writer.edit("note", "a stone", number=2)
        writer.save_result(2, {"modulus_pa": 45e6})
        writer.note_event("gap", {"samples": 3})
        writer.add_point("P 9", {"plate_radius_m": 0.1})
    disk.refuse(False)
    assert recover(survey, spare=spare).ok
    content = read_survey(survey)
    second = content.drops[1]
    assert (len(second.read().rebounds), second.notes) == (1, ("a stone",))
    assert second.read_results() == ({"modulus_pa": 45e6},)
    assert content.points[-1].name == "P 9"
    assert [event["event"] for event in content.events] == ["gap"]
    assert check(survey, spare=spare).ok


def test_a_folder_that_refused_waits_for_a_start(
    survey: Path, spare: SpareFolder, disk: Refusing
) -> None:
    with open_writer(survey, disk, spare) as writer:
        expected = {1: save(writer, 1)}
        disk.refuse()
        expected[2] = save(writer, 2)
        disk.refuse(False)
        writer.maintain()
        expected[3] = save(writer, 3)
        for number in (1, 2, 3):
            writer.publish(number)
        assert list(writer.drops_in_spare()) == [2, 3]
        assert len(writer.take_reports()) == 1
    assert digests(survey) == {1: expected[1]}
    with open_writer(survey, disk, spare) as writer:
        assert any("moved to the survey" in text for text in writer.recovery.actions)
        assert writer.drops_in_spare() == {}
    assert digests(survey) == expected
    assert check(survey, spare=spare).ok


def test_a_new_survey_at_the_path_of_a_deleted_survey_gets_no_drop_of_it(
    tmp_path: Path, survey: Path, spare: SpareFolder, disk: Refusing, divided: dict[int, str]
) -> None:
    shutil.rmtree(survey)
    (part,) = spare.root.iterdir()
    new = {}
    for number in (1, 2):  # the second time the survey is continued
        with open_writer(survey, disk, spare) as writer:
            texts = [text for text in writer.recovery.actions if str(part) in text]
            new[number] = save(writer, number)
        assert len(texts) == (number == 1)
    assert digests(survey) == new
    assert read_survey(survey).survey_id not in part.name
    report = recover(survey, spare=spare)
    assert report.ok
    (text,) = [text for text in report.actions if "another survey" in text]
    assert f"pfwd import {part} -o FOLDER" in text
    assert digests(survey) == new
    assert check(survey, spare=spare).ok
    # The drops of the deleted survey are recovered at its path as soon as that is free.
    assert 2 in digests(part)
    survey.rename(tmp_path / "new")
    recover(survey, spare=spare)
    assert 2 in digests(survey)
    assert read_survey(survey).survey_id in part.name
    assert not any("another survey" in text for text in recover(survey, spare=spare).actions)


def test_a_survey_that_went_on_without_its_spare_part_gets_new_numbers(
    survey: Path, spare: SpareFolder, divided: dict[int, str]
) -> None:
    stranger = make_record(2, np.random.default_rng(99))  # of the same point and number
    stranger.metadata["key"] = "another"  # type: ignore[index]
    with open_survey(survey) as writer:  # another computer: no spare folder there
        assert writer.save_drop(stranger) == 2
        writer.edit("note", "the other", number=2)
    assert recover(survey, spare=spare).ok
    _, second, third = read_survey(survey).drops
    assert (second.number, second.notes) == (2, ("the other",))
    assert (third.number, third.notes, len(third.read().rebounds)) == (3, ("the first",), 1)
    assert (second.point, second.drop, third.point, third.drop) == ("P 1", 2, "P 1", 3)
    assert check(survey, spare=spare).ok
    assert recover(survey, spare=spare).actions == ()


def test_omitted_records_leave_no_gap(
    survey: Path, spare: SpareFolder, disk: Refusing, tmp_path: Path
) -> None:
    """The record of a result's file means nothing under another number; it is listed again."""
    with open_writer(survey, disk, spare) as writer:
        save(writer, 1)
        disk.refuse()
        for number in (2, 3, 4, 5):
            save(writer, number)
            writer.edit("note", f"of {number}", number=number)
            writer.save_result(number, {"modulus_pa": 45e6})
        writer.note_event("gap")
    disk.refuse(False)
    with open_survey(survey) as writer:
        assert writer.save_drop(record_of(7)) == 2
        shutil.copytree(survey, tmp_path / "killed")
    shutil.rmtree(survey)
    os.rename(tmp_path / "killed", survey)
    assert recover(survey, spare=spare).ok
    assert check(survey, spare=spare).ok
    drops = {drop.number: drop for drop in read_survey(survey).drops}
    assert [drops[number].notes for number in (3, 4, 5, 6)] == [(f"of {n}",) for n in (2, 3, 4, 5)]
    assert [event["event"] for event in read_survey(survey).events if event["event"] == "gap"]


def test_a_record_that_the_spare_folder_did_not_keep_leaves_its_number_free(
    survey: Path, spare: SpareFolder, disk: Refusing, monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_writer(survey, disk, spare) as writer:
        save(writer, 1)
        disk.refuse()
        save(writer, 2)
        files = writer._records._files[-1]
        real, acknowledged = files.problem, len(files.entries)

        def failing() -> str | None:
            if len(files.entries) > acknowledged:
                raise OSError(errno.EIO, "no look")
            return real()

        monkeypatch.setattr(files, "problem", failing)
        with pytest.raises(RecordingError, match="the spare folder refuses it too"):
            save(writer, 3)
        assert len(files.entries) == acknowledged
        monkeypatch.undo()
        save(writer, 3)
    disk.refuse(False)
    assert recover(survey, spare=spare).ok
    assert check(survey, spare=spare).ok


def test_a_point_in_the_spare_is_appended(survey: Path, spare: SpareFolder, disk: Refusing) -> None:
    with open_writer(survey, disk, spare) as writer:
        save(writer, 1)
        disk.refuse()
        assert writer.save_drop(record_of(21)) == 2
    disk.refuse(False)
    with open_survey(survey) as writer:
        assert writer.save_drop(record_of(11)) == 2
    assert recover(survey, spare=spare).ok
    points = [(point.name, len(point.drops)) for point in read_survey(survey).points]
    assert points == [("P 1", 1), ("P 2", 1), ("P 3", 1)]


@pytest.mark.parametrize(("free", "is_reserved"), [(16_383, False), (16_384, True)])
def test_a_reserve_needs_four_times_its_size(
    survey: Path, disk: Refusing, free: int, is_reserved: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disk, "free_bytes", lambda _: free)
    with open_survey(survey, storage=disk, reserve_bytes=4096):
        assert (survey / "reserve").exists() is is_reserved


def test_a_repeated_drop_is_merged_once(survey: Path, spare: SpareFolder, disk: Refusing) -> None:
    with open_writer(survey, disk, spare) as writer:
        disk.refuse()
        save(writer, 1)
    disk.refuse(False)
    with open_survey(survey) as writer:
        save(writer, 1)  # the instrument offered it again
    assert recover(survey, spare=spare).ok
    assert len(read_survey(survey).drops) == 1


@pytest.mark.posix
def test_a_deleted_survey_is_restored(tmp_path: Path, survey: Path, spare: SpareFolder) -> None:
    """The last of several deleted surveys at a path."""
    for count in (1, 2, 3):
        with open_writer(survey, Storage(), spare) as writer:
            expected = {n: save(writer, n) for n in range(1, count + 1)}
            shutil.rmtree(survey)
        for part in spare.root.iterdir():  # later than the earlier ones on any clock
            if part.name.endswith(writer.survey_id):
                os.utime(part / "acknowledged.txt", (2e9 + count, 2e9 + count))
    assert recover(survey, spare=spare).ok
    assert digests(survey) == expected
    assert check(survey, spare=spare).ok
    with pytest.raises(RecordingError, match="expected the folder of a survey, got no survey"):
        recover(tmp_path / "another", spare=spare)


def test_records_that_home_no_longer_has_are_read_from_the_spare_folder(
    survey: Path, spare: SpareFolder
) -> None:
    with open_writer(survey, Storage(), spare) as writer:
        expected = {1: save(writer, 1)}
        length = journal_of(survey).stat().st_size
        expected |= {2: save(writer, 2)}
        os.truncate(journal_of(survey), length)
        writer.maintain()
        assert digests(writer.contents()) == expected


@pytest.mark.posix
def test_a_deleted_spare_folder_is_remade(survey: Path, spare: SpareFolder, disk: Refusing) -> None:
    with open_writer(survey, disk, spare) as writer:
        disk.refuse()
        expected = {1: save(writer, 1)}
        shutil.rmtree(spare.root)
        expected[2] = save(writer, 2)
        (part,) = spare.root.iterdir()
        assert digests(part) == expected
        (journal_of(part)).unlink()
        writer.maintain()
        assert digests(part) == expected
    disk.refuse(False)
    assert_recovered(survey, spare, expected)


def test_two_places_that_refuse_leave_the_drop_with_the_caller(tmp_path: Path) -> None:
    survey = tmp_path / "all" / "survey"
    disk = Refusing(tmp_path / "all")
    spare = SpareFolder(tmp_path / "all" / "spare")
    with open_writer(survey, disk, spare) as writer:
        expected = {1: save(writer, 1)}
        disk.refuse()
        record = record_of(2)
        with pytest.raises(StorageFull, match=r"survey: .*; the spare folder refuses it too: ref"):
            writer.save_drop(record)
        assert writer.drops_acknowledged == 1
        disk.refuse(False)
        expected[2] = save(writer, 2)
    assert digests(survey) == expected
    assert check(survey, spare=spare).ok


@pytest.mark.posix
def test_a_spare_folder_that_refuses_is_named_once(tmp_path: Path) -> None:
    survey = tmp_path / "all" / "survey"
    disk = Refusing(tmp_path / "all")
    with open_writer(survey, disk, SpareFolder(tmp_path / "all" / "spare")) as writer:
        expected = {1: save(writer, 1)}
        shutil.rmtree(survey)
        disk.refuse()
        for _ in range(3):
            writer.maintain()
        (report,) = writer.take_reports()
        assert report.text.count("the spare folder refuses it too") == 1
        disk.refuse(False)
        expected[2] = save(writer, 2)
        shutil.rmtree(tmp_path / "all" / "spare")
        disk.refuse()
        for _ in range(3):
            writer.maintain()
        assert [report.text.count("refuses it too") for report in writer.take_reports()] == [0, 1]
        disk.refuse(False)
        writer.maintain()
        assert digests(writer.drops_in_spare()[1]) == expected


def test_a_part_of_the_spare_folder_is_refused(
    survey: Path, spare: SpareFolder, disk: Refusing
) -> None:
    with open_writer(survey, disk, spare) as writer:
        disk.refuse()
        save(writer, 1)
    (part,) = spare.root.iterdir()
    hint = f"for {survey}; run pfwd recover {survey}"
    for action in (SurveyWriter.open, recover):
        with pytest.raises(RecordingError, match=re.escape(hint)):
            action(part)
    assert len(read_survey(part).drops) == 1


@pytest.mark.parametrize(
    "text", ["", "[]", '{"survey": 1}', '{"survey_id": "zz"}', "\xff", "[" * 9999]
)
def test_a_damaged_note_of_home_is_no_note(tmp_path: Path, text: str) -> None:
    part = tmp_path / "spare" / "x"
    part.mkdir(parents=True)
    (part / "home.json").write_text(text, encoding="latin-1")
    assert SpareFolder(tmp_path / "spare").parts(home=tmp_path) == []
