"""The architecture at run time: modules loaded by an import, and content of the wheel."""

import ast
import itertools
import re
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import packages_distributions

import pytest

from tests.sources import PACKAGES, PROJECT, TOP, parse_package


@pytest.mark.parametrize(
    ("module", "unwanted"),
    [
        ("pfwd_device", ["scipy", "textual", "rich", "matplotlib", "inversion", "pfwd"]),
        ("inversion", ["textual", "rich", "matplotlib", "serial", "h5py", "pfwd_device"]),
        ("simulators.demo, simulators.instrument", ["textual", "tui", "inversion", "pfwd"]),
        # Its physics is not the inversion's either.
        ("tests.campaigns.blind", ["inversion", "pfwd"]),
        ("pfwd.files.traces", ["textual", "rich", "matplotlib", "scipy", "h5py", "tui"]),
        (
            "pfwd",
            [
                "numpy",
                "scipy",
                "textual",
                "rich",
                "matplotlib",
                "h5py",
                "pandas",
                "tui",
                "simulators",
            ],
        ),
        ("tui.screen.app", ["scipy", "matplotlib", "h5py", "rich.markdown", "inversion.forward"]),
        ("tui.cli", ["numpy", "scipy", "textual", "rich", "matplotlib", "h5py", "serial"]),
    ],
)
def test_an_import_loads_no_unwanted_module(module: str, unwanted: list[str]) -> None:
    # In a fresh interpreter: this one has imported everything by now.
    code = f"import sys, {module}; print(*(set({unwanted}) & set(sys.modules)))"
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=TOP, capture_output=True, text=True, check=True
    )
    assert run.stdout.split() == []


def test_the_wheel_holds_every_package_of_the_checkout() -> None:
    unpacked = {"tests", "docs", "benchmarks", "examples", "build", "dist"}
    folders = {path.parent.name for path in TOP.glob("*/__init__.py")} - unpacked
    assert set(PACKAGES) == folders


def test_every_folder_of_modules_is_a_package() -> None:
    """Without `__init__.py` the contracts of imports ignore a folder."""
    folders = {path.parent for name in PACKAGES for path in (TOP / name).rglob("*.py")}
    assert len(folders) > 20
    assert [str(f) for f in sorted(folders) if not (f / "__init__.py").is_file()] == []


def test_every_package_is_marked_as_typed() -> None:
    for package in PACKAGES:
        assert (TOP / package / "py.typed").is_file()


def test_every_package_is_checked() -> None:
    tools = PROJECT["tool"]
    assert set(tools["mypy"]["packages"]) == {*PACKAGES, "benchmarks"}
    assert set(tools["importlinter"]["root_packages"]) == set(PACKAGES)


def test_package_names_belong_to_this_distribution() -> None:
    # Others could use names like tui or inversion, and the later installation would win.
    owners = packages_distributions()
    for package in PACKAGES:
        assert set(owners.get(package, [])) <= {"pfwd"}


def test_no_folder_of_tests_hides_a_package() -> None:
    assert list((TOP / "tests").rglob("__init__.py")) == []


def test_every_requirement_has_a_reason() -> None:
    lines = (TOP / "pyproject.toml").read_text(encoding="utf-8").splitlines()
    requirements = [line for line in lines if line.startswith('    "') and "<" in line]
    assert len(requirements) > 10
    assert [line for line in requirements if '", # ' not in line] == []


def test_every_dependency_has_its_version_in_the_constraints() -> None:
    text = (TOP / "constraints.txt").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    assert all(line.count("==") == 1 and " " not in line for line in lines)
    pinned = {line.split("==")[0].lower().replace("_", "-") for line in lines}
    extras = PROJECT["project"]["optional-dependencies"]
    requirements = [*PROJECT["project"]["dependencies"], *extras["dev"], *extras["docs"]]
    names = {text.split(">=")[0].split("[")[0].lower() for text in requirements}
    assert names <= pinned


@pytest.mark.parametrize("package", PACKAGES)
def test_no_pattern_has_a_possessive_or_atomic_group(package: str) -> None:
    """Python 3.11.0 to 3.11.4 does not match them correctly; single characters are sound."""
    group = re.compile(r"\)(?:[*+?]|\{[\d,]+\})\+|\(\?>")
    files = (TOP / package).rglob("*.py")
    assert [file.name for file in files if group.search(file.read_text(encoding="utf-8"))] == []


# Their content is counted, collected or read in parts. All other dataclasses cannot be changed.
_MUTABLE = {
    "Counters",
    "Device",
    "DropEntry",
    "FileEntry",
    "Index",
    "LinkCounters",
    "Summary",
    "SurveyDrop",
    "SurveyPoint",
}


def test_mutable_dataclasses_are_listed() -> None:
    assert {name for name in _dataclasses(frozen=False) if name[0] != "_"} == _MUTABLE
    assert len(set(_dataclasses(frozen=True))) > 100


def _dataclasses(frozen: bool) -> Iterator[str]:
    """Yield the names of the dataclasses that are frozen, or are not."""
    trees = [tree for package in PACKAGES for tree in parse_package(package).values()]
    for node in itertools.chain.from_iterable(map(ast.walk, trees)):
        if not isinstance(node, ast.ClassDef):
            continue
        for decorator in map(ast.unparse, node.decorator_list):
            if decorator.startswith("dataclass") and ("frozen=True" in decorator) == frozen:
                yield node.name
