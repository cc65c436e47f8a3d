"""The console command: usage, exit status, its outputs, and its end by a signal."""

import errno
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import textwrap
import types
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from inversion.notices import text_notice
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropResult, FileOutcome
from tests.tui.console import TOP, pfwd, records
from tui.arguments import analysis_options
from tui.cli import main
from tui.commands import bench, completion
from tui.parser import CommandParser, build_parser, command_module

RESULT = DropResult(file="a.csv", drop=1, status="measured", modulus_pa=4e7, r_squared=0.99)
REJECTED = DropResult(file="a.csv", drop=2, status="rejected", reason=text_notice("no pulse"))


class FakeAnalysis(types.ModuleType):
    """Replaces the analysis: yields prepared outcomes and records the request."""

    def __init__(self, *outcomes: FileOutcome | Exception) -> None:
        super().__init__("pfwd.analysis.analyse")
        self.outcomes = outcomes
        self.request: tuple[Any, ...] = ()
        self.closed = False

    def analyse_files(
        self, paths: list[str], options: AnalysisOptions, jobs: int, *_: object, use_stored: bool
    ) -> Iterator[FileOutcome]:
        self.request = (paths, options, jobs)
        try:
            for outcome in self.outcomes:
                if isinstance(outcome, Exception):
                    raise outcome
                yield outcome
        finally:
            self.closed = True


def analysis(monkeypatch: pytest.MonkeyPatch, *outcomes: FileOutcome | Exception) -> FakeAnalysis:
    fake = FakeAnalysis(*outcomes)
    monkeypatch.setitem(sys.modules, "pfwd.analysis.analyse", fake)
    return fake


# Usage


HELP = """
import atexit, sys, time
atexit.register(lambda: print(time.process_time(), file=sys.stderr))
from tui.cli import main
main(["--help"])
"""


def test_help_answers_in_under_300_ms() -> None:
    """Processor time, which other programs on the computer do not lengthen as they do the wait."""

    def run() -> float:
        help_run = subprocess.run(
            [sys.executable, "-c", HELP], cwd=TOP, capture_output=True, text=True
        )
        assert "invert" in help_run.stdout
        return float(help_run.stderr)

    assert any(run() < 0.3 for _ in range(5))


def test_the_help_of_a_command_imports_nothing_heavy() -> None:
    code = textwrap.dedent("""
        import sys
        from tui.parser import build_parser
        for name, command in build_parser().commands.items():
            if name != "schema":  # the kinds of files come from their readers
                command.add_arguments()
        heavy = {"numpy", "h5py", "scipy", "textual", "matplotlib", "serial", "multiprocessing"}
        assert not heavy & set(sys.modules)
    """)
    subprocess.run([sys.executable, "-c", code], cwd=TOP, check=True)


def test_every_option_reaches_the_analysis(tmp_path: Path) -> None:
    header = tmp_path / "setup.toml"
    header.write_text("")
    line = (
        "invert a.csv b.csv --model layer --bedrock-depth 1.5 --elastic --load half-sine "
        "--plate rigid-smooth --sensors centre --joint --method posterior --seed 7 "
        "--plate-radius 0.1 --poisson-ratio 0.3 --density 1900 --plate-mass 12 --header"
    )
    options = analysis_options(build_parser().parse_args([*line.split(), str(header)]))
    assert options == AnalysisOptions(
        model="layer",
        bedrock_depth=1.5,
        elastic=True,
        load="half-sine",
        plate="rigid-smooth",
        sensors="centre",
        joint=True,
        method="posterior",
        seed=7,
        header=str(header),
        plate_radius=0.1,
        poisson_ratio=0.3,
        density=1900.0,
        plate_mass=12.0,
    )


# Output and status


def test_json_has_an_object_for_each_line_and_people_get_a_table(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    results = [replace(RESULT, modulus_sd_pa=float("nan")), REJECTED]
    fake = analysis(monkeypatch, FileOutcome("a.csv", None, results))
    printed = pfwd("invert", "a.csv", "--json", "--jobs", 2)
    assert records(printed.out) == [RESULT.to_json(), REJECTED.to_json()]
    assert (printed.status, printed.err) == (0, "")
    assert fake.request == (["a.csv"], AnalysisOptions(), 2)
    table = pfwd("invert", "a.csv").out
    for part in ("E MPa", "40.0", "rejected, drop 2: no pulse"):
        assert part in table


def test_a_refused_file_is_status_1_and_the_next_file_is_inverted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    refused = FileOutcome("b.csv", "b.csv, line 3: expected \x1b[31m, got\nothing")
    analysis(monkeypatch, refused, FileOutcome("a.csv", None, [RESULT]))
    printed = pfwd("invert", "b.csv", "a.csv", "--json")
    assert (printed.status, len(records(printed.out))) == (1, 1)
    mark = "_" if os.name == "nt" else "\ufffd"  # a pipe of Windows gets ASCII
    assert printed.err == f"pfwd: b.csv, line 3: expected {mark}[31m, got{mark}othing\n"


def test_a_plot_is_drawn_of_all_files(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    drawn: list[Any] = []
    plots = types.ModuleType("pfwd.analysis.plots")
    plots.plot_outcomes = lambda *args: drawn.append(args) or []  # type: ignore[attr-defined,func-returns-value]
    monkeypatch.setitem(sys.modules, "pfwd.analysis.plots", plots)
    outcomes = [FileOutcome("a.csv", None, [RESULT]), FileOutcome("b.csv", "refused")]
    analysis(monkeypatch, *outcomes)
    assert main(["invert", "a.csv", "b.csv", "--plot", "out.PNG"]) == 1
    assert drawn == [(outcomes, "out.PNG")]


def test_an_unforeseen_error_is_a_single_line_after_the_end_of_the_analysis(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for error, message in (
        (ZeroDivisionError("division\nby zero"), "an unexpected error, please report it: Zero"),
        (OSError(28, "No space left on device", "out.png"), "out.png: No space left on device"),
    ):
        analysis(monkeypatch, error)
        printed = pfwd("invert", "a.csv")
        assert printed.status == 1
        assert message in printed.refusal
    fake = analysis(monkeypatch, FileOutcome("a.csv", None, [{"unprintable": object()}]))
    closed: list[bool] = []
    with monkeypatch.context() as patch:
        patch.setattr("tui.cli.say", lambda _message: closed.append(fake.closed))
        assert main(["invert", "a.csv", "--json"]) == 1
    assert closed == [True]
    analysis(monkeypatch, ZeroDivisionError("division by zero"))
    monkeypatch.setenv("PFWD_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        main(["invert", "a.csv"])


# Stopping, in a separate process, because signals and closed pipes concern the complete process

ENDLESS = textwrap.dedent("""
    import sys, time, types
    from pfwd.analysis.results import FileOutcome
    from pfwd.analysis.results import DropResult
    from tui.cli import main

    def analyse_files(paths, options, jobs, progress, use_stored):
        try:
            while True:
                yield FileOutcome("a.csv", None, [DropResult(file="a.csv", drop=1)])
                time.sleep(0.02)
        finally:
            print("closed", file=sys.stderr)

    fake = types.ModuleType("pfwd.analysis.analyse")
    fake.analyse_files = analyse_files
    sys.modules["pfwd.analysis.analyse"] = fake
    sys.exit(main(["invert", "a.csv", "--json"]))
""")


@pytest.fixture
def endless() -> Iterator[subprocess.Popen[str]]:
    """A running `pfwd invert` that never ends by itself and has printed its first line."""
    pipe = subprocess.PIPE
    command = [sys.executable, "-c", ENDLESS]
    with subprocess.Popen(command, cwd=TOP, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["drop"] == 1
        yield process
        process.kill()


LATE = """
import atexit, os, signal, sys
# Registered by what was imported first: done after what the command registers.
atexit.register(lambda: (print("ending", flush=True), sys.stdin.read(1)))
class Late:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
from tui.cli import main
sys.late = Late()
sys.exit(main(["procedures"]))
"""


@pytest.mark.posix
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_python_ends_changes_nothing(number: signal.Signals) -> None:
    pipe = subprocess.PIPE
    with subprocess.Popen(
        [sys.executable, "-c", LATE], cwd=TOP, stdin=pipe, stdout=pipe, stderr=pipe, text=True
    ) as process:
        assert process.stdout is not None
        assert any(line == "ending\n" for line in process.stdout)
        process.send_signal(number)
        _, err = process.communicate("x", timeout=60)
    assert (process.returncode, err) == (0, "")


@pytest.mark.posix
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_command(endless: subprocess.Popen[str], number: int) -> None:
    endless.send_signal(number)
    out, err = endless.communicate(timeout=20)
    assert endless.returncode == 0
    assert all(json.loads(line) for line in out.splitlines())
    assert err == "closed\npfwd: stopped\n"


def test_a_reader_who_leaves_ends_a_command(endless: subprocess.Popen[str]) -> None:
    assert endless.stdout is not None
    assert endless.stderr is not None
    endless.stdout.close()
    assert endless.wait(timeout=20) == 0
    assert endless.stderr.read() == "closed\n"


class WindowsOutput(io.FileIO):
    """Pipe or file whose loss is reported as by the C library of Windows."""

    lost = False

    def write(self, data: Any) -> int:
        if self.lost:
            raise OSError(errno.EINVAL, "Invalid argument")
        return len(data)


@pytest.fixture
def windows_output(monkeypatch: pytest.MonkeyPatch) -> Iterator[WindowsOutput]:
    """A pipe as standard output, and the branches for Windows in the command."""
    reading, writing = os.pipe()
    output = WindowsOutput(writing, "wb")
    stream = io.TextIOWrapper(io.BufferedWriter(output), encoding="cp850")
    # Also at the descriptor of standard output: the command tests whether it is a pipe.
    standard_output = os.dup(1)
    os.dup2(writing, 1)
    monkeypatch.setattr("tui.cli.os", types.SimpleNamespace(**{**vars(os), "name": "nt"}))
    with monkeypatch.context() as patched:
        patched.setattr(sys, "stdout", stream)
        yield output
    output.lost = False
    stream.close()
    os.dup2(standard_output, 1)
    for descriptor in (standard_output, reading):
        os.close(descriptor)


@pytest.mark.usefixtures("windows_output")
def test_errors_of_files_on_windows_have_their_reason(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "a.csv"
    file.touch()
    for error, reason in (
        (OSError(errno.EINVAL, "Invalid argument"), "Invalid argument"),
        (OSError(errno.EINVAL, "Invalid argument", r"\\\\server\\a.csv"), "Invalid argument"),
        (PermissionError(errno.EACCES, "Permission denied", str(file)), "open in another program"),
    ):
        analysis(monkeypatch, error)
        assert main(["invert", "a.csv"]) == 1
        assert reason in capsys.readouterr().err


def test_a_reader_who_leaves_on_windows_ends_a_command(
    windows_output: WindowsOutput,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    analysis(monkeypatch, FileOutcome("a.csv", None, [RESULT]))
    windows_output.lost = True
    assert main(["invert", "a.csv", "--json"]) == 0
    assert capsys.readouterr().err == ""


def test_the_package_is_a_command_too() -> None:
    command = [sys.executable, "-m", "tui", "--version"]
    completed = subprocess.run(command, cwd=TOP, capture_output=True, text=True, check=False)
    assert completed.stdout.startswith("pfwd "), completed.stderr


def test_benchmarks_get_their_arguments_and_return_their_status(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    folder, decoy = tmp_path / "benchmarks", tmp_path / "elsewhere" / "benchmarks"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "__main__.py").write_text("import sys; print(sys.argv[1:]); sys.exit(5)")
    decoy.mkdir(parents=True)
    (decoy / "__init__.py").write_text("raise SystemExit('the wrong folder')")
    monkeypatch.setattr(bench, "TOP", tmp_path)
    monkeypatch.chdir(decoy.parent)
    assert main(["bench", "--json", "speed", "-n", "3"]) == 5
    assert capfd.readouterr().out.strip() == "['--json', 'speed', '-n', '3']"


# Help


def all_commands() -> dict[str, CommandParser]:
    commands = build_parser().commands
    for command in commands.values():
        command.add_arguments()
    return commands


def test_every_module_of_commands_has_a_command_with_a_description() -> None:
    folder = TOP / "tui" / "commands"
    commands = all_commands()
    modules = {command_module(name).__name__.rpartition(".")[2] for name in commands}
    assert modules == {file.stem for file in folder.glob("*.py")} - {"__init__"}
    silent = [name for name, command in commands.items() if not command.description]
    assert silent == ["bench"], "bench hands its options on to a benchmark"
    for command in commands.values():
        titles = [group.title for group in command._action_groups]
        assert "expert options" not in titles[:-1], "they are the last group"


def test_help_lists_twelve_commands_in_four_groups() -> None:
    text = pfwd("help").out
    assert re.findall(r"^(\w+):$", text, re.M) == ["measure", "look", "export", "repair"]
    names = re.findall(r"^  (\w+)  ", text, re.M)
    assert len(names) <= 12
    everything = re.findall(r"^  (\w+)  ", pfwd("help", "--all").out, re.M)
    assert everything == list(build_parser().commands)
    assert f"help --all        {len(everything) - len(names)} more" in text
    assert pfwd("--help").out == text


@pytest.mark.posix
@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
def test_bash_completes_commands_options_and_files(tmp_path: Path) -> None:
    (tmp_path / "script").write_text(pfwd("completion", "bash").out)
    (tmp_path / "Ring road").mkdir()
    expected = {
        "pfwd inv": "invert",
        "pfwd invert --me": "--method",
        "pfwd open Ring": "Ring road",
    }
    commands = ["source ./script"]
    for words in expected:
        commands.append(f"COMP_WORDS=({words}); COMP_CWORD=$(( ${{#COMP_WORDS[@]}} - 1 ))")
        commands.append("_shtab_pfwd; printf '%s\\n' \"${COMPREPLY[@]}\"")
    completed = subprocess.run(
        ["bash", "-c", "\n".join(commands)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert completed.stdout.splitlines() == list(expected.values())


def test_every_shell_has_a_completion_script() -> None:
    for shell in completion.SHELLS:
        assert "posterior" in pfwd("completion", shell).out


def test_help_of_a_command_ends_with_the_expert_options() -> None:
    text = pfwd("help", "invert").out
    assert text.startswith("usage: pfwd invert FILE [FILE ...] [OPTIONS]\n")
    everyday, expert = text.split("\nexpert options:\n")
    assert "--bedrock-depth" in everyday
    assert "--method" in expert
