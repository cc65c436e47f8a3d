"""A new number in a result is one edit: a field of `inversion.result.InversionResult`."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "inversion" / "result.py"
NEW_FIELD = """
    settlement_index_m: float | None = quantity("Settlement that nobody computes yet", "m")
    warnings: tuple[Notice, ...] | None = quantity("""
SCRIPT = """
import json, sys, types
from pathlib import Path

source, field, folder = Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
text = source.read_text(encoding="utf-8")
old = "\\n    warnings: tuple[Notice, ...] | None = quantity("
assert text.count(old) == 1
module = types.ModuleType("inversion.result")
sys.modules["inversion.result"] = module
exec(compile(text.replace(old, field), str(source), "exec"), module.__dict__)

import pfwd
from pfwd_device.recording import DropRecord, SurveyWriter
from pfwd.export.export import export_survey
from pfwd.files.header import declared_values
from pfwd.analysis.results import DropResult
from tests.pfwd.report.surveys import SETUP, half_sine_drop, result_of

with SurveyWriter.open(folder / "s", publish=False, reserve_bytes=0) as writer:
    declared = declared_values(SETUP)
    record = writer.save_drop(DropRecord(point="1", drop=half_sine_drop(1, 8e3), declared=declared))
    result = DropResult.from_json(result_of(1) | {"settlement_index_m": 0.0125})
    assert result.settlement_index_m == 0.0125 and not result.more
    writer.save_result(record, result.to_json())
for form in ("table", "jsonl", "xlsx"):
    export_survey(folder / "s", form, folder / f"made.{form}")
from pfwd.report.provenance_blocks import result_values
assert "settlement_index_m 0.0125" in result_values(result)
print(json.dumps(pfwd.open(str(folder / "s")).to_dict()))
"""


def test_a_new_number_in_a_result_is_one_edit(tmp_path: Path) -> None:
    command = [sys.executable, "-c", SCRIPT, str(SOURCE), NEW_FIELD, str(tmp_path)]
    found = subprocess.run(command, cwd=SOURCE.parents[1], capture_output=True, check=False)
    assert found.returncode == 0, found.stderr.decode()
    (drop,) = json.loads(found.stdout)["drops"]
    assert drop["settlement_index_m"] == 0.0125
    with (tmp_path / "made.table").open(encoding="utf-8", newline="") as stream:
        names, row = csv.reader(stream)
    assert names[-1] == "settlement_index_m", "columns of before keep their places"
    assert float(row[-1]) == 0.0125
    line = json.loads((tmp_path / "made.jsonl").read_text(encoding="utf-8"))
    assert line["settlement_index_m"] == 0.0125
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.load_workbook(tmp_path / "made.xlsx", read_only=True)
    titles, cells = book["drops"].iter_rows(values_only=True)
    assert dict(zip(titles, cells, strict=False))["Settlement index (mm)"] == 12.5
    book.close()
