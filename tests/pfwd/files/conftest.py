"""Trace files, written as a test wants them."""

from collections.abc import Callable
from pathlib import Path

import pytest


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Writes lines as a trace file; bytes as they are."""

    def write_file(lines: list[str] | bytes, name: str = "point.csv") -> Path:
        path = tmp_path / name
        data = lines if isinstance(lines, bytes) else ("\n".join(lines) + "\n").encode()
        path.write_bytes(data)
        return path

    return write_file
