"""Small surveys, and records that are compared bit by bit."""

from pathlib import Path

import pytest

from pfwd_device.recording import SpareFolder


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    """Folder of a survey, which is not there yet."""
    return tmp_path / "survey"


@pytest.fixture
def spare(tmp_path: Path) -> SpareFolder:
    return SpareFolder(tmp_path / "spare")
