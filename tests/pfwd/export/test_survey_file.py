"""Surveys in one file: every reader accepts them, and what is damaged or hostile is refused."""

import hashlib
import io
import json
import os
import shutil
import stat
import zipfile
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from pfwd.errors import SurveyError
from pfwd.export.export import export_survey
from pfwd.files import survey_file
from pfwd.files.editing import add_events
from pfwd.files.folders import MANIFEST, is_survey_file
from pfwd.files.importing import import_files
from pfwd.files.opening import survey_content
from pfwd.files.photos import photos_of, store_photo
from pfwd.files.reading import read_points
from pfwd.files.survey_file import survey_folder
from pfwd.files.upkeep import check_survey
from pfwd.judging import JobRequest, job_of
from pfwd_device.recording import SurveyWriter, read_survey

EVERYDAY_STEP = 40_009
"""Every so many bits of a file are turned in the everyday run; a prime, so that all eight bits of a
byte are."""


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder to which surveys are unpacked."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


@pytest.fixture
def packed(survey: Path, tmp_path: Path) -> Path:
    export_survey(survey, "survey", tmp_path / "s.pfwdz")
    return tmp_path / "s.pfwdz"


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if (path.is_file() and path.parent != folder) or path.name == "acknowledged.txt"
    }


def test_the_file_has_the_files_of_the_folder(survey: Path, packed: Path, temporary: Path) -> None:
    with survey_folder(packed) as folder:
        assert Path(folder).name == "s"
        assert files_of(Path(folder)) == files_of(survey)
        assert len(files_of(survey)) > 5
    content = survey_content(packed)
    assert content.path == str(packed)
    drops = read_survey(survey).drops
    assert [drop.read().metadata for drop in content.drops] == [
        drop.read().metadata for drop in drops
    ]
    del content
    assert [point.setup.point for point in read_points(packed)] == [
        point.setup.point for point in read_points(survey)
    ]
    assert check_survey(packed)[0] == check_survey(survey)[0] | {"survey": str(packed)}
    import gc

    gc.collect()
    assert list(temporary.iterdir()) == []


def test_it_is_never_changed(packed: Path) -> None:
    before = packed.read_bytes()
    with pytest.raises(SurveyError, match=r"in one file, which is not changed; pfwd import makes"):
        add_events(packed, [("job", {"target": 1.0})])
    assert packed.read_bytes() == before


def test_another_name_is_recognised_by_the_content(packed: Path, tmp_path: Path) -> None:
    renamed = tmp_path / "s.zip"
    shutil.copy(packed, renamed)
    assert is_survey_file(renamed)
    assert read_points(renamed)
    (tmp_path / "empty.pfwdz").touch()
    with pytest.raises(SurveyError, match="an intact survey in one file, got damage"):
        read_points(tmp_path / "empty.pfwdz")


def test_damage_in_the_folder_is_named(survey: Path, tmp_path: Path) -> None:
    drop = survey / "drops" / "drop-000001.h5"
    drop.write_bytes(b"damaged")
    (survey / "results" / "notes.txt").touch()
    (notes := export_survey(survey, "survey", tmp_path / "s.pfwdz").notes)
    assert notes[0] == "drops/drop-000001.h5 is damaged or missing; pfwd recover restores it"
    assert notes[1] == "results/notes.txt is left out: no file of a survey"
    assert len(read_points(tmp_path / "s.pfwdz")) == len(read_points(survey))
    assert not check_survey(tmp_path / "s.pfwdz")[0]["ok"]


def test_drops_that_follow_meanwhile_are_omitted(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    add = survey_file._add

    def during(archive: Any, file: Path, listed: Any) -> None:
        if file.suffix == ".pfwdj":
            with file.open("ab") as stream:
                stream.write(b"the begin of a record")
        add(archive, file, listed)

    monkeypatch.setattr(survey_file, "_add", during)
    export_survey(survey, "survey", tmp_path / "s.pfwdz")
    assert check_survey(tmp_path / "s.pfwdz")[0]["ok"]


def refused(path: Path, temporary: Path) -> str:
    """The line with which every reader refuses the file; nothing is left behind."""
    lines = set()
    for reader in (read_points, survey_content, check_survey):
        with pytest.raises(SurveyError) as caught:
            reader(path)
        lines.add(str(caught.value))
    (imported,) = import_files([str(path)], path.parent / "into")
    lines.add(str(imported.error))
    (line,) = lines
    assert line.startswith(f"{path}: expected ")
    assert "\n" not in line
    assert list(temporary.iterdir()) == []
    return line


@pytest.mark.parametrize("step", [EVERYDAY_STEP, pytest.param(2503, marks=pytest.mark.slow)])
def test_single_bits_are_noticed_or_without_effect(
    step: int, packed: Path, temporary: Path
) -> None:
    data = packed.read_bytes()
    with survey_folder(packed) as folder:
        before = files_of(Path(folder))
    noticed = 0
    for bit in range(0, 8 * len(data), step):
        turned = bytearray(data)
        turned[bit // 8] ^= 1 << bit % 8
        packed.write_bytes(turned)
        try:
            with survey_folder(packed) as folder:
                assert files_of(Path(folder)) == before
        except SurveyError:
            noticed += 1
    assert noticed > 10
    assert list(temporary.iterdir()) == []


@pytest.mark.parametrize("part", [0.0, 0.3, 0.9, 0.999])
def test_a_part_of_a_file_is_refused(part: float, packed: Path, temporary: Path) -> None:
    data = packed.read_bytes()
    packed.write_bytes(data[: int(part * len(data))])
    assert "got damage" in refused(packed, temporary)


Member = tuple[zipfile.ZipInfo, bytes]


def _member(name: str, data: bytes = b"x", **attributes: Any) -> Member:
    info = zipfile.ZipInfo(name)
    for key, value in attributes.items():
        setattr(info, key, value)
    return info, data


LINK = {"external_attr": (stat.S_IFLNK | 0o777) << 16}
DEVICE = {"external_attr": (stat.S_IFCHR | 0o777) << 16}
HOSTILE: dict[str, list[Member]] = {
    "an absolute path": [_member("/tmp/pfwd-hostile")],
    "a path out of the folder": [_member("../hostile")],
    "a path out of the folder of photos": [_member("photos/../../hostile")],
    "a backslash": [_member("photos\\..\\..\\hostile")],
    "a drive": [_member("C:/hostile")],
    "a device of Windows": [_member("damaged/NUL.txt")],
    "a link": [_member("damaged/hostile", b"/etc/passwd", **LINK)],
    "a device": [_member("damaged/hostile", b"", **DEVICE)],
    "a folder": [_member("photos/hostile/", b"")],
    "two files of one name": [_member("damaged/a"), _member("damaged/a")],
    "names that differ in case": [_member("damaged/a"), _member("damaged/A")],
    "another kind of file": [_member("settings.toml")],
    "a compressed file": [
        _member("damaged/zeros", bytes(1 << 24), compress_type=zipfile.ZIP_DEFLATED)
    ],
}


def repack(
    path: Path, more: list[Member], change: Callable[[Any], object] = lambda _: None
) -> None:
    """Write the file again with further members, which the list of files has as well."""
    with zipfile.ZipFile(path) as archive:
        members = [(info, archive.read(info)) for info in archive.infolist()]
    manifest = json.loads(members[0][1])
    for info, data in more:
        listed = {"path": info.filename, "size": len(data)}
        manifest["files"].append(listed | {"sha256": hashlib.sha256(data).hexdigest()})
    change(manifest)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(MANIFEST, json.dumps(manifest))
        for info, data in [*members[1:], *more]:
            archive.writestr(info, data, info.compress_type)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("attack", HOSTILE)
def test_hostile_members_are_refused(attack: str, packed: Path, temporary: Path) -> None:
    repack(packed, HOSTILE[attack])
    before = set(packed.parent.rglob("*"))
    assert "got damage" in refused(packed, temporary)
    assert set(packed.parent.rglob("*")) == before


CHANGES: dict[str, Callable[[Any], object]] = {
    "a file more": lambda said: said["files"].append(said["files"][0]),
    "a file less": lambda said: said["files"].pop(),
    "another order": lambda said: said["files"].reverse(),
    "another size": lambda said: said["files"][0].update(size=1),
    "another digest": lambda said: said["files"][1].update(sha256="0" * 64),
    "a number as path": lambda said: said["files"][0].update(path=7),
    "no files": lambda said: said.pop("files"),
    "no version": lambda said: said.pop("format_version"),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_list_that_does_not_fit_is_refused(change: str, packed: Path, temporary: Path) -> None:
    repack(packed, [], CHANGES[change])
    assert "got damage" in refused(packed, temporary)


def test_another_version_is_refused(packed: Path, temporary: Path) -> None:
    repack(packed, [], lambda said: said.update(format_version=2))
    assert "expected format version 1 of a survey in one file, got '2'" in refused(
        packed, temporary
    )


def test_members_that_share_their_bytes_are_refused(packed: Path, temporary: Path) -> None:
    """The directory names one member again and again: the sum is more than the file."""
    data = bytes(100_000)
    with zipfile.ZipFile(packed, "a") as archive:
        archive.writestr("damaged/0", data)
        first = archive.infolist()[-1]
        for number in range(1, 1000):
            copy = zipfile.ZipInfo(f"damaged/{number}")
            copy.header_offset, copy.CRC = first.header_offset, first.CRC
            copy.file_size = copy.compress_size = len(data)
            archive.filelist.append(copy)
    assert "longer than the file" in refused(packed, temporary)


def test_a_long_directory_and_a_full_disk_are_refused(
    packed: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(survey_file, "MAX_LIST_BYTES", 300)
        assert "a list of members of" in refused(packed, temporary)
    usage = shutil.disk_usage(temporary)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=10))
    assert "expected room for" in refused(packed, temporary)


def test_photos_are_imported_in_their_order(survey: Path, tmp_path: Path) -> None:
    name = read_survey(survey).points[0].name
    for minute in (2, 1):
        stream = io.BytesIO()
        Image.frombytes("RGB", (20, 10), os.urandom(600)).save(stream, "PNG")
        moment = datetime(2024, 5, 6, 8, minute, tzinfo=UTC)
        store_photo(survey, name, stream.getvalue(), moment=moment)
    photos = photos_of(survey, name)
    export_survey(survey, "survey", tmp_path / "s.pfwdz")
    for _ in range(2):  # nothing is imported twice
        outcomes = list(import_files([str(tmp_path / "s.pfwdz")], tmp_path / "again"))
        assert [outcome.remark or outcome.error for outcome in outcomes] == [None] * len(outcomes)
        imported_photos = photos_of(tmp_path / "again", name)
        assert [(p.name, p.read_bytes()) for p in imported_photos] == [
            (p.name, p.read_bytes()) for p in photos
        ]
    photos[1].write_bytes(photos[1].read_bytes()[:-9])
    export_survey(survey, "survey", tmp_path / "t.pfwdz")
    outcomes = list(import_files([str(tmp_path / "t.pfwdz")], tmp_path / "other"))
    (remark,) = [outcome.remark for outcome in outcomes if outcome.remark]
    assert f"is damaged and is not imported: {photos[1].name}" in remark


def test_an_import_into_a_survey_keeps_its_targets(survey: Path, tmp_path: Path) -> None:
    shutil.copytree(survey, tmp_path / "own")
    with SurveyWriter.open(survey, publish=False) as writer:
        for event in JobRequest(target=33e6, step_m=20.0).events():
            writer.note_event(*event)
        point = writer.points[0]
        writer.edit("target", 44e6, point=point)
        writer.add_point("planned", {"plate_radius_m": 0.1})
    export_survey(survey, "survey", tmp_path / "s.pfwdz")
    for folder, target, of_point in (("own", 20e6, 25e6), ("new", None, None)):
        if target is not None:
            with SurveyWriter.open(tmp_path / folder, publish=False) as writer:
                writer.note_event("job", {"target": target})
                writer.edit("target", of_point, point=point)
        imported = list(import_files([str(tmp_path / "s.pfwdz")], tmp_path / folder))
        content = read_survey(tmp_path / folder)
        assert job_of(content).target == (target or 33e6)
        assert job_of(content).step_m == 20.0  # the survey had none
        assert content.points[0].target == (of_point or 44e6)
        assert "planned" in [each.name for each in content.points], "a point without drops"
        remarks = [each.remark for each in imported if each.remark]
        assert ["has its own: target, target of point" in remark for remark in remarks] == (
            [True] if target else []
        )
