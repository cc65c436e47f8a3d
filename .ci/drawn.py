"""Which of a fixed list of changes do the tests of a package notice, before and after tests change?

    python3 dev.py mutate drawn [--draw N] [--seed S] [--as NAME] [--only WORD] [--package P]
        [--minutes M]

The list is .ci/drawn.json: a change is a place in a module with the lines before and after it, so
that it can be made again while other lines of the module change. `--draw` writes a new list, as
many changes of each package; without it the changes that have no outcome of NAME yet are tried, the
outcome is stored after each, and a list that was left half way is taken up again. `--only` takes
changes whose other outcomes have the word, as `noticed`. Ends with 0.
"""

import argparse
import difflib
import json
import os
import random
import re
import subprocess
import sys
import tempfile
import time
from itertools import chain, zip_longest
from pathlib import Path
from typing import Any

from mutate import TOP, _copy, _mutations, _sample

LIST = TOP / ".ci" / "drawn.json"
LONGEST_S = 900.0
"""A change that makes the tests of a package longer than this is noticed, s."""
PACKAGES = {
    "wire": ("pfwd_device/wire", "tests/pfwd_device/wire tests/simulators"),
    "acquisition": ("pfwd_device/acquisition", "tests/pfwd_device/acquisition"),
    "recording": ("pfwd_device/recording", "tests/pfwd_device/recording"),
    "inference": ("inversion/inference", "tests/inversion/inference tests/inversion"),
    "forward": ("inversion/forward", "tests/inversion/forward"),
    "procedures": ("pfwd/procedures", "tests/pfwd/procedures tests/pfwd/judging"),
    "judging": ("pfwd/judging", "tests/pfwd/judging tests/pfwd/procedures"),
    "analysis": ("pfwd/analysis", "tests/pfwd/analysis"),
    "files": ("pfwd/files", "tests/pfwd/files"),
    "export": ("pfwd/export", "tests/pfwd/export"),
    "report": ("pfwd/report", "tests/pfwd/report"),
    "session": ("pfwd/session", "tests/pfwd/session"),
    "screen": ("tui/screen", "tests/tui/screen"),
}
"""Folder of each package, and its tests."""


def main(arguments: list[str]) -> int:
    """Draw a list, or try what is left of it."""
    parser = argparse.ArgumentParser(prog="dev.py mutate drawn", description=__doc__)
    parser.add_argument("--draw", type=int, help="draw a new list of so many changes")
    parser.add_argument("--seed", type=int, default=0, help="of the list (0)")
    parser.add_argument("--as", dest="name", default="now", help="name of the outcomes (now)")
    parser.add_argument("--only", default="", help="try changes that another outcome calls so")
    parser.add_argument("--package", choices=PACKAGES, help="try changes of this package")
    parser.add_argument("--minutes", type=float, default=14.0, help="time to spend (14)")
    options = parser.parse_args(arguments)
    if options.draw:
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(TOP)
            changes = _draw(options.draw, options.seed, Path(folder))
        _store({"seed": options.seed, "changes": changes})
        return 0
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "checkout"
        _copy(copy)
        if (TOP.parent / "shared").is_dir():  # some tests need records that stand beside a checkout
            (Path(folder) / "shared").symlink_to(TOP.parent / "shared")
        _try(json.loads(LIST.read_text("utf-8")), options, copy)
    return 0


def _draw(count: int, seed: int, folder: Path) -> list[dict[str, Any]]:
    """Return changes, drawn from each package in turn."""
    drawn = []
    for package, (source, _) in PACKAGES.items():
        modules = [path.relative_to(TOP) for path in sorted((TOP / source).rglob("*.py"))]
        specs = _mutations(modules, folder / f"{package}.sqlite")
        drawn.append([(package, each) for each in _sample(specs, random.Random(seed))[:count]])
    chosen = [each for each in chain(*zip_longest(*drawn)) if each is not None][:count]
    return [_described(package, spec) for package, spec in chosen]


def _described(package: str, spec: Any) -> dict[str, Any]:
    """Return a change with its lines, without their line ends."""
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    old = spec.module_path.read_text("utf-8")
    arguments = getattr(spec, "operator_args", None) or {}
    new = mutate_code(old, get_operator(spec.operator_name)(**arguments), spec.occurrence)
    lines, changed = old.splitlines(), new.splitlines()
    (_, start, stop, first, last) = next(
        code
        for code in difflib.SequenceMatcher(None, lines, changed, autojunk=False).get_opcodes()
        if code[0] != "equal"
    )
    return {
        "package": package,
        "module": spec.module_path.as_posix(),
        "line": start + 1,
        "before": lines[start:stop],
        "after": changed[first:last],
        "outcomes": {},
    }


def _place(lines: list[str], change: dict[str, Any]) -> int | None:
    """Return where the lines before a change stand now, nearest to where they stood."""
    before = change["before"]
    found = [n for n in range(len(lines)) if lines[n : n + len(before)] == before]
    return min(found, key=lambda n: abs(n + 1 - change["line"]), default=None)


def _try(table: dict[str, Any], options: argparse.Namespace, copy: Path) -> None:
    begin = time.monotonic()
    for number, change in enumerate(table["changes"], start=1):
        others = " ".join(text for name, text in change["outcomes"].items() if name != options.name)
        if options.package not in (None, change["package"]):
            continue
        if options.name in change["outcomes"] or options.only not in others:
            continue
        if time.monotonic() - begin > 60 * options.minutes:
            print(f"stopped after {options.minutes:g} minutes", flush=True)
            return
        started = time.monotonic()
        change["outcomes"][options.name] = outcome = _outcome(change, copy)
        _store(table)
        taken = time.monotonic() - started
        print(
            f"{number:4} {taken:5.0f} s {change['module']}:{change['line']} {outcome}", flush=True
        )
    texts = [change["outcomes"].get(options.name, "") for change in table["changes"]]
    noticed = sum(text.startswith("noticed") for text in texts)
    print(f"{noticed} of {sum(map(bool, texts))} changes were noticed", flush=True)


def _outcome(change: dict[str, Any], copy: Path) -> str:
    """Make a change in the copy, and return what the tests say: the file's own first."""
    path = copy / change["module"]
    text = path.read_text("utf-8")
    lines = text.splitlines()
    place = _place(lines, change)
    if place is None:
        return "gone: its lines are no longer in the module"
    lines[place : place + len(change["before"])] = change["after"]
    own = Path("tests") / Path(change["module"]).parent / f"test_{Path(change['module']).stem}.py"
    steps = [[own.as_posix()]] if (copy / own).exists() else []
    environment = {**os.environ, "PYTHONPATH": str(copy), "OMP_NUM_THREADS": "1"}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    try:
        for tests in [*steps, PACKAGES[change["package"]][1].split()]:
            command = ["-m", "pytest", "-x", "-q", "-p", "no:xdist", "-m", "not slow", *tests]
            try:
                done = subprocess.run(
                    [os.environ.get("PFWD_TEST_PYTHON", sys.executable), *command],
                    cwd=copy,
                    env=environment,
                    stdin=subprocess.DEVNULL,
                    capture_output=True,
                    text=True,
                    timeout=LONGEST_S,
                )
            except subprocess.TimeoutExpired:
                return f"noticed: longer than {LONGEST_S:.0f} s"
            if done.returncode:
                failed = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
                return f"noticed: {failed[1] if failed else 'the tests did not start'}"
    finally:
        path.write_text(text, encoding="utf-8")
    return "survived"


def _store(table: dict[str, Any]) -> None:
    rows = ",\n".join(json.dumps(change, ensure_ascii=False) for change in table["changes"])
    text = f'{{"seed": {table["seed"]}, "changes": [\n{rows}\n]}}\n'
    LIST.with_suffix(".new").write_text(text, encoding="utf-8")
    LIST.with_suffix(".new").replace(LIST)
