"""The table of features: what a user has, run against the installed program.

    PFWD_INSTALLED=/path/to/an/environment python tests/features/rows.py [ARGUMENTS OF PYTEST]

The TOML files beside this one hold the rows. A row runs commands or a short script in an empty
folder and states what must be true of the result. The rows were written from the documents; nothing
of the program is imported here. Remove or change a row only where a feature is removed or changed
on purpose.

Keys of a row:

name      what must hold, in words
covers    what it stands for: `command NAME`, `import FORMAT`, `export FORMAT`, `key COMMAND.KEY`,
          `guarantee EVENT`, `page NAME`, `promise WORDS OF README`
shown_by  instead of `run`: the test or campaign that shows what cannot be provoked from outside
removed   the sentence that removed the feature; the row does not run and covers nothing
run       commands; `{name}` is the path of a copy of an input, `{shared}` that of foreign records
screen    instead of `run`: a command with a screen, `typed` keys with the pattern that each must
          bring onto the screen, `size` of the terminal
python    instead of `run`: a script for the installed Python
files     files to write into the folder first
status    exit status of the last command (0)
error     pattern of the one line on standard error that refuses something
text      patterns in standard output or on the screen; `absent`: patterns that must not be there
lines     number of JSON objects on standard output
keys      keys that each of them (or the one of index `line`) must have
values    list of {line, key, equals | about and within | between | matches | empty}; a key may be
          a path `a.b.0`
check     Python for foreign libraries; has `text`, `error`, `objects`, `folder`, `approx`
font      language whose letters the row draws; without a font that has them it is skipped
slow      true: only with -m slow
"""

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import filelock
import pytest

HERE = Path(__file__).resolve().parent
TOP = HERE.parents[1]
SHARED = TOP.parent / "shared"
INSTALLED = Path(os.environ["PFWD_INSTALLED"]).absolute()
BIN = INSTALLED / ("Scripts" if os.name == "nt" else "bin")
KINDS = ("command", "import", "export", "key", "guarantee", "page", "promise")
WAYS = ("run", "python", "screen", "shown_by")


@cache
def read_table() -> dict[str, Any]:
    """Rows and inputs of all TOML files beside this one, by name."""
    table: dict[str, Any] = {"row": {}, "input": {}}
    for path in sorted(HERE.glob("*.toml")):
        for kind, entries in tomllib.loads(path.read_text(encoding="utf-8")).items():
            for entry in entries:
                assert entry["name"] not in table[kind], f"{path.name}: {entry['name']} twice"
                table[kind][entry["name"]] = entry
    return table


def covered(kind: str) -> set[str]:
    """What the rows cover, of one kind."""
    rows = [row for row in read_table()["row"].values() if "removed" not in row]
    covers = [text for row in rows for text in row["covers"]]
    assert {text.split()[0] for text in covers} <= set(KINDS)
    return {text.partition(" ")[2] for text in covers if text.startswith(f"{kind} ")}


class Runner:
    """Runs commands of the installed program for one row, in a folder that holds all they store.

    Inputs are made once for all rows and processes in the folder `shelf`. A row gets a copy.
    """

    def __init__(self, shelf: Path, home: Path) -> None:
        self.shelf = shelf
        self.home = home
        self.folder = home / "here"
        self.folder.mkdir(parents=True)
        places = {
            "PFWD_SPARE": home / "spare",
            "PFWD_CACHE": shelf / "cache",
            "PFWD_SETTINGS": home / "settings.toml",
        }
        self.environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("PYTHON")},
            **{name: str(place) for name, place in places.items()},
            "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}",
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }

    def __call__(self, command: str) -> "subprocess.CompletedProcess[str]":
        """Run one command without a terminal and return its status and texts."""
        words = [self.expand(word) for word in shlex.split(command)]
        words[0] = str(BIN / words[0])
        return subprocess.run(
            words,
            cwd=self.folder,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            timeout=240,
        )

    def expand(self, text: str) -> str:
        """Put the paths of inputs and foreign records into a text; skip without the records."""
        for name in re.findall(r"\{([a-z0-9-]+)\}", text):
            if name == "shared" and not SHARED.is_dir():
                pytest.skip(f"no folder {SHARED}: these records may not be copied into the project")
            path = SHARED if name == "shared" else self.input(name)
            text = text.replace(f"{{{name}}}", str(path))
        return text

    def input(self, name: str) -> Path:
        """Path of the copy of a named input, which the first row that needs it makes."""
        entry = read_table()["input"][name]
        made, copy = self.shelf / name / "here", self.home / name
        with filelock.FileLock(self.shelf / f"{name}.lock"):
            if not made.with_name("complete").exists():
                shutil.rmtree(self.shelf / name, ignore_errors=True)
                maker = Runner(self.shelf, self.shelf / name)
                write_files(entry, maker.folder)
                for command in entry["run"]:
                    done = maker(command)
                    assert done.returncode == 0, f"input {name}: {done.stderr}"
                made.with_name("complete").touch()
        if not copy.exists():
            shutil.copytree(made, copy)
        return copy / entry["path"]


@pytest.fixture
def runner(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path) -> Runner:
    base = tmp_path_factory.getbasetemp()
    shelf = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "inputs"
    shelf.mkdir(exist_ok=True)
    return Runner(shelf, tmp_path)


def write_files(entry: dict[str, Any], folder: Path) -> None:
    for name, text in entry.get("files", {}).items():
        (folder / name).write_text(text, encoding="utf-8")


def has_font(language: str) -> bool:
    """Whether this computer has a font for a language, as far as its list of fonts says."""
    if shutil.which("fc-list") is None:
        return os.name == "nt" or sys.platform == "darwin"  # their systems come with them
    listed = subprocess.run(["fc-list", f":lang={language}"], capture_output=True, check=True)
    return bool(listed.stdout.strip())


def rows() -> list[Any]:
    """Rows that run, as parameters."""
    return [
        pytest.param(row, id=row["name"], marks=[pytest.mark.slow] if row.get("slow") else [])
        for row in read_table()["row"].values()
        if not {"shown_by", "removed"} & set(row)
    ]


@pytest.mark.parametrize("row", rows())
def test_a_row_holds(row: dict[str, Any], runner: Runner) -> None:
    if "font" in row and not has_font(row["font"]):
        pytest.skip(f"no font with the letters of {row['font']!r} on this computer (fc-list)")
    write_files(row, runner.folder)
    if "screen" in row:
        text, error, status = screen_text(row, runner), "", 0
    else:
        if "python" in row:
            (runner.folder / "script.py").write_text(runner.expand(row["python"]), encoding="utf-8")
        commands = row.get("run", ["python script.py"])
        for command in commands:
            done = runner(command)
            assert "Traceback" not in done.stderr, done.stderr
            assert command == commands[-1] or done.returncode == 0, f"{command}: {done.stderr}"
        text, error, status = done.stdout, done.stderr, done.returncode
    assert status == row.get("status", 0), error
    if "error" in row:
        assert len(error.strip().splitlines()) == 1, error
        assert re.search(row["error"], error), error
    for pattern in row.get("text", []):
        assert re.search(pattern, text, re.M), f"{pattern!r} is not in\n{text}\n{error}"
    for pattern in row.get("absent", []):
        assert not re.search(pattern, text, re.M), f"{pattern!r} is in\n{text}"
    objects = []
    if {"lines", "keys", "values"} & set(row) or "objects" in row.get("check", ""):
        objects = [
            json.loads(line, parse_constant=refuse_constant) for line in text.splitlines() if line
        ]
    if "lines" in row:
        assert len(objects) == row["lines"], text
    for number, entry in enumerate(objects):
        missing = [key for key in row.get("keys", []) if value_at(entry, key) is MISSING]
        assert not missing or number != row.get("line", number), f"object {number} lacks {missing}"
    for value in row.get("values", []):
        check_value(value, objects)
    if "check" in row:
        names = {
            "text": text,
            "error": error,
            "objects": objects,
            "folder": runner.folder,
            "approx": pytest.approx,
        }
        exec(compile(row["check"], f"check of {row['name']}", "exec"), names)


MISSING = object()


def value_at(entry: Any, path: str) -> Any:
    """Value at a path of keys and indices with dots between them, or MISSING."""
    for key in path.split("."):
        if isinstance(entry, list) and key.lstrip("-").isdigit() and int(key) < len(entry):
            entry = entry[int(key)]
        elif isinstance(entry, dict) and key in entry:
            entry = entry[key]
        else:
            return MISSING
    return entry


def check_value(value: dict[str, Any], objects: list[Any]) -> None:
    """Compare one value of a JSON object with what the row states."""
    got = value_at(objects[value.get("line", 0)], value["key"])
    where = f"{value['key']}: {got!r}"
    if "equals" in value:
        assert got == value["equals"], where
    elif "about" in value:
        assert got == pytest.approx(value["about"], rel=value["within"]), where
    elif "between" in value:
        assert value["between"][0] <= got <= value["between"][1], where
    elif "matches" in value:
        assert re.search(value["matches"], got), where
    else:
        assert (got in (None, [], "")) == value["empty"], where


def refuse_constant(name: str) -> None:
    raise AssertionError(f"{name} is no JSON")


def screen_text(row: dict[str, Any], runner: Runner) -> str:
    """Text of a screen after the keys; each key waits until its pattern is on the screen."""
    pexpect = pytest.importorskip("pexpect")
    pyte = pytest.importorskip("pyte")
    columns, height = row.get("size", [120, 40])
    words = [runner.expand(word) for word in shlex.split(row["screen"])]
    child = pexpect.spawn(
        str(BIN / words[0]),
        words[1:],
        cwd=runner.folder,
        env={
            **runner.environment,
            "TERM": "xterm-256color",
            "COLUMNS": str(columns),
            "LINES": str(height),
        },
        dimensions=(height, columns),
        encoding="utf-8",
    )
    screen = pyte.Screen(columns, height)
    stream = pyte.Stream(screen)

    def wait(pattern: str) -> str:
        end = time.monotonic() + 120
        while time.monotonic() < end:
            try:
                stream.feed(child.read_nonblocking(65536, timeout=0.1))
            except pexpect.TIMEOUT:  # the page is complete when nothing more comes
                end = 0.0 if re.search(pattern, "\n".join(screen.display)) else end
            except pexpect.EOF:
                end = 0.0
        text = "\n".join(screen.display)
        assert re.search(pattern, text), f"{pattern!r} is not on the screen:\n{text}"
        return text

    try:
        for key, pattern in row["typed"]:
            child.send(key)
            text = wait(pattern)
    finally:
        child.close(force=True)
    return text


def test_each_row_is_complete() -> None:
    for name, row in read_table()["row"].items():
        assert len([way for way in WAYS if way in row]) == 1, name
        if "shown_by" in row:
            path, _, test = row["shown_by"].partition("::")
            assert test in (TOP / path).read_text(encoding="utf-8"), f"{name}: {path} has no {test}"
        elif row.get("status", 0) == 0:
            assert {"text", "values", "check"} & set(row), f"{name} checks nothing"


def test_each_key_is_looked_at_by_the_row_that_covers_it() -> None:
    for name, row in read_table()["row"].items():
        if "shown_by" not in row:
            looked_at = {word for key in row.get("keys", []) for word in str(key).split(".")}
            looked_at |= {
                word for value in row.get("values", []) for word in value["key"].split(".")
            }
            looked_at |= set(re.findall(r"\w+", row.get("check", "") + row.get("python", "")))
            keys = {text.rpartition(".")[2] for text in row["covers"] if text.startswith("key ")}
            assert not (keys - looked_at), f"{name}: {sorted(keys - looked_at)}"


def test_each_command_has_a_row(runner: Runner) -> None:
    listed = re.findall(r"^  ([a-z]+) +\S", runner("pfwd help --all").stdout, re.M)
    assert len(listed) > 20
    assert set(listed) == covered("command")


def table_column(page: str, heading: str) -> list[str]:
    """First column of the first table below a heading of a page."""
    text = (TOP / page).read_text(encoding="utf-8").split(f"\n{heading}\n")[1]
    table = re.search(r"\n\|.*\n\|[-| ]+\n((?:\|.*\n)+)", text)
    assert table is not None
    cells = [line.split("|")[1].strip() for line in table[1].splitlines()]
    return [re.sub(r"[`*]", "", cell) for cell in cells]


@pytest.mark.parametrize(
    ("kind", "page", "heading"),
    [
        ("import", "docs/files.md", "## Import"),
        ("export", "docs/files.md", "## Export"),
        ("guarantee", "docs/recording.md", "## The guarantee"),
    ],
)
def test_each_row_of_a_documented_table_has_a_row(kind: str, page: str, heading: str) -> None:
    assert set(table_column(page, heading)) == covered(kind)


def test_each_page_with_a_picture_has_a_row() -> None:
    pictures = re.findall(
        r"pictures/screen-([a-z-]+)\.svg", (TOP / "docs/user-guide.md").read_text("utf-8")
    )
    assert set(pictures) <= covered("page")


def test_each_sentence_of_the_readme_has_a_row() -> None:
    """A sentence or a row of a table holds words of a promise or of not_promises.txt."""
    readme = (TOP / "README.md").read_text(encoding="utf-8").split("\n## Read on")[0]
    text = re.sub(r"^(#.*|\*.*\*|!\[.*|\|[-|]+)$", "", readme, flags=re.M)
    blocks = re.split(r"\n\n+|\n(?=- |\|)|(?<=[.:])\n(?=```)", text)
    sentences = [
        " ".join(part.split())
        for block in blocks
        for part in (
            [block] if "```" in block else re.split(r"(?<=[a-z0-9\)*][.?])\s+(?=[A-Z`*])", block)
        )
    ]
    others = (HERE / "not_promises.txt").read_text(encoding="utf-8").splitlines()
    promises = covered("promise")
    missing = [
        one
        for one in sentences
        if one and not any(words in one for words in [*promises, *filter(None, others)])
    ]
    assert not missing, "\n".join(missing)
    joined = " ".join(" ".join(sentences).split())
    assert not [words for words in [*promises, *others] if words not in joined]


def test_each_key_of_the_contract_has_a_row() -> None:
    """Words in code marks of CONTRACT.md are keys, or stand in not_keys.txt (options, values)."""
    contract = SHARED / "CONTRACT.md"
    if not contract.is_file():
        pytest.skip(f"no {contract}")
    text = contract.read_text(encoding="utf-8").split("\n## Added at the end of November 2026")[0]
    text = "\n".join(line for line in text.splitlines() if not re.match(r"\| `pfwd ", line))
    words = {
        word
        for mark in re.findall(r"`([^`]+)`", text)
        for word in re.findall(r"[a-z][a-z0-9_]*", mark)
    }
    other = set((HERE / "not_keys.txt").read_text(encoding="utf-8").split())
    keys = {text.rpartition(".")[2] for text in covered("key")}
    assert not (words - other - keys), sorted(words - other - keys)
    assert not (keys & other)


if __name__ == "__main__":
    sys.exit(
        pytest.main(
            ["-c", str(HERE / "pytest.ini"), "-n", "4", "-m", "not slow", str(HERE), *sys.argv[1:]]
        )
    )
