"""What several of the mirrored folders need."""

import os

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

# A change is judged by the same examples twice; new ones are looked for on purpose. How long one
# example takes says how busy the computer is.
settings.register_profile("everyday", derandomize=True, deadline=None)
settings.register_profile("explore", derandomize=False, deadline=None, print_blob=True)
settings.load_profile("everyday")


@pytest.fixture(scope="session", autouse=True)
def _messages_have_no_text_of_their_own() -> Iterator[None]:
    """Only `text_of` makes sentences: a message that is formatted as a text is an error."""

    def refuse(message: Notice) -> str:
        raise TypeError(f"expected text_of, got {message!r} as a text")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Notice, "__str__", refuse)
        yield


@pytest.fixture(scope="session", autouse=True)
def _own_spare_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """No test writes to the place where the drops of whoever runs it would go."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PFWD_SPARE", str(tmp_path_factory.mktemp("spare")))
        yield


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Tests marked `posix` rest on what Windows does not have.

    What they are about is tested there by others of the same files: the driver and the probes over
    TCP, errors of Windows' ports word for word, disks that are full or fail on a disk that is
    played, ends of programs by killing them.
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
    """Makes drops with a half-sine load and a displacement that follows it."""
    return half_sine_drop
