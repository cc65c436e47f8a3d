"""The examples in the docstrings of all packages run and give what they show."""

import doctest
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

import pfwd
from tests.sources import PACKAGES, TOP


def modules_with_examples() -> Iterator[str]:
    for package in PACKAGES:
        for path in sorted((TOP / package).rglob("*.py")):
            if ">>> " in path.read_text(encoding="utf-8"):
                parts = path.relative_to(TOP).with_suffix("").parts
                yield ".".join(parts).removesuffix(".__init__")


@pytest.mark.parametrize("name", list(modules_with_examples()))
def test_the_examples_run(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = import_module(name)
    monkeypatch.chdir(tmp_path)
    result = doctest.testmod(
        module, extraglobs={"pfwd": pfwd}, optionflags=doctest.ELLIPSIS, raise_on_error=False
    )
    assert result.failed == 0
