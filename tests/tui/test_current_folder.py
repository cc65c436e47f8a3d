"""No command runs code that lies in the current folder, nor is disturbed by it.

A survey may come from a stranger, and commands are given in its folder. Every module of Python's
own library, and those of this project and what it rests on, lie in it here under their names.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from simulators.demo import demo_drops
from simulators.instrument import serve
from tests.tui.console import PATIENCE, PLAIN, RATE, TOP

OURS = ("pfwd_device", "pfwd", "inversion", "simulators", "tui", "benchmarks")
OTHERS = (
    "numpy",
    "scipy",
    "h5py",
    "matplotlib",
    "jinja2",
    "filelock",
    "serial",
    "pyarrow",
    "dask",
    "distributed",
    "textual",
    "rich",
    "threadpoolctl",
    "cobs",
    "skfem",
    "platformdirs",
)
STARTED_BY_PYTHON = ("sitecustomize", "usercustomize", "planted_backend")
SETTINGS = """
backend: module://planted_backend
text.usetex: True
no.such.setting: 1
"""


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that is a survey, with two trace files in it."""
    folder = tmp_path_factory.mktemp("received") / "survey"
    made = demo_drops(2, 0, tmp_path_factory.mktemp("made"))
    done = pfwd(folder.parent, "import", made, "-o", folder)
    assert done.returncode == 0, done.stderr
    text = made.read_text(encoding="utf-8")
    (folder / "traces").mkdir()
    for number in (1, 2):
        named = text.replace('"demo-0"', f'"demo-{number}"')
        (folder / "traces" / f"p{number}.csv").write_text(named, encoding="utf-8")
    return folder


@pytest.fixture
def planted(whole: Path, tmp_path: Path) -> Path:
    """A copy of it with modules that leave a mark when they are run."""
    folder = tmp_path / "survey"
    shutil.copytree(whole, folder)
    marks = tmp_path / "marks"
    marks.mkdir()
    library = [name for name in sys.stdlib_module_names if not name.startswith("_")]
    for name in (*library, *OURS, *OTHERS, *STARTED_BY_PYTHON):
        text = f"import os\nopen(os.path.join({str(marks)!r}, {name!r}), 'w').close()\n"
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    (folder / "matplotlibrc").write_text(SETTINGS, encoding="utf-8")
    for name in ("dask.yaml", "distributed.yaml"):
        (folder / name).write_text("distributed: {worker: {preload: [planted_backend]}}\n")
    return folder


def pfwd(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run it in a folder as the installed command is run: by a script that lies elsewhere."""
    script = folder.parent / "pfwd-script.py"
    script.write_text(
        "import sys\nfrom tui.cli import main\nif __name__ == '__main__':\n    sys.exit(main())\n"
    )
    unsafe = {key: value for key, value in os.environ.items() if key != "PYTHONSAFEPATH"}
    return subprocess.run(
        [sys.executable, script, *map(str, arguments)],
        cwd=folder,
        env={**unsafe, "PYTHONPATH": str(TOP)},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        stdin=subprocess.DEVNULL,
    )


def run_clean(planted: Path, *arguments: object) -> str:
    """What is printed; nothing of the folder was run, and nothing was said of it."""
    done = pfwd(planted, *arguments)
    marks = sorted(path.name for path in (planted.parent / "marks").iterdir())
    assert marks == [], done.stderr
    assert done.returncode == 0, done.stderr
    for word in ("matplotlibrc", "no.such.setting", "not published", "Traceback"):
        assert word not in done.stderr
    return done.stdout


QUICK = ("--method", "posterior", "--sensors", "centre", "--bedrock-depth", "1.2")


@pytest.mark.parametrize(
    "arguments",
    [
        ("check", "."),
        ("import", "traces/p1.csv", "-o", "."),
        ("replay", ".", "-o", "../again", "--no-invert"),
        ("replay", "."),
        ("invert", "traces/p1.csv", "traces/p2.csv", "--jobs", "2", *QUICK),
        ("invert", "traces", "--archive", "../out", "--jobs", "2", *QUICK),
        ("invert", "traces/p1.csv", "--plot", "../plot.png", *QUICK),
        ("invert", "traces/p1.csv", "--plot", "../plot.pdf", *QUICK),
        ("report", ".", "-o", "../report.html"),
        ("report", ".", "-o", "../report.pdf"),
        ("export", ".", "--format", "parquet", "-o", "../out.parquet"),
        ("export", ".", "--format", "h5", "-o", "../out.h5"),
        ("export", ".", "--format", "csv", "-o", "../out"),
        ("edit", ".", "--note", "seen"),
        ("procedures",),
        ("ports", "--no-probe"),
        (
            "demo",
            "--drops",
            "1",
            "--rate",
            "5",
            "--json",
            "-o",
            "../demo",
            "--plot",
            "../plot.png",
        ),
        ("simulate", "--drops", "1", "--rate", "0", "--listen", "tcp://127.0.0.1:0", "--help"),
    ],
    ids=lambda arguments: " ".join(arguments[:5]),
)
def test_nothing_of_the_current_folder_is_run(arguments: tuple[str, ...], planted: Path) -> None:
    run_clean(planted, *arguments)


def test_recovery_publishes_and_runs_nothing_of_the_folder(planted: Path) -> None:
    (planted / "drops" / "drop-000001.h5").unlink()
    run_clean(planted, "recover", ".")
    assert (planted / "drops" / "drop-000001.h5").is_file()


def test_logging_publishes_and_runs_nothing_of_the_folder(planted: Path) -> None:
    with serve(PLAIN, drops=1, rate=RATE) as instrument:
        run_clean(planted, "log", instrument.url, "-o", "../new", "--drops", 1)
    assert (planted.parent / "new" / "drops" / "drop-000001.h5").is_file()


@pytest.mark.slow
def test_a_diagnosis_by_processes_runs_nothing_of_the_folder(planted: Path) -> None:
    run_clean(
        planted, "diagnose", "traces/p1.csv", "traces/p2.csv", "--jobs", 2, "--plot", "../p.png"
    )


def test_the_benchmarks_run_nothing_of_the_folder(planted: Path) -> None:
    done = pfwd(planted, "bench", "--help")
    assert list((planted.parent / "marks").iterdir()) == []
    assert "pfwd bench" in done.stdout + done.stderr


SCRIPT = """
import sys
from pfwd.analysis.analyse import analyse_files
from pfwd.analysis.options import AnalysisOptions

options = AnalysisOptions(method="posterior", sensors="centre", bedrock_depth=1.2)
for outcome in analyse_files(sys.argv[1:], options, jobs=2):
    print(outcome.results[0].modulus_pa)
"""


def test_a_script_that_inverts_by_processes_runs_nothing_of_the_folder(planted: Path) -> None:
    script = planted.parent / "script.py"
    script.write_text(SCRIPT)
    unsafe = {key: value for key, value in os.environ.items() if key != "PYTHONSAFEPATH"}
    done = subprocess.run(
        [sys.executable, script, "traces/p1.csv", "traces/p2.csv"],
        cwd=planted,
        env={**unsafe, "PYTHONPATH": str(TOP)},
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert list((planted.parent / "marks").iterdir()) == []
    assert len(done.stdout.splitlines()) == 2, done.stderr


def test_one_module_starts_python_processes() -> None:
    start = re.compile(
        r"sys\.executable|ProcessPool|^ *(from|import) multiprocessing", re.MULTILINE
    )
    packages = ("pfwd_device", "inversion", "pfwd", "tui", "simulators")
    files = [path for package in packages for path in (TOP / package).rglob("*.py")]
    places = [path for path in files if start.search(path.read_text(encoding="utf-8"))]
    assert places == [TOP / "pfwd_device" / "child_python.py"]
