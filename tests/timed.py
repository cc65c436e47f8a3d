"""List the test files with threads, timers or processes, which a busy computer could upset.

    python3 dev.py test -p tests.timed --timed=FILE    list them while everything runs
    python3 dev.py test -n 10 @FILE                    run the listed ones, ten at a time

A plugin of pytest. Python itself reports processes, and sockets, which each event loop has.
"""

import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

REPORTED = {"subprocess.Popen", "os.fork", "os.posix_spawn", "socket.__new__"}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option with the name of the list."""
    parser.addoption("--timed", type=Path, help="file that gets the files of tests with timing")


def pytest_configure(config: pytest.Config) -> None:
    """Watch every test, in the process that runs it."""
    path: Path | None = config.getoption("--timed")
    if path is None:
        return
    if not hasattr(config, "workerinput"):
        path.write_text("", encoding="utf-8")
    config.pluginmanager.register(Watch(path.resolve()))


class Watch:
    """Adds the file of a test to the list once it starts a thread, a process or an event loop."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._started = False
        self._listed: set[Path] = set()
        start = threading.Thread.start

        def started(thread: threading.Thread) -> None:
            self._started = True
            start(thread)

        threading.Thread.start = started
        sys.addaudithook(self._see)

    def _see(self, event: str, _: tuple[object, ...]) -> None:
        self._started |= event in REPORTED

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        """Run a test with its fixtures."""
        self._started = False
        result = yield
        if self._started and item.path not in self._listed:
            self._listed.add(item.path)
            with self._path.open("a", encoding="utf-8") as stream:
                stream.write(f"{item.path.relative_to(item.config.rootpath).as_posix()}\n")
        return result
