"""A survey with everything that an export has to carry."""

import csv
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfwd.analysis.drop_facts import FACTS_KEY, facts_to_store
from pfwd.analysis.results import DropResult
from pfwd.files.header import PointSetup
from pfwd.judging import drop_from_traces
from pfwd_device import Channel, Drop
from pfwd_device.jobs import Jobs
from pfwd_device.recording import DropRecord, ReboundRecord, SurveyWriter
from tests.pfwd.report import surveys
from tests.records import complete, known

RESULT: dict[str, Any] = {
    **surveys.result_of(1),
    "modulus_interval_pa": [43e6, 47e6],
    "equivalent_modulus_interval_pa": [43e6, 47e6],
    "viscosity_pa_s": 1e4,
    "half_sine": {"peak_pressure_pa": 1.1e5, "duration_s": 0.018, "rms_over_peak": 0.02},
    "residual_rms_over_peak": float("nan"),
    "explained": True,
    "converged": True,
    "at_bound": [],
    "warnings": ["depth not unique"],
}

FORMULA = "=HYPERLINK(1)"
"""A note that a spreadsheet would run."""

BELONGS = ("modulus_sd_pa", "model", "plate_radius_m", "poisson_ratio", "warnings")
"""Columns that a table must have with a modulus."""


def result_of(number: int = 1, **more: Any) -> dict[str, Any]:
    """Values of a stored result."""
    return RESULT | {"drop": number} | more


def rows_of(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream, strict=True))


@pytest.fixture
def survey(made: Path, tmp_path: Path) -> Path:
    """A copy that a test may change."""
    return shutil.copytree(made, tmp_path / "survey")


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory, make_drop: Callable[..., Drop]) -> Path:
    """Two points: one with position, results, notes and a discarded drop, one without any."""
    folder = tmp_path_factory.mktemp("export") / "survey"
    counts = np.arange(600, dtype=np.int32).reshape(300, 2)
    with SurveyWriter.open(folder, jobs=Jobs(0)) as writer:
        declared = {"plate_radius_m": 0.15, "poisson_ratio": 0.35, "site": "km 1", "device": "d7"}
        for number in (1, 2, 3):
            drop = make_drop(number=number, peak=8000.0 + number, offsets=(0.0, -0.3), offset=50.0)
            view = drop_from_traces(drop, PointSetup(plate_radius=0.15, poisson_ratio=0.35))
            facts = known(facts_to_store(view.own, view.own_pulse_peak, view.setup))
            metadata = {
                "key": f"d7/1/{number}",
                "time_utc": f"2024-05-06T08:0{number}:00+00:00",
                "position": {"latitude": 48.1, "longitude": 11.5, "altitude_m": 520.0},
                "identity": {"serial_number": "7", "channels": []},
                "not a number": float("nan"),
                FACTS_KEY: facts.to_json(),
            }
            bounce = ReboundRecord(0.2, 900.0, 4000, counts[:50])
            record = DropRecord("A/1", drop, counts, declared, metadata, (bounce,))
            saved = writer.save_drop(record)
            writer.publish(saved)
            if number < 3:
                for more in ({"modulus_pa": 1.0, "method": "posterior"}, {}):
                    writer.save_result(saved, complete(DropResult, result_of(number, **more)))
        writer.edit("note", FORMULA, number=1)
        writer.edit("discard", "wet", number=3)
        writer.edit("name", "north, end", point="A/1")
        writer.edit("target", 45e6, point="A/1")
        drop = make_drop(number=1, peak=7000.0, offsets=(0.0, -0.3), quantity="velocity")
        # Without position and without time, with samples that never came at the end.
        values = drop.channels[0].values.copy()
        values[-20:] = np.nan
        channels = (Channel(0.0, "velocity", values), drop.channels[1])
        late = Drop(1, drop.time, drop.load, channels)
        writer.publish(writer.save_drop(DropRecord("CON", late, None, declared, {})))
        writer.note_event("gap", {"samples": 5})
        writer.save_check({"zero": 1.0})
        capture = writer.open_capture("link", {"url": "x"})
        capture.write("from", b"hello")
    return folder
