"""Log and writer of a session."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pfwd_device.recording import SurveyWriter
from tests.pfwd.scripted_feed import Log, SpyWriter


@pytest.fixture
def log() -> Log:
    return Log()


@pytest.fixture
def writer(tmp_path: Path, log: Log) -> Iterator[Any]:
    with SurveyWriter.open(tmp_path / "survey", publish=False) as inner:
        yield SpyWriter(inner, log)
