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

Reader = Callable[..., list[TracePoint]]


@pytest.fixture
def original(shared: Path) -> Callable[[str], Path]:
    """Path of an original by its name."""

    def find(name: str) -> Path:
        imported = sorted((shared / "originals").glob(f"*/{name}"))
        if not imported:
            pytest.skip(f"no {name} among the originals")
        return imported[0]

    return find


DIFFERENT_LOADS = "peak load of"
EQUAL_DROPS = "number for number"
DIFFERENT_RATE = (
    "{name}: the traces state 15000 Hz and 750 samples, database.json states 30000 Hz and"
)


def remarks_of(points: list[TracePoint]) -> list[str]:
    texts = [text_of(warning) for point in points for warning in point.warnings]
    return list(dict.fromkeys(texts))


@pytest.mark.parametrize(
    ("name", "points", "drops", "remark", "reported"),
    [
        ("maxidyn-12-points.prjz", 12, 36, DIFFERENT_LOADS, False),
        ("heavydyn-5-points.prjz", 5, 15, DIFFERENT_LOADS, False),
        ("minidyn-two-points.dynz", 2, 12, EQUAL_DROPS, True),
        ("big-endian.dynz", 12, 36, EQUAL_DROPS, True),
        ("rate-disagrees.mpvz", 14, 42, DIFFERENT_RATE, True),
        ("old-viewer.mpvz", 14, 42, DIFFERENT_RATE, True),
    ],
)
def test_points_and_drops_by_the_makers_names(
    original: Callable[[str], Path],
    name: str,
    points: int,
    drops: int,
    remark: str,
    reported: bool,
) -> None:
    imported = read_points(original(name))
    assert len(imported) == points
    assert sum(len(point.drops) for point in imported) == drops
    # A report and a number, never the name of a member.
    names = [str(point.setup.point) for point in imported]
    assert all(re.fullmatch(r"\S.* \d+", name) for name in names)
    assert not any(name.startswith("point ") for name in names)
    assert names[0].endswith(" 1")
    if name == "heavydyn-5-points.prjz":
        offsets = [-0.3, -0.2, 0.0, 0.2, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.1]
        assert [channel.offset for channel in imported[0].drops[0].channels] == offsets
    assert all(drop.load.max() > 1000 for point in imported for drop in point.drops)
    assert any(remark.format(name=name) in text for text in remarks_of(imported)) is reported
    if remark == DIFFERENT_RATE:
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
def test_peaks_without_traces(
    original: Callable[[str], Path], name: str, points: int, drops: int, sensors: int
) -> None:
    imported = read_points(original(name))
    assert len(imported) == points
    assert sum(len(point.drops) for point in imported) == drops
    for point in imported:
        assert point.setup.plate_radius == 0.15
        assert isinstance(point.setup.latitude, float)
        for drop in point.drops:
            assert drop.only_peaks is not None
            assert len(drop.only_peaks.displacements) == sensors
            assert 30e3 < drop.only_peaks.load < 100e3


def test_four_exports_of_a_survey_agree(original: Callable[[str], Path]) -> None:
    names = ("exported.pdx", "exported.F25", "exported-sweco.fwd", "exported-dynatest.fwd")
    exact, *rounded = (read_points(original(name)) for name in names)
    for points in rounded:
        for point, exact_point in zip(points, exact, strict=True):
            for drop, exact_drop in zip(point.drops, exact_point.drops, strict=True):
                assert drop.only_peaks is not None
                assert exact_drop.only_peaks is not None
                # Whole kPa, and 0.1 kN.
                assert drop.only_peaks.load == pytest.approx(exact_drop.only_peaks.load, abs=52)
                right = dict(exact_drop.only_peaks.displacements)
                for offset, peak in drop.only_peaks.displacements:
                    # 0.1 um, whole ones from 1 mm in F25; what is not positive is 0.1 in two.
                    rounding = 0.11e-6 if right[offset] < 1e-3 else 0.51e-6
                    assert peak == pytest.approx(right[offset], abs=rounding)


OFFSETS = [0.0, 0.203, 0.305, 0.457, 0.61, 0.914, 1.219, 1.524, -0.305]


def test_peaks_of_a_dat_agree_with_its_thy(original: Callable[[str], Path], tmp_path: Path) -> None:
    header = tmp_path / "h.toml"
    header.write_text(f"plate_radius_m = 0.15\nsensor_offsets_m = {OFFSETS}\n")
    traced = read_points(original("stations-1-5.THY"), header)
    alone = read_points(original("stations-1-5.DAT"), header)
    assert [p.setup.point for p in traced] == [p.setup.point for p in alone]
    for point, peaks_point in zip(traced, alone, strict=True):
        assert isinstance(point.setup.latitude, float)
        assert [channel.offset for channel in point.drops[0].channels] == OFFSETS
        assert (point.setup.latitude, point.setup.longitude) == (
            peaks_point.setup.latitude,
            peaks_point.setup.longitude,
        )
        noted = point.setup.extra["imported"]
        assert noted["note"]
        assert 15 < noted["surface_temperature_c"] < 30
        for drop, exact_drop in zip(point.drops, peaks_point.drops, strict=True):
            # 0.01 kip, as SOURCES has it 0.004 at most
            assert float(drop.load.max()) == pytest.approx(
                known(exact_drop.only_peaks).load, abs=25
            )
    differing = {
        str(point.setup.point)
        for point in traced
        if any("off that of the time history" in text_of(text) for text in point.warnings)
    }
    assert differing == {"station 2 lane 1", "station 3 lane 1"}


@pytest.mark.parametrize("name", ["rig-no-plate.dynz", "rig-unescaped.dynz"])
def test_a_rig_is_a_stiffness_test(original: Callable[[str], Path], name: str) -> None:
    imported = read_points(original(name))
    assert len(imported) == 45
    assert all(point.setup.is_stiffness_test for point in imported)
    assert [imported[n].setup.point for n in (0, 15, 30)] == ["2s1p 1", "4s1p 1", "2s2p 1"]
    escaped = [text for text in remarks_of(imported) if "not escaped" in text]
    assert bool(escaped) == (name == "rig-unescaped.dynz")
    if escaped:
        assert escaped[0].startswith("rig-unescaped.dynz, database.xml, line 7: &")
    texts = remarks_of(imported)
    assert any("smoothed alike these agree within 0.5 %" in text for text in texts)
    # Three points of the one file have peaks that are not of their channels.
    off = [
        p.setup.point for p in imported if any(" % off " in text_of(text) for text in p.warnings)
    ]
    assert off == ([] if name == "rig-no-plate.dynz" else ["4s1p 1", "4s1p 2", "4s1p 3"])
    stiffness = []
    for point in imported:
        peaks = trace_peaks(point.drops[0])
        stiffness.append(peaks.load / peaks.displacements[0][1])
    np.testing.assert_allclose(stiffness[:15], 24.8e6, rtol=0.05)
