"""Files of other programs as these wrote them; they stay outside the project."""

from collections.abc import Callable
from pathlib import Path

import pytest

from pfwd_survey.files.reading import read_points
from pfwd_survey.files.traces import TracePoint

Reader = Callable[..., list[TracePoint]]


@pytest.fixture
def original(shared: Path) -> Callable[[str], Path]:
    """Path of an original by its name."""

    def find(name: str) -> Path:
        found = sorted((shared / "originals").glob(f"*/{name}"))
        if not found:
            pytest.skip(f"no {name} among the originals")
        return found[0]

    return find


def said(points: list[TracePoint]) -> list[str]:
    texts = [text for point in points for text in point.warnings]
    return list(dict.fromkeys(texts))


@pytest.mark.parametrize(
    ("name", "points", "drops", "first"),
    [
        ("maxidyn-12-points.prjz", 12, 36, "2022-01-21 1"),
        ("heavydyn-5-points.prjz", 5, 15, "PV01 1"),
        ("minidyn-two-points.dynz", 2, 12, "pv1 1"),
        ("big-endian.dynz", 12, 36, "ccrn 1"),
        ("rate-disagrees.mpvz", 14, 42, "PV1 1"),
        ("old-viewer.mpvz", 14, 42, "PV1 1"),
    ],
)
def test_points_and_drops_by_the_makers_names(
    original: Callable[[str], Path], name: str, points: int, drops: int, first: str
) -> None:
    found = read_points(original(name))
    assert len(found) == points
    assert sum(len(point.drops) for point in found) == drops
    assert found[0].setup.point == first
    assert all(drop.load.max() > 1000 for point in found for drop in point.drops)


def test_sensors_on_both_sides_are_kept(original: Callable[[str], Path]) -> None:
    found = read_points(original("heavydyn-5-points.prjz"))
    offsets = [-0.3, -0.2, 0.0, 0.2, 0.3, 0.6, 0.9, 1.2, 1.5, 1.8, 2.1]
    assert [c.offset for c in found[0].drops[0].channels] == pytest.approx(offsets)
    assert found[0].setup.plate_radius == 0.15
    assert not any("left out" in text for text in said(found))


@pytest.mark.parametrize("name", ["rate-disagrees.mpvz", "old-viewer.mpvz"])
def test_a_rate_that_disagrees(original: Callable[[str], Path], name: str) -> None:
    found = read_points(original(name))
    assert found[0].drops[0].sampling_rate == pytest.approx(15_000.0)
    text = "rawdata/128: 15000 Hz and 750 samples, in database.json 30000 Hz and 1500 samples"
    assert any(text in one for one in said(found))


@pytest.mark.parametrize("name", ["maxidyn-12-points.prjz", "heavydyn-5-points.prjz"])
def test_loads_are_those_that_the_program_stored(
    original: Callable[[str], Path], name: str
) -> None:
    texts = said(read_points(original(name)))
    assert not any("peak load of" in text for text in texts)


@pytest.mark.parametrize("name", ["minidyn-two-points.dynz", "big-endian.dynz"])
def test_drops_that_are_one_are_said(original: Callable[[str], Path], name: str) -> None:
    assert any("number for number" in text for text in said(read_points(original(name))))
