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
from pfwd_device import Channel, Drop
from pfwd_device.recording import DropRecord, SurveyWriter, drop_payload, payload
from pfwd_device.recording import read_survey as read


def table(survey: Path, path: Path, form: str = "table") -> bytes:
    export_survey(survey, form, path)
    return path.read_bytes()


@contextlib.contextmanager
def computed_anew() -> Iterator[None]:
    """No peaks of a record are taken: those that this version writes are another version's."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drop_payload, "TRACE_PEAKS_VERSION", drop_payload.TRACE_PEAKS_VERSION + 1)
        yield


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Callable[[], tuple[int, int]]:
    """How many drops' arrays were unpacked, and of how many drops peaks were computed."""
    unpacked, computed = [], []
    arrays, of = payload._arrays, view.unbroken_peaks

    def noted(*arguments: Any) -> Any:
        unpacked.append(1)
        return arrays(*arguments)

    monkeypatch.setattr(payload, "_arrays", noted)
    monkeypatch.setattr(view, "unbroken_peaks", lambda drop: computed.append(1) or of(drop))
    return lambda: (len(unpacked), len(computed))


@pytest.mark.parametrize("form", ["table", "jsonl", "geojson"])
def test_recorded_peaks_make_the_same_bytes(survey: Path, tmp_path: Path, form: str) -> None:
    recorded = table(survey, tmp_path / "recorded", form)
    with computed_anew():
        assert table(survey, tmp_path / "computed", form) == recorded


def test_arrays_are_unpacked_only_for_drops_without_recorded_peaks(
    survey: Path, tmp_path: Path, counted: Callable[[], tuple[int, int]]
) -> None:
    table(survey, tmp_path / "recorded")
    # The drop of four with missing samples, once for its row and for the verdict of its point.
    assert counted() == (1, 1)
    with computed_anew():
        table(survey, tmp_path / "computed")
    assert counted() == (5, 5)


def test_nothing_declared_later_changes_peaks(survey: Path, tmp_path: Path) -> None:
    """The integral of a velocity carries the geophone's response, whatever is said of it."""
    with SurveyWriter.open(survey, publish=False) as writer:
        said = {"geophone_frequency_hz": 10.0, "geophone_damping": 0.7, "plate_radius_m": 0.1}
        for point in writer.points:
            writer.edit("declared", said, point=point)
    recorded = table(survey, tmp_path / "recorded")
    with computed_anew():
        assert table(survey, tmp_path / "computed") == recorded


def test_what_was_recorded_is_what_the_traces_say(survey: Path) -> None:
    for drop in read(survey).drops:
        facts, record = drop.read_facts(), drop.read()
        missing = any(np.isnan(channel.values).any() for channel in record.drop.channels)
        assert (facts.drop is not None) == missing
        assert (facts.peaks is None) == missing
        assert (facts.declared, facts.metadata.keys()) == (record.declared, record.metadata.keys())
        if facts.peaks is not None:
            assert facts.peaks == unbroken_peaks(record.drop)
            assert facts.peaks.centre == facts.peaks.displacements[0][1]


def test_a_damaged_record_gives_way_to_the_drops_own_file(survey: Path, tmp_path: Path) -> None:
    expected = table(survey, tmp_path / "expected")
    contents = read(survey)
    drop = contents.drops[0]
    journal = survey / "journal" / "0001.pfwdj"
    data = bytearray(journal.read_bytes())
    at = data.index(b'"displacements"')
    data[at + 20] ^= 1
    journal.write_bytes(data)
    facts = drop.read_facts()
    assert facts.drop is not None
    assert np.array_equal(facts.drop.load, drop.read().drop.load)
    again = table(survey, tmp_path / "again")
    assert again == expected


def test_a_drop_of_numbers_near_the_largest_is_saved(tmp_path: Path) -> None:
    """Their sum is no number any more: peaks are left to readers, the drop is recorded."""
    time = np.linspace(-0.1, 0.1, 40)
    huge = np.full(40, 1.7e308)
    drop = Drop(1, time, huge, (Channel(0.0, "velocity", huge),))
    assert drop_payload.peaks_data(drop) is None
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        assert writer.save_drop(DropRecord("P", drop)) == 1
    (saved,) = read(tmp_path / "s").drops
    assert saved.read_facts().drop is not None
