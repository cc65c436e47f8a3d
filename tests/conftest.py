"""What several of the mirrored folders need."""

import os

# Before numpy is imported. With a thread a core in every worker of the tests, and in every process
# that a test starts, linear algebra waits for itself: factorising finite elements takes three to
# five times as long on two busy cores.
for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
    os.environ.setdefault(_name, "1")

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray

from inversion.notices import Notice
from pfwd_device import Channel, Drop

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


@pytest.fixture
def make_drop() -> Callable[..., Drop]:
    """Makes drops with a half-sine load and a displacement that follows it."""
    return _make_drop


def _make_drop(
    *,
    number: int = 1,
    peak: float = 8000.0,
    duration: float = 0.018,
    pre_trigger: float = 0.005,
    window: float = 0.06,
    rate: float = 10_000.0,
    offset: float = 0.0,
    offsets: tuple[float, ...] = (0.0,),
    quantity: str = "displacement",
) -> Drop:
    """A drop of `peak` N and `duration` s; the load cell adds `offset` N."""
    first = -round(pre_trigger * rate)
    time = np.arange(first, round(window * rate)) / rate
    load = peak * _half_sine(time, duration)
    channels = []
    for place in offsets:
        # 0.5 mm per 8 kN in the centre, later and less further out; late and long like a real one.
        pulse = 5e-4 * _half_sine(time - 1e-3 - abs(place) / 100, 1.2 * duration) * peak / 8000
        values = pulse / (1 + 5 * abs(place))
        if quantity == "velocity":
            values = np.gradient(values, time)
        channels.append(Channel(place, quantity, values))  # type: ignore[arg-type]
    return Drop(number, time, load + offset, tuple(channels))


def _half_sine(time: NDArray[np.float64], duration: float) -> NDArray[np.float64]:
    inside = (time > 0) & (time < duration)
    return np.where(inside, np.sin(np.pi * time / duration), 0.0)
