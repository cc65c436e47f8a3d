"""A survey with results, to be reported."""

import shutil
from pathlib import Path

import pytest

from pfwd.files.importing import import_files
from pfwd.files.traces import TracePoint, write_traces
from pfwd.report import gathering
from pfwd_device.recording import read_survey
from tests.pfwd.report.surveys import SETUP, half_sine_drop, result_of, save_results


def write_survey(top: Path, drops: tuple[int, ...]) -> Path:
    """Write two points with these numbers of drops, and results of them."""
    folder = top / "survey"
    for name, shift in (("A", 0.0), ("B", 30.0)):
        traces = tuple(half_sine_drop(n, 8000.0 + shift + n) for n in drops)
        write_traces(top / f"{name}.csv", TracePoint("", SETUP, traces, ()))
    list(import_files([str(top / "A.csv"), str(top / "B.csv")], folder))
    saved = read_survey(folder).drops
    save_results(folder, {drop.number: result_of(drop.drop, 60e6) for drop in saved})
    # The last result counts.
    save_results(folder, {d.number: result_of(d.drop, 45e6 + 1e5 * d.drop) for d in saved})
    return folder


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two points of four drops with results; made once, because the disk is slow."""
    return write_survey(tmp_path_factory.mktemp("made"), (1, 2, 3, 4))


@pytest.fixture
def survey(made: Path, tmp_path: Path) -> Path:
    """A copy that a test may change."""
    return shutil.copytree(made, tmp_path / "survey")


@pytest.fixture
def short_survey(tmp_path: Path) -> Path:
    """Two points of two drops, the first of them seating, for tests that invert them."""
    return write_survey(tmp_path, (1, 2))


@pytest.fixture
def without_curves(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the fitted curves, which take most of the time of a report."""
    monkeypatch.setattr(gathering, "curves_of", lambda *_: None)
