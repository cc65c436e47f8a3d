"""``pfwd import`` of other programs' files and ``pfwd export``, as a user calls them."""

import json
from pathlib import Path

import pytest

from pfwd.files.foreign.registry import FOREIGN_FORMATS
from tests.pfwd.files.foreign.builders import dynz, prjz, pulse, thy, viewed
from tests.tui.console import pfwd, records

DROPS = {"1": [pulse(samples=750, peak=8000.0 + n) for n in range(3)]}


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exports")
    (folder / "a.mpvz").write_bytes(prjz(DROPS, viewed(DROPS), folder="rawdata/"))
    done = pfwd("import", folder / "a.mpvz", "-o", folder / "survey", "--json")
    assert done.returncode == 0, done.stderr
    lines = records(done.stdout)
    assert [(line["point"], line["drop"], line["saved"]) for line in lines] == [
        ("east 1", 1, True),
        ("east 1", 2, True),
        ("east 1", 3, True),
    ]
    return folder / "survey"


def test_a_refused_file_is_one_line_and_the_others_come(tmp_path: Path) -> None:
    (tmp_path / "bad.dynz").write_bytes(dynz(DROPS)[:-100])
    (tmp_path / "h.toml").write_text("plate_radius_m = 0.15")
    (tmp_path / "good.thy").write_bytes(thy([(1, 1, pulse(samples=470))]))
    done = pfwd(
        "import",
        *(tmp_path / "bad.dynz", tmp_path / "good.thy"),
        *("-o", tmp_path / "s", "--header", tmp_path / "h.toml", "--json"),
    )
    assert done.returncode == 1
    (line,) = records(done.stdout)
    assert (line["point"], line["drop"]) == ("station 1 lane 1", 1)
    refused = [text for text in done.stderr.splitlines() if "bad.dynz" in text]
    assert len(refused) == 1
    assert "expected" in refused[0]
    assert "got" in refused[0]


def test_an_import_ends_with_what_it_did_and_the_next_command(tmp_path: Path) -> None:
    (tmp_path / "a.mpvz").write_bytes(prjz(DROPS, viewed(DROPS), folder="rawdata/"))
    command = ("import", tmp_path / "a.mpvz", "-o", tmp_path / "road")
    done = pfwd(*command)
    lines = done.stdout.splitlines()
    assert lines[0] == "a.mpvz, point east 1: 3 drops saved"
    assert lines[1] == f"{tmp_path / 'road'}: 3 drops at 1 point"
    assert lines[2].startswith("next: pfwd open ")
    assert len(lines) == 3
    again = pfwd(*command).stdout.splitlines()
    assert again[0] == "a.mpvz, point east 1: 3 drops already in the survey"
    assert again[1].endswith("3 drops at 1 point, 3 of them already in the survey")


def test_the_help_of_import_names_every_format() -> None:
    text = pfwd("import", "--help").stdout
    for form in FOREIGN_FORMATS:
        assert form.name.split()[0] in text
        assert all(suffix in text for suffix in form.suffixes)


def test_export_says_what_it_did_on_one_line(survey: Path, tmp_path: Path) -> None:
    path = tmp_path / "r.geojson"
    done = pfwd("export", survey, "--format", "geojson", "-o", path, "--json")
    assert done.returncode == 0
    (line,) = records(done.stdout)
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
    assert "3 of 3 drops have no result" in done.stderr
    features = json.loads(path.read_text(encoding="utf-8"))["features"]
    assert [one["geometry"]["coordinates"] for one in features] == [[6.25, 45.5]] * 3
    forced = pfwd("export", survey, "--format", "geojson", "-o", path, "--force")
    assert forced.returncode == 0
    assert forced.stdout == f"{path}: format geojson, 1 point, 3 drops\n"
