"""Tests that are coroutines run within the application, without a terminal."""

import inspect
from typing import Any

import pytest

from tests.tui.screen.scripted import App, play


@pytest.fixture
def app() -> App:
    return App()


@pytest.fixture
def pilot() -> None:
    """What presses keys; it exists while the application runs."""


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    test = pyfuncitem.obj
    if not inspect.iscoroutinefunction(test):
        return None
    given = {name: pyfuncitem.funcargs[name] for name in inspect.signature(test).parameters}

    async def script(_app: App, pilot: Any) -> None:
        await test(**given | {"pilot": pilot})

    play(given["app"], script, given.get("size", (120, 40)))
    return True
