"""What is declared wrongly is warned of, covered by the interval, or documented as not visible.

The drop is computed by finite elements, which share nothing with the model of the inversion.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from inversion import SurrogateLibrary
from inversion.notices import Notice, text_of
from pfwd.analysis.analyse import analyse_point
from pfwd.analysis.drop_result import drop_result
from pfwd.analysis.options import AnalysisOptions
from pfwd.analysis.results import DropResult
from pfwd.files.header import PointSetup, setup_warnings
from pfwd.files.traces import TracePoint
from pfwd_device import Channel, Drop
from simulators.drop import DropSimulator, Hammer, SimulatedDrop
from simulators.mesh import Plate, SoilProfile
from simulators.traces import Geophone, Recording, record_drop

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
TAIL = "record after the contact unexplained"


def _simulated(rock_depth: float | None) -> SimulatedDrop:
    ground = SoilProfile.uniform(MODULUS, VISCOSITY, DENSITY, POISSON_RATIO, rock_depth or math.inf)
    simulator = DropSimulator(ground, PLATE, (0.0,), 0.06, 2e-4, HAMMER.pulse_duration)
    return simulator.run(HAMMER)


def _recorded(drop: SimulatedDrop) -> Drop:
    """The drop with noise of 0.1 % of the largest load and velocity, as its geophone reads it."""
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
    return _recorded(_simulated(1.2))


@pytest.fixture(scope="module")
def half_space() -> Drop:
    return _recorded(_simulated(None))


def inverted(drop: Drop, setup: PointSetup, library: SurrogateLibrary) -> DropResult:
    point = TracePoint("drop.csv", setup, (drop,), setup_warnings(setup, (drop,)))
    (analysis,) = analyse_point(point, AnalysisOptions(method="posterior"), library)
    return drop_result(point.file, analysis, point.warnings)


@dataclass(frozen=True)
class Case:
    """One thing that is declared wrongly.

    Parameters
    ----------
    name : str
    setup : PointSetup, as declared
    warning : str, with which one of the warnings on shallow rock begins
    documented : str, what the document calls it, where ground without rock shows nothing
    recorded : callable, what the fault makes of the record
    """

    name: str
    setup: PointSetup
    warning: str
    documented: str = ""
    recorded: Callable[[Drop], Drop] = lambda drop: drop

    def __str__(self) -> str:
        return self.name


CASES = (
    Case(
        "geophone not declared",
        replace(SOUND, geophone_natural_frequency=None, geophone_damping=None),
        text_of(GEOPHONE_NOT_DECLARED),
    ),
    Case("1 Hz in place of 4.5 Hz", replace(SOUND, geophone_natural_frequency=1.0), TAIL),
    Case(
        "time axis halved",
        SOUND,
        "time axis suspect: the pulse lasts 6.7 ms",
        recorded=lambda drop: replace(drop, time=0.5 * drop.time),
    ),
    Case("radius halved", replace(SOUND, plate_radius=0.075), TAIL, "Plate radius"),
    Case(
        "load gain of 2",
        SOUND,
        TAIL,
        "Load gain",
        recorded=lambda drop: replace(drop, load=2.0 * drop.load),
    ),
)


def holds_truth(result: DropResult) -> bool:
    assert result.modulus_interval_pa is not None
    low, high = result.modulus_interval_pa
    return low is not None and high is not None and low <= MODULUS <= high


def test_a_sound_drop_is_not_warned_of(on_rock: Drop, library: SurrogateLibrary) -> None:
    result = inverted(on_rock, SOUND, library)
    assert result.warnings == ()
    assert holds_truth(result)


@pytest.mark.parametrize("ground", ["on_rock", "half_space"])
def test_an_undeclared_mass_is_found(
    ground: str, library: SurrogateLibrary, request: pytest.FixtureRequest
) -> None:
    undeclared = replace(SOUND, plate_mass=0.0)
    result = inverted(request.getfixturevalue(ground), undeclared, library)
    assert result.warnings is not None
    assert text_of(result.warnings[0]).startswith("plate_mass_kg = 0 is less than")
    assert holds_truth(result)
    assert result.modulus_pa == pytest.approx(MODULUS, rel=0.01)
    assert result.added_mass_kg == pytest.approx(SOUND.plate_mass, rel=0.1)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_wrong_modulus_has_a_warning(
    case: Case, on_rock: Drop, library: SurrogateLibrary
) -> None:
    result = inverted(case.recorded(on_rock), case.setup, library)
    assert not holds_truth(result)  # else the case tests nothing
    assert any(text_of(text).startswith(case.warning) for text in result.warnings or ())


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=str)
def test_without_rock_it_has_a_warning_or_is_documented(
    case: Case, half_space: Drop, library: SurrogateLibrary
) -> None:
    result = inverted(case.recorded(half_space), case.setup, library)
    if not result.warnings and not holds_truth(result):
        section = DOCUMENT.read_text(encoding="utf-8").split(SECTION)[1].split("\n## ")[0]
        assert case.documented
        assert f"| {case.documented} " in section


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


def test_a_corrected_velocity_is_read_as_it_is(
    half_sine_drop: Drop, library: SurrogateLibrary
) -> None:
    corrected = replace(SOUND, geophone_natural_frequency=0.0, geophone_damping=None)
    silent = replace(SOUND, geophone_natural_frequency=None, geophone_damping=None)
    one, other = (inverted(half_sine_drop, setup, library) for setup in (corrected, silent))
    assert one.modulus_pa == other.modulus_pa
    assert one.deflection_corrected_m == other.deflection_corrected_m
    assert GEOPHONE_NOT_DECLARED not in (one.warnings or ())
    assert GEOPHONE_NOT_DECLARED in (other.warnings or ())


@pytest.fixture
def half_sine_drop(make_drop: Callable[..., Drop]) -> Drop:
    drop = make_drop(pre_trigger=0.02)
    (channel,) = drop.channels
    velocity: NDArray[np.float64] = np.gradient(channel.values, drop.time)
    return replace(drop, channels=(Channel(0.0, "velocity", velocity),))


@pytest.mark.parametrize(
    ("mass", "radius", "warned"),
    [(0.0, 0.15, True), (0.5, 0.15, True), (1.5, 0.15, False), (0.5, 0.075, False)],
)
def test_a_plate_lighter_than_any_is_warned_of(mass: float, radius: float, warned: bool) -> None:
    found = setup_warnings(replace(SOUND, plate_mass=mass, plate_radius=radius))
    assert [text_of(text).split(" is less")[0] for text in found] == (
        [f"plate_mass_kg = {mass:g}"] if warned else []
    )
