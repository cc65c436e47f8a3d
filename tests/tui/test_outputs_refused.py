"""No command writes a file into a survey, or in the place of a pipe or a device."""

import os
import stat
from collections.abc import Callable
from pathlib import Path

import pytest

from pfwd_device import Drop
from pfwd_device.jobs import Jobs
from pfwd_device.recording import DropRecord, SurveyWriter
from tests.pfwd.files.trace_lines import HEADER, NAMES, rows
from tests.tui.console import PATIENCE, pfwd, running

JOURNAL, LEDGER, DROP = "journal/0001.pfwdj", "acknowledged.txt", "drops/drop-000001.h5"


@pytest.fixture
def survey(tmp_path: Path, make_drop: Callable[..., Drop]) -> Path:
    folder = tmp_path / "survey"
    with SurveyWriter.open(folder, jobs=Jobs(0)) as writer:
        declared = {"plate_radius_m": 0.15, "poisson_ratio": 0.35}
        writer.publish(writer.save_drop(DropRecord("A", make_drop(), None, declared)))
    return folder


def write_trace(path: Path) -> Path:
    path.write_text("\n".join([*HEADER, NAMES, *rows()]) + "\n", encoding="utf-8")
    return path


def content(folder: Path) -> dict[str, bytes | None]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() if path.is_file() else None
        for path in sorted(folder.rglob("*"))
    }


COMMANDS = {
    "export": ("export", "{s}", "--format", "jsonl", "--force", "-o", "{}"),
    "map": ("map", "{t}", "--force", "--no-questions", "-o", "{}"),
    "calibrate": ("calibrate", "{t}", "--stiffness", "1e6", "-o", "{}"),
    "write-device": ("diagnose", "{t}", "--write-device", "{}"),
    "truth": ("simulate", "--drops", "1", "--rate", "20", "--truth", "{}"),
}
"""Commands that write one file, of any name."""


def fill(template: tuple[str, ...], survey: Path, output: Path) -> list[str]:
    """Return the words of a command with a survey, a trace file and its output."""
    trace = write_trace(survey.with_name("trace.csv"))
    places = {"{s}": str(survey), "{t}": str(trace), "{}": str(output)}
    words = list(template)
    for gap, text in places.items():
        words = [word.replace(gap, text) for word in words]
    return words


def assert_refused(template: tuple[str, ...], output: Path, survey: Path) -> None:
    before = content(survey)
    printed = pfwd(*fill(template, survey, output))
    assert printed.status == 2
    assert f"inside the survey {survey.resolve()}" in printed.refusal
    assert "Name a place outside of it" in printed.refusal
    assert content(survey) == before


FOLDER_COMMANDS = (
    ("export", "{s}", "--format", "csv", "-o", "{}"),
    ("log", "nowhere", "-o", "{}"),
    ("live", "nowhere", "-o", "{}", "--json"),
    ("demo", "--lines", "--drops", "1", "-o", "{}"),
    ("import", "{t}", "-o", "{}"),
    ("replay", "{s}", "-o", "{}"),
    ("invert", "{t}", "--archive", "{}"),
    ("diagnose", "{t}", "--archive", "{}"),
)
"""Commands that write a folder."""


@pytest.mark.parametrize("template", [*COMMANDS.values(), *FOLDER_COMMANDS])
def test_no_output_goes_into_a_survey(template: tuple[str, ...], survey: Path) -> None:
    files = ("captures", "new") if template in FOLDER_COMMANDS else (JOURNAL, LEDGER, DROP, "new")
    for name in files:
        assert_refused(template, survey / name, survey)


@pytest.mark.parametrize(
    "template",
    [
        ("report", "{s}", "-o", "{}.html"),
        ("report", "{s}", "-o", "{}.pdf"),
        ("invert", "{t}", "--plot", "{}.png"),
        ("diagnose", "{t}", "--plot", "{}.svg"),
        ("demo", "--lines", "--drops", "1", "--plot", "{}.pdf"),
    ],
    ids=lambda template: template[0],
)
def test_no_picture_or_report_goes_into_a_survey_through_a_link(
    template: tuple[str, ...], survey: Path, tmp_path: Path
) -> None:
    assert_refused(template, survey / "new", survey)
    link = tmp_path / f"link{template[-1].removeprefix('{}')}"
    link.symlink_to(survey / JOURNAL)
    assert_refused((*template[:-1], str(link)), link, survey)
    assert link.is_symlink()


@pytest.mark.posix
@pytest.mark.parametrize("template", COMMANDS.values(), ids=COMMANDS)
def test_a_named_pipe_is_not_replaced_and_not_awaited(
    template: tuple[str, ...], survey: Path, tmp_path: Path
) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    assert f"{pipe}: this is a named pipe" in pfwd(*fill(template, survey, pipe)).refusal
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@pytest.mark.posix
def test_a_device_is_refused_as_an_output(survey: Path, tmp_path: Path) -> None:
    link = tmp_path / "report.html"
    link.symlink_to("/dev/null")
    assert f"{link}: this is a device and no file" in pfwd("report", survey, "-o", link).refusal
    assert link.is_symlink()


@pytest.mark.posix
def test_a_map_still_goes_to_standard_output(tmp_path: Path) -> None:
    trace = write_trace(tmp_path / "trace.csv")
    with running("map", trace, "--no-questions", "--force", "-o", "/dev/stdout") as process:
        output, errors = process.communicate(timeout=PATIENCE)
    assert "delimiter" in output, errors


def test_a_survey_inside_another_is_still_continued(survey: Path, tmp_path: Path) -> None:
    inner = survey / "inner"
    survey.rename(tmp_path / "moved")
    survey.mkdir()
    (tmp_path / "moved").rename(inner)
    with SurveyWriter.open(survey, publish=False) as writer:
        assert writer.folder == survey
    (survey / LEDGER).touch()
    trace = write_trace(tmp_path / "trace.csv")
    assert pfwd("import", trace, "-o", inner).status == 0
