"""The table of features: what a user has, run against the installed program.

    PFWD_INSTALLED=/path/to/an/environment python -m pytest -c tests/features/pytest.ini tests/features

The TOML files beside this one hold the rows. A row runs commands or a short script in an empty folder and
states what must be true of the result. The rows were written from the documents; nothing of the program is
imported here. Remove or change a row only where a feature is removed or changed on purpose.

Keys of a row:

name      what must hold, in words
covers    what it stands for: `command NAME`, `import FORMAT`, `export FORMAT`, `key COMMAND.KEY`,
          `guarantee EVENT`, `page NAME`, `promise WORDS OF README`
shown_by  instead of `run`: the test or campaign that shows what cannot be provoked from outside
run       commands; `{name}` stands for an input, `{shared}` for the folder of foreign records
screen    instead of `run`: a command with a screen, `keys` typed into it, `size` of the terminal
python    instead of `run`: a script for the installed Python
files     files to write into the folder first
status    exit status of the last command (0)
error     pattern of the one line on standard error that refuses something
text      patterns that standard output or the screen must contain; `absent`: patterns it must not
lines     number of JSON objects on standard output
keys      keys that each of them (or the one of index `line`) must have
values    list of {line, key, equals | about and within | between | matches | empty}; a key may be a path `a.b.0`
check     Python for foreign libraries: `text`, `objects`, `folder`, `approx` are defined
slow      true: not in the everyday run
"""

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

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
    covers = [text for row in read_table()["row"].values() for text in row["covers"]]
    assert {text.split()[0] for text in covers} <= set(KINDS)
    return {text.partition(" ")[2] for text in covers if text.startswith(f"{kind} ")}


class Runner:
    """Runs commands of the installed program in a folder, with places of its own for everything it stores."""

    def __init__(self, home: Path) -> None:
        self.home = home
        self.inputs: dict[str, Path] = {}
        places = {"PFWD_SPARE": "spare", "PFWD_CACHE": "cache", "PFWD_SETTINGS": "settings.toml"}
        self.environment = {
            **{name: value for name, value in os.environ.items() if not name.startswith("PYTHON")},
            **{name: str(home / place) for name, place in places.items()},
            "PATH": f"{BIN}{os.pathsep}{os.environ['PATH']}",
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }

    def __call__(self, command: str, folder: Path) -> "subprocess.CompletedProcess[str]":
        """Run one command without a terminal and return its status and texts."""
        words = [self.expand(word) for word in shlex.split(command)]
        words[0] = str(BIN / words[0])
        return subprocess.run(
            words,
            cwd=folder,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            encoding="utf-8",
            timeout=240,
        )

    def expand(self, text: str) -> str:
        """Put the paths of inputs and of the foreign records into a text, and skip where these are absent."""
        for name in re.findall(r"\{([a-z0-9-]+)\}", text):
            if name == "shared" and not SHARED.is_dir():
                pytest.skip(f"no folder {SHARED}: these records may not be copied into the project")
            path = SHARED if name == "shared" else self.input(name)
            text = text.replace(f"{{{name}}}", str(path))
        return text

    def input(self, name: str) -> Path:
        """Path of a named input, which is made once."""
        if name not in self.inputs:
            entry = read_table()["input"][name]
            folder = self.home / name
            folder.mkdir()
            write_files(entry, folder)
            for command in entry["run"]:
                done = self(command, folder)
                assert done.returncode == 0, f"input {name}: {done.stderr}"
            self.inputs[name] = folder / entry["path"]
        return self.inputs[name]


@pytest.fixture(scope="session")
def runner(tmp_path_factory: pytest.TempPathFactory) -> Runner:
    return Runner(tmp_path_factory.mktemp("program"))


def write_files(entry: dict[str, Any], folder: Path) -> None:
    for name, text in entry.get("files", {}).items():
        (folder / name).write_text(text, encoding="utf-8")


def rows() -> list[Any]:
    """Rows as parameters; those that share their first input run in one process, so that it is made once."""
    parameters = []
    for row in read_table()["row"].values():
        if "shown_by" in row:
            continue
        commands = " ".join([*row.get("run", []), row.get("screen", ""), row.get("python", "")])
        first = re.search(r"\{(?!shared)([a-z0-9-]+)\}", commands)
        marks = [pytest.mark.xdist_group(first[1] if first else row["name"])]
        if row.get("slow"):
            marks.append(pytest.mark.slow)
        parameters.append(pytest.param(row, id=row["name"], marks=marks))
    return parameters


@pytest.mark.parametrize("row", rows())
def test_a_row_holds(row: dict[str, Any], runner: Runner, tmp_path: Path) -> None:
    write_files(row, tmp_path)
    if "screen" in row:
        text, error, status = screen_text(row, runner, tmp_path), "", 0
    else:
        if "python" in row:
            script = tmp_path / "script.py"
            script.write_text(runner.expand(row["python"]), encoding="utf-8")
        for command in row.get("run", ["python script.py"]):
            done = runner(command, tmp_path)
            assert "Traceback" not in done.stderr, done.stderr
            if command != row.get("run", [command])[-1]:
                assert done.returncode == 0, f"{command}: {done.stderr}"
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
        objects = [json.loads(line, parse_constant=refuse_constant) for line in text.splitlines() if line]
    if "lines" in row:
        assert len(objects) == row["lines"], text
    for number, entry in enumerate(objects):
        if number == row.get("line", number):
            missing = [key for key in row.get("keys", []) if value_at(entry, key) is MISSING]
            assert not missing, f"object {number} lacks {missing}"
    for value in row.get("values", []):
        check_value(value, objects)
    if "check" in row:
        names = {"text": text, "objects": objects, "folder": tmp_path, "approx": pytest.approx}
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


def screen_text(row: dict[str, Any], runner: Runner, folder: Path) -> str:
    """Text of a screen after the keys; each key waits until its pattern is on the screen."""
    pexpect = pytest.importorskip("pexpect")
    pyte = pytest.importorskip("pyte")
    columns, height = row.get("size", [120, 40])
    words = [runner.expand(word) for word in shlex.split(row["screen"])]
    child = pexpect.spawn(
        str(BIN / words[0]),
        words[1:],
        cwd=folder,
        env={**runner.environment, "TERM": "xterm-256color"},
        dimensions=(height, columns),
        encoding="utf-8",
    )
    screen = pyte.Screen(columns, height)
    stream = pyte.Stream(screen)

    def wait(pattern: str) -> str:
        for _ in range(1200):
            try:
                stream.feed(child.read_nonblocking(65536, timeout=0.1))
            except pexpect.TIMEOUT:
                text = "\n".join(screen.display)
                if re.search(pattern, text):
                    return text
            except pexpect.EOF:
                break
        raise AssertionError(f"{pattern!r} is not on the screen:\n" + "\n".join(screen.display))

    try:
        for key, pattern in row["keys"]:
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
            assert {"text", "values", "check", "lines", "keys"} & set(row), f"{name} checks nothing"


def test_each_command_has_a_row(runner: Runner, tmp_path: Path) -> None:
    listed = re.findall(r"^  ([a-z]+) +\S", runner("pfwd help --all", tmp_path).stdout, re.M)
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
    pictures = re.findall(r"pictures/screen-([a-z-]+)\.svg", (TOP / "docs/user-guide.md").read_text("utf-8"))
    assert set(pictures) <= covered("page")


def test_each_promise_stands_in_the_readme() -> None:
    readme = " ".join((TOP / "README.md").read_text(encoding="utf-8").split())
    missing = {words for words in covered("promise") if words not in readme}
    assert not missing
    sections = re.split(r"\n## ", (TOP / "README.md").read_text(encoding="utf-8"))[1:]
    for section in sections:
        if section.splitlines()[0] not in ("Read on",):
            text = " ".join(section.split())
            assert any(words in text for words in covered("promise")), section.splitlines()[0]


def test_each_key_of_the_contract_has_a_row() -> None:
    """Words in code marks of CONTRACT.md are keys, or stand in not_keys.txt: options, values, commands, verbs."""
    contract = SHARED / "CONTRACT.md"
    if not contract.is_file():
        pytest.skip(f"no {contract}")
    text = contract.read_text(encoding="utf-8").split("\n## Added at the end of November 2026")[0]
    text = "\n".join(line for line in text.splitlines() if not re.match(r"\| `pfwd ", line))
    words = {word for mark in re.findall(r"`([^`]+)`", text) for word in re.findall(r"[a-z][a-z0-9_]*", mark)}
    other = set((HERE / "not_keys.txt").read_text(encoding="utf-8").split())
    keys = {text.rpartition(".")[2] for text in covered("key")}
    assert not (words - other - keys), sorted(words - other - keys)
    assert not (keys & other)


if __name__ == "__main__":
    sys.exit(pytest.main(["-c", str(HERE / "pytest.ini"), str(HERE), *sys.argv[1:]]))
