"""Circles of imports, with those for annotations only and those within functions."""

import ast
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from importlib.util import resolve_name
from pathlib import Path

import pytest

from tests.sources import PACKAGES, TOP, parse_folder, parse_package


def import_graph(top: Path, trees: dict[Path, ast.Module]) -> dict[str, set[str]]:
    """Return the modules below a folder, each with the modules that it imports anywhere."""
    modules = {_module_name(file.relative_to(top)): file for file in trees}
    return {
        module: modules.keys() & set(_imported(module, file, trees[file], modules)) - {module}
        for module, file in modules.items()
    }


def _module_name(file: Path) -> str:
    parts = file.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _imported(module: str, file: Path, tree: ast.Module, modules: dict[str, Path]) -> Iterator[str]:
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), package)
            for alias in node.names:
                submodule = f"{base}.{alias.name}"
                yield submodule if submodule in modules else base


def find_circle(graph: dict[str, set[str]]) -> str | None:
    """Return the modules of one circle, each before the one that it imports; None: no circle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return " -> ".join(reversed(error.args[1]))
    return None


def test_no_modules_import_each_other_in_a_circle() -> None:
    trees = {file: tree for name in PACKAGES for file, tree in parse_package(name).items()}
    graph = import_graph(TOP, trees)
    assert len(graph) > 300
    assert sum(map(len, graph.values())) > 1000
    assert find_circle(graph) is None


@pytest.mark.parametrize(
    "closing",
    [
        "import made.first",
        "from made.first import name",
        "from made import first",
        "from .first import name",
        "from . import first",
        "def function():\n    from made import first",
        "if TYPE_CHECKING:\n    from made.first import name",
    ],
)
def test_a_circle_is_named(tmp_path: Path, closing: str) -> None:
    folder = tmp_path / "made"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "first.py").write_text("from made import second", encoding="utf-8")
    (folder / "second.py").write_text("import made.third", encoding="utf-8")
    third = folder / "third.py"
    third.write_text("import json", encoding="utf-8")
    assert find_circle(import_graph(tmp_path, parse_folder(folder))) is None
    third.write_text(closing, encoding="utf-8")
    circle = find_circle(import_graph(tmp_path, parse_folder(folder)))
    assert circle is not None
    modules = circle.split(" -> ")
    assert modules[0] == modules[-1]
    assert "made.third -> made.first" in f"{circle} -> {modules[1]}"
    assert set(modules) == {"made.first", "made.second", "made.third"}


def test_a_name_of_the_package_itself_closes_a_circle(tmp_path: Path) -> None:
    folder = tmp_path / "made"
    folder.mkdir()
    (folder / "__init__.py").write_text("from made.first import name", encoding="utf-8")
    (folder / "first.py").write_text("from made import other", encoding="utf-8")
    assert find_circle(import_graph(tmp_path, parse_folder(folder))) in (
        "made -> made.first -> made",
        "made.first -> made -> made.first",
    )
