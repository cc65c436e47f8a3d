"""Two additions are one edit each: a number in a result, and a quantity that a sensor measures."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).parents[1] / "inversion" / "result.py"
NEW_FIELD = """
    settlement_index_m: float | None = quantity("Settlement that nobody computes yet", "m")
    warnings: tuple[Notice, ...] = quantity("""
SCRIPT = """
import json, sys, types
from pathlib import Path

source, field, folder = Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
text = source.read_text(encoding="utf-8")
old = "\\n    warnings: tuple[Notice, ...] = quantity("
assert text.count(old) == 1
module = types.ModuleType("inversion.result")
sys.modules["inversion.result"] = module
exec(compile(text.replace(old, field), str(source), "exec"), module.__dict__)

import pfwd
from inversion.notices import Notice
from pfwd_device.recording import DropRecord, SurveyWriter
from pfwd.export.export import export_survey
from pfwd.files.header import declared_values
from pfwd.analysis.results import DropResult
from tests.pfwd.report.surveys import SETUP, half_sine_drop, result_of
from tests.records import read

with SurveyWriter.open(folder / "s", publish=False, reserve_bytes=0) as writer:
    declared = declared_values(SETUP)
    record = writer.save_drop(DropRecord(point="1", drop=half_sine_drop(1, 8e3), declared=declared))
    result = read(DropResult, result_of(1) | {"settlement_index_m": 0.0125})
    assert result.settlement_index_m == 0.0125
    writer.save_result(record, result.to_json())
for form in ("table", "jsonl", "xlsx"):
    export_survey(folder / "s", form, folder / f"made.{form}")
from pfwd.report.provenance_blocks import result_values
assert result_values(result)["settlement_index_m"] == "0.0125"
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


QUANTITIES = SOURCE.parents[1] / "pfwd_plugins" / "quantities.py"
NEW_QUANTITY = """
    JERK = (
        *("jerk", "m/s3", "jerkmeter", 9, "jerk_m_s3", 3),
        *({"m/s3": 1.0, "g/s": 9.80665}, Unit("km/s3", 1e3), Unit("in/s3", INCH_M), 7.0),
    )
    VOLTAGE = ("""
QUANTITY_SCRIPT = """
import sys, types
from pathlib import Path

source, member, folder = Path(sys.argv[1]), sys.argv[2], Path(sys.argv[3])
text = source.read_text(encoding="utf-8")
old = "\\n    VOLTAGE = ("
assert text.count(old) == 1
module = types.ModuleType("pfwd_plugins.quantities")
sys.modules["pfwd_plugins.quantities"] = module
exec(compile(text.replace(old, member), str(source), "exec"), module.__dict__)
jerk = module.Measurand.JERK

import numpy as np
import pfwd
from inversion import Instrument, Record, Sensor
from inversion.measured.record import prepare
from pfwd.files.foreign.column_map import parse_map
from pfwd.files.traces import read_traces
from pfwd.session.live_trace import Envelope
from pfwd_device.identity import ChannelIdentity, Identity, identity_as_dict, identity_from_dict
from pfwd_device.recording import DropRecord, SurveyWriter, read_survey
from pfwd_device.recording.drop_file import drop_file_bytes, drop_from_file_bytes
from pfwd_device.setup import read_device_setup
from pfwd_device.wire.identity_layout import pack_identity, read_identity
from tests.pfwd.report.surveys import half_sine_drop
from tui.screen.drawing.drop_figures import live_figures
from pfwd.units import SI, US

# Instrument: the role in JSON and in a setup file, the code on the wire.
channel = ChannelIdentity("j0", jerk)
load = ChannelIdentity("load", module.Measurand.LOAD)
identity = Identity("1", "m", "1", 1e4, 18, 5.0, (load, channel))
assert identity_as_dict(identity)["channels"][1]["role"] == "jerkmeter"
assert identity_from_dict(identity_as_dict(identity)) == identity
payload = pack_identity(identity)
assert payload.count(b"j0\\x09") == 1
assert read_identity(payload) == identity
setup = read_device_setup({"channels": [{"name": "j0", "role": "jerkmeter"}]}, "setup")
assert setup.channels[0]["quantity"] is jerk

# Files: the column of traces, a column of another program's text, and HDF5.
made = half_sine_drop(1, 8e3)
time, jerks = made.time, 3e2 * (np.sin(150 * made.time) * (made.time > 0))
taken = pfwd.drop(time, made.load, jerks, quantity="jerk", plate_radius=0.15, plate_mass=10.0)
rows = "\\n".join(map("{:.9g},{:.9g},{:.9g}".format, time, made.load, jerks))
file = folder / "jerk.csv"
top = "# pfwd-traces = 1\\n# plate_radius_m = 0.15\\ntime_s,load_N,jerk_m_s3@0.0\\n"
file.write_text(f"{top}{rows}\\n", "utf-8")
(read,) = read_traces(file).drops
assert read.channels[0].quantity is jerk
assert "jerk_m_s3@0.0" in taken.to_dict()
of_map = {"column": 3, "unit": "g/s", "quantity": "jerk", "offset_m": 0.0}
tables = {"time": {"column": 1, "unit": "s"}, "load": {"column": 2, "unit": "N"}}
(sensor,) = parse_map({**tables, "sensor": [of_map]}, "map").sensors
assert (sensor.quantity, sensor.where.factor) == (jerk, 9.80665)
kept = DropRecord(point="1", drop=read, declared={})
with SurveyWriter.open(folder / "s", publish=False, reserve_bytes=0) as writer:
    writer.save_drop(kept)
assert read_survey(folder / "s").drops[0].read().drop.channels[0].quantity is jerk
stored = drop_from_file_bytes(drop_file_bytes(kept, 1, bytes(16)), "file")[0]
assert stored.drop.channels[0].quantity is jerk

# Three integrations, on both sides.
expected = jerks
for _ in range(3):
    steps = np.diff(time) * (expected[1:] + expected[:-1]) / 2
    expected = np.concatenate([[0.0], np.cumsum(steps)])
np.testing.assert_allclose(taken.displacement[0], expected, atol=1e-12)
record = Record(time, made.load, (Sensor(0.0, jerk, jerks),), Instrument(0.15))
moved = prepare(record).displacement[0]
np.testing.assert_allclose(moved, expected[-moved.size :], atol=1e-6)

# Screen.
assert SI.of(jerk) == ("km/s3", 1e3) and US.of(jerk).name == "in/s3"
rest = np.zeros((3, 2))
figure = live_figures(Envelope(0.01, rest, rest + 2e3, 30, jerk), SI, 5.0)[1]
assert (figure.title, figure.unit, figure.min_range) == ("live jerk", "km/s3", 7.0)
assert figure.curves[0].values.max() == 2.0
"""


def test_a_new_quantity_is_one_edit(tmp_path: Path) -> None:
    command = [sys.executable, "-c", QUANTITY_SCRIPT, str(QUANTITIES), NEW_QUANTITY, str(tmp_path)]
    found = subprocess.run(command, cwd=SOURCE.parents[1], capture_output=True, check=False)
    assert found.returncode == 0, found.stderr.decode()
