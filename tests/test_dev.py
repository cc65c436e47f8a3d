"""Set-up by dev.py without a download: the packages that pip would install."""

import os
import tomllib
import venv
from pathlib import Path
from unittest.mock import Mock

import pytest

import dev

TOP = Path(__file__).resolve().parents[1]


class SetUp:
    """An environment in a temporary folder; pip commands are recorded and not executed."""

    def __init__(self) -> None:
        self.targets: list[str] = []
        """Installed packages, in order."""
        self.commands: list[list[str]] = []
        self.status = 0
        """Exit status of pip."""
        self.environments = 0
        """Number of times that the environment was created."""

    def run(self, command: list[str]) -> int:
        self.commands.append(command)
        self.targets.append(command[-1])
        return self.status

    def create(self, folder: Path, *, with_pip: bool) -> None:
        assert with_pip
        self.environments += 1
        venv.EnvBuilder().create(folder)


@pytest.fixture
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SetUp:
    set_up = SetUp()
    folder = tmp_path / "venv"
    windows = os.name == "nt"
    scripts = folder / ("Scripts" if windows else "bin")
    monkeypatch.setattr(dev, "VENV", folder)
    monkeypatch.setattr(dev, "BIN", scripts)
    monkeypatch.setattr(dev, "PYTHON", scripts / ("python.exe" if windows else "python"))
    monkeypatch.setattr(dev, "run", set_up.run)
    monkeypatch.setattr(dev.venv, "create", set_up.create)
    return set_up


@pytest.mark.parametrize(
    ("extras", "targets"),
    [(["", ""], ["."]), (["", "dev", "dev", ""], [".", ".[dev]"]), (["dev", ""], [".[dev]"])],
)
def test_the_tools_are_installed_once_and_on_request(
    environment: SetUp, extras: list[str], targets: list[str]
) -> None:
    for extra in extras:
        dev.set_up(extra)
    assert environment.targets == targets


@pytest.mark.parametrize(
    ("task", "extra"),
    [("demo", ""), *((task, "dev") for task in ("test", "check", "docs", "release"))],
)
def test_each_task_installs_its_extra(
    task: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    set_up = Mock(side_effect=SystemExit)
    monkeypatch.setattr(dev, "set_up", set_up)
    with pytest.raises(SystemExit):
        dev.main([task])
    set_up.assert_called_once_with(extra)


def test_a_changed_recipe_is_installed_by_either_task(
    environment: SetUp, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("pyproject.toml", "constraints.txt"):
        (tmp_path / name).write_text("old")
    monkeypatch.setattr(dev, "TOP", tmp_path)
    dev.set_up("dev")
    (tmp_path / "constraints.txt").write_text("new")
    dev.set_up("")
    # The tools must be those of the new recipe, and then of the old one.
    dev.set_up("dev")
    (tmp_path / "constraints.txt").write_text("old")
    dev.set_up("")
    assert environment.targets == [".[dev]", ".", ".[dev]", "."]


def test_an_interrupted_environment_is_completed(environment: SetUp) -> None:
    venv.EnvBuilder(with_pip=False).create(dev.VENV)
    dev.set_up("")
    assert environment.environments == 1


def test_a_failed_installation_is_repeated(environment: SetUp) -> None:
    environment.status = 1
    with pytest.raises(SystemExit, match="packages not installed"):
        dev.set_up("")
    environment.status = 0
    dev.set_up("")
    assert environment.targets == [".", "."]


def test_each_step_is_announced_with_its_cost(
    environment: SetUp, capsys: pytest.CaptureFixture[str]
) -> None:
    dev.set_up("")
    first, second, last = capsys.readouterr().out.splitlines()
    assert str(dev.VENV) in first
    assert "what the program needs" in second
    assert "MB to download" in second
    assert last.startswith("dev.py: set up in ")


@pytest.mark.parametrize("terminal", [True, False])
def test_progress_of_pip_is_for_a_terminal(
    terminal: bool, environment: SetUp, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dev.sys.stdout, "isatty", lambda: terminal)
    dev.set_up("")
    assert ("--quiet" in environment.commands[0]) != terminal


def test_every_step_is_an_extra_of_the_project() -> None:
    project = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(dev.STEPS) - {""} <= set(project["optional-dependencies"])
