"""Trace files of simulated drops, few and quickly inverted."""

from pathlib import Path

import pytest

from simulators.demo import demo_drops


@pytest.fixture(scope="session")
def demo_files(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Contents of six trace files of two drops each: one finite-element run, other noise."""
    folder = tmp_path_factory.mktemp("demo")
    text = demo_drops(2, 0, folder).read_text(encoding="utf-8")
    # Another point, hence another content, of the same traces.
    return [text.replace('"demo-0"', f'"demo-{number}"') for number in range(6)]


@pytest.fixture
def drops(tmp_path: Path, demo_files: list[str]) -> Path:
    """A folder with six trace files in two folders, twelve drops."""
    for number, text in enumerate(demo_files):
        place = tmp_path / "drops" / f"area-{number % 2}"
        place.mkdir(parents=True, exist_ok=True)
        (place / f"point-{number}.csv").write_text(text, encoding="utf-8")
    return tmp_path / "drops"
