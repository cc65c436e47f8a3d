"""Settings and fixtures of several folders of tests."""

import gc
import os

# A search for cyclic garbage goes through the objects of thousands of tests: with the usual
# thresholds it took 40 % of the collection and 6 % of the tests.
gc.set_threshold(100_000, 50, 100)

# Before numpy is imported. With a thread a core in every worker of the tests, and in every process
# that a test starts, linear algebra waits for itself: factorising finite elements takes three to
# five times as long on two busy cores.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_name, "1")

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

from inversion.notices import Notice
from pfwd_device import Drop
from tests.drops import half_sine_drop

TOP = Path(__file__).resolve().parents[1]

# Everyday runs repeat the same examples. The duration of an example depends on other programs.
settings.register_profile("everyday", derandomize=True, deadline=None)
settings.register_profile("explore", derandomize=False, deadline=None, print_blob=True)
settings.load_profile("everyday")


@pytest.fixture(scope="session", autouse=True)
def _messages_cannot_be_formatted_as_texts() -> Iterator[None]:
    """Only `text_of` makes sentences: a message that is formatted as a text is an error."""

    def refuse(message: Notice) -> str:
        raise TypeError(f"expected text_of, got {message!r} as a text")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Notice, "__str__", refuse)
        yield


@pytest.fixture(scope="session", autouse=True)
def _separate_spare_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Direct fallback records away from the data folder of the user."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PFWD_SPARE", str(tmp_path_factory.mktemp("spare")))
        yield


def pytest_collection_finish() -> None:
    """Exclude the collected tests from later searches for cyclic garbage."""
    gc.collect()
    gc.freeze()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip tests marked `posix` on Windows.

    Other tests of the same files show the same there: driver and probes over TCP, the errors of
    Windows' ports, full disks on a simulated disk, and killed programs.
    """
    if os.name == "nt" and item.get_closest_marker("posix") is not None:
        pytest.skip("Windows has no pseudo-terminals, limits of files or signals to a process")


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder with records whose licence keeps them out of the project; skips where it is absent."""
    folder = TOP.parent / "shared"
    if not folder.is_dir():
        pytest.skip(f"no folder {folder}: the records in it may not be copied into the project")
    return folder


@pytest.fixture(scope="session")
def make_drop() -> Callable[..., Drop]:
    """Function that makes drops with a half-sine load and a displacement in proportion."""
    return half_sine_drop
