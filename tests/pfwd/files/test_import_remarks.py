"""Remarks on the reading of another program's file are warnings with codes."""

from pathlib import Path
from typing import Any

import pytest

from inversion.notices import OTHER
from pfwd.files.header import remark_notices
from pfwd.files.reading import read_points


def test_warnings_of_imported_files_have_codes(shared: Path) -> None:
    warnings = [
        warning
        for file in sorted((shared / "originals").glob("*/*.*"))
        for point in read_points(file, overrides={"plate_radius_m": 0.15})
        for warning in point.warnings
    ]
    assert {"stored-traces", "peaks-imported"} <= {warning.code for warning in warnings}
    assert [warning for warning in warnings if warning.code == OTHER] == []


@pytest.mark.parametrize(
    "codes",
    [
        None,
        [],
        [{"code": "peaks-imported", "values": {}}],
        [{"code": "unknown", "values": {}}],
        [{"code": OTHER, "values": {"text": "another text"}}],
    ],
)
def test_a_code_that_contradicts_its_sentence_is_ignored(codes: Any) -> None:
    (notice,) = remark_notices({"imported": {"remarks": ["it rained"], "remark_codes": codes}})
    assert (notice.code, notice) == (OTHER, "it rained")
