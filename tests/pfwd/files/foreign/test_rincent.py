"""Projects of Rincent's programs: channels, sensors, places and settings."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inversion.notices import text_of
from pfwd.errors import TraceError
from pfwd.files.foreign import archive as archive_module
from pfwd.files.foreign.rincent import compare_peaks, smoothed_as_stored
from pfwd.files.foreign.rincent_facts import StoredPeaks
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from pfwd_device import Channel, Drop
from pfwd_device.signals import trace_peaks
from tests.pfwd.files.foreign.builders import (
    acquired,
    dataset,
    dynz,
    prjz,
    pulse,
    stored,
    viewed,
    zipped,
)

Reader = Callable[..., list[TracePoint]]
RAW = {"1": [pulse(peak=8000.0 + n, offset=2000.0) for n in range(3)], "A": [pulse()]}
HEX = {"F0000000000000AB": [pulse(peak=80e3 + n) for n in range(3)]}


def test_raw_channels_are_read_exactly(read: Reader) -> None:
    first, second = read(dynz(RAW), "a.dynz")
    assert (first.setup.point, second.setup.point) == ("a & b 1", "a & b 2")
    assert [drop.number for drop in first.drops] == [1, 2, 3]
    for drop, recorded in zip(first.drops, RAW["1"], strict=True):
        assert drop.load.tobytes() == recorded.load.tobytes()
        (channel,) = drop.channels
        assert (channel.offset, channel.quantity) == (0.0, "velocity")
        assert channel.values.tobytes() == recorded.sensors[0].tobytes()
        assert drop.time[0] == -0.005
        assert drop.time[75] == 0.0
        assert drop.sampling_rate == pytest.approx(15_000.0)
    setup = first.setup
    assert (setup.plate_radius, setup.poisson_ratio, setup.seating_drops) == (0.15, 0.35, 1)
    assert (setup.latitude, setup.longitude) == (45.5, 6.25)
    assert (setup.time_utc, setup.temperature) == ("2024-05-06T08:00:00+00:00", 12.0)
    assert setup.device == "Minidyn T-1"
    assert setup.extra["imported"]["position_dop"] == 0.7
    assert "geophone_natural_frequency_hz" in remarks(first)
    # What another program's file said is no mistake of the user.
    assert "not known to the format" not in remarks(first)


def test_stored_channels_are_read_on_request(read: Reader) -> None:
    first, _ = read(dynz(RAW), "a.dynz", channels="stored")
    assert first.setup.point == "north 1"
    for drop, recorded in zip(first.drops, RAW["1"], strict=True):
        np.testing.assert_array_equal(drop.load, (2 * recorded.load).astype("f4"))
        assert drop.channels[0].quantity == "displacement"
    assert "processed and stored" in remarks(first)


@pytest.mark.parametrize("folder", ["Rawdata\\", "rawdata/", "RAWDATA/"])
@pytest.mark.parametrize("rate", [None, 15_000.0])
def test_a_project_with_stored_traces(read: Reader, folder: str, rate: float | None) -> None:
    (point,) = read(prjz(HEX, acquired(HEX), folder=folder, rate=rate), "a.prjz")
    setup = point.setup
    assert (setup.plate_radius, setup.poisson_ratio, setup.seating_drops) == (0.3, 0.25, 2)
    assert (setup.point, setup.operator, setup.site) == ("north 1", "A. B.", "yard")
    assert setup.device == "Maxidyn T-2"
    assert setup.extra["imported"]["chainage_m"] == 10.0
    assert "position_dop" not in setup.extra["imported"]
    for drop, recorded in zip(point.drops, next(iter(HEX.values())), strict=True):
        np.testing.assert_array_equal(drop.load, recorded.load.astype("f4"))
        np.testing.assert_array_equal(drop.channels[0].values, recorded.sensors[0].astype("f4"))


def test_the_viewers_project(read: Reader) -> None:
    (point,) = read(prjz(HEX, viewed(HEX), folder="rawdata/"), "a.mpvz")
    setup = point.setup
    assert (setup.plate_radius, setup.poisson_ratio, setup.seating_drops) == (0.15, 0.35, 1)
    assert (setup.point, setup.site, setup.device) == ("east 1", "field", "Minidyn T-3")
    assert (setup.latitude, setup.longitude) == (45.5, 6.25)
    assert setup.extra["imported"]["surface_temperature_c"] == 13.0
    assert len(point.drops) == 3


@pytest.mark.parametrize("by_sample", [False, True])
def test_several_sensors_stand_where_the_database_says(read: Reader, by_sample: bool) -> None:
    offsets = [-0.3, 0.0, 0.3, 0.6]
    drops = {"1F": [pulse(channels=4), pulse(channels=4, peak=9000.0)]}
    (point,) = read(prjz(drops, acquired(drops, offsets=offsets), by_sample=by_sample), "a.prjz")
    assert point.setup.plate_radius == 0.15
    for drop, recorded in zip(point.drops, drops["1F"], strict=True):
        assert [channel.offset for channel in drop.channels] == offsets
        for channel, values in zip(drop.channels, recorded.sensors, strict=True):
            np.testing.assert_array_equal(channel.values, values.astype("f4"))
    assert "left out" not in remarks(point)


def test_the_first_of_two_sensors_at_a_place_is_read(read: Reader) -> None:
    drops = {"1F": [pulse(channels=4)]}
    (point,) = read(prjz(drops, acquired(drops, offsets=[-0.3, 0.0, 0.3, -0.3])), "a.prjz")
    (drop,) = point.drops
    assert [channel.offset for channel in drop.channels] == [-0.3, 0.0, 0.3]
    np.testing.assert_array_equal(drop.channels[0].values, drops["1F"][0].sensors[0].astype("f4"))
    assert "a second sensor at -0.3 m is left out" in remarks(point)


def test_accelerations_are_no_traces_but_displacements_are(read: Reader) -> None:
    point, _ = read(dynz(RAW, kind=1), "a.dynz")
    assert point.drops[0].channels[0].quantity == "displacement"
    assert "accelerations" in remarks(point)
    with pytest.raises(TraceError, match="got accelerations; import the stored traces with"):
        read(dynz(RAW, kind=1), "a.dynz", channels="raw")
    with pytest.raises(TraceError, match="got accelerations"):
        read(zipped({"database.xml": dataset(RAW, kind=1)}), "a.dynz")
    point, _ = read(dynz(RAW, kind=3), "a.dynz", channels="raw")
    assert point.drops[0].channels[0].quantity == "displacement"


def test_traces_that_no_point_claims_are_not_lost(read: Reader) -> None:
    database = acquired({"1": HEX["F0000000000000AB"]})
    (point,) = read(prjz(HEX, database), "a.prjz")
    # Nobody can read out what a program calls its files.
    assert point.setup.point == "point 1"
    assert "a.prjz, rawdata/f0000000000000ab: no point of the database has these" in remarks(point)


def test_no_fix_is_no_position_and_a_time_without_a_zone_is_local(read: Reader) -> None:
    database = acquired(HEX)
    about = {"Latitude": 0.0, "Longitude": 0.0, "Date": "2024-05-06T08:00:00"}
    database["PVs"][0]["Points"][0]["Point"] |= about
    (point,) = read(prjz(HEX, database), "a.prjz")
    assert (point.setup.latitude, point.setup.longitude, point.setup.time_utc) == (None,) * 3
    assert point.setup.extra["imported"]["time_local"] == "2024-05-06T08:00:00"


def test_a_bomb_is_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive_module, "MAX_MEMBER_BYTES", 1_000_000)
    path = tmp_path / "bomb.prjz"
    path.write_bytes(zipped({"database.json": b" " * 50_000_000}))
    assert path.stat().st_size < 100_000
    with pytest.raises(TraceError, match="expected at most 1 MB, got more"):
        read_points(path)


@pytest.mark.parametrize("letter", [b"\n", b"\0"])
def test_a_damaged_name_does_not_break_the_line(read: Reader, letter: bytes) -> None:
    """The list of members has a different name than the member, or none at all."""
    data = prjz(HEX, acquired(HEX))
    at = data.rfind(b"database.json")
    with pytest.raises(TraceError) as caught:
        read(data[:at] + letter + data[at + 1 :], "a.prjz")
    assert len(str(caught.value).splitlines()) == 1


# Versions of the programs that differ: what is unclear in their files is a remark.

DROPS = {"1F": [pulse(peak=80e3 + 100 * n) for n in range(3)]}


def member(database: dict[str, Any], traces: bytes) -> bytes:
    return zipped({"database.json": json.dumps(database).encode(), "Rawdata/1F": traces})


def remarks(point: TracePoint) -> str:
    return "\n".join(map(text_of, point.warnings))


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
    assert f"rig.dynz, database.xml, line {at}: {text}" in remarks(point)


def test_entities_of_xml_are_decoded(read: Reader) -> None:
    data = dataset({"1": DROPS["1F"]}).decode().replace("a &amp; b", "&lt;&#65;&#x42;&gt;")
    (point,) = read(zipped({"database.xml": data.encode()}), "a.dynz")
    assert point.setup.site == "<AB>"
    assert "escaped" not in remarks(point)


def test_a_set_that_is_not_utf_8_is_read_with_a_remark(read: Reader) -> None:
    data = dataset({"1": DROPS["1F"]}).decode().replace("a &amp; b", "Étang").encode("cp1252")
    data = data.replace(b' encoding="utf-8"', b"")
    (point,) = read(zipped({"database.xml": data}), "a.dynz")
    assert point.setup.site == "Étang"
    assert "not UTF-8" in remarks(point)


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


@pytest.mark.parametrize("rate", [15_000.0, 30_000.0])
def test_the_rate_of_the_traces_is_used(read: Reader, rate: float) -> None:
    database = acquired(DROPS, rate=rate)
    (point,) = read(member(database, stored(DROPS["1F"], rate=15_000.0)), "a.mpvz")
    assert point.drops[0].sampling_rate == pytest.approx(15_000.0)
    text = "a.mpvz: the traces state 15000 Hz and 300 samples, database.json states 30000 Hz and"
    assert (text in remarks(point)) == (rate == 30_000.0)


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
    assert "maker's software stored" not in remarks(point)
    (point,) = read(prjz(DROPS, with_peaks([1.004 * item for item in loads], moved)), "a.prjz")
    assert "peak load" not in remarks(point)
    (point,) = read(prjz(DROPS, with_peaks([item / 1.01 for item in loads], moved)), "a.prjz")
    assert "a.prjz, database.json: peak load of the stored traces is +1.0 % off" in remarks(point)
    (point,) = read(prjz(DROPS, with_peaks(loads[:2], moved[:2])), "a.prjz")
    assert "peaks of 2 drops, 3 drops in the stored traces" in remarks(point)


def test_a_drifting_deflection_is_a_remark(read: Reader) -> None:
    drops = {"1F": [pulse(peak=8000.0), pulse(peak=9000.0)]}
    late = np.linspace(0, 9e-4, 300)
    for item in drops["1F"]:
        item.sensors[0, 200:] += late[200:] - late[200]
    database = acquired(drops)
    (entry,) = database["PVs"][0]["Points"]
    entry["Drops"] = [{"Fmax": 8000.0, "Umax": 1e-4}, {"Fmax": 9000.0, "Umax": 1.125e-4}]
    (point,) = read(prjz(drops, database), "a.prjz")
    assert "which are larger later: they drift" in remarks(point)
    assert " % off " not in remarks(point)


def test_equal_drops_are_a_remark(read: Reader) -> None:
    drops = {"1F": [pulse(), pulse(), pulse()]}
    (point,) = read(prjz(drops, acquired(drops)), "a.prjz")
    assert len(point.drops) == 3
    assert "of all 3 drops are the same, number for number" in remarks(point)
    (point,) = read(prjz(DROPS, acquired(DROPS)), "a.prjz")
    assert "number for number" not in remarks(point)


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

    def stored_as(load: float, moved: float) -> str:
        acquisition = acquired({"1": [item]})
        (entry,) = acquisition["PVs"]
        entry["PV"]["Name"] = "a & b"
        entry["Points"][0]["Drops"] = [{"Fmax": load, "Umax": moved}]
        members = {"database.xml": database, "database.json": json.dumps(acquisition).encode()}
        (point,) = read(zipped(members), "b.dynz")
        return remarks(point)

    assert "smoothed alike these agree within 0.5 %" in stored_as(load, moved)
    assert "peak load of the raw channels is" in stored_as(0.9 * load, moved)
    recorded = trace_peaks(plain.drops[0])
    assert "maker's software stored" not in stored_as(recorded.load, recorded.displacements[0][1])


def test_a_wrong_count_without_a_rate_is_a_remark(read: Reader) -> None:
    database = acquired(DROPS)
    database["ParamsAcqu"]["NbSamples"] = 600
    data = member(database, stored(DROPS["1F"], older=True))
    (point,) = read(data, "a.dynz")
    expected = "a.dynz, rawdata/1f: 300 samples without a sampling rate; 15000 Hz of the database"
    assert expected in remarks(point)
    (point,) = read(data, "a.dynz", "sampling_rate_hz = 7500.0")
    assert "without a sampling rate" not in remarks(point)


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
