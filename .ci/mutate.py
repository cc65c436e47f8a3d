"""Which changes of a module do its tests not notice?

    python3 dev.py mutate MODULE [--sample N] [--minutes M] [--seed S] [--tests PATH ...]

MODULE is a file or a folder of packages. One operator, number or condition at a time is changed in
a copy of the checkout, and the tests that mirror the module are run: a change that they pass has
survived. The sample is drawn at random, the same one for the same seed. Ends with 0 when at least
85 % of what was tried was noticed. What survived so far, and why, is in .ci/survivors.md.
"""

import argparse
import ast
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from cosmic_ray.commands import init
from cosmic_ray.mutating import mutate_and_test
from cosmic_ray.work_db import WorkDB, use_db
from cosmic_ray.work_item import MutationSpec, TestOutcome

TOP = Path(__file__).resolve().parents[1]
TARGET = 0.85
# A change that makes a loop endless is noticed after this multiple of the usual time, and after at
# least this time, s.
PATIENCE, LEAST_PATIENCE = 8, 60.0
# First and last line and column, as cosmic-ray and ast count them.
Place = tuple[tuple[int, int], tuple[int, int]]


def main(arguments: list[str]) -> int:
    """Change, test, tell; 0, 1 below the target, 2 for wrong usage."""
    if arguments[:1] == ["drawn"]:
        import drawn

        return drawn.main(arguments[1:])
    parser = argparse.ArgumentParser(prog="dev.py mutate", description=__doc__)
    parser.add_argument("module", type=Path, help="file or folder to change")
    parser.add_argument("--sample", type=int, default=100, help="changes to try (100)")
    parser.add_argument("--minutes", type=float, default=30.0, help="time to spend (30)")
    parser.add_argument("--seed", type=int, default=0, help="of the sample (0)")
    parser.add_argument("--tests", nargs="+", help="run these instead of those that mirror it")
    options = parser.parse_args(arguments)
    module = Path(os.path.relpath(options.module.resolve(), TOP))
    modules = sorted((TOP / module).rglob("*.py")) if (TOP / module).is_dir() else [TOP / module]
    if not modules or not all(path.is_file() for path in modules):
        parser.error(f"MODULE: expected a Python file or folder of this checkout, got {module}")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "checkout"
        _copy(copy)
        os.chdir(copy)
        os.environ.update(PYTHONPATH=str(copy), PYTHONDONTWRITEBYTECODE="1", OMP_NUM_THREADS="1")
        names = [path.relative_to(TOP) for path in modules]
        specs = _mutations(names, Path(folder) / "session.sqlite")
        chosen = _sample(specs, random.Random(options.seed))
        print(f"{len(specs)} changes at {len(chosen)} places are possible", flush=True)
        return _try(chosen[: options.sample], options)


def _copy(target: Path) -> None:
    """What git knows of, as it stands, and what the tests keep between runs."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=TOP,
        stdout=subprocess.PIPE,
        check=True,
    )
    for name in filter(None, listed.stdout.decode().split("\0")):
        if (TOP / name).is_file():
            (target / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(TOP / name, target / name)
    if (TOP / ".pytest_cache").is_dir():
        shutil.copytree(TOP / ".pytest_cache", target / ".pytest_cache")


def _mutations(modules: list[Path], session: Path) -> list[MutationSpec]:
    """All changes but those that other checks notice or nobody can, in the order of the text."""
    with use_db(str(session), WorkDB.Mode.create) as work:
        init(modules, work, {})
        found = [spec for item in work.work_items for spec in item.mutations]
    left = {module: list(_left_out(ast.parse(module.read_text("utf-8")))) for module in modules}
    kept = [
        spec
        for spec in found
        if not any(begin <= tuple(spec.start_pos) < end for begin, end in left[spec.module_path])
    ]
    return sorted(
        kept, key=lambda s: (str(s.module_path), s.start_pos, s.operator_name, s.occurrence)
    )


def _sample(specs: list[MutationSpec], rng: random.Random) -> list[MutationSpec]:
    """One change a place, in any order: a product can be changed in eleven ways, a bound in two."""
    places: dict[tuple[str, Place], list[MutationSpec]] = {}
    for spec in specs:
        place = (tuple(spec.start_pos), tuple(spec.end_pos))
        places.setdefault((str(spec.module_path), place), []).append(spec)
    chosen = [rng.choice(several) for several in places.values()]
    rng.shuffle(chosen)
    return chosen


def _left_out(tree: ast.AST) -> Iterator[Place]:
    """Where annotations stand, which mypy checks, and the switches of dataclasses.

    `slots` and `kw_only` change no outcome; that what crosses a boundary is frozen is one test for
    all packages (tests/test_architecture.py), which does not mirror any module.
    """
    for node in ast.walk(tree):
        parts = [getattr(node, name, None) for name in ("annotation", "returns")]
        if isinstance(node, ast.ClassDef):
            parts += [part for part in node.decorator_list if _is_dataclass(part)]
        for part in parts:
            if part is not None:
                yield (part.lineno, part.col_offset), (part.end_lineno, part.end_col_offset)


def _is_dataclass(decorator: ast.expr) -> bool:
    function = decorator.func if isinstance(decorator, ast.Call) else None
    return isinstance(function, ast.Name) and function.id == "dataclass"


def _tests(module: Path) -> list[str]:
    """Return the file that mirrors a module, if there is one, and the nearest folder that does."""
    file = Path("tests") / module.parent / f"test_{module.stem}.py"
    folder = file.parent
    while not folder.is_dir():
        folder = folder.parent
    return [path.as_posix() for path in (file, folder) if path.exists()]


def _command(tests: Sequence[str]) -> str:
    python = Path(sys.executable).as_posix()
    return f'"{python}" -m pytest -x -q -p no:xdist -m "not slow" {" ".join(tests)}'


def _try(specs: list[MutationSpec], options: argparse.Namespace) -> int:
    begin = time.monotonic()
    patience: dict[str, float] = {}
    noticed, survived = 0, []
    for number, spec in enumerate(specs, start=1):
        # The folder is run only if the file, which takes less time, passes with the change.
        steps = [options.tests] if options.tests else [[step] for step in _tests(spec.module_path)]
        for command in map(_command, steps):
            if command not in patience:
                started = time.monotonic()
                if subprocess.call(command, shell=True, stdout=subprocess.DEVNULL) != 0:
                    print(f"the tests fail on the module as it is: {command}")
                    return 2
                patience[command] = max(LEAST_PATIENCE, PATIENCE * (time.monotonic() - started))
            result = mutate_and_test((spec,), command, patience[command])
            if result.test_outcome != TestOutcome.SURVIVED:
                break
        where = f"{spec.module_path.as_posix()}:{spec.start_pos[0]} {spec.operator_name}"
        if result.test_outcome == TestOutcome.SURVIVED:
            survived.append(result.diff or where)
        else:
            noticed += 1
        word = "SURVIVED" if result.test_outcome == TestOutcome.SURVIVED else "noticed"
        print(f"{number:4} {word:8} {where}", flush=True)
        if time.monotonic() - begin > 60 * options.minutes:
            print(f"stopped after {options.minutes:g} minutes")
            break
    print(*survived, sep="\n")
    tried = noticed + len(survived)
    print(f"{noticed} of {tried} changes were noticed ({100 * noticed / tried:.0f} %)")
    return 0 if noticed >= TARGET * tried else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
