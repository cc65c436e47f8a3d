"""Files of other programs, written and read as a test requires."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint


@pytest.fixture
def read(tmp_path: Path) -> Callable[..., list[TracePoint]]:
    """Write a file, and a header file if there is a header; read the points of the file."""

    def read_written(
        data: bytes | str, name: str, header: str = "", **options: Any
    ) -> list[TracePoint]:
        path, header_file = tmp_path / name, tmp_path / "header.toml"
        path.write_bytes(data.encode() if isinstance(data, str) else data)
        header_file.write_text(header)
        return read_points(path, header_file if header else None, **options)

    return read_written
