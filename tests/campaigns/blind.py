"""Trace files of simulated drops for a blind test of the diagnosis.

A trace file is a text file with the samples of load and sensors, and a header with declared values.
Each file of a campaign has an effect that its header does not declare, such as a delayed sensor.

>>> cases = make_campaign(Path("campaign"), seed=1, cache=Path("cache"))  # doctest: +SKIP

writes ``campaign/traces/0001.csv`` and so on, in random order, and their true values to
``campaign/truth/truth.json``, which inversion and diagnosis must not read. `only` restricts the
campaign to some effects (keys of `effects.catalogue.EFFECTS`) and ``clean``:

>>> make_campaign(Path("few"), seed=1, per_case=2, only=("clean", "sensor_lag"))  # doctest: +SKIP

The ground is computed by finite elements. One run for each site and contact serves every drop on it
(see `effects.response`); the folder `cache` stores it. Equal seeds give equal files.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from simulators.mesh import ConstantQ, Growth, SoilProfile, require
from tests.campaigns.effects.catalogue import CLEAN, EFFECTS, SimulatedEffect
from tests.campaigns.effects.mechanics import soil_parameters
from tests.campaigns.effects.recording import Converter, write_signals
from tests.campaigns.effects.scene import Laboratory, Scene, SimulatedPoint

CLEAN_FRACTION = 0.2  # fraction of the files without an effect
DRAWN_LEVEL = -1  # level of a strength that is drawn at random
# Larger than any level, so that drawn strengths have random streams of their own.
_DRAWN_STREAM_OFFSET = 10_000
REFERENCE_RAD_S = 2 * math.pi * 30.0  # of constant-Q soil; about the frequency of the pulses
GROWTH_LIMIT_M = 5.0  # depth below which the modulus is constant
N_SURVEY_POINTS = 5
CALIBRATED = "2026-01-05"  # date of the calibration in all headers


@dataclass(frozen=True)
class Site:
    """Ground and plate of a finite-element run."""

    radius: float
    """Radius of the plate, m."""
    depth: float
    """Depth of the rigid base, m; infinite without base."""
    modulus: float
    """Young's modulus, Pa."""
    viscosity: float
    """Viscosity, Pa s."""
    poisson_ratio: float = 0.35
    """Poisson's ratio."""
    offsets: tuple[float, ...] = (0.0, 2.0, 4.0)
    """Distances of the sensors from the plate centre, in plate radii."""
    quality: float = math.inf
    """Q of constant-Q soil, whose modulus is that at `REFERENCE_RAD_S`; infinite: Kelvin-Voigt."""
    growth: float = 0.0
    """Plate radius over z0 of `Growth`; 0: none, otherwise the modulus is that of the surface."""
    exponent: float = 1.0
    """Exponent n of `Growth`."""

    @property
    def ground(self) -> SoilProfile:
        """Ground of the finite-element run, with a density of 1900 kg/m3."""
        uniform = SoilProfile.uniform(
            self.modulus, self.viscosity, 1900.0, self.poisson_ratio, self.depth
        )
        if self.growth > 0:
            growth = Growth(self.radius / self.growth, self.exponent, GROWTH_LIMIT_M)
            return replace(uniform, growth=growth)
        if self.quality < math.inf:
            return replace(uniform, damping_law=ConstantQ(self.quality, REFERENCE_RAD_S))
        return uniform


_WIDE_OFFSETS = (0.0, 3.0, 6.0)
SITES = (
    Site(0.10, 0.5, 35e6, 25e3),
    Site(0.10, 1.2, 60e6, 40e3, 0.4, _WIDE_OFFSETS),
    Site(0.10, math.inf, 25e6, 20e3),
    Site(0.15, 0.5, 40e6, 54e3),
    Site(0.15, 0.7, 90e6, 60e3),
    Site(0.15, 1.0, 30e6, 30e3),
    Site(0.15, 1.5, 60e6, 80e3, 0.4),
    Site(0.15, 2.0, 45e6, 54e3),
    Site(0.15, 3.0, 120e6, 60e3),
    Site(0.15, math.inf, 50e6, 60e3),
    Site(0.15, math.inf, 20e6, 30e3, 0.45),
    Site(0.20, 0.8, 25e6, 40e3, 0.3),
    Site(0.20, math.inf, 70e6, 90e3),
    Site(0.30, 0.8, 55e6, 80e3),
    Site(0.30, 1.5, 80e6, 120e3),
    Site(0.30, math.inf, 40e6, 100e3),
    Site(0.15, math.inf, 50e6, 0.0, quality=20.0),
    Site(0.10, 1.2, 35e6, 0.0, quality=20.0),
    Site(0.15, math.inf, 30e6, 0.0, 0.4, quality=10.0),
    Site(0.30, math.inf, 60e6, 0.0, quality=10.0),
    Site(0.15, 1.0, 45e6, 0.0, quality=5.0),
    Site(0.15, math.inf, 70e6, 0.0, quality=5.0),
    Site(0.15, math.inf, 40e6, 50e3, growth=0.1),
    Site(0.30, math.inf, 45e6, 80e3, growth=0.1, exponent=0.5),
    Site(0.15, math.inf, 25e6, 25e3, growth=0.4),
    Site(0.10, math.inf, 30e6, 25e3, 0.4, growth=0.4, exponent=0.5),
    Site(0.15, math.inf, 15e6, 15e3, growth=1.0, exponent=0.5),
    Site(0.10, math.inf, 12e6, 10e3, growth=1.0),
)
# Probability of each soil at a point of the campaign; clean points have Kelvin-Voigt soil.
SOIL_PROBABILITIES = {"kelvin-voigt": 0.7, "constant-q": 0.15, "growth": 0.15}
# Sites of effects whose strengths each need a finite-element run.
LAYER_SITES = (SITES[9], SITES[12])
HEIGHT_SITES, HEIGHTS = (SITES[3],), (0.6, 0.8)
# Slip under the plate depends on Poisson's ratio, so there is one site per ratio.
CONTACT_SITES = (
    Site(0.15, 1.0, 40e6, 54e3, 0.2),
    Site(0.15, 1.0, 40e6, 54e3, 0.35),
)


@dataclass(frozen=True)
class Case:
    """True values of one trace file."""

    file: str
    """Name within the folder of the traces."""
    effect: str
    """Name of the effect; `clean` without one."""
    key: str
    """Name of the effect with its variant."""
    level: int
    """Strength: 0 the weakest; -1 for clean and for strengths that were drawn."""
    strength: float
    parameters: dict[str, float | list[float]]
    """True values, SI units in the names."""
    modulus_pa: float | None
    """Modulus that a perfect diagnosis reports. For a modulus that grows with depth: that of the
    uniform ground with the same static stiffness. Constant-Q soil: the absolute modulus at
    1/(2 T0) of the load."""
    bedrock_depth_m: float | None
    """True depth of the rigid base, m; None without rock."""
    radius_m: float
    drops: int
    """Number of drops."""
    sensors: int
    """Number of sensors."""
    quantity: str
    """Quantity of the sensors, `velocity` or `displacement`."""
    noise: float
    """Root mean square over the peak of each channel."""
    device: str | None
    """Key shared by the files of a survey."""
    group: str = "known"
    """Group of the effect, see `SimulatedEffect.group`."""
    soil: str = "kelvin-voigt"
    """Soil, see `Ground.soil`."""
    soil_parameters: dict[str, float | list[float]] = field(default_factory=dict)
    """Parameters of growth and damping law, SI units in the names."""


@dataclass(frozen=True)
class _Plan:
    """Effect, strength and random streams of one trace file."""

    effect: SimulatedEffect
    level: int
    strength: float
    stream: tuple[int, ...]
    device: str | None = None
    device_stream: tuple[int, ...] = (0,)


def make_campaign(
    folder: Path,
    *,
    seed: int,
    per_case: int = 8,
    cache: Path | None = None,
    only: Iterable[str] | None = None,
    levels: Sequence[int] | None = None,
    noise: float | None = None,
    curve: int | None = None,
    drawn: bool = False,
) -> list[Case]:
    """Write the trace files of a campaign and, in another folder, the true values.

    Parameters
    ----------
    folder : Path
        Folder in which the folders `traces` and `truth` are made.
    seed : int
        Seed of all random numbers.
    per_case : int
        Smallest number of drops for each effect and strength.
    cache : Path, optional
        Folder for finite-element responses, which all campaigns share.
    only : iterable of str, optional
        Keys of `EFFECTS`, of which `clean` is one; None: all.
    levels : sequence of int, optional
        Strengths from 0, the weakest, to 2; None: all.
    noise : float, optional
        Root mean square of the noise over the peak; None: drawn at random.
    curve : int, optional
        Number of strengths from the weakest to the strongest, where the effect allows it (see
        `SimulatedEffect.curve`). None: three, and surveys of several points of one device.
    drawn : bool
        True: draw the strength of every point at random.

    Returns
    -------
    list of Case
        True values of each file.

    Raises
    ------
    GroundError
        If a key is unknown, or `folder` contains other traces.
    """
    keys = set(EFFECTS if only is None else only)
    require(keys <= set(EFFECTS), "only", f"some of {', '.join(EFFECTS)}", keys)
    laboratory = Laboratory(cache)
    traces, truth = folder / "traces", folder / "truth"
    traces.mkdir(parents=True, exist_ok=True)
    if (truth / "truth.json").is_file():
        for case in read_truth(folder):
            (traces / case.file).unlink(missing_ok=True)
    strange = sorted(path.name for path in traces.iterdir())
    require(not strange, "folder", "only traces of a former campaign", strange[:3])
    truth.mkdir(parents=True, exist_ok=True)
    plans = list(_plans(seed, keys, per_case, levels, curve, drawn))
    order = np.random.default_rng([seed, 1]).permutation(len(plans))
    cases = [
        _make(plans[index], traces / f"{number:04d}.csv", laboratory, noise)
        for number, index in enumerate(order, start=1)
    ]
    text = json.dumps({"seed": seed, "cases": [asdict(case) for case in cases]}, indent=1)
    (truth / "truth.json").write_text(text + "\n", encoding="utf-8")
    return cases


def read_truth(folder: Path) -> list[Case]:
    """Return the true values of each file of a campaign that `make_campaign` wrote."""
    text = (folder / "truth" / "truth.json").read_text(encoding="utf-8")
    return [Case(**case) for case in json.loads(text)["cases"]]


def _plans(
    seed: int,
    keys: set[str],
    per_case: int,
    levels: Sequence[int] | None,
    curve: int | None,
    drawn: bool,
) -> Iterable[_Plan]:
    files = 0
    for key in sorted(keys - {CLEAN}):
        effect, code = EFFECTS[key], _number(key)
        strengths = effect.strengths if curve is None else effect.curve(curve)
        if drawn:
            levels = (DRAWN_LEVEL,)
        for level in range(len(strengths)) if levels is None else levels:
            drops, count = 0, 0
            while drops < per_case:
                stream = (seed, code, level % _DRAWN_STREAM_OFFSET, count)
                drops += _drop_count(effect, np.random.default_rng([*stream, 7]))
                count += 1
                strength = strengths[level]
                if drawn:
                    strength = effect.drawn(np.random.default_rng([*stream, 11]))
                yield _Plan(effect, level, strength, stream)
            surveyed = effect.scope == "device" and effect.is_in_vocabulary and curve is None
            if surveyed and level > 0 and per_case >= 4:
                device_stream = (seed, code, level, 10_000)
                name = f"unit-{np.random.default_rng(device_stream).integers(16**6):06x}"
                for point in range(N_SURVEY_POINTS):
                    point_stream = (*device_stream, point)
                    yield _Plan(effect, level, strength, point_stream, name, device_stream)
                count += N_SURVEY_POINTS
            files += count
    if CLEAN in keys:
        clean = max(
            math.ceil(files * CLEAN_FRACTION / (1 - CLEAN_FRACTION)), math.ceil(per_case / 2)
        )
        for count in range(clean):
            yield _Plan(EFFECTS[CLEAN], DRAWN_LEVEL, 0.0, (seed, _number(CLEAN), 0, count))


def _number(key: str) -> int:
    return int.from_bytes(hashlib.sha256(key.encode()).digest()[:4], "big")


def _drop_count(effect: SimulatedEffect, generator: np.random.Generator) -> int:
    return max(effect.min_drops, int(generator.choice([1, 1, 2, 3])))


def _site(plan: _Plan, generator: np.random.Generator) -> Site:
    effect = plan.effect
    choice = list(SITES)
    if effect.sites == "few":
        choice = list(LAYER_SITES if effect.name == "layer" else HEIGHT_SITES)
    if effect.sites == "contact":
        choice = list(CONTACT_SITES)
    if effect.sites == "shallow":  # the strength is the depth over the radius, roughly
        choice = [s for s in SITES if 0.6 < s.depth / s.radius / plan.strength <= 1.7]
    if effect.sites == "constant-q":
        choice = [s for s in SITES if s.quality == plan.strength]
    if effect.sites == "growth":
        choice = [s for s in SITES if s.growth == plan.strength]
    if effect.sites == "kelvin-voigt":
        choice = [s for s in SITES if s.ground.soil == "kelvin-voigt"]
    return _draw_site(choice, generator)


def _draw_site(sites: Sequence[Site], generator: np.random.Generator) -> Site:
    """Draw a kind of soil with `SOIL_PROBABILITIES`, then one of the sites with this soil."""
    soils = [site.ground.soil for site in sites]
    chances = np.array([SOIL_PROBABILITIES[soil] / soils.count(soil) for soil in soils])
    return sites[int(generator.choice(len(sites), p=chances / np.sum(chances)))]


def _scene(plan: _Plan, laboratory: Laboratory) -> tuple[Scene, Site]:
    generator = np.random.default_rng(plan.stream)
    count = _drop_count(plan.effect, np.random.default_rng([*plan.stream, 7]))
    # properties of a device are drawn from its own stream, so that all of its points share them
    device = np.random.default_rng(plan.device_stream if plan.device else (*plan.stream, 3))
    site = _site(plan, generator)
    if plan.device is not None:
        same_layout = [
            s for s in SITES if s.offsets != _WIDE_OFFSETS
        ]  # a device has one layout of sensors
        radius = float(device.choice(sorted({s.radius for s in same_layout})))
        candidates = [s for s in same_layout if s.radius == radius]
        site = _draw_site(candidates, generator)
    sensors = int(device.choice([1, 1, 2, 3]))
    size = site.radius / 0.15
    plate_mass, hammer_mass = device.uniform([9.0, 7.0], [18.0, 14.0]) * size
    pulse = float(np.exp(device.uniform(math.log(0.008), math.log(0.024))))
    lower = generator.uniform(0.55, 0.95, count - 1)
    if plan.effect.variant:  # each height needs a finite-element run
        lower = generator.choice(HEIGHTS, count - 1, replace=False)
    heights = [*sorted(lower), 1.0]
    scene = Scene(
        laboratory,
        site.ground,
        site.radius,
        tuple(round(offset * site.radius, 4) for offset in site.offsets),
        plate_mass=round(float(plate_mass), 2),
        hammer_mass=float(hammer_mass),
        hammer_pulse=pulse,
        pressure=float(generator.uniform(50e3, 200e3)),
        heights=tuple(float(height) for height in heights),
        sensors=max(sensors, plan.effect.min_sensors),
        generator=generator,
        device=device,
        pre_trigger=float(device.choice([0.01, 0.015, 0.02])),
        time_scale=float(generator.uniform(0.92, 1.1)),
        density_scale=float(generator.uniform(0.85, 1.12)),
    )
    return scene, site


def _make(plan: _Plan, path: Path, laboratory: Laboratory, noise: float | None) -> Case:
    scene, site = _scene(plan, laboratory)
    effect, generator = plan.effect, scene.generator
    converter = Converter.drawn(generator, scene.device, noise)
    outcome = effect.build(scene, plan.strength)
    depth = scene.ground.bedrock_depth if effect.name != "layer" else math.inf
    header = _header(scene, site, outcome, depth, plan, generator)
    offsets = scene.offsets[: len(outcome.signals[0].velocity)]
    write_signals(path, outcome.signals, offsets, header, converter, generator)
    return Case(
        file=path.name,
        effect=effect.name,
        key=effect.key,
        level=plan.level,
        strength=plan.strength,
        parameters=dict(outcome.parameters),
        modulus_pa=outcome.modulus,
        bedrock_depth_m=depth if math.isfinite(depth) else None,
        radius_m=scene.radius,
        drops=len(outcome.signals),
        sensors=len(offsets),
        quantity=converter.quantity,
        noise=converter.noise,
        device=plan.device,
        group=effect.group,
        soil=scene.ground.soil,
        soil_parameters=soil_parameters(scene.ground),
    )


def _header(
    scene: Scene,
    site: Site,
    outcome: SimulatedPoint,
    depth: float,
    plan: _Plan,
    generator: np.random.Generator,
) -> dict[str, str | float | int]:
    """Return the header with the true values, except for the value that the effect falsifies."""
    header: dict[str, str | float | int] = {
        "pfwd-traces": 1,
        "plate_radius_m": scene.radius,
        "plate_mass_kg": scene.plate_mass,
        "poisson_ratio": site.poisson_ratio,
        "calibrated": CALIBRATED,
    }
    declared = depth if outcome.declared_depth is None else outcome.declared_depth
    # a half-space need not be declared, as the base model assumes it
    if math.isfinite(declared) or generator.random() < 0.5:
        header["bedrock_depth_m"] = declared
    if plan.device is not None:
        header["device"] = plan.device
    return header
