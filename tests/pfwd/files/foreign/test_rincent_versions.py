"""Versions of Rincent's programs that differ: what is unclear in their files is a remark."""

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pfwd.errors import TraceError
from pfwd.files.foreign.rincent import compare_peaks, smoothed_as_stored
from pfwd.files.foreign.rincent_facts import StoredPeaks
from pfwd.files.traces import TracePoint
from pfwd_device import Channel, Drop
from pfwd_device.signals import trace_peaks
from tests.pfwd.files.foreign.builders import (
    acquired,
    dataset,
    prjz,
    pulse,
    stored,
    viewed,
    zipped,
)

Reader = Callable[..., list[TracePoint]]
DROPS = {"1F": [pulse(peak=80e3 + 100 * n) for n in range(3)]}


def member(database: dict[str, Any], traces: bytes) -> bytes:
    return zipped({"database.json": json.dumps(database).encode(), "Rawdata/1F": traces})


def remarks(point: TracePoint) -> list[str]:
    return list(point.setup.extra["imported"].get("remarks", ()))


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("a &amp; b", "a & b", "&"),
        ("a &amp; b", "a && b", "& is not escaped, as at 1 more places"),
        ("a &amp; b", "a &nbsp; b", "&"),
        ("a &amp; b", "a <10", "<"),
    ],
)
def test_unescaped_characters_are_read_with_a_remark(
    read: Reader, old: str, new: str, text: str
) -> None:
    data = dataset({"1": DROPS["1F"]}).decode().replace(old, new)
    at = data[: data.index(new)].count("\n") + 1
    (point,) = read(zipped({"database.xml": data.encode()}), "rig.dynz")
    assert point.setup.site == new
    (remark,) = [item for item in remarks(point) if "not escaped" in item]
    assert remark.startswith(f"rig.dynz, database.xml, line {at}: {text}")


def test_entities_of_xml_are_decoded(read: Reader) -> None:
    data = dataset({"1": DROPS["1F"]}).decode().replace("a &amp; b", "&lt;&#65;&#x42;&gt;")
    (point,) = read(zipped({"database.xml": data.encode()}), "a.dynz")
    assert point.setup.site == "<AB>"
    assert not any("escaped" in item for item in remarks(point))


def test_a_set_that_is_not_utf_8_is_read_with_a_remark(read: Reader) -> None:
    data = dataset({"1": DROPS["1F"]}).decode().replace("a &amp; b", "Étang").encode("cp1252")
    data = data.replace(b' encoding="utf-8"', b"")
    (point,) = read(zipped({"database.xml": data}), "a.dynz")
    assert point.setup.site == "Étang"
    assert any("not UTF-8" in item for item in remarks(point))


def test_the_older_layout_is_read(read: Reader) -> None:
    (point,) = read(member(acquired(DROPS), stored(DROPS["1F"], older=True)), "a.dynz")
    assert point.drops[0].sampling_rate == pytest.approx(15_000.0)
    for drop, item in zip(point.drops, DROPS["1F"], strict=True):
        np.testing.assert_array_equal(drop.load, item.load.astype("f4"))
        np.testing.assert_array_equal(drop.channels[0].values, item.sensors[0].astype("f4"))


@pytest.mark.parametrize("older", [False, True])
def test_a_rate_that_no_place_says_is_declared(read: Reader, older: bool) -> None:
    database = acquired(DROPS)
    del database["ParamsAcqu"]["FreqAcqu"]
    data = member(database, stored(DROPS["1F"], older=older))
    with pytest.raises(
        TraceError, match=r"FreqAcqu.*give sampling_rate_hz in a file with --header"
    ):
        read(data, "a.dynz")
    (point,) = read(data, "a.dynz", "sampling_rate_hz = 12000.0")
    assert point.drops[0].sampling_rate == pytest.approx(12_000.0)
    assert "sampling_rate_hz" not in point.setup.extra
    with pytest.raises(TraceError, match="sampling_rate_hz, a number from 1 to 1e"):
        read(data, "a.dynz", "sampling_rate_hz = 0.0")


def test_the_rate_of_the_traces_is_used(read: Reader) -> None:
    database = acquired(DROPS, rate=30_000.0)
    (point,) = read(member(database, stored(DROPS["1F"], rate=15_000.0)), "a.mpvz")
    assert point.drops[0].sampling_rate == pytest.approx(15_000.0)
    expected = (
        "a.mpvz: the traces state 15000 Hz and 300 samples, database.json states 30000 Hz and "
        "300 samples; those of the traces were used"
    )
    assert expected in remarks(point)
    (same,) = read(member(acquired(DROPS), stored(DROPS["1F"], rate=15_000.0)), "a.mpvz")
    assert not any("those of the traces" in item for item in remarks(same))


def test_an_older_viewers_project(read: Reader) -> None:
    project = viewed(DROPS)["project"]
    old = {"version": 1, **project}
    (point,) = read(member(old, stored(DROPS["1F"])), "a.mpvz")
    assert (point.setup.point, point.setup.device) == ("east 1", "Minidyn T-3")
    assert len(point.drops) == 3


def test_names_of_an_older_program(read: Reader) -> None:
    """It says PVs, Points, Machines and Dossiers where the newer one says PV, Point and so on."""
    database = acquired(DROPS)
    (entry,) = database["PVs"]
    entry["PVs"] = entry.pop("PV")
    for point in entry["Points"]:
        point["Points"] = point.pop("Point")
    database["Machines"] = database.pop("Hardware")
    database["Dossiers"] = database.pop("Project")
    (point,) = read(prjz(DROPS, database), "a.prjz")
    assert (point.setup.point, point.setup.site) == ("north 1", "yard")
    assert point.setup.device == "Maxidyn T-2"
    assert point.setup.extra["imported"]["chainage_m"] == 10.0


def with_peaks(loads: list[float], deflections: list[float]) -> dict[str, Any]:
    database = acquired(DROPS)
    (point,) = database["PVs"][0]["Points"]
    point["Drops"] = [
        {"Number": n, "Fmax": load, "Umax": moved}
        for n, (load, moved) in enumerate(zip(loads, deflections, strict=True))
    ]
    return database


def test_peaks_of_the_makers_software_are_compared(read: Reader) -> None:
    loads = [float(item.load.max()) for item in DROPS["1F"]]
    moved = [float(item.sensors.max()) for item in DROPS["1F"]]
    (point,) = read(prjz(DROPS, with_peaks(loads, moved)), "a.prjz")
    assert not any("maker's software stored" in item for item in remarks(point))
    (point,) = read(prjz(DROPS, with_peaks([1.004 * item for item in loads], moved)), "a.prjz")
    assert not any("peak load" in item for item in remarks(point))
    (point,) = read(prjz(DROPS, with_peaks([item / 1.01 for item in loads], moved)), "a.prjz")
    (expected,) = [item for item in remarks(point) if "maker's software stored" in item]
    assert expected == (
        "a.prjz, database.json: peak load of the stored traces is +1.0 % off what the "
        "maker's software stored"
    )
    (point,) = read(prjz(DROPS, with_peaks(loads[:2], moved[:2])), "a.prjz")
    assert any("peaks of 2 drops, 3 drops in the stored traces" in item for item in remarks(point))


def test_a_drifting_deflection_is_a_remark(read: Reader) -> None:
    drops = {"1F": [pulse(peak=8000.0), pulse(peak=9000.0)]}
    late = np.linspace(0, 9e-4, 300)
    for item in drops["1F"]:
        item.sensors[0, 200:] += late[200:] - late[200]
    database = acquired(drops)
    (entry,) = database["PVs"][0]["Points"]
    entry["Drops"] = [{"Fmax": 8000.0, "Umax": 1e-4}, {"Fmax": 9000.0, "Umax": 1.125e-4}]
    (point,) = read(prjz(drops, database), "a.prjz")
    assert any("which are larger later: they drift" in item for item in remarks(point))
    assert not any(" % off " in item for item in remarks(point))


def test_equal_drops_are_a_remark(read: Reader) -> None:
    drops = {"1F": [pulse(), pulse(), pulse()]}
    (point,) = read(prjz(drops, acquired(drops)), "a.prjz")
    assert len(point.drops) == 3
    assert any("of all 3 drops are the same, number for number" in item for item in remarks(point))
    (point,) = read(prjz(DROPS, acquired(DROPS)), "a.prjz")
    assert not any("number for number" in item for item in remarks(point))


def test_stored_peaks_of_smoothed_channels_are_recognised(read: Reader) -> None:
    """The filter is that of the maker's software; unsmoothed channels are off by more."""
    item = pulse(peak=8000.0)
    item.sensors[0] = np.gradient(item.sensors[0], 1 / 15_000.0)
    # What rings at 1 kHz is smoothed away.
    item.load[80:160] += 300 * np.sin(2 * np.pi * 1000 * np.arange(80) / 15_000)
    database = dataset({"1": [item]})
    (plain,) = read(zipped({"database.xml": database}), "a.dynz")
    (smooth,) = (smoothed_as_stored(drop) for drop in plain.drops)
    load, ((_, moved),) = trace_peaks(smooth).load, trace_peaks(smooth).displacements

    def stored_as(load: float, moved: float) -> list[str]:
        acquisition = acquired({"1": [item]})
        (entry,) = acquisition["PVs"]
        entry["PV"]["Name"] = "a & b"
        entry["Points"][0]["Drops"] = [{"Fmax": load, "Umax": moved}]
        members = {"database.xml": database, "database.json": json.dumps(acquisition).encode()}
        (point,) = read(zipped(members), "b.dynz")
        return [text for text in remarks(point) if "maker's software stored" in text]

    (text,) = stored_as(load, moved)
    assert "smoothed alike these agree within 0.5 %" in text
    assert any("peak load of the raw channels is" in text for text in stored_as(0.9 * load, moved))
    recorded = trace_peaks(plain.drops[0])
    assert stored_as(recorded.load, recorded.displacements[0][1]) == []


def test_a_wrong_count_without_a_rate_is_a_remark(read: Reader) -> None:
    database = acquired(DROPS)
    database["ParamsAcqu"]["NbSamples"] = 600
    data = member(database, stored(DROPS["1F"], older=True))
    (point,) = read(data, "a.dynz")
    expected = (
        "a.dynz, rawdata/1f: 300 samples without a sampling rate; 15000 Hz of the database was used"
    )
    assert any(text.startswith(expected) for text in remarks(point))
    (point,) = read(data, "a.dynz", "sampling_rate_hz = 7500.0")
    assert not any("without a sampling rate" in text for text in remarks(point))


@pytest.mark.parametrize(("count", "read_it"), [(10_000, True), (10_001, False)])
def test_no_end_of_signs_is_mended(read: Reader, count: int, read_it: bool) -> None:
    data = dataset({"1": DROPS["1F"]}).decode().replace("a &amp; b", "&" * count)
    archive = zipped({"database.xml": data.encode()})
    if read_it:
        assert len(read(archive, "a.dynz")) == 1
        return
    with pytest.raises(TraceError, match="complete XML"):
        read(archive, "a.dynz")


def peak_deviations(drops: list[Drop], stored: list[StoredPeaks]) -> dict[str, float]:
    return compare_peaks(drops, stored, "a.prjz", "stored_traces")[1]


def peaks_of(drop: Drop, load: float = 1.0, deflection: float = 1.0) -> StoredPeaks:
    peaks = trace_peaks(drop)
    assert peaks.centre is not None
    return StoredPeaks(load * peaks.load, (deflection * peaks.centre,))


def moved(drop: Drop, factor: float) -> Drop:
    centre = replace(drop.channels[0], values=factor * drop.channels[0].values)
    return replace(drop, channels=(Channel(0.0, centre.quantity, centre.values),))


def test_each_drop_is_compared_with_its_peaks(make_drop: Callable[..., Drop]) -> None:
    first = moved(make_drop(), 1.0)
    second = replace(moved(make_drop(), 2.0), number=2)
    assert peak_deviations([first, second], [peaks_of(first), peaks_of(second)]) == {}
    low = peaks_of(second, deflection=4.0)
    assert peak_deviations([first, second], [peaks_of(first), low]) == {"2": pytest.approx(0.75)}
    heavy = peaks_of(first, load=0.5)
    assert peak_deviations([first, second], [heavy, peaks_of(second)]) == {"1": pytest.approx(1.0)}


def test_copies_have_the_deviation_of_the_first(make_drop: Callable[..., Drop]) -> None:
    first = moved(make_drop(), 1.0)
    copy = replace(first, number=2)
    stored = [peaks_of(first), peaks_of(first, deflection=4.0)]
    assert peak_deviations([first, copy], stored) == {}
    turned = peak_deviations([first, copy], stored[::-1])
    assert turned == {"1": pytest.approx(0.75), "2": pytest.approx(0.75)}


def test_missing_peaks_are_not_compared(make_drop: Callable[..., Drop]) -> None:
    assert peak_deviations([make_drop()], []) == {}
