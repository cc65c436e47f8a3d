"""Imports of other programs' files: refusals, and remarks with codes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inversion.notices import OTHER, Notice, codes, text_of
from pfwd.files import importing
from pfwd.files.foreign.registry import foreign_suffixes
from pfwd.files.header import PointSetup, remark_notices
from pfwd.files.importing import import_files
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from tests.pfwd.files.foreign.builders import dynz, prjz, pulse, thy, viewed
from tests.pfwd.files.trace_lines import NAMES, rows
from tests.records import known

DROPS = {"1": [pulse(samples=750)]}
ENDINGS = sorted({*foreign_suffixes(), ".csv", ".h5"})
CONTENTS = {
    "empty": b"",
    "noise": np.random.default_rng(1).bytes(3000),
    "table": b"a,b\n1,2\n",
    "project": prjz(DROPS, viewed(DROPS))[:-100],
    "stored": dynz(DROPS)[: len(dynz(DROPS)) // 2],
    "history": thy([(1, 1, pulse(samples=470))])[:300],
    "history without drops": thy([]),
}


@pytest.mark.parametrize("content", CONTENTS.values(), ids=CONTENTS)
@pytest.mark.parametrize("ending", ENDINGS)
def test_a_refused_file_leaves_no_survey(ending: str, content: bytes, tmp_path: Path) -> None:
    file = tmp_path / f"file{ending}"
    file.write_bytes(content)
    (refused,) = import_files([str(file)], tmp_path / "survey")
    assert refused.error is not None
    assert file.name in refused.error
    assert list(tmp_path.iterdir()) == [file]


def test_points_without_drops_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    empty = TracePoint("a.x", PointSetup(plate_radius=0.15), (), ())
    monkeypatch.setattr(importing, "read_points", lambda *_, **_more: [empty])
    (refused,) = import_files([str(tmp_path / "a.x")], tmp_path / "survey")
    assert known(refused.error).endswith("a.x: expected at least one drop, got none")
    assert list(tmp_path.iterdir()) == []


def test_a_missing_plate_radius_names_the_header(tmp_path: Path) -> None:
    file = tmp_path / "a.csv"
    file.write_text("\n".join(["# pfwd-traces = 1", NAMES, *rows()]) + "\n", encoding="utf-8")
    (refused,) = import_files([str(file)], tmp_path / "survey")
    assert refused.error is not None
    assert "plate_radius_m = 0.15 (in m) into a TOML file and give it with --header" in (
        refused.error
    )
    header = tmp_path / "h.toml"
    header.write_text("plate_radius_m = 0.15", encoding="utf-8")
    (imported,) = import_files([str(file)], tmp_path / "survey", str(header))
    assert imported.error is None


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
