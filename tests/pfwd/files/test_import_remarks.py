"""Remarks on the reading of another program's file are warnings with codes."""

from pathlib import Path
from typing import Any

import pytest

from inversion.notices import OTHER, Notice, codes, text_of
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
        [{"code": "unknown", "values": {}}],
        [{"code": "peaks-imported", "values": {}}, {"code": "peaks-imported", "values": {}}],
    ],
)
def test_codes_that_cannot_be_read_leave_the_sentence(codes: Any) -> None:
    (notice,) = remark_notices({"imported": {"remarks": ["it rained"], "remark_codes": codes}})
    assert (notice.code, text_of(notice)) == (OTHER, "it rained")


def test_a_reworded_remark_keeps_its_code() -> None:
    stored = {"remarks": ["an earlier wording"], "remark_codes": codes([Notice("peaks-imported")])}
    assert [notice.code for notice in remark_notices({"imported": stored})] == ["peaks-imported"]
