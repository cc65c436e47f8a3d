"""The examples in the docstrings of `pfwd` run."""

import doctest
from importlib import import_module

import pytest

import pfwd

MODULES = (
    "pfwd",
    "pfwd.scripting.measured",
    "pfwd.scripting.surveys",
    "pfwd.scripting.inverting",
    "pfwd.scripting.diagnosing",
)


@pytest.mark.parametrize("name", MODULES)
def test_the_examples_run(name: str) -> None:
    module = import_module(name)
    done = doctest.testmod(
        module, extraglobs={"pfwd": pfwd}, optionflags=doctest.ELLIPSIS, raise_on_error=False
    )
    assert done.attempted > 0
    assert done.failed == 0
