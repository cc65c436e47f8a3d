"""The documented example runs, and a recording on the disk opens."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from pfwd_device.jobs import Jobs
from pfwd_device.recording import CaptureReader, check, read_drop_file, read_survey, recover
from pfwd_device.recording.drop_file import drop_digest
from tests.pfwd_device.recording.make_recording import values

TOP = Path(__file__).resolve().parents[3]
RECORDING = TOP / "tests" / "data" / "recording"


def test_the_example_of_the_documentation_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    text = (TOP / "docs" / "recording.md").read_text(encoding="utf-8")
    example = re.search(r"<!-- example -->\n```python\n(.*?)```", text, re.S)
    monkeypatch.chdir(RECORDING)
    names: dict[str, np.ndarray] = {}
    exec(compile(example[1], "recording.md", "exec"), names)
    np.testing.assert_array_equal(names["load"], 1000.0 + np.arange(24))
    np.testing.assert_array_equal(names["time"], (np.arange(24) - 4) / 8192.0)
    assert np.isnan(names["velocity"][5])


def test_the_recording_opens() -> None:
    survey = read_survey(RECORDING)
    (point,) = survey.points
    assert (point.name, point.declared) == ("Köln 1", {"plate_radius_m": 0.15})
    first, two = point.drops
    assert (first.notes, first.discarded, two.discarded) == (("nass",), False, True)
    assert [event["event"] for event in survey.events] == ["gap"]
    assert survey.checks[0]["details"] == {"zero": 0.5}
    assert first.results[0].name == "drop-000001-1.json"
    for number, drop in ((1, first), (2, two)):
        assert drop.file is not None
        for record in (drop.read(), read_drop_file(drop.file)):
            assert drop_digest(record, 0) == drop_digest(values(number), 0)
    (capture,) = survey.captures
    assert [item.data for item in CaptureReader(capture)] == [b"\x00\x01"]


def test_the_recording_is_intact_and_requires_no_recovery(tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(RECORDING, copy)
    report = check(copy)
    assert (report.ok, report.notes, report.closed) == (True, (), True)
    recovered = recover(copy, jobs=Jobs(0))
    assert (recovered.ok, recovered.actions, recovered.drops_published) == (True, (), 2)
    assert check(copy).ok
