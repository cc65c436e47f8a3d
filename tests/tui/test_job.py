"""``pfwd job``, and the same options at ``pfwd log``."""

import csv
import json
from pathlib import Path
from typing import Any

import pytest

from pfwd.files.header import declared_values
from pfwd_device.recording import DropRecord, SurveyWriter
from simulators.instrument import serve
from tests.pfwd.report.surveys import SETUP, half_sine_drop
from tests.tui.console import PLAIN, RATE, pfwd, records
from tui.cli import main


@pytest.fixture
def survey(tmp_path: Path) -> str:
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        known = declared_values(SETUP)
        for number in range(1, 5):
            drop = half_sine_drop(number, 8000.0 + number)
            writer.save_drop(DropRecord("12+320", drop, None, known, {}))
    return str(tmp_path / "s")


def test_what_is_said_is_shown(survey: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["job", survey, "--procedure", "mndot", "--target", "0.6", "--step", "20"]) == 0
    assert capsys.readouterr().err == "", "nothing was said before"
    assert main(["job", survey, "--json"]) == 0
    job = json.loads(capsys.readouterr().out)
    assert (job["procedure"], job["quantity"], job["unit"]) == ("mndot", "deflection", "m")
    assert (job["target"], job["step_m"]) == (pytest.approx(6e-4), 20.0)
    assert main(["job", survey, "--target", "0.5"]) == 0
    out, err = capsys.readouterr()
    assert "the target of the survey was 0.6 mm, now it is 0.5 mm" in err
    assert "target     0.5 mm" in out
    assert out.count("target = ") == 2, "every change has its date"


def test_the_report_is_judged_by_it(
    survey: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["job", survey, "--procedure", "astm-e2835", "--target", "0.6"])
    capsys.readouterr()
    assert main(["report", survey, "-o", str(tmp_path / "r.html"), "--json"]) == 0
    (point,) = (json.loads(line) for line in capsys.readouterr().out.splitlines())
    assert (point["target"], point["verdict"]) == (pytest.approx(6e-4), "pass")
    assert point["value"]["unit"] == "m"


def test_columns_of_a_station_list_that_are_not_used_are_named(
    survey: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "lot.csv"
    file.write_text("name,lane\n12+320,left\n", encoding="utf-8")
    assert main(["job", survey, "--stations", str(file)]) == 0
    assert "columns not used: 'lane'. Known columns are name," in capsys.readouterr().err
    file.write_text("name,target_MPa\n12+320,45\n", encoding="utf-8")
    assert main(["job", survey, "--stations", str(file)]) == 2
    assert "expected a column target, in MPa, got 'target_MPa'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--target", "-1"], "--target: expected a number > 0, in MPa, got -1"),
        (["--procedure", "mndot", "--target", "45"], "got 45 mm; did you mean a modulus?"),
        (["--target", "45000"], "got 45000 MPa; did you mean another unit?"),
        (["--procedure", "mndott"], "procedure: expected one of astm-e2583"),
        (["--stations", "none.csv"], "none.csv: expected a readable file"),
    ],
)
def test_what_cannot_be_said_is_wrong_usage(
    survey: str, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["job", survey, *options]) == 2
    assert message in capsys.readouterr().err


def test_a_procedure_that_cannot_be_read_is_replaced(
    survey: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with SurveyWriter.open(survey, publish=False) as writer:
        writer.note_event("procedure", {"name": "x", "text": "pfwd-procedure = 9"})
    assert main(["job", survey]) == 1
    assert "choose another one with --procedure" in capsys.readouterr().err
    assert main(["job", survey, "--procedure", "mndot"]) == 0
    assert main(["job", survey]) == 0


def test_log_takes_the_same_options_and_ends_with_the_point(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    asked = ("--procedure", "mndot", "--target", "0.9", "--point", "12+320")
    with serve(PLAIN, drops=3, rate=RATE, seed=1) as instrument:
        first = pfwd("log", instrument.url, "-o", survey, "--json", "--no-invert", *asked)
    with serve(PLAIN, drops=3, rate=RATE, seed=2) as instrument:
        second = pfwd("log", instrument.url, "-o", survey, "--json", "--no-invert")
    assert first.returncode == second.returncode == 0, first.stderr + second.stderr
    assert [line["status"] for line in records(first.stdout)] == ["seating"] * 3
    *drops, point = records(second.stdout)
    assert [line["status"] for line in drops] == ["measured"] * 3
    assert (point["point"], point["complete"], point["target"]) == ("12+320", True, 9e-4)
    assert (point["value"]["unit"], point["value"]["drops"]) == ("m", 3)
    # The same from the survey, and from a replay of it.
    again = pfwd("replay", survey, "--json", "--no-invert")
    assert records(again.stdout)[-1] == point
    text = pfwd("replay", survey, "--no-invert").stdout.splitlines()[-1]
    assert text.startswith("point 12+320: deflection 0.")
    assert "target 0.9 mm" in text


def test_live_for_machines_keeps_the_usual_procedure(tmp_path: Path) -> None:
    with serve(PLAIN, drops=6, rate=RATE, seed=1) as instrument:
        options = ("-o", tmp_path / "s", "--json", "--no-invert", "--target", "40")
        done = pfwd("live", instrument.url, *options)
    assert done.returncode == 0, done.stderr
    *drops, point = records(done.stdout)
    assert [line["status"] for line in drops] == ["seating"] * 3 + ["measured"] * 3
    assert (point["target"], point["verdict"]) == (40e6, "undecided"), "nothing was inverted"
    job = json.loads(pfwd("job", tmp_path / "s", "--json").stdout)
    assert (job["procedure"], job["target"]) == ("plain", 40e6)


def reported(survey: str, capsys: pytest.CaptureFixture[str], *options: str) -> tuple[Any, str]:
    """The line of the only point, and what was said besides."""
    capsys.readouterr()
    out = str(Path(survey).parent / "r.html")
    assert main(["report", survey, "-o", out, "--json", *options]) == 0
    said = capsys.readouterr()
    return json.loads(said.out), said.err


def test_the_target_of_a_report_is_in_the_unit_of_its_procedure(
    survey: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["job", survey, "--procedure", "astm-e2835"])
    for option in ("--target", "--target-deflection"):
        point, said = reported(survey, capsys, option, "0.6")
        assert (point["target"], point["verdict"]) == (pytest.approx(6e-4), "pass")
        assert said.count("report: ") == 1, "only the target differs from the survey"
        command = f"pfwd job {survey} --target 0.6"
        assert "report: its target is not stored: other reports" in said
        assert f"To store it: {command}\n" in said
    point, said = reported(survey, capsys, "--procedure", "tp-bf-stb-b8.3", "--target", "45")
    assert (point["target"], point["value"]["unit"]) == (45e6, "Pa")
    assert "judged by tp-bf-stb-b8.3; the procedure of the survey is another: astm-e2835" in said
    page = (Path(survey).parent / "r.html").read_text(encoding="utf-8")
    assert "own procedure is astm-e2835" in page
    assert f"pfwd job {survey} --procedure tp-bf-stb-b8.3 --target 45\n" in said
    main(["job", survey, "--target", "0.6"])
    _, said = reported(survey, capsys, "--target", "0.6")
    assert "its target is not stored" not in said


def test_a_survey_in_one_file_is_reported_with_a_target(
    survey: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["export", survey, "-o", f"{survey}.pfwdz"]) == 0
    _, said = reported(f"{survey}.pfwdz", capsys, "--target", "45")
    assert "s.pfwdz --target 45" in said


def test_a_target_of_a_report_that_does_not_count_is_said(
    survey: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main(["job", survey, "--target", "40"])
    point, said = reported(survey, capsys, "--target", "50")
    assert point["target"] == 40e6
    expected = "counts for 0 of 1 points; the others have their own: 1 x 40 MPa of the survey"
    assert f"report: the target 50 MPa {expected}" in said


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--target", "0"], "--target: expected a number > 0, in MPa, got 0"),
        (["--target-deflection", "1"], "a procedure that judges deflections, got none, which"),
        (["--target", "1", "--target-deflection", "1"], "expected one of them, got both"),
        (["--procedure", "mndot", "--target", "1000"], "of 0.01 to 10 mm, got 1000 mm"),
    ],
)
def test_a_target_that_no_report_can_have_is_wrong_usage(
    survey: str, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", survey, "-o", str(Path(survey).parent / "r.html"), *options]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(
    ("zone", "said", "expected"),
    [
        ([], "2024-05-06T08:01:00", ""),
        (["--time-zone=-03:30"], "2024-05-06T22:01:00", "2024-05-07T01:31:00+00:00"),
        (["--time-zone", "+2"], "2024-05-06T08:01:00", "2024-05-06T06:01:00+00:00"),
        (["--time-zone", "+2"], "2024-05-06T08:01:00+05:00", "2024-05-06T03:01:00+00:00"),
        ([], "2024-05-06T08:01:00+05:00", "2024-05-06T03:01:00+00:00"),
        (["--time-zone", "UTC"], "in the morning", ""),
        (["--time-zone", "+2"], "0001-01-01T00:00:00", ""),
    ],
)
def test_exports_have_utc_where_the_zone_is_known(
    tmp_path: Path, zone: list[str], said: str, expected: str
) -> None:
    known = declared_values(SETUP) | {"imported": {"time_local": said}}
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        writer.save_drop(DropRecord("1", half_sine_drop(1, 8000.0), None, known, {}))
    if zone:
        assert main(["job", str(tmp_path / "s"), *zone]) == 0
    for form in ("points", "table"):
        made = tmp_path / f"{form}.csv"
        assert main(["export", str(tmp_path / "s"), "--format", form, "-o", str(made)]) == 0
        (row,) = csv.DictReader(made.read_text(encoding="utf-8").splitlines())
        assert row["time_utc"] == expected
        assert row.get("time_local", said) == said


@pytest.mark.parametrize(
    ("zone", "expected"), [(None, ""), ("+2", "2024-05-06T10:01:00+02:00"), ("UTC", None)]
)
def test_exports_have_local_time_where_the_zone_is_known(
    tmp_path: Path, zone: str | None, expected: str | None
) -> None:
    metadata = {"time_utc": "2024-05-06T08:01:00+00:00"}
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        known = declared_values(SETUP)
        writer.save_drop(DropRecord("1", half_sine_drop(1, 8000.0), None, known, metadata))
    if zone is not None:
        assert main(["job", str(tmp_path / "s"), "--time-zone", zone]) == 0
    made = tmp_path / "points.csv"
    assert main(["export", str(tmp_path / "s"), "--format", "points", "-o", str(made)]) == 0
    (row,) = csv.DictReader(made.read_text(encoding="utf-8").splitlines())
    assert row["time_utc"] == metadata["time_utc"]
    assert row["time_local"] == (metadata["time_utc"] if expected is None else expected)


@pytest.mark.parametrize("zone", ["Europe/Berlin", "+15", "+02:60", "2"])
def test_what_is_no_time_zone_is_wrong_usage(
    survey: str, zone: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["job", survey, "--time-zone", zone]) == 2
    assert "expected an offset such as +02:00, or UTC, got" in capsys.readouterr().err
