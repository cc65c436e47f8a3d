"""A survey in one file: drops are taken from their files where these hold what the journal does."""

import io
import json
import os
import shutil
from collections.abc import Callable
from dataclasses import fields, replace
from datetime import UTC, datetime
from pathlib import Path

import h5py
import numpy as np
import pytest
from PIL import Image

from pfwd.files import survey_file
from pfwd.files.importing import import_files
from pfwd.files.photos import photos_of, store_photo
from pfwd.files.survey_file import (
    SurveyPhoto,
    check_survey_file,
    photos_of_survey,
    read_survey_file,
    write_survey_file,
)
from pfwd.judging import JobRequest, job_of
from pfwd_device.errors import RecordingError
from pfwd_device.recording import Rebound, SurveyPoint, SurveyWriter, read_survey
from pfwd_device.recording.drop_file import drop_digest
from pfwd_device.recording.survey_content import SurveyContent


def digests(content: SurveyContent) -> dict[int, str]:
    return {drop.number: drop_digest(drop.read(), drop.number) for drop in content.drops}


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Numbers of the drops that were written anew, in order."""
    numbers: list[int] = []
    write = survey_file.write_drop

    def noted(group: object, record: object, number: int, survey: bytes) -> object:
        numbers.append(number)
        return write(group, record, number, survey)  # type: ignore[arg-type]

    monkeypatch.setattr(survey_file, "write_drop", noted)
    return numbers


def test_drops_are_copied_from_their_files(
    survey: Path, tmp_path: Path, written: list[int]
) -> None:
    content = read_survey(survey)
    write_survey_file(tmp_path / "s.h5", content)
    assert written == []
    assert digests(read_survey_file(tmp_path / "s.h5")) == digests(content)
    assert check_survey_file(tmp_path / "s.h5")[0]["ok"]


def test_what_is_copied_is_what_is_written(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = read_survey(survey)
    write_survey_file(tmp_path / "copied.h5", content)
    monkeypatch.setattr(content, "file_bytes_of", lambda number: None)
    write_survey_file(tmp_path / "written.h5", content)
    assert described(tmp_path / "copied.h5") == described(tmp_path / "written.h5")


def test_an_exported_survey_is_asked_as_its_folder_is(survey: Path, tmp_path: Path) -> None:
    with SurveyWriter.open(survey, publish=False) as writer:
        writer.save_result(1, {"seed": 7})
        writer.edit("position", {"latitude": 48.0, "longitude": 11.0}, number=2)
    content = read_survey(survey)
    write_survey_file(tmp_path / "s.h5", content)
    exported = read_survey_file(tmp_path / "s.h5")
    assert (content.path, exported.path) == (str(survey), str(tmp_path / "s.h5"))
    assert described_survey(exported) == described_survey(content)
    assert exported.drops[0].read_last_result() == {"seed": 7}
    for drop in exported.drops:
        assert (drop.source, drop.file, drop.read_file(), drop.results) == (
            "export",
            None,
            None,
            (),
        )
        assert drop.place is None
        traces = drop.read_traces()
        assert (traces.rebounds, traces.counts) == ((), None)
        assert traces.drop.load.tolist() == drop.read().drop.load.tolist()
    assert {drop.source for drop in content.drops} == {"journal"}


def described_survey(content: SurveyContent) -> dict[str, object]:
    """Everything that does not say where the survey is kept; arrays as digests."""
    own = ("_origin", "source", "drops")
    points: list[SurveyPoint] = list(content.points)
    said = {
        "points": [
            {f.name: getattr(p, f.name) for f in fields(p) if f.name not in own} for p in points
        ],
        "drops": [
            (
                {f.name: getattr(drop, f.name) for f in fields(drop) if f.name not in own},
                (drop.key, drop.result_count, drop.read_results(), drop.read_last_result()),
                drop_digest(drop.read(), drop.number),
            )
            for point in points
            for drop in point.drops
        ],
        "by number": [drop.number for drop in content.drops],
        "rest": (content.survey_id, content.info, content.events, content.checks, content.damage),
    }
    assert len(content.drops) > 3
    return said


def described(path: Path) -> dict[str, object]:
    """Everything below the drops and results: names, attributes, values, storage."""
    import h5py

    found: dict[str, object] = {}

    def note(name: str, item: object) -> None:
        about: list[object] = [sorted((k, repr(v)) for k, v in item.attrs.items())]  # type: ignore[attr-defined]
        if isinstance(item, h5py.Dataset):
            about += [item.dtype.str, item.shape, item.chunks, item.compression, item.shuffle]
            about += [item.fletcher32, np.asarray(item[()]).tobytes() if item.shape else item[()]]
        found[name] = about

    with h5py.File(path) as file:
        file["drops"].visititems(note)
        file["results"].visititems(note)
    assert len(found) > 20
    return found


def test_a_rebound_that_came_after_publication_is_exported(
    survey: Path, tmp_path: Path, written: list[int]
) -> None:
    with SurveyWriter.open(survey, publish=False) as writer:
        counts = np.arange(8, dtype=np.int32).reshape(4, 2)
        writer.save_rebound(2, Rebound(0.9, 500.0, 9000, counts))
    content = read_survey(survey)
    write_survey_file(tmp_path / "s.h5", content)
    assert written == [2]
    assert len(read_survey_file(tmp_path / "s.h5").drops[1].read().rebounds) == 2


@pytest.mark.parametrize("damage", ["flip", "cut", "unlink"])
def test_a_damaged_drop_file_does_not_reach_the_export(
    survey: Path, tmp_path: Path, written: list[int], damage: str
) -> None:
    before = digests(read_survey(survey))
    path = survey / "drops" / "drop-000001.h5"
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.unlink()
    if damage != "unlink":
        path.write_bytes(data if damage == "flip" else data[:-1])
    write_survey_file(tmp_path / "s.h5", read_survey(survey))
    assert written == [1]
    assert digests(read_survey_file(tmp_path / "s.h5")) == before


def test_a_file_that_holds_another_drop_is_noticed(
    survey: Path, tmp_path: Path, written: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    # As no disk makes it: the file is as it was listed, and no copy of the record.
    content = read_survey(survey)
    images = content.file_bytes_of
    with monkeypatch.context() as patch:
        patch.setattr(content, "file_bytes_of", lambda number: images(2 if number == 1 else number))
        write_survey_file(tmp_path / "s.h5", content)
    assert written == [1, 2, 3, 4]
    assert digests(read_survey_file(tmp_path / "s.h5")) == digests(content)
    # The same samples under the same number, but another key.
    kept = content.drops[0].read()
    monkeypatch.setattr(
        survey_file, "_read_drop", lambda *_: replace(kept, metadata={"key": "another"})
    )
    with pytest.raises(RecordingError, match="differs from the drop in the survey"):
        write_survey_file(tmp_path / "t.h5", content)


def test_the_file_is_opened_anew_after_some_drops(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_survey_file(tmp_path / "s.h5", read_survey(survey))
    opens: list[str] = []
    opened: Callable[[str], object] = survey_file._opened

    def noted(path: str) -> object:
        opens.append(path)
        return opened(path)

    monkeypatch.setattr(survey_file, "_opened", noted)
    before = check_survey_file(tmp_path / "s.h5")
    few = len(opens)
    monkeypatch.setattr(survey_file, "PART_DROPS", 1)
    assert check_survey_file(tmp_path / "s.h5") == before
    assert len(opens) == 2 * few + len(read_survey(survey).drops) - 1


def add_photos(survey: Path) -> dict[str, list[bytes]]:
    """Store two photos of one point and one of the other; return them by point, in order."""
    moments = [datetime(2024, 5, 6, 8, minute, tzinfo=UTC) for minute in (1, 2)]
    for point, moment in (("A/1", moments[1]), ("A/1", moments[0]), ("CON", moments[0])):
        stream = io.BytesIO()
        Image.frombytes("RGB", (20, 10), os.urandom(600)).save(stream, "PNG")
        store_photo(survey, point, stream.getvalue(), moment=moment)
    return photos_by_point(survey)


def photos_by_point(survey: Path) -> dict[str, list[bytes]]:
    points = ("A/1", "CON")
    return {point: [photo.read_bytes() for photo in photos_of(survey, point)] for point in points}


def test_photos_come_back_with_their_order(survey: Path, tmp_path: Path) -> None:
    photos = add_photos(survey)
    assert [len(images) for images in photos.values()] == [2, 1]
    write_survey_file(tmp_path / "s.h5", read_survey(survey))
    exported = read_survey_file(tmp_path / "s.h5")
    write_survey_file(tmp_path / "t.h5", exported)
    for path in (tmp_path / "s.h5", tmp_path / "t.h5"):
        assert check_survey_file(path)[0]["damaged"] == []
        assert [photo.data for photo in photos_of_survey(read_survey_file(path))] == [
            image for images in photos.values() for image in images
        ]
    for _ in range(2):  # nothing is imported twice
        outcomes = list(import_files([str(tmp_path / "t.h5")], tmp_path / "again"))
        assert [outcome.remark or outcome.error for outcome in outcomes] == [None] * len(outcomes)
        assert photos_by_point(tmp_path / "again") == photos
    names = [photo.name for photo in photos_of(tmp_path / "again", "A/1")]
    assert names == [photo.name for photo in photos_of(survey, "A/1")]


def test_a_survey_without_photos_is_a_file_that_earlier_versions_check(
    survey: Path, tmp_path: Path
) -> None:
    write_survey_file(tmp_path / "s.h5", read_survey(survey))
    with h5py.File(tmp_path / "s.h5") as file:
        assert "photos" not in file
        assert "photos" not in json.loads(file["survey"][()])


def test_a_damaged_photo_is_named_and_left_out(survey: Path, tmp_path: Path) -> None:
    add_photos(survey)
    path = tmp_path / "s.h5"
    write_survey_file(path, read_survey(survey))
    with h5py.File(path, "r+") as file:
        file["photos/000002"][5] ^= 1
    assert check_survey_file(path)[0]["damaged"] == [
        f"{path}, photos/000002: other bytes than were written"
    ]
    outcomes = list(import_files([str(path)], tmp_path / "again"))
    assert [outcome.error for outcome in outcomes] == [None] * len(outcomes)
    assert [outcome.remark for outcome in outcomes if outcome.remark] == [
        f"{path}, photos/000002: expected a photo, got damage"
    ]
    with h5py.File(path, "r+") as file:
        del file["photos/000003"]
    assert f"{path}, photos/000003: missing" in check_survey_file(path)[0]["damaged"]


def test_a_photo_that_is_none_is_a_remark(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add_photos(survey)
    photos = [SurveyPhoto("A/1", "../../x", b"no picture"), SurveyPhoto("elsewhere", "y", b"")]
    monkeypatch.setattr(survey_file, "photos_of_survey", lambda _: photos)
    write_survey_file(tmp_path / "s.h5", read_survey(survey))
    monkeypatch.undo()
    outcomes = list(import_files([str(tmp_path / "s.h5")], tmp_path / "again"))
    (remark,) = [outcome.remark for outcome in outcomes if outcome.remark]
    assert "a photo of A/1: picture: expected a JPEG or PNG file" in remark
    assert not (tmp_path / "again" / "photos").exists()


def test_an_import_into_a_survey_keeps_its_targets(survey: Path, tmp_path: Path) -> None:
    events = JobRequest(target=33e6, step_m=20.0).events()
    shutil.copytree(survey, tmp_path / "own")
    with SurveyWriter.open(survey, publish=False) as writer:
        for event in events:
            writer.note_event(*event)
        point = writer.points[0]
        writer.edit("target", 44e6, point=point)
    write_survey_file(tmp_path / "s.h5", read_survey(survey))
    for folder, target, of_point in (("own", 20e6, 25e6), ("new", None, None)):
        if target is not None:
            with SurveyWriter.open(tmp_path / folder, publish=False) as writer:
                writer.note_event("job", {"target": target})
                writer.edit("target", of_point, point=point)
        imported = list(import_files([str(tmp_path / "s.h5")], tmp_path / folder))
        content = read_survey(tmp_path / folder)
        assert job_of(content).target == (target or 33e6)
        assert job_of(content).step_m == 20.0  # the survey had none
        assert content.points[0].target == (of_point or 44e6)
        remarks = [each.remark for each in imported if each.remark]
        assert ["has its own: target, target of point" in remark for remark in remarks] == (
            [True] if target else []
        )
