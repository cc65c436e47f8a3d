"""Moduli and indices of peaks against hand calculations."""

from math import pi

import pytest

from pfwd.peaks.basin import basin_of, implausible_offsets
from pfwd_device.drop import Peaks

MIL = 2.54e-5


def halfspace(modulus: float, offsets: list[float], radius: float = 0.15) -> Peaks:
    """Rigid plate in the centre, point load outside; Poisson's ratio 0.35."""
    load = 50e3
    part = (1 - 0.35**2) * load / modulus
    peaks = [part / (2 * radius) if r == 0 else part / (pi * abs(r)) for r in offsets]
    return Peaks(load, tuple(zip(offsets, peaks, strict=True)))


def test_a_half_space_has_the_same_modulus_everywhere() -> None:
    basin = basin_of(halfspace(80e6, [0.0, 0.3, 0.6, 0.9, 1.5]), 0.15, 0.35)
    assert basin.peak_modulus_pa == pytest.approx(80e6)
    assert list(basin.surface_moduli_pa) == [0.3, 0.6, 0.9, 1.5]
    assert list(basin.surface_moduli_pa.values()) == pytest.approx([80e6] * 4)
    assert basin.rejected_offsets_m == ()


def test_indices_by_hand() -> None:
    """AREA of Hoffman and Thompson: 6 (1 + 2 12/20 + 2 8/20 + 5/20) = 19.5 in."""
    inches = [0.0, 0.3048, 0.6096, 0.9144]
    peaks = Peaks(40e3, tuple(zip(inches, [20 * MIL, 12 * MIL, 8 * MIL, 5 * MIL], strict=True)))
    basin = basin_of(peaks, 0.15, 0.35)
    assert basin.sci_m == pytest.approx(8 * MIL)
    assert basin.bdi_m == pytest.approx(4 * MIL)
    assert basin.bci_m == pytest.approx(3 * MIL)
    assert basin.area_m == pytest.approx(19.5 * 0.0254)


def test_an_index_is_missing_without_its_sensor() -> None:
    basin = basin_of(halfspace(80e6, [0.0, 0.2, 0.45]), 0.15, 0.35)
    assert (basin.sci_m, basin.bdi_m, basin.bci_m, basin.area_m) == (None,) * 4
    assert list(basin.surface_moduli_pa) == [0.45]
    alone = basin_of(Peaks(7e3, ((0.0, 5e-4),)), 0.15, 0.35)
    assert alone.peak_modulus_pa is not None
    assert basin_of(Peaks(7e3, ((0.3, 5e-4),)), 0.15, 0.35).peak_modulus_pa is None


@pytest.mark.parametrize(
    ("pairs", "expected"),
    [
        ([(0.0, 10.0), (0.3, 5.0), (0.6, 2.0)], ()),
        ([(0.0, 10.0), (0.3, 0.0), (0.6, 2.0)], (0.3,)),
        ([(0.0, 10.0), (0.3, 5.0), (0.6, -2.0)], (0.6,)),
        # It stood still between two that moved.
        ([(0.0, 148.0), (-0.2, 0.1), (-0.3, 72.0)], (-0.2,)),
        # They drift: each moves more than one nearer to the plate.
        ([(0.0, 5.8), (0.3, 4.9), (0.6, 4.2), (0.9, 30.2), (1.2, 99.9)], (0.9, 1.2)),
        # One side says nothing of the other.
        ([(0.0, 10.0), (0.3, 5.0), (-0.3, 8.0), (-0.6, 4.0)], ()),
        ([(0.0, 10.0), (0.3, 10.9)], ()),
        ([(0.0, 10.0), (0.3, 11.1)], (0.3,)),
    ],
)
def test_sensors_that_no_basin_has(
    pairs: list[tuple[float, float]], expected: tuple[float, ...]
) -> None:
    assert implausible_offsets(Peaks(50e3, tuple(pairs))) == expected


def test_bad_sensors_take_no_part() -> None:
    peaks = Peaks(50e3, ((0.0, 1e-3), (0.3, 4e-4), (0.6, 5e-4), (0.9, 1e-4)))
    basin = basin_of(peaks, 0.15, 0.35)
    assert basin.rejected_offsets_m == (0.6,)
    assert basin.sci_m == pytest.approx(6e-4)
    assert (basin.bdi_m, basin.bci_m, basin.area_m) == (None, None, None)
    assert list(basin.surface_moduli_pa) == [0.3, 0.9]
