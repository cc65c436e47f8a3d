"""A survey that an earlier version left opens, goes on, is reported and exported."""

import csv
import hashlib
import json
import shutil
from pathlib import Path

import h5py
import pytest

from pfwd_device.recording import read_survey
from simulators.instrument import serve
from tests.tui.console import PLAIN, RATE, TOP, checked, numbers, pfwd, records

BEFORE = TOP / "tests" / "data" / "survey-v1"
# As the program that wrote it exported them: peak load in N, modulus in Pa.
EXPORTED = {
    ("North 1", 1): (9633.851, 38236738.178),
    ("North 1", 2): (9496.355, 42295941.108),
    ("North 2", 2): (9666.910, 42239928.811),
}


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    return Path(shutil.copytree(BEFORE, tmp_path / "bypass"))


def drop_files(survey: Path) -> dict[str, str]:
    found = sorted((survey / "drops").iterdir())
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in found}


def test_it_opens_with_everything_that_was_said_of_it(survey: Path) -> None:
    read = read_survey(survey)
    north_1, north_2 = read.points
    assert (north_1.name, north_2.name) == ("North 1", "North 2")
    assert [len(point.drops) for point in read.points] == [2, 2]
    assert [drop.discarded for drop in read.drops] == [False, False, True, False]
    for drop in read.drops:
        record = drop.read()
        assert len(record.rebounds) == 3
        assert record.declared["operator"] == "T. Ünal"
        assert len(drop.results) == 2
    shown = pfwd("edit", survey, "--json")
    assert shown.returncode == 0, shown.stderr
    first, second = records(shown.stdout)
    assert (first["target_pa"], first["notes"]) == (45e6, ["wet after rain"])
    assert (first["position"]["latitude"], first["position"]["longitude"]) == (48.1374, 11.5755)
    assert second["target_pa"] is None
    report = checked(survey)
    assert (report["ok"], report["drops_acknowledged"], report["drops_published"]) == (True, 4, 4)


def test_it_goes_on(survey: Path) -> None:
    before = drop_files(survey)
    with serve(PLAIN, drops=1, rate=RATE, seed=5) as instrument:
        done = pfwd("log", instrument.url, "-o", survey, "--json", "--no-invert")
    assert done.returncode == 0, done.stderr
    assert numbers(records(done.stdout)) == [("North 2", 3)]
    report = checked(survey)
    assert (report["ok"], report["drops_acknowledged"], report["drops_published"]) == (True, 5, 5)
    after = drop_files(survey)
    assert {name: after[name] for name in before} == before, "an old file was written over"
    versions = []
    for name in after:
        with h5py.File(survey / "drops" / name) as file:
            versions.append(int(file.attrs["format_version"]))
    assert versions == [1, 1, 1, 1, 2]


def test_a_new_drop_file_stands_in_for_an_old_one_that_was_lost(survey: Path) -> None:
    """The journal of before gives a file of today, with the rebounds."""
    (survey / "drops" / "drop-000002.h5").unlink()
    done = pfwd("recover", survey)
    assert done.returncode == 0, done.stderr
    with h5py.File(survey / "drops" / "drop-000002.h5") as file:
        assert file.attrs["format_version"] == 2
        assert sorted(file["rebounds"]) == ["1", "2", "3"]
        assert file["rebounds/1"].attrs["delay_s"] == 0.318
    assert checked(survey)["ok"]


def test_it_is_inverted_as_before(survey: Path) -> None:
    done = pfwd("invert", survey, "--json", "--method", "least-squares")
    assert done.returncode == 0, done.stderr
    found = {(line["point"], line["drop"]): line for line in records(done.stdout)}
    assert found.keys() == EXPORTED.keys()
    for key, (load, modulus) in EXPORTED.items():
        # The fit takes off what the load cell shows at rest, the export shows the record.
        assert found[key]["peak_load_n"] == pytest.approx(load, abs=20)
        assert found[key]["modulus_pa"] == pytest.approx(modulus, rel=1e-4)


def test_it_is_reported(survey: Path, tmp_path: Path) -> None:
    done = pfwd("report", survey, "-o", tmp_path / "r.html", "--json")
    assert done.returncode == 0, done.stderr
    first, second = records(done.stdout)
    assert (first["used"], first["target"], first["verdict"]) == ([1, 2], 45e6, "undecided")
    # The mean of the two stored results, on their logarithms; version 0.1 took that of the moduli.
    assert first["value"]["value"] == pytest.approx(40215156.7, rel=1e-6)
    assert second["excluded"] == [[1, "discarded: plate rocked"]]
    assert "wet after rain" in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_it_is_exported(survey: Path, tmp_path: Path) -> None:
    done = pfwd("export", survey, "--format", "table", "-o", tmp_path / "t.csv", "--json")
    assert done.returncode == 0, done.stderr
    (told,) = records(done.stdout)
    assert (told["points"], told["drops"], told["results"]) == (2, 4, 4)
    with (tmp_path / "t.csv").open(encoding="utf-8", newline="") as file:
        rows = {(row["point"], int(row["drop"])): row for row in csv.DictReader(file)}
    assert len(rows) == 4
    for key, (load, modulus) in EXPORTED.items():
        assert float(rows[key]["peak_load_n"]) == pytest.approx(load, abs=1e-3)
        assert float(rows[key]["modulus_pa"]) == pytest.approx(modulus, abs=1e-3)
    assert rows["North 2", 1]["discarded"] == "true"
    # What is exported whole can be read in the survey's place.
    for form, target in (("h5", "s.h5"), ("jsonl", "s.jsonl")):
        done = pfwd("export", survey, "--format", form, "-o", tmp_path / target)
        assert done.returncode == 0, done.stderr
    lines = (tmp_path / "s.jsonl").read_text(encoding="utf-8").splitlines()
    assert all(json.loads(line) for line in lines)
    done = pfwd("invert", tmp_path / "s.h5", "--json", "--method", "least-squares")
    assert done.returncode == 0, done.stderr
    assert len(records(done.stdout)) == len(EXPORTED)
