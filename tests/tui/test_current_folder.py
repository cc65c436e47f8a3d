"""No command runs code of the current folder, nor is disturbed by it.

A survey may come from a stranger, and commands are typed in its folder. Here it contains a file
with the name of every module of Python's library, of the installed packages and of this project.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from simulators.demo import demo_drops
from simulators.instrument import serve
from tests.tui.console import PATIENCE, PLAIN, RATE, TOP

STARTED_BY_PYTHON = ("sitecustomize", "usercustomize", "planted_backend")
SETTINGS = """
backend: module://planted_backend
text.usetex: True
no.such.setting: 1
"""


COMMANDS = """
import json
import sys
from tui.cli import main

if __name__ == "__main__":
    for words in json.loads(sys.argv[1]):
        if status := main(words):
            sys.exit(status)
"""


@pytest.fixture(scope="module")
def received(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that is a survey, with two trace files in it."""
    folder = tmp_path_factory.mktemp("received") / "survey"
    made = demo_drops(2, 0, tmp_path_factory.mktemp("made"))
    completed = run(folder.parent, json.dumps([["import", str(made), "-o", str(folder)]]))
    assert completed.returncode == 0, completed.stderr
    text = made.read_text(encoding="utf-8")
    (folder / "traces").mkdir()
    for number in (1, 2):
        named = text.replace('"demo-0"', f'"demo-{number}"')
        (folder / "traces" / f"p{number}.csv").write_text(named, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def modules() -> set[str]:
    """Names of all modules that can be imported: of Python, of the packages, of the project."""
    standard = {name for name in sys.stdlib_module_names if not name.startswith("_")}
    installed = {name for name in packages_distributions() if name.isidentifier()}
    own = {folder.name for folder in TOP.iterdir() if (folder / "__init__.py").is_file()}
    return standard | {name for name in installed if name[0] != "_"} | own


@pytest.fixture
def planted(received: Path, modules: set[str], tmp_path: Path) -> Path:
    """The survey with modules that leave a mark when they are run."""
    folder = shutil.copytree(received, tmp_path / "survey")
    marks = tmp_path / "marks"
    marks.mkdir()
    assert {"numpy", "textual", "pfwd_device", "tui", "benchmarks"} <= modules
    for name in (*modules, *STARTED_BY_PYTHON):
        text = f"import os\nopen(os.path.join({str(marks)!r}, {name!r}), 'w').close()\n"
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    (folder / "matplotlibrc").write_text(SETTINGS, encoding="utf-8")
    for name in ("dask.yaml", "distributed.yaml"):
        (folder / name).write_text("distributed: {worker: {preload: [planted_backend]}}\n")
    return folder


def run(
    folder: Path, *arguments: object, script: str = COMMANDS
) -> subprocess.CompletedProcess[str]:
    """Run a script outside of the folder in the folder, as the installed command is run."""
    file = folder.parent / "pfwd-script.py"
    file.write_text(script)
    unsafe = {key: value for key, value in os.environ.items() if key != "PYTHONSAFEPATH"}
    return subprocess.run(
        [sys.executable, file, *map(str, arguments)],
        cwd=folder,
        env={**unsafe, "PYTHONPATH": str(TOP)},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        stdin=subprocess.DEVNULL,
    )


def run_clean(planted: Path, *arguments: object, script: str = COMMANDS) -> str:
    """Return the output of a script that ran no module of the folder and reported none."""
    completed = run(planted, *arguments, script=script)
    marks = sorted(path.name for path in (planted.parent / "marks").iterdir())
    assert marks == [], completed.stderr
    assert completed.returncode == 0, completed.stderr
    for word in ("matplotlibrc", "no.such.setting", "not published", "Traceback"):
        assert word not in completed.stderr
    return completed.stdout


QUICK = ("--method", "posterior", "--sensors", "centre", "--bedrock-depth", "1.2")
TRACES = ("traces/p1.csv", "traces/p2.csv")


@pytest.mark.parametrize(
    "commands",
    [
        [
            ("check", "."),
            ("edit", ".", "--note", "seen"),
            ("procedures",),
            ("ports", "--no-probe"),
            ("import", "traces/p1.csv", "-o", "."),
            ("replay", ".", "-o", "../again", "--no-invert"),
            ("report", ".", "-o", "../report.pdf"),
            ("export", ".", "--format", "parquet", "-o", "../out.parquet"),
            ("export", ".", "--format", "h5", "-o", "../out.h5"),
            ("export", ".", "--format", "csv", "-o", "../out"),
            ("invert", *TRACES, "--jobs", "2", "--plot", "../p.png", *QUICK),
            ("invert", "traces", "--archive", "../out.archive", "--jobs", "2", *QUICK),
        ],
        [("demo", "--drops", "1", "--rate", "5", "--json", "-o", "../demo")],
        pytest.param(
            [("diagnose", *TRACES, "--jobs", "2", "--plot", "../p.png")],
            marks=pytest.mark.slow,
        ),
    ],
    ids=lambda commands: commands[0][0],
)
def test_no_module_of_the_current_folder_is_run(
    commands: list[tuple[str, ...]], planted: Path
) -> None:
    run_clean(planted, json.dumps(commands))


def test_drops_are_published_and_no_module_of_the_folder_is_run(planted: Path) -> None:
    (planted / "drops" / "drop-000001.h5").unlink()
    with serve(PLAIN, drops=1, rate=RATE) as instrument:
        log = ("log", instrument.url, "-o", "../new", "--drops", "1")
        run_clean(planted, json.dumps([("recover", "."), log]))
    assert (planted / "drops" / "drop-000001.h5").is_file()
    assert (planted.parent / "new" / "drops" / "drop-000001.h5").is_file()


SCRIPT = """
import sys
from pfwd.analysis.analyse import analyse_files
from pfwd.analysis.options import AnalysisOptions

options = AnalysisOptions(method="posterior", sensors="centre", bedrock_depth=1.2)
for outcome in analyse_files(sys.argv[1:], options, jobs=2):
    print(outcome.results[0].modulus_pa)
"""


def test_a_script_that_inverts_by_processes_runs_no_module_of_the_folder(planted: Path) -> None:
    output = run_clean(planted, *TRACES, script=SCRIPT)
    assert len(output.splitlines()) == 2


def test_a_single_module_starts_python_processes() -> None:
    start = re.compile(
        r"sys\.executable|ProcessPool|^ *(from|import) multiprocessing", re.MULTILINE
    )
    packages = ("pfwd_device", "inversion", "pfwd", "tui", "simulators")
    files = [path for package in packages for path in (TOP / package).rglob("*.py")]
    places = [path for path in files if start.search(path.read_text(encoding="utf-8"))]
    assert places == [TOP / "pfwd_device" / "child_python.py"]
