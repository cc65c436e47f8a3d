"""Exported surveys: whatever of them a reader could see changed is told by the check."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from pfwd.errors import SurveyError
from pfwd.export.export import export_survey
from pfwd.files import survey_file
from pfwd.files.importing import import_files
from pfwd.files.reading import read_points, survey_content
from pfwd.files.survey_file import check_survey_file
from pfwd.files.upkeep import check_survey
from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_file import DIGEST
from pfwd_device.recording.payload import encode_json
from tests.hdf5_visible import visible

DATA = Path(__file__).resolve().parents[2] / "data"
VERSION_1 = DATA / "exported-v1" / "survey.h5"

EVERYDAY_STEP = 2503
"""Every so many bits of a file are turned in the everyday run; a prime, so that all eight of a byte
come up."""


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    shutil.copytree(DATA / "recording-v1", folder / "survey")
    export_survey(folder / "survey", "h5", folder / "s.h5")
    return folder / "s.h5"


def sound(path: Path) -> bool:
    """Whether the check finds nothing; whatever it says is one line each."""
    try:
        record, _ = check_survey(path)
    except (RecordingError, SurveyError) as err:
        record = {"ok": False, "damaged": [str(err)]}
    assert all("\n" not in text for text in record["damaged"])
    return bool(record["ok"])


def with_bit(path: Path, data: bytes, bit: int) -> bytes:
    turned = bytearray(data)
    turned[bit // 8] ^= 1 << bit % 8
    path.write_bytes(turned)
    return bytes(turned)


def test_single_bits_that_a_reader_sees_are_noticed(exported: Path, tmp_path: Path) -> None:
    data, path = exported.read_bytes(), tmp_path / "s.h5"
    before = visible(data)
    noticed = 0
    for bit in range(0, 8 * len(data), EVERYDAY_STEP):
        turned = with_bit(path, data, bit)
        if sound(path):
            assert visible(turned) == before
        else:
            noticed += 1
    assert noticed > 10


@pytest.mark.parametrize("limit", [100, 10**9])
def test_a_survey_that_was_cut_off_is_not_refused_as_a_drop(
    limit: int, exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # 100: as for a survey that is larger than any drop file.
    monkeypatch.setattr("pfwd_device.recording.drop_file.MAX_DROP_FILE_BYTES", limit)
    data, path = exported.read_bytes(), tmp_path / "s.h5"
    path.write_bytes(data[: len(data) // 2])
    message = "expected (an intact drop file|a drop file of .* or an intact) .*exported survey"
    for reader in (read_points, survey_content):
        with pytest.raises(SurveyError, match=message):
            reader(path)
    (damage,) = check_survey(path)[0]["damaged"]
    assert re.search(message, damage)


@pytest.mark.slow
@pytest.mark.timeout(14400)
def test_no_bit_of_the_file_changes_unnoticed(exported: Path, tmp_path: Path) -> None:
    data, path = exported.read_bytes(), tmp_path / "s.h5"
    before = visible(data)
    for bit in range(8 * len(data)):
        turned = with_bit(path, data, bit)
        if sound(path):
            assert visible(turned) == before


def changed(source: Path, target: Path, change: Callable[[Any], None]) -> Path:
    shutil.copyfile(source, target)
    with h5py.File(target, "r+") as file:
        change(file)
    return target


def test_every_attribute_that_is_changed_removed_or_added_is_told(
    exported: Path, tmp_path: Path
) -> None:
    with h5py.File(exported) as file:
        attributes = {"/": list(file.attrs)}
        file.visititems(lambda name, item: attributes.__setitem__(name, list(item.attrs)))
    tried = 0
    for path, names in attributes.items():

        def add(file: Any, path: str = path) -> None:
            file[path].attrs["more"] = 1.0

        changes: list[Callable[[Any], None]] = [add]
        for name in names:

            def change(file: Any, path: str = path, name: str = name) -> None:
                value = file[path].attrs[name]
                file[path].attrs[name] = value + "x" if isinstance(value, str) else -value - 1

            def remove(file: Any, path: str = path, name: str = name) -> None:
                del file[path].attrs[name]

            changes += [change, remove]
        for number, make in enumerate(changes):
            tried += 1
            assert not sound(changed(exported, tmp_path / "t.h5", make)), (path, names, number)
    assert tried > 150


def external(file: Any) -> None:
    del file["drops/000001/load"]
    file["drops/000001/load"] = h5py.ExternalLink("other.h5", "load")


STRUCTURE: dict[str, Callable[[Any], None]] = {
    "a drop more": lambda f: f.copy("drops/000001", "drops/000009"),
    "a drop less": lambda f: f.__delitem__("drops/000002"),
    "drops exchanged": lambda f: (
        f.move("drops/000001", "x"),
        f.move("drops/000002", "drops/000001"),
        f.move("x", "drops/000002"),
    ),
    "a result more": lambda f: f.copy("results/000001/1", "results/000001/2"),
    "a result less": lambda f: f.__delitem__("results/000001/1"),
    "no results": lambda f: f.__delitem__("results"),
    "results of a drop that is not there": lambda f: f.copy("results/000001", "results/000009"),
    "a capture more": lambda f: f.copy("captures/link-1.pfwdc", "captures/link-2.pfwdc"),
    "a capture less": lambda f: f.__delitem__("captures/link-1.pfwdc"),
    "a dataset more": lambda f: f.__setitem__("more", np.zeros(3)),
    "a group more": lambda f: f.create_group("more"),
    "a link to another file": external,
    "a link in the place of the drops": lambda f: (
        f.move("drops", "x"),
        f.__setitem__("drops", h5py.SoftLink("/x")),
    ),
}


@pytest.mark.parametrize("change", STRUCTURE)
def test_what_is_more_less_or_elsewhere_is_told(
    change: str, exported: Path, tmp_path: Path
) -> None:
    path = changed(exported, tmp_path / "s.h5", STRUCTURE[change])
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["load"] = np.zeros(24)
    assert not sound(path)


def test_changed_attributes_are_refused_when_the_file_is_read(
    exported: Path, tmp_path: Path
) -> None:
    def plate(file: Any) -> None:
        file["drops/000001"].attrs["plate_radius_m"] = 0.1

    def identity(file: Any) -> None:
        file.attrs["survey_id"] = "0" * 32

    path = changed(exported, tmp_path / "s.h5", plate)
    with pytest.raises(SurveyError, match=r"drop 1: expected the content that was written"):
        read_points(path)
    found = list(import_files([str(path)], tmp_path / "into"))
    assert [one.error is None for one in found] == [False, True]
    path = changed(exported, tmp_path / "s.h5", identity)
    with pytest.raises(SurveyError, match="attributes or survey differ from their digest"):
        survey_content(path)


def test_an_export_of_version_1_opens_and_says_what_is_not_covered(tmp_path: Path) -> None:
    record, notes = check_survey(VERSION_1)
    assert (record["ok"], record["drops_published"]) == (True, 2)
    assert [note.partition(": ")[2] for note in notes] == [
        "attributes are not covered by the digests of format version 1"
    ]
    content = survey_content(VERSION_1)
    assert [drop.read().drop.load[0] for drop in content.drops] == [1000.0, 2000.0]
    assert [len(drop.read_results()) for drop in content.drops] == [1, 0]
    found = list(import_files([str(VERSION_1)], tmp_path / "into"))
    assert [one.error for one in found] == [None, None]

    def change(file: Any) -> None:
        file["drops/000001/load"][3] += 1.0

    assert not sound(changed(VERSION_1, tmp_path / "t.h5", change))


def test_a_drop_file_is_checked_alone(tmp_path: Path) -> None:
    old = DATA / "recording-v1" / "drops" / "drop-000001.h5"
    record, notes = check_survey(old)
    assert (record["ok"], record["drops_published"], len(notes)) == (True, 1, 1)
    assert "format version 1" in notes[0]

    def damage(file: Any) -> None:
        file["time"][3] += 1.0

    record, _ = check_survey(changed(old, tmp_path / "t.h5", damage))
    assert not record["ok"]
    assert len(record["damaged"]) == 1


def test_an_export_cannot_be_taken_for_an_old_one(exported: Path, tmp_path: Path) -> None:
    def old(file: Any) -> None:
        file.attrs["format_version"] = 1

    def older(file: Any) -> None:
        old(file)
        del file.attrs[DIGEST]

    for change in (old, older):
        path = changed(exported, tmp_path / "s.h5", change)
        assert not sound(path)
        with pytest.raises(SurveyError, match="states format version 1, but has another layout"):
            survey_content(path)

    def newer(file: Any) -> None:
        file.attrs["format_version"] = 3

    with pytest.raises(RecordingError, match="got 3; a newer version of this program reads it"):
        check_survey_file(changed(exported, tmp_path / "s.h5", newer))


def test_an_export_says_what_it_says_in_json(exported: Path) -> None:
    with h5py.File(exported) as file:
        said = json.loads(file["survey"][()])
        assert encode_json(said) == file["survey"][()].decode()
        assert said["drops"][0]["sha256"] == file["drops/000001"].attrs[DIGEST]
        assert said["captures"] == {"link-1.pfwdc": file["captures/link-1.pfwdc"].attrs["sha256"]}
        assert said["drops"][0]["results_sha256"] == [file["results/000001/1"].attrs["sha256"]]


def test_several_processes_find_what_one_finds(
    exported: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(survey_file, "PART_DROPS", 1)
    monkeypatch.setattr(survey_file, "MIN_PARALLEL_PARTS", 1)
    path = tmp_path / "s.h5"
    shutil.copy(exported, path)
    assert check_survey_file(path, jobs=2) == check_survey_file(path)
    assert check_survey_file(path, jobs=2)[0]["ok"]
    with h5py.File(path, "r+") as file:
        names = sorted(file["drops"])
        for name in (names[0], names[-1]):
            file[f"drops/{name}"].attrs["point"] = "another"
    record, _ = check_survey_file(path, jobs=2)
    assert record == check_survey_file(path)[0]
    assert len(record["damaged"]) == 2
    survey = tmp_path / "survey"
    shutil.copytree(DATA / "recording-v1", survey)
    done = export_survey(survey, "h5", tmp_path / "two.h5", jobs=2)
    assert done.drops == check_survey_file(tmp_path / "two.h5")[0]["drops_published"]
