"""Parsed modules of the packages, for the tests of names, imports and structure."""

import ast
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

TOP = Path(__file__).resolve().parents[1]
PROJECT: dict[str, Any] = tomllib.loads((TOP / "pyproject.toml").read_text(encoding="utf-8"))
PACKAGES: list[str] = PROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]


def parse_folder(folder: Path) -> dict[Path, ast.Module]:
    """Return the syntax trees of all modules in a folder by their files."""
    files = sorted(folder.rglob("*.py"))
    return {file: ast.parse(file.read_text(encoding="utf-8")) for file in files}


@cache
def parse_package(name: str) -> dict[Path, ast.Module]:
    """Return the syntax trees of all modules of a package by their files."""
    return parse_folder(TOP / name)
