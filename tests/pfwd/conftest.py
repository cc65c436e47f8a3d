"""Surveys and results that tests of several packages share; made once a run."""

from pathlib import Path

import pytest

import pfwd
from pfwd.files.importing import import_files
from tests.pfwd.files.foreign.peaks_builders import pddx, places


@pytest.fixture(scope="session")
def peaks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Survey of two points of three drops, with peaks and without time histories."""
    folder = tmp_path_factory.mktemp("peaks")
    (folder / "a.pdx").write_text(pddx(places()))
    assert all(drop.kind == "peaks" for drop in import_files([str(folder / "a.pdx")], folder / "s"))
    return folder / "s"


@pytest.fixture(scope="session")
def diagnosis() -> pfwd.Diagnosis:
    """Diagnosis of the example that the base model does not explain."""
    return pfwd.diagnose(pfwd.example("unexplained")[0])


@pytest.fixture(scope="session")
def layer_results() -> pfwd.Results:
    """Results of the three drops of the example with a layer."""
    return pfwd.invert(pfwd.example("layer"), method="posterior")
