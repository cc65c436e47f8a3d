"""``pfwd import`` of files of foreign programs, and ``pfwd export``."""

import json
from pathlib import Path

import pytest

from pfwd.files.foreign.registry import FOREIGN_FORMATS
from tests.pfwd.files.foreign.builders import dynz, prjz, pulse, thy, viewed
from tests.tui.console import numbers, pfwd, records

DROPS = {"1": [pulse(samples=750, peak=8000.0 + n) for n in range(3)]}


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exports")
    (folder / "a.mpvz").write_bytes(prjz(DROPS, viewed(DROPS), folder="rawdata/"))
    command = ("import", folder / "a.mpvz", "-o", folder / "survey")
    lines = records(pfwd(*command, "--json").out)
    assert numbers(lines) == [("east 1", 1), ("east 1", 2), ("east 1", 3)]
    assert all(line["saved"] for line in lines)
    text = pfwd(*command).out.splitlines()
    assert text[0] == "a.mpvz, point east 1: 3 drops already in the survey"
    assert text[1].endswith("3 drops at 1 point, 3 of them already in the survey")
    assert text[2].startswith("next: pfwd open ")
    assert len(text) == 3
    return folder / "survey"


def test_a_refused_file_is_reported_and_the_next_is_imported(tmp_path: Path) -> None:
    (tmp_path / "bad.dynz").write_bytes(dynz(DROPS)[:-100])
    (tmp_path / "h.toml").write_text("plate_radius_m = 0.15")
    (tmp_path / "good.thy").write_bytes(thy([(1, 1, pulse(samples=470))]))
    completed = pfwd(
        "import",
        *(tmp_path / "bad.dynz", tmp_path / "good.thy"),
        *("-o", tmp_path / "s", "--header", tmp_path / "h.toml", "--json"),
    )
    assert completed.status == 1
    (line,) = records(completed.out)
    assert (line["point"], line["drop"]) == ("station 1 lane 1", 1)
    refused = [text for text in completed.err.splitlines() if "bad.dynz" in text]
    assert len(refused) == 1
    assert "expected" in refused[0]
    assert "got" in refused[0]


def test_the_help_of_import_names_every_format() -> None:
    text = pfwd("import", "--help").out
    for form in FOREIGN_FORMATS:
        assert form.name.split()[0] in text
        assert all(suffix in text for suffix in form.suffixes)


def test_export_reports_its_output_in_a_single_line(survey: Path, tmp_path: Path) -> None:
    path = tmp_path / "r.geojson"
    completed = pfwd("export", survey, "--format", "geojson", "-o", path, "--json")
    assert completed.status == 0
    (line,) = records(completed.out)
    assert line == {
        "survey": str(survey),
        "format": "geojson",
        "path": str(path),
        "points": 1,
        "drops": 3,
        "results": 0,
        "without_result": 3,
        "notes": ["3 of 3 drops have no result"],
    }
    assert "3 of 3 drops have no result" in completed.err
    features = json.loads(path.read_text(encoding="utf-8"))["features"]
    assert [feature["geometry"]["coordinates"] for feature in features] == [[6.25, 45.5]] * 3
    forced = pfwd("export", survey, "--format", "geojson", "-o", path, "--force")
    assert forced.status == 0
    assert forced.out == f"{path}: format geojson, 1 point, 3 drops\n"
