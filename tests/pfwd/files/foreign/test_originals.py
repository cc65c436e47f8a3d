"""Files of other programs as these wrote them; they stay outside the project."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from inversion.notices import text_of
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from pfwd_device.signals import trace_peaks
from tests.records import known

Find = Callable[[str], Path]


@pytest.fixture
def original(shared: Path) -> Find:
    """Path of an original by its name."""

    def find(name: str) -> Path:
        imported = sorted((shared / "originals").glob(f"*/{name}"))
        if not imported:
            pytest.skip(f"no {name} among the originals")
        return imported[0]

    return find


def remarks_of(points: list[TracePoint]) -> list[str]:
    texts = [text_of(warning) for point in points for warning in point.warnings]
    return list(dict.fromkeys(texts))


RATE = "the traces state 15000 Hz and 750 samples, database.json states 30000 Hz and"


@pytest.mark.parametrize(
    ("name", "points", "drops", "remark", "reported"),
    [
        ("maxidyn-12-points.prjz", 12, 36, "peak load of", False),
        ("heavydyn-5-points.prjz", 5, 15, "peak load of", False),
        ("minidyn-two-points.dynz", 2, 12, "number for number", True),
        ("big-endian.dynz", 12, 36, "number for number", True),
        ("rate-disagrees.mpvz", 14, 42, RATE, True),
        ("old-viewer.mpvz", 14, 42, RATE, True),
    ],
)
def test_a_project_has_the_points_and_drops_of_its_maker(
    original: Find, name: str, points: int, drops: int, remark: str, reported: bool
) -> None:
    imported = read_points(original(name))
    assert (len(imported), sum(len(point.drops) for point in imported)) == (points, drops)
    # A report and a number, never the name of a member.
    names = [str(point.setup.point) for point in imported]
    assert all(re.fullmatch(r"(?!point )\S.* \d+", name) for name in names)
    assert all(drop.load.max() > 1000 for point in imported for drop in point.drops)
    assert any(remark in text for text in remarks_of(imported)) is reported
    if remark == RATE:
        assert imported[0].drops[0].sampling_rate == pytest.approx(15_000.0)


@pytest.mark.parametrize(
    ("name", "points", "drops", "sensors"),
    [
        ("heavydyn-peaks-only.mpvz", 26, 78, 11),
        ("dynatest-fwdwin.f25", 63, 252, 9),
        ("exported.F25", 52, 156, 11),
        ("exported-sweco.fwd", 52, 156, 11),
        ("exported.pdx", 52, 156, 11),
        ("exported-dynatest.fwd", 52, 156, 7),
    ],
)
def test_a_file_of_peaks_has_the_points_and_sensors_of_its_maker(
    original: Find, name: str, points: int, drops: int, sensors: int
) -> None:
    imported = read_points(original(name))
    assert {point.setup.plate_radius for point in imported} == {0.15}
    assert all(isinstance(point.setup.latitude, float) for point in imported)
    peaks = [known(drop.only_peaks) for point in imported for drop in point.drops]
    assert (len(imported), len(peaks)) == (points, drops)
    assert {len(drop.displacements) for drop in peaks} == {sensors}
    assert all(30e3 < drop.load < 100e3 for drop in peaks)


def test_four_exports_of_a_survey_agree(original: Find) -> None:
    names = ("exported.pdx", "exported.F25", "exported-sweco.fwd", "exported-dynatest.fwd")
    exact, *rounded = (
        [known(drop.only_peaks) for point in read_points(original(name)) for drop in point.drops]
        for name in names
    )
    for drops in rounded:
        for drop, exact_drop in zip(drops, exact, strict=True):
            # Whole kPa, and 0.1 kN.
            assert drop.load == pytest.approx(exact_drop.load, abs=52)
            right = dict(exact_drop.displacements)
            for offset, peak in drop.displacements:
                # 0.1 um, whole ones from 1 mm in F25; what is not positive is 0.1 in two.
                rounding = 0.11e-6 if right[offset] < 1e-3 else 0.51e-6
                assert peak == pytest.approx(right[offset], abs=rounding)


OFFSETS = [0.0, 0.203, 0.305, 0.457, 0.61, 0.914, 1.219, 1.524, -0.305]


def test_peaks_of_a_dat_agree_with_its_thy(original: Find, tmp_path: Path) -> None:
    header = tmp_path / "h.toml"
    header.write_text(f"plate_radius_m = 0.15\nsensor_offsets_m = {OFFSETS}\n")
    traced = read_points(original("stations-1-5.THY"), header)
    alone = read_points(original("stations-1-5.DAT"), header)
    for point, peaks_point in zip(traced, alone, strict=True):
        setup, peaks_setup = point.setup, peaks_point.setup
        assert setup.point == peaks_setup.point
        assert (setup.latitude, setup.longitude) == (peaks_setup.latitude, peaks_setup.longitude)
        assert [channel.offset for channel in point.drops[0].channels] == OFFSETS
        assert 15 < setup.extra["imported"]["surface_temperature_c"] < 30
        for drop, exact in zip(point.drops, peaks_point.drops, strict=True):
            # 0.01 kip, as SOURCES has it 0.004 at most
            assert float(drop.load.max()) == pytest.approx(known(exact.only_peaks).load, abs=25)
    different = "off that of the time history"
    differing = {p.setup.point for p in traced if different in " ".join(map(text_of, p.warnings))}
    assert differing == {"station 2 lane 1", "station 3 lane 1"}


@pytest.mark.parametrize(
    ("name", "off"),
    [("rig-no-plate.dynz", []), ("rig-unescaped.dynz", ["4s1p 1", "4s1p 2", "4s1p 3"])],
)
def test_a_rig_is_a_stiffness_test(original: Find, name: str, off: list[str]) -> None:
    """Three points of one file have peaks that are not those of their channels."""
    imported = read_points(original(name))
    assert len(imported) == 45
    assert all(point.setup.is_stiffness_test for point in imported)
    assert [imported[n].setup.point for n in (0, 15, 30)] == ["2s1p 1", "4s1p 1", "2s2p 1"]
    texts = remarks_of(imported)
    escaped = [text[:46] for text in texts if "not escaped" in text]
    assert escaped == (["rig-unescaped.dynz, database.xml, line 7: & is"] if off else [])
    assert any("smoothed alike these agree within 0.5 %" in text for text in texts)
    with_other_peaks = [p for p in imported if " % off " in " ".join(map(text_of, p.warnings))]
    assert [point.setup.point for point in with_other_peaks] == off
    peaks = [trace_peaks(point.drops[0]) for point in imported[:15]]
    stiffness = [drop.load / drop.displacements[0][1] for drop in peaks]
    np.testing.assert_allclose(stiffness, 24.8e6, rtol=0.05)
