"""Refusal of drops in wrong units."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

import pfwd
from pfwd.errors import TraceError
from pfwd.files.header import PointSetup
from pfwd.files.plausible_units import refuse_wrong_units
from pfwd_device import Drop
from pfwd_device.drop import Peaks

SETUP = PointSetup(plate_radius=0.15)
RIG = PointSetup(plate_radius=0.0, rig_stiffness=2e6)


def in_units(drop: Drop, time: float, load: float, values: float) -> Drop:
    """Return a drop whose numbers are in other units, by their factors."""
    channels = (dataclasses.replace(c, values=values * c.values) for c in drop.channels)
    return dataclasses.replace(
        drop, time=time * drop.time, load=load * drop.load, channels=tuple(channels)
    )


WRONG = [
    ("time in ms", (1e3, 1.0, 1.0), "a load pulse of 0.05 to 1000 ms, got 1.79e.04 ms"),
    ("time in us", (1e6, 1.0, 1.0), "a load pulse"),
    ("load in kN", (1.0, 1e-3, 1.0), "over peak deflection of 0.1 to 5000 MN/m, got 0.016 MN/m"),
    ("load a thousandfold", (1.0, 1e3, 1.0), "a peak load of at most 500 kN, got 8e.03 kN"),
    ("deflection in mm", (1.0, 1.0, 1e3), "a peak deflection of at most 20 mm, got"),
    ("deflection in um", (1.0, 1.0, 1e6), "a peak deflection"),
    ("deflection a thousandth", (1.0, 1.0, 1e-3), "5000 MN/m, got 1.6e.04 MN/m"),
]


@pytest.mark.parametrize(("factors", "message"), [w[1:] for w in WRONG], ids=[w[0] for w in WRONG])
@pytest.mark.parametrize("quantity", ["displacement", "velocity"])
def test_arrays_in_wrong_units_are_refused_with_a_question(
    quantity: str,
    factors: tuple[float, float, float],
    message: str,
    make_drop: Callable[..., Drop],
) -> None:
    right = make_drop(quantity=quantity)
    wrong = in_units(right, *factors)
    question = rf"{message}.*; is the time in s, the load in N, and are the values in m(/s)?\?"
    with pytest.raises(TraceError, match=rf"^arrays: expected .*{question}"):
        made(wrong, quantity)
    made(right, quantity)


def made(drop: Drop, quantity: str) -> pfwd.Drop:
    values = drop.channels[0].values
    return pfwd.drop(drop.time, drop.load, values, plate_radius=0.15, quantity=quantity)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("load", "deflection", "duration"),
    [
        (1.2e3, 9e-3, 0.03),  # a light device on mud
        (7.07e3, 0.3e-3, 0.017),
        (150e3, 0.08e-3, 0.03),  # a heavy one on concrete
        (300e3, 1.5e-3, 0.06),
    ],
)
def test_light_and_heavy_devices_are_not_refused(
    load: float, deflection: float, duration: float, make_drop: Callable[..., Drop]
) -> None:
    drop = make_drop(peak=load, duration=duration, window=0.2)
    drop = in_units(drop, 1.0, 1.0, deflection / float(np.max(drop.channels[0].values)))
    refuse_wrong_units([drop], SETUP, "arrays", "")


def test_a_unit_is_that_of_every_drop(make_drop: Callable[..., Drop]) -> None:
    right = make_drop()
    wrong = in_units(right, 1.0, 1.0, 1e3)
    refuse_wrong_units([wrong, right], SETUP, "a.csv", "")
    with pytest.raises(TraceError, match="peak deflection"):
        refuse_wrong_units([wrong, wrong], SETUP, "a.csv", "")


def test_drops_without_pulse_or_ground_are_not_compared(make_drop: Callable[..., Drop]) -> None:
    right = make_drop()
    refuse_wrong_units([in_units(right, 1.0, 1.0, 1e-6)], RIG, "rig.csv", "")
    refuse_wrong_units([in_units(right, 1.0, 0.0, 1.0)], SETUP, "arrays", "")
    refuse_wrong_units([Drop.of_peaks(1, Peaks(8e6, ((0.0, 0.5),)))], SETUP, "arrays", "")
