"""Two additions are one edit each: a number in a result, and a quantity that a sensor measures."""

import csv
import json
import subprocess
import sys
from pathlib import Path

import pytest

TOP = Path(__file__).parents[1]
# Module, the line before which the addition is made, and the addition.
EDITS = [
    (
        "inversion/result.py",
        "    warnings: tuple[Notice, ...] = quantity(",
        '    settlement_index_m: float | None = quantity("Settlement in no program", "m")\n',
    ),
    (
        "pfwd_plugins/quantities.py",
        "    VOLTAGE = (",
        """    JERK = (
        *("jerk", "m/s3", "jerkmeter", 9, "jerk_m_s3", 3),
        *({"m/s3": 1.0, "g/s": 9.80665}, Unit("km/s3", 1e3), Unit("in/s3", INCH_M), 7.0),
    )
""",
    ),
]
# Replaces the modules by edited ones before the program is imported.
EDIT = """
import json, sys, types
from pathlib import Path

top, folder = Path(sys.argv[1]), Path(sys.argv[2])
for file, line, addition in json.loads(sys.argv[3]):
    text = (top / file).read_text(encoding="utf-8")
    assert text.count("\\n" + line) == 1
    name = file.removesuffix(".py").replace("/", ".")
    module = sys.modules[name] = types.ModuleType(name)
    exec(compile(text.replace(line, addition + line), file, "exec"), module.__dict__)
"""
NUMBER = """
import pfwd
from pfwd_device.recording import DropRecord, SurveyWriter
from pfwd.export.export import export_survey
from pfwd.files.header import declared_values
from pfwd.analysis.results import DropResult
from pfwd.report.provenance_blocks import result_values
from tests.pfwd.report.surveys import SETUP, half_sine_drop, result_of
from tests.records import read

with SurveyWriter.open(folder / "s", publish=False, reserve_bytes=0) as writer:
    declared = declared_values(SETUP)
    record = writer.save_drop(DropRecord(point="1", drop=half_sine_drop(1, 8e3), declared=declared))
    result = read(DropResult, result_of(1) | {"settlement_index_m": 0.0125})
    writer.save_result(record, result.to_json())
for form in ("table", "jsonl", "xlsx"):
    export_survey(folder / "s", form, folder / f"made.{form}")
assert result_values(result)["settlement_index_m"] == "0.0125"
(drop,) = pfwd.open(str(folder / "s")).to_dict()["drops"]
assert drop["settlement_index_m"] == 0.0125
"""
QUANTITY = """
import numpy as np
from inversion import Instrument, Record, Sensor
from inversion.measured.record import prepare
from pfwd.files.foreign.column_map import parse_map
from pfwd.files.traces import read_traces
from pfwd.session.live_trace import Envelope
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_device.recording import read_survey
from pfwd_device.setup import read_device_setup
from pfwd_device.wire.identity_layout import pack_identity, read_identity
from pfwd_plugins.quantities import Measurand
from tui.screen.drawing.drop_figures import live_figures
from pfwd.units import SI, US

jerk = Measurand.JERK
# Instrument: the role in JSON and in a setup file, the code on the wire.
channel = ChannelIdentity("j0", jerk)
load = ChannelIdentity("load", Measurand.LOAD)
identity = Identity("1", "m", "1", 1e4, 18, 5.0, (load, channel))
payload = pack_identity(identity)
assert payload.count(b"j0\\x09") == 1
assert read_identity(payload) == identity
setup = read_device_setup({"channels": [{"name": "j0", "role": "jerkmeter"}]}, "setup")
assert setup.channels[0]["quantity"] is jerk

# Files: the column of traces, a column of another program's text, and HDF5.
made = half_sine_drop(1, 8e3)
time, jerks = made.time, 3e2 * (np.sin(150 * made.time) * (made.time > 0))
measured = pfwd.drop(time, made.load, jerks, quantity="jerk", plate_radius=0.15, plate_mass=10.0)
rows = "\\n".join(map("{:.9g},{:.9g},{:.9g}".format, time, made.load, jerks))
file = folder / "jerk.csv"
head = "# pfwd-traces = 1\\n# plate_radius_m = 0.15\\ntime_s,load_N,jerk_m_s3@0.0\\n"
file.write_text(f"{head}{rows}\\n", "utf-8")
(traces,) = read_traces(file).drops
assert traces.channels[0].quantity is jerk
assert "jerk_m_s3@0.0" in measured.to_dict()
sensor = {"column": 3, "unit": "g/s", "quantity": "jerk", "offset_m": 0.0}
tables = {"time": {"column": 1, "unit": "s"}, "load": {"column": 2, "unit": "N"}}
(sensor,) = parse_map({**tables, "sensor": [sensor]}, "map").sensors
assert (sensor.quantity, sensor.where.factor) == (jerk, 9.80665)
record = DropRecord(point="1", drop=traces, declared={})
with SurveyWriter.open(folder / "jerks", publish=False, reserve_bytes=0) as writer:
    writer.save_drop(record)
assert read_survey(folder / "jerks").drops[0].read().drop.channels[0].quantity is jerk

# Three integrations, on both sides.
expected = jerks
for _ in range(3):
    steps = np.diff(time) * (expected[1:] + expected[:-1]) / 2
    expected = np.concatenate([[0.0], np.cumsum(steps)])
np.testing.assert_allclose(measured.displacement[0], expected, atol=1e-12)
data = Record(time, made.load, (Sensor(0.0, jerk, jerks),), Instrument(0.15))
moved = prepare(data).displacement[0]
np.testing.assert_allclose(moved, expected[-moved.size :], atol=1e-6)

# Screen.
assert SI.of(jerk) == ("km/s3", 1e3) and US.of(jerk).name == "in/s3"
rest = np.zeros((3, 2))
figure = live_figures(Envelope(0.01, rest, rest + 2e3, 30, jerk), SI, 5.0)[1]
assert (figure.title, figure.unit, figure.min_range) == ("live jerk", "km/s3", 7.0)
assert figure.curves[0].values.max() == 2.0
"""


def test_a_number_of_a_result_and_a_quantity_are_single_edits(tmp_path: Path) -> None:
    script = EDIT + NUMBER + QUANTITY
    command = [sys.executable, "-c", script, str(TOP), str(tmp_path), json.dumps(EDITS)]
    run = subprocess.run(command, cwd=TOP, capture_output=True, check=False)
    assert run.returncode == 0, run.stderr.decode()
    with (tmp_path / "made.table").open(encoding="utf-8", newline="") as stream:
        names, row = csv.reader(stream)
    assert names[-1] == "settlement_index_m", "former columns keep their places"
    assert float(row[-1]) == 0.0125
    line = json.loads((tmp_path / "made.jsonl").read_text(encoding="utf-8"))
    assert line["settlement_index_m"] == 0.0125
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.load_workbook(tmp_path / "made.xlsx", read_only=True)
    titles, cells = book["drops"].iter_rows(values_only=True)
    assert dict(zip(titles, cells, strict=False))["Settlement index (mm)"] == 12.5
    book.close()
