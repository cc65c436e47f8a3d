"""Wrong declarations have a warning, are covered by the interval, or are documented.

The drop is computed by finite elements, which share nothing with the model of the inversion.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.notices import Notice
from pfwd.analysis.analyse import analyse_point
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropResult
from pfwd.files.header import PointSetup, setup_warnings
from pfwd.files.traces import TracePoint
from pfwd_device import Channel, Drop
from simulators.drop import DropSimulator, Hammer
from simulators.mesh import Plate, SoilProfile
from simulators.traces import Geophone, Recording, record_drop
from tests.records import known

GEOPHONE_NOT_DECLARED = Notice("geophone-not-declared")

DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "validation.md"
SECTION = "## What one record cannot show"

MODULUS, VISCOSITY, DENSITY, POISSON_RATIO = 45e6, 54e3, 1900.0, 0.35
PLATE = Plate(radius=0.15, mass=15.0)
HAMMER = Hammer(mass=10.0, stiffness=5.6e5, velocity=4.2)
GEOPHONE = Geophone(natural_frequency=4.5, damping=0.6)
SOUND = PointSetup(
    plate_radius=PLATE.radius,
    plate_mass=PLATE.mass,
    poisson_ratio=POISSON_RATIO,
    geophone_natural_frequency=GEOPHONE.natural_frequency,
    geophone_damping=GEOPHONE.damping,
)
TAIL = "tail-not-explained"


def recorded(rock_depth: float = math.inf) -> Drop:
    """A drop with noise of 0.1 % of the largest load and velocity, as its geophone records it."""
    ground = SoilProfile.uniform(MODULUS, VISCOSITY, DENSITY, POISSON_RATIO, rock_depth)
    simulator = DropSimulator(ground, PLATE, (0.0,), 0.06, 2e-4, HAMMER.pulse_duration)
    drop = simulator.run(HAMMER)
    recording = Recording(
        pre_trigger=0.02,
        load_noise=1e-3 * float(drop.load.max()),
        sensor_noise=1e-3 * float(np.abs(drop.plate_velocity).max()),
        geophone=GEOPHONE,
    )
    record = record_drop(drop, recording, np.random.default_rng(0))
    return Drop(1, record.time, record.load, (Channel(0.0, "velocity", record.sensors[0]),))


@pytest.fixture(scope="module")
def library() -> SurrogateLibrary:
    return SurrogateLibrary()


@pytest.fixture(scope="module")
def on_rock() -> Drop:
    return recorded(1.2)


@pytest.fixture(scope="module")
def half_space() -> Drop:
    return recorded()


def inverted(drop: Drop, setup: PointSetup, library: SurrogateLibrary) -> DropResult:
    point = TracePoint("drop.csv", setup, (drop,), setup_warnings(setup, (drop,)))
    (analysis,) = analyse_point(point, AnalysisOptions(method="posterior"), library)
    return drop_result(point.file, analysis, point.warnings)


Change = Callable[[Drop], Drop]
UNDECLARED = replace(SOUND, geophone_natural_frequency=None, geophone_damping=None)
# Setup as declared, change of the record by the fault, code of a warning on shallow rock, and name
# in the document where ground without rock shows nothing.
CASES: dict[str, tuple[PointSetup, Change, str, str]] = {
    "geophone not declared": (UNDECLARED, lambda drop: drop, "geophone-not-declared", ""),
    "1 Hz in place of 4.5 Hz": (
        replace(SOUND, geophone_natural_frequency=1.0), lambda drop: drop, TAIL, "",
    ),
    "time axis halved": (
        SOUND, lambda drop: replace(drop, time=0.5 * drop.time), "time-axis-suspect", "",
    ),
    "radius halved": (
        replace(SOUND, plate_radius=0.075), lambda drop: drop, TAIL, "Plate radius",
    ),
    "load gain of 2": (
        SOUND, lambda drop: replace(drop, load=2.0 * drop.load), TAIL, "Load gain",
    ),
}  # fmt: skip


def holds_truth(result: DropResult) -> bool:
    low, high = known(result.modulus_interval_pa)
    return low <= MODULUS <= high


def test_a_sound_drop_is_not_warned_of(on_rock: Drop, library: SurrogateLibrary) -> None:
    result = inverted(on_rock, SOUND, library)
    assert result.warnings == ()
    assert holds_truth(result)


@pytest.mark.parametrize("ground", ["on_rock", pytest.param("half_space", marks=pytest.mark.slow)])
def test_an_undeclared_mass_is_estimated(
    ground: str, library: SurrogateLibrary, request: pytest.FixtureRequest
) -> None:
    undeclared = replace(SOUND, plate_mass=0.0)
    result = inverted(request.getfixturevalue(ground), undeclared, library)
    assert known(result.warnings)[0].code == "plate-mass-too-small"
    assert holds_truth(result)
    assert result.modulus_pa == pytest.approx(MODULUS, rel=0.01)
    assert result.added_mass_kg == pytest.approx(SOUND.plate_mass, rel=0.1)


@pytest.mark.parametrize("case", CASES)
def test_a_wrong_modulus_has_a_warning(case: str, on_rock: Drop, library: SurrogateLibrary) -> None:
    setup, change, code, _ = CASES[case]
    result = inverted(change(on_rock), setup, library)
    assert not holds_truth(result)  # else the case tests nothing
    assert code in [warning.code for warning in result.warnings or ()]


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_without_rock_it_has_a_warning_or_is_documented(
    case: str, half_space: Drop, library: SurrogateLibrary
) -> None:
    setup, change, _, documented = CASES[case]
    result = inverted(change(half_space), setup, library)
    if not result.warnings and not holds_truth(result):
        section = DOCUMENT.read_text(encoding="utf-8").split(SECTION)[1].split("\n## ")[0]
        assert documented
        assert f"| {documented} " in section


@pytest.mark.parametrize(
    ("damping", "frequency", "warned"), [(None, None, True), (0.6, 4.5, False), (None, 0.0, False)]
)
@pytest.mark.parametrize("quantity", ["velocity", "displacement"])
def test_velocities_alone_need_a_declared_response(
    quantity: str,
    damping: float | None,
    frequency: float | None,
    warned: bool,
    make_drop: Callable[..., Drop],
) -> None:
    setup = replace(SOUND, geophone_natural_frequency=frequency, geophone_damping=damping)
    drops = [make_drop(number=number, quantity=quantity) for number in (1, 2)]
    expected = (GEOPHONE_NOT_DECLARED,) if warned and quantity == "velocity" else ()
    assert setup_warnings(setup, drops) == expected


def test_a_velocity_is_corrected_once(
    make_drop: Callable[..., Drop], library: SurrogateLibrary
) -> None:
    drop = make_drop(pre_trigger=0.02, quantity="velocity")
    corrected = replace(SOUND, geophone_natural_frequency=0.0, geophone_damping=None)
    first, second = (inverted(drop, setup, library) for setup in (corrected, UNDECLARED))
    assert first.modulus_pa == second.modulus_pa
    assert first.deflection_corrected_m == second.deflection_corrected_m
    assert GEOPHONE_NOT_DECLARED not in (first.warnings or ())
    assert GEOPHONE_NOT_DECLARED in (second.warnings or ())


@pytest.mark.parametrize(
    ("mass", "radius", "warned"),
    [(0.0, 0.15, True), (0.5, 0.15, True), (1.5, 0.15, False), (0.5, 0.075, False)],
)
def test_a_plate_lighter_than_any_is_warned_of(mass: float, radius: float, warned: bool) -> None:
    warnings = setup_warnings(replace(SOUND, plate_mass=mass, plate_radius=radius))
    assert [warning.code for warning in warnings] == ["plate-mass-too-small"] * warned
