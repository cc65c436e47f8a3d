"""``pfwd job``, the same options at ``pfwd log``, and targets of a report."""

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pfwd.files.header import declared_values
from pfwd_device.recording import DropRecord, SurveyWriter
from simulators.instrument import serve
from tests.pfwd.report.surveys import SETUP, half_sine_drop
from tests.tui.console import PLAIN, RATE, logged, pfwd, records
from tui.cli import main


def write_drops(folder: Path, count: int = 1, **declared: Any) -> str:
    with SurveyWriter.open(folder, publish=False) as writer:
        for number in range(1, count + 1):
            drop = half_sine_drop(number, 8000.0 + number)
            metadata = {"time_utc": "2024-05-06T08:01:00+00:00"} if not declared else {}
            declarations = declared_values(SETUP) | declared
            writer.save_drop(DropRecord("12+320", drop, None, declarations, metadata))
    return str(folder)


@pytest.fixture
def survey(tmp_path: Path) -> str:
    return write_drops(tmp_path / "s", 4)


def test_declarations_are_printed_with_their_changes(survey: str, tmp_path: Path) -> None:
    stations = tmp_path / "lot.csv"
    stations.write_text("name,lane\n12+320,left\n", encoding="utf-8")
    first = pfwd("job", survey, "--procedure", "mndot", "--target", "0.6", "--step", "20")
    assert (first.status, first.err) == (0, ""), "the first declarations replace none"
    job = json.loads(pfwd("job", survey, "--json").out)
    assert (job["procedure"], job["quantity"], job["unit"]) == ("mndot", "deflection", "m")
    assert (job["target"], job["step_m"]) == (pytest.approx(6e-4), 20.0)
    changed = pfwd("job", survey, "--target", "0.5", "--stations", stations)
    assert "the target of the survey was 0.6 mm, now it is 0.5 mm" in changed.err
    assert "columns not used: 'lane'" in changed.err
    assert "target     0.5 mm" in changed.out
    assert changed.out.count("target = ") == 2, "every change has its date"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("job --target -1", "--target: expected a number > 0, in MPa, got -1"),
        ("job --procedure mndot --target 45", "did you mean a modulus?"),
        ("job --procedure mndott", "procedure: expected one of astm-e2583"),
        ("job --stations none.csv", "none.csv: expected a readable file"),
        ("job --time-zone Europe/Berlin", "expected an offset such as +02:00, or UTC, got"),
        ("job --time-zone +15", "expected an offset such as +02:00, or UTC, got"),
        ("job --time-zone +02:60", "expected an offset such as +02:00, or UTC, got"),
        ("report --target-deflection 1", "a procedure that judges deflections, got none, which"),
        ("report --target 1 --target-deflection 1", "expected one of them, got both"),
        ("report --procedure mndot --target 1000", "of 0.01 to 10 mm, got 1000 mm"),
    ],
)
def test_impossible_declarations_are_wrong_usage(survey: str, words: str, message: str) -> None:
    name, *options = words.split()
    output = ["-o", f"{survey}.html"] if name == "report" else []
    printed = pfwd(name, survey, *output, *options)
    assert (printed.status, message in printed.err) == (2, True)


def test_an_unreadable_procedure_is_replaced(survey: str) -> None:
    with SurveyWriter.open(survey, publish=False) as writer:
        writer.note_event("procedure", {"name": "x", "text": "pfwd-procedure = 9"})
    printed = pfwd("job", survey)
    assert printed.status == 1
    assert "choose another one with --procedure" in printed.err
    assert pfwd("job", survey, "--procedure", "mndot").status == 0
    assert pfwd("job", survey).status == 0


def test_log_takes_the_same_options_and_ends_with_the_point(tmp_path: Path) -> None:
    survey = tmp_path / "survey"
    job = ("--procedure", "mndot", "--target", "0.9", "--point", "12+320")
    with serve(PLAIN, drops=3, rate=RATE, seed=1) as instrument:
        seating = logged(instrument, survey, "--no-invert", *job)
    with serve(PLAIN, drops=3, rate=RATE, seed=2) as instrument:
        *measured, point = logged(instrument, survey, "--no-invert")
    statuses = [line["status"] for line in seating + measured]
    assert statuses == ["seating"] * 3 + ["measured"] * 3
    assert (point["point"], point["complete"], point["target"]) == ("12+320", True, 9e-4)
    assert (point["value"]["unit"], point["value"]["drops"]) == ("m", 3)
    replay = pfwd("replay", survey, "--json", "--no-invert")
    assert records(replay.out)[-1] == point
    text = pfwd("replay", survey, "--no-invert").out.splitlines()[-1]
    assert text.startswith("point 12+320: deflection 0.")
    assert "target 0.9 mm" in text


def test_live_for_machines_has_the_plain_procedure(tmp_path: Path) -> None:
    with serve(PLAIN, drops=6, rate=RATE, seed=1) as instrument:
        options = ("-o", tmp_path / "s", "--json", "--no-invert", "--target", "40")
        completed = pfwd("live", instrument.url, *options)
    assert completed.status == 0, completed.err
    *drops, point = records(completed.out)
    assert [line["status"] for line in drops] == ["seating"] * 3 + ["measured"] * 3
    assert (point["target"], point["verdict"]) == (40e6, "undecided"), "nothing was inverted"
    job = json.loads(pfwd("job", tmp_path / "s", "--json").out)
    assert (job["procedure"], job["target"]) == ("plain", 40e6)


@pytest.fixture
def reported(survey: str) -> Callable[..., tuple[Any, str]]:
    """Return the line of the only point and the messages of a report."""

    def report(*options: str, source: str = survey) -> tuple[Any, str]:
        printed = pfwd("report", source, "-o", f"{survey}.html", "--json", *options)
        assert printed.status == 0
        return json.loads(printed.out), printed.err

    return report


def test_the_target_of_a_report_is_in_the_unit_of_its_procedure(
    survey: str, reported: Callable[..., tuple[Any, str]]
) -> None:
    main(["job", survey, "--procedure", "astm-e2835"])
    for option in ("--target", "--target-deflection"):
        point, messages = reported(option, "0.6")
        assert (point["target"], point["verdict"]) == (pytest.approx(6e-4), "pass")
        assert messages.count("report: ") == 1, "only the target differs from the survey"
        assert f"To store it: pfwd job {survey} --target 0.6\n" in messages
    point, messages = reported("--procedure", "tp-bf-stb-b8.3", "--target", "45")
    assert (point["target"], point["value"]["unit"]) == (45e6, "Pa")
    assert "judged by tp-bf-stb-b8.3; the procedure of the survey is another" in messages
    assert f"pfwd job {survey} --procedure tp-bf-stb-b8.3 --target 45\n" in messages
    main(["job", survey, "--target", "0.6"])
    point, messages = reported("--target", "0.6")
    assert (point["verdict"], point["value"]["unit"]) == ("pass", "m")
    assert "its target is not stored" not in messages
    _, messages = reported("--target", "0.5")
    assert "report: the target 0.5 mm counts for 0 of 1 points" in messages
    assert main(["export", survey, "-o", f"{survey}.pfwdz"]) == 0
    _, messages = reported("--target", "0.6", source=f"{survey}.pfwdz")
    assert "its target is not stored" not in messages


def exported(survey: str, form: str) -> dict[str, str]:
    file = Path(survey).with_name(f"{form}.csv")
    assert main(["export", survey, "--format", form, "-o", str(file)]) == 0
    (row,) = csv.DictReader(file.read_text(encoding="utf-8").splitlines())
    return row


@pytest.mark.parametrize(
    ("zone", "local", "utc"),
    [
        ([], "2024-05-06T08:01:00", ""),
        (["--time-zone=-03:30"], "2024-05-06T22:01:00", "2024-05-07T01:31:00+00:00"),
        (["--time-zone", "+2"], "2024-05-06T08:01:00+05:00", "2024-05-06T03:01:00+00:00"),
        (["--time-zone", "UTC"], "in the morning", ""),
        (["--time-zone", "+2"], "0001-01-01T00:00:00", ""),
    ],
)
def test_exports_have_utc_if_the_zone_is_declared(
    tmp_path: Path, zone: list[str], local: str, utc: str
) -> None:
    survey = write_drops(tmp_path / "s", imported={"time_local": local})
    if zone:
        assert main(["job", survey, *zone]) == 0
    for form in ("points", "table"):
        row = exported(survey, form)
        assert row["time_utc"] == utc
        assert row.get("time_local", local) == local


def test_exports_have_local_time_if_the_zone_is_declared(tmp_path: Path) -> None:
    survey = write_drops(tmp_path / "s")
    assert exported(survey, "points")["time_local"] == ""
    for zone, local in (("+2", "2024-05-06T10:01:00+02:00"), ("UTC", "2024-05-06T08:01:00+00:00")):
        assert main(["job", survey, "--time-zone", zone]) == 0
        (Path(survey).with_name("points.csv")).unlink()
        assert exported(survey, "points")["time_local"] == local
