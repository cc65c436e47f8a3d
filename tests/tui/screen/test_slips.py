"""The key for the slip of a point: the dialog, the file beside the survey, and every refusal."""

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from pfwd.jobs import Task
from pfwd.judging import Job
from pfwd.session.events import DropNotSaved, JobReported
from tests.pfwd.report.surveys import write_judged_survey
from tests.tui.screen.scripted import App, QuietSource, deliver, play, ready, until
from tui.screen.session import slips
from tui.screen.session.slips import free_path, signature_error


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    return write_judged_survey(
        tmp_path / "road", 50e6, dict.fromkeys(("km 12/3", "7"), (60e6, 60e6))
    )


class Commands(list[Sequence[str]]):
    """Stands for the process that runs commands: notes them, and says how they ended."""

    error = ""
    waits = False

    def __init__(self) -> None:
        super().__init__()
        self.n_open = 0
        self._finish: Callable[[], object]

    def submit(self, _: object, words: Sequence[str], *, on_finish: Callable[[Any], None]) -> None:
        self.append(words)
        task = Task[str]()
        task.set_result(self.error)
        self.n_open, self._finish = 1, lambda: on_finish(task)
        if not self.waits:
            self.finish()

    def finish(self) -> None:
        self.n_open = 0
        self._finish()

    def close(self) -> None:
        pass


@pytest.fixture
def commands(monkeypatch: pytest.MonkeyPatch) -> Commands:
    """Commands that would be run; none is."""
    commands = Commands()
    monkeypatch.setattr(slips, "Jobs", lambda: commands)
    return commands


def app_of(folder: Path) -> App:
    return App(QuietSource(folder))


async def survey_is_read(app: App, pilot: Any) -> None:
    await until(pilot, lambda: len(app.state.points) == 2)
    app.redraw()
    await pilot.pause()


def test_one_key_writes_the_slip_beside_the_survey(survey: Path) -> None:
    async def script(app: App, pilot: Any) -> None:
        await survey_is_read(app, pilot)
        await deliver(app, pilot, JobReported(Job(operator="A. Ström")))
        await pilot.press("s")
        await until(pilot, lambda: "Slip of point 7" in app.text)
        assert "A. Ström" in app.text  # the operator of the survey is proposed
        await pilot.press("enter")
        file = survey.with_name("road-reports") / "slip-7.pdf"
        await until(pilot, lambda: f"slip of point 7: {file}" in app.message, 60.0)
        assert file.read_bytes().startswith(b"%PDF")
        assert app.state.notices[-1][1].text.endswith("slip-7.pdf")  # the help keeps the path

    play(app_of(survey), script)


def test_the_points_page_writes_the_slip_of_the_chosen_point(
    survey: Path, commands: Commands
) -> None:
    async def script(app: App, pilot: Any) -> None:
        await survey_is_read(app, pilot)
        await pilot.press("2", "home", "s")
        await until(pilot, lambda: "Slip of point km 12/3" in app.text)
        await pilot.press(*"Li", "enter")  # typed over the proposed name
        await until(pilot, lambda: bool(commands))

    play(app_of(survey), script)
    (words,) = commands
    assert words[:2] == ["report", str(survey)]
    assert {"--slip", "--no-store", "--point=km 12/3", "--signed=Li"} <= set(words)
    assert words[-1] == f"--output={survey.with_name('road-reports') / 'slip-km 12_3.pdf'}"


def test_an_empty_signature_leaves_a_line_to_sign_on(survey: Path, commands: Commands) -> None:
    async def script(app: App, pilot: Any) -> None:
        await survey_is_read(app, pilot)
        await pilot.press("s", "delete", "enter")
        await until(pilot, lambda: bool(commands))

    play(app_of(survey), script)
    assert not any(word.startswith("--signed") for word in commands[0])


def test_escape_writes_nothing(survey: Path, commands: Commands) -> None:
    async def script(app: App, pilot: Any) -> None:
        await survey_is_read(app, pilot)
        await pilot.press("s", "escape")
        await pilot.pause()
        assert "writing" not in app.message

    play(app_of(survey), script)
    assert commands == []


@pytest.mark.parametrize("size", [(80, 24), (120, 40)])
def test_a_failure_is_one_sentence(survey: Path, commands: Commands, size: tuple[int, int]) -> None:
    commands.error = "--output x: disk full"

    async def script(app: App, pilot: Any) -> None:
        await survey_is_read(app, pilot)
        await pilot.press("s", "enter")
        await until(pilot, lambda: "not written" in app.message)
        expected = "the slip of point 7 was not written: --output x: disk full"
        assert app.message == expected
        app.redraw()
        await pilot.pause()
        assert "disk full" in app.text

    play(app_of(survey), script, size)


def test_a_folder_that_cannot_be_made_is_one_sentence(survey: Path, commands: Commands) -> None:
    survey.with_name("road-reports").write_text(
        "a file where the folder would be", encoding="utf-8"
    )

    async def script(app: App, pilot: Any) -> None:
        await survey_is_read(app, pilot)
        await pilot.press("s", "enter")
        await until(pilot, lambda: "not written" in app.message)
        assert str(survey.with_name("road-reports")) in app.message

    play(app_of(survey), script)
    assert commands == []


def test_the_screen_goes_on_while_a_slip_is_written(survey: Path, commands: Commands) -> None:
    commands.waits = True

    async def script(app: App, pilot: Any) -> None:
        await survey_is_read(app, pilot)
        await pilot.press("s", "enter")
        await until(pilot, lambda: "writing the slip" in app.message)
        start = time.monotonic()
        await deliver(app, pilot, ready())
        assert time.monotonic() - start < 5.0
        await pilot.press("s")  # one at a time
        await until(pilot, lambda: "another slip is being written" in app.message)
        commands.finish()
        await until(pilot, lambda: "slip of point 7:" in app.message)
        await pilot.press("s")
        await until(pilot, lambda: "Slip of point 7" in app.text)

    play(app_of(survey), script)


def test_a_point_without_safe_drops_has_no_slip(survey: Path) -> None:
    async def without_drops(app: App, pilot: Any) -> None:
        await pilot.press("s")
        await until(pilot, lambda: "no drop on the disk" in app.message)

    play(App(QuietSource(survey.parent)), without_drops)

    async def with_an_unsafe_drop(app: App, pilot: Any) -> None:
        await survey_is_read(app, pilot)
        await deliver(app, pilot, ready(), DropNotSaved("7", 3, "no room"))
        await pilot.press("s")
        await until(pilot, lambda: "only in memory" in app.message)
        await pilot.press("q", "y")

    play(app_of(survey), with_an_unsafe_drop)


def test_a_survey_in_the_current_folder_has_a_place_for_slips(
    survey: Path, commands: Commands, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(survey)

    async def script(app: App, pilot: Any) -> None:
        await survey_is_read(app, pilot)
        await pilot.press("s", "enter")
        await until(pilot, lambda: bool(commands))

    play(app_of(Path()), script)
    assert commands[0][-1] == f"--output={survey.with_name('road-reports') / 'slip-7.pdf'}"


def test_an_earlier_slip_is_not_overwritten(tmp_path: Path) -> None:
    names = []
    for _ in range(3):
        file = free_path(tmp_path, "slip-7", ".pdf")
        file.touch()
        names.append(file.name)
    assert names == ["slip-7.pdf", "slip-7-2.pdf", "slip-7-3.pdf"]


def test_a_signature_is_one_short_line() -> None:
    assert signature_error("A. Ström") == signature_error("") == ""
    assert signature_error("x" * 65) == signature_error("a\nb") == "up to 64 letters on one line"
