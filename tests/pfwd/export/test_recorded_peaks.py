"""A table takes the peaks that were recorded with a drop, and they are those of its traces."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfwd.analysis.drop_facts import unbroken_peaks
from pfwd.export.export import export_survey
from pfwd.judging import view
from pfwd_device.recording import SurveyWriter, drop_payload, payload
from pfwd_device.recording import read_survey as read
from tests.records import known


def table(survey: Path, path: Path) -> bytes:
    export_survey(survey, "table", path)
    return path.read_bytes()


@contextlib.contextmanager
def without_recorded_peaks() -> Iterator[None]:
    """Ignore the recorded peaks, as those of another version."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drop_payload, "TRACE_PEAKS_VERSION", drop_payload.TRACE_PEAKS_VERSION + 1)
        yield


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Callable[[], tuple[int, int]]:
    """Numbers of drops of which arrays were unpacked, and of which peaks were computed."""
    unpacked, computed = [], []
    arrays, of = payload._arrays, view.unbroken_peaks

    def noted(*arguments: Any) -> Any:
        unpacked.append(1)
        return arrays(*arguments)

    monkeypatch.setattr(payload, "_arrays", noted)
    monkeypatch.setattr(view, "unbroken_peaks", lambda drop: computed.append(1) or of(drop))
    return lambda: (len(unpacked), len(computed))


def test_recorded_peaks_make_the_same_table_without_unpacking_arrays(
    survey: Path, tmp_path: Path, counted: Callable[[], tuple[int, int]]
) -> None:
    recorded = table(survey, tmp_path / "recorded")
    # The drop of four with missing samples, once for its row and for the verdict of its point.
    assert counted() == (1, 1)
    with without_recorded_peaks():
        assert table(survey, tmp_path / "computed") == recorded
    assert counted() == (5, 5)


def test_later_declarations_do_not_change_peaks(survey: Path, tmp_path: Path) -> None:
    """The integral of a velocity carries the geophone's response, whatever is said of it."""
    with SurveyWriter.open(survey, publish=False) as writer:
        declared = {"geophone_frequency_hz": 10.0, "geophone_damping": 0.7, "plate_radius_m": 0.1}
        for point in writer.points:
            writer.edit("declared", declared, point=point)
    recorded = table(survey, tmp_path / "recorded")
    with without_recorded_peaks():
        assert table(survey, tmp_path / "computed") == recorded


def test_recorded_peaks_agree_with_the_traces(survey: Path) -> None:
    for drop in read(survey).drops:
        facts, record = drop.read_facts(), drop.read()
        missing = any(np.isnan(channel.values).any() for channel in record.drop.channels)
        assert (facts.drop is not None) == missing
        assert (facts.peaks is None) == missing
        assert (facts.declared, facts.metadata.keys()) == (record.declared, record.metadata.keys())
        if facts.peaks is not None:
            assert facts.peaks == unbroken_peaks(record.drop)
            assert facts.peaks.centre == facts.peaks.displacements[0][1]


def test_a_damaged_record_is_replaced_by_the_drop_file(survey: Path, tmp_path: Path) -> None:
    expected = table(survey, tmp_path / "expected")
    contents = read(survey)
    drop = contents.drops[0]
    journal = survey / "journal" / "0001.pfwdj"
    data = bytearray(journal.read_bytes())
    at = data.index(b'"displacements"')
    data[at + 20] ^= 1
    journal.write_bytes(data)
    facts = drop.read_facts()
    assert np.array_equal(known(facts.drop).load, drop.read().drop.load)
    assert table(survey, tmp_path / "damaged") == expected
