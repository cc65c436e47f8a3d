"""Runs commands in the process of the tests."""

import pytest

from tests.tui.console import Command, Printed
from tui.cli import main


@pytest.fixture
def command(capsys: pytest.CaptureFixture[str]) -> Command:
    """Run ``pfwd`` with words in this process and return its status and output."""

    def run(*words: object) -> Printed:
        capsys.readouterr()
        try:
            status = main([str(word) for word in words])
        except SystemExit as err:
            status = int(str(err.code))
        return Printed(status, *capsys.readouterr())

    return run
