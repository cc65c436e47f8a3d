"""The key for the slip of a point: the dialog, the file beside the survey, and every refusal."""

from collections.abc import Awaitable, Callable, Sequence
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
    """Replaces the process of the commands: records them and sets their outcome."""

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
    commands = Commands()
    monkeypatch.setattr(slips, "Jobs", lambda: commands)
    return commands


Script = Callable[[App, Any], Awaitable[None]]


def play_survey(folder: Path, script: Script, size: tuple[int, int] = (120, 40)) -> None:
    """Run a script once both points of the survey are read."""

    async def with_survey(app: App, pilot: Any) -> None:
        await until(pilot, lambda: len(app.state.points) == 2)
        app.redraw()
        await pilot.pause()
        await script(app, pilot)

    play(App(QuietSource(folder)), with_survey, size)


def test_a_key_writes_the_slip_to_the_reports_of_the_survey(survey: Path) -> None:
    async def script(app: App, pilot: Any) -> None:
        await deliver(app, pilot, JobReported(Job(operator="A. Ström")))
        await pilot.press("s")
        await until(pilot, lambda: "Slip of point 7" in app.text)
        assert "A. Ström" in app.text  # the operator of the survey is proposed
        await pilot.press("enter")
        file = survey.with_name("road-reports") / "slip-7.pdf"
        await until(pilot, lambda: f"slip of point 7: {file}" in app.message, 60.0)
        assert file.read_bytes().startswith(b"%PDF")
        assert app.state.notices[-1][1].text.endswith("slip-7.pdf")  # the help keeps the path

    play_survey(survey, script)


def test_the_slip_of_the_chosen_point_has_the_typed_signature(
    survey: Path, commands: Commands, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def script(app: App, pilot: Any) -> None:
        await pilot.press("s", "escape")
        await pilot.pause()
        assert "writing" not in app.message
        await pilot.press("2", "home", "s")
        await until(pilot, lambda: "Slip of point km 12/3" in app.text)
        await pilot.press(*"Li", "enter")  # typed over the proposed name
        await until(pilot, lambda: len(commands) == 1)
        await pilot.press("s", "delete", "enter")
        await until(pilot, lambda: len(commands) == 2)

    monkeypatch.chdir(survey)
    play_survey(Path(), script)
    output = f"--output={survey.with_name('road-reports') / 'slip-km 12_3.pdf'}"
    signed, unsigned = commands
    assert signed[:2] == ["report", "."]
    assert {"--slip", "--no-store", "--point=km 12/3", "--signed=Li"} <= set(signed)
    assert signed[-1] == output
    assert not any(word.startswith("--signed") for word in unsigned)


def test_a_failure_is_a_sentence(survey: Path, commands: Commands) -> None:
    folder = survey.with_name("road-reports")
    folder.write_text("a file in the place of the folder", encoding="utf-8")
    commands.error = "--output x: disk full"

    async def script(app: App, pilot: Any) -> None:
        await pilot.press("s", "enter")
        await until(pilot, lambda: "not written" in app.message)
        assert str(folder) in app.message
        assert commands == []
        folder.unlink()
        await pilot.press("s", "enter")
        sentence = "the slip of point 7 was not written: --output x: disk full"
        await until(pilot, lambda: app.message == sentence)
        app.redraw()
        await pilot.pause()
        assert "disk full" in app.text

    play_survey(survey, script, (80, 24))


def test_the_screen_goes_on_while_a_slip_is_written(survey: Path, commands: Commands) -> None:
    commands.waits = True

    async def script(app: App, pilot: Any) -> None:
        await pilot.press("s", "enter")
        await until(pilot, lambda: "writing the slip" in app.message)
        await deliver(app, pilot, ready())
        assert app.state.device.serial_number == "T-1042"
        await pilot.press("s")  # one at a time
        await until(pilot, lambda: "another slip is being written" in app.message)
        commands.finish()
        await until(pilot, lambda: "slip of point 7:" in app.message)
        await pilot.press("s")
        await until(pilot, lambda: "Slip of point 7" in app.text)

    play_survey(survey, script)


def test_a_point_without_safe_drops_has_no_slip(survey: Path) -> None:
    async def without_drops(app: App, pilot: Any) -> None:
        await pilot.press("s")
        await until(pilot, lambda: "no drop on the disk" in app.message)

    play(App(QuietSource(survey.parent)), without_drops)

    async def with_an_unsafe_drop(app: App, pilot: Any) -> None:
        await deliver(app, pilot, ready(), DropNotSaved("7", 3, "no room"))
        await pilot.press("s")
        await until(pilot, lambda: "only in memory" in app.message)
        await pilot.press("q", "y")

    play_survey(survey, with_an_unsafe_drop)


def test_an_earlier_slip_is_not_overwritten(tmp_path: Path) -> None:
    names = []
    for _ in range(3):
        file = free_path(tmp_path, "slip-7", ".pdf")
        file.touch()
        names.append(file.name)
    assert names == ["slip-7.pdf", "slip-7-2.pdf", "slip-7-3.pdf"]


def test_a_signature_is_a_single_short_line() -> None:
    assert signature_error("A. Ström") == signature_error("") == ""
    assert signature_error("x" * 65) == signature_error("a\nb") == "up to 64 letters on one line"
