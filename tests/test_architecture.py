"""The architecture at run time: what an import brings along, and what the wheel holds."""

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement

TOP = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]


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
def test_an_import_brings_nothing_along_that_it_should_not(
    module: str, unwanted: list[str]
) -> None:
    # In a fresh interpreter: this one has imported everything by now.
    code = f"import sys, {module}; print(*(set({unwanted}) & set(sys.modules)))"
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=TOP, capture_output=True, text=True, check=True
    )
    assert run.stdout.split() == []


def test_the_wheel_holds_every_package_of_the_checkout() -> None:
    beside = {"tests", "docs", "benchmarks", "examples", "build", "dist"}
    folders = {path.parent.name for path in TOP.glob("*/__init__.py")} - beside
    assert set(PACKAGES) == folders


def test_every_folder_of_modules_is_a_package() -> None:
    """Without `__init__.py` the contracts of imports look past it and hold whatever it does."""
    beside = {"tests", "benchmarks", "docs", "examples"}
    tops = {path.parent for path in TOP.glob("*/__init__.py") if path.parent.name not in beside}
    folders = {path.parent for top in tops for path in top.rglob("*.py")}
    assert len(folders) > 20
    assert [str(f) for f in sorted(folders) if not (f / "__init__.py").is_file()] == []


def test_every_package_says_that_it_is_typed() -> None:
    for package in PACKAGES:
        assert (TOP / package / "py.typed").is_file()


def test_the_checks_look_at_every_package() -> None:
    tools = PROJECT["tool"]
    assert set(tools["mypy"]["packages"]) == {*PACKAGES, "benchmarks"}
    assert set(tools["importlinter"]["root_packages"]) == set(PACKAGES)


def test_no_other_distribution_ships_a_package_of_our_name() -> None:
    # Others could use names like tui or inversion, and the later installation would win.
    owners = packages_distributions()
    for package in PACKAGES:
        assert set(owners.get(package, [])) <= {"pfwd"}


def test_no_folder_of_tests_hides_a_package() -> None:
    assert list((TOP / "tests").rglob("__init__.py")) == []


def test_every_requirement_has_a_reason_beside_it() -> None:
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
    wanted = [*PROJECT["project"]["dependencies"], *extras["dev"], *extras["docs"]]
    names = {text.split(">=")[0].split("[")[0].lower() for text in wanted}
    assert names <= pinned


def test_cobs_has_a_wheel_for_every_python_on_windows() -> None:
    """Version 1.2.2 has none for Python 3.11, and 1.2.1 has none for Python 3.14."""
    pinned = re.search(
        r"^cobs==(\S+)$", (TOP / "constraints.txt").read_text(encoding="utf-8"), re.M
    )
    assert pinned is not None
    assert pinned[1] == "1.2.1"
    wanted = [text for text in PROJECT["project"]["dependencies"] if text.startswith("cobs")]
    requirements = [Requirement(text) for text in wanted]

    def accepts(python: str, version: str) -> bool:
        return all(
            version in requirement.specifier
            for requirement in requirements
            if requirement.marker is None or requirement.marker.evaluate({"python_version": python})
        )

    assert not accepts("3.11", "1.2.2")
    assert all(accepts(python, "1.2.1") for python in ("3.11", "3.12", "3.13"))
    assert accepts("3.14", "1.2.2")


@pytest.mark.parametrize("package", PACKAGES)
def test_no_pattern_has_a_possessive_or_atomic_group(package: str) -> None:
    """Python 3.11.0 to 3.11.4 does not match them correctly; single characters are sound."""
    group = re.compile(r"\)(?:[*+?]|\{[\d,]+\})\+|\(\?>")
    files = (TOP / package).rglob("*.py")
    assert [file.name for file in files if group.search(file.read_text(encoding="utf-8"))] == []


# What they hold is being counted, collected or read in parts. Everything else that is handed on
# cannot be changed by whoever gets it.
_CHANGING = {
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


def test_only_these_dataclasses_can_be_changed() -> None:
    assert {name for name in _dataclasses(frozen=False) if name[0] != "_"} == _CHANGING
    assert len(set(_dataclasses(frozen=True))) > 100


def _dataclasses(frozen: bool) -> Iterator[str]:
    """Names of all that are frozen, or are not."""
    files = (path for package in PACKAGES for path in (TOP / package).rglob("*.py"))
    for path in files:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ClassDef):
                continue
            for decorator in map(ast.unparse, node.decorator_list):
                if decorator.startswith("dataclass") and ("frozen=True" in decorator) == frozen:
                    yield node.name
