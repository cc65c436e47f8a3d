"""The scripts in the folder examples read files of the program."""

import runpy
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfwd_device import Drop
from pfwd_device.recording import DropRecord, ReboundRecord, SurveyWriter, read_survey

SCRIPT = Path(__file__).resolve().parents[1] / "examples" / "read_journal.py"
READER = runpy.run_path(str(SCRIPT))
POINT, DROP, REBOUND, EDIT = 2, 3, 4, 5


@pytest.fixture
def survey(tmp_path: Path, make_drop: Callable[..., Drop]) -> Path:
    folder = tmp_path / "survey"
    counts = np.arange(600, dtype=np.int32).reshape(300, 2)
    with SurveyWriter.open(folder, publish=False) as writer:
        for number in (1, 2, 3):
            drop = make_drop(number=number, peak=7000.0 + 100 * number, offsets=(0.0, 0.3))
            declared = {"plate_radius_m": 0.15}
            writer.save_drop(DropRecord("km 1", drop, counts, declared, {"key": f"d7/1/{number}"}))
        writer.save_rebound(2, ReboundRecord(0.2, 900.0, 4000, counts[:50]))
        writer.edit("discard", "wet", number=3)
    return folder


def records_of(folder: Path, kind: int) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    records = READER["read_records"](folder).values()
    return [(data, arrays) for record_kind, data, arrays in records if record_kind == kind]


def test_a_journal_is_read_without_the_program(survey: Path) -> None:
    drops = records_of(survey, DROP)
    stored = [drop.read() for drop in read_survey(survey).drops]
    assert len(drops) == len(stored) == 3
    for (data, arrays), record in zip(drops, stored, strict=True):
        assert (data["point"], data["drop"]) == ("km 1", record.drop.number)
        assert data["declared"] == record.declared
        np.testing.assert_array_equal(arrays["time"], record.drop.time)
        np.testing.assert_array_equal(arrays["load"], record.drop.load)
        np.testing.assert_array_equal(arrays["counts"], record.counts)
        for index, channel in enumerate(record.drop.channels, 1):
            np.testing.assert_array_equal(arrays[f"sensor {index}"], channel.values)
    ((rebound, samples),) = records_of(survey, REBOUND)
    assert (rebound["number"], len(samples["counts"])) == (2, 50)
    ((edit, _),) = records_of(survey, EDIT)
    assert (edit["what"], edit["value"], edit["number"]) == ("discard", "wet", 3)


def test_a_damaged_record_does_not_affect_others(survey: Path) -> None:
    (segment,) = (survey / "journal").glob("*.pfwdj")
    content = bytearray(segment.read_bytes())
    begin = content.index(b'"drop":2')
    content[begin : begin + 8] = b'"drop":9'
    segment.write_bytes(bytes(content) + content[:60])  # and a torn end
    assert [data["drop"] for data, _ in records_of(survey, DROP)] == [1, 3]


def test_the_script_prints_the_peaks_with_numpy_only(survey: Path) -> None:
    code = (
        "import runpy, sys; sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], "
        "run_name='__main__'); assert not {'pfwd', 'pfwd_device', 'h5py'} & set(sys.modules)"
    )
    command = [sys.executable, "-c", code, str(SCRIPT), str(survey)]
    run = subprocess.run(command, capture_output=True, encoding="utf-8", check=True)
    lines = run.stdout.splitlines()
    assert lines[0] == "point km 1, drop 1: peak load 7.10 kN"
    assert len(lines) == 3
