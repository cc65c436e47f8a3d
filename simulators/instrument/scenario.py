"""What is simulated: soil, hammer, instrument, drops, link and faults, read from TOML.

A scenario never travels over the wire; the instrument only tells what a real one would. Every key
has its default here; docs/simulator.md lists them.
"""

from __future__ import annotations

import datetime
import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, ClassVar

from pfwd_device.errors import SetupError
from pfwd_device.identity import ChannelIdentity, Identity, Role
from simulators.drop import STANDARD_GRAVITY
from simulators.instrument.checks import (
    ANY,
    AT_LEAST_0,
    FRACTION,
    POSITIVE,
    POSITIVE_OR_INFINITE,
    ScenarioError,
    about,
    below,
    key,
    merged,
    one_of,
    read_table,
)
from simulators.instrument.language import LANGUAGES
from simulators.mesh import Ground, GroundError, Layer, Plate

FOLDER = files("simulators").joinpath("scenarios")


@dataclass(frozen=True)
class Soil:
    """The ground under the plate."""

    modulus: float = key(45e6, POSITIVE, "Young's modulus, Pa")
    viscosity: float = key(54e3, AT_LEAST_0, "Kelvin-Voigt viscosity, Pa s")
    density: float = key(1900.0, POSITIVE, "kg/m3")
    poisson_ratio: float = key(0.35, below(0.5), "0 to below 0.5")
    bedrock_depth: float = key(1.2, POSITIVE_OR_INFINITE, "depth of a rigid base, m; `inf`: none")
    crust_modulus: float | None = key(None, POSITIVE, "modulus of a layer on top, Pa; else none")
    crust_thickness: float = key(0.2, POSITIVE, "thickness of that layer, m")
    scatter: float = key(
        0.0, FRACTION, "standard deviation of the logarithm of modulus and viscosity between seeds"
    )

    def ground(self, factor: float = 1.0) -> Ground:
        """The ground with every modulus times `factor`."""
        base = Layer(
            factor * self.modulus, self.viscosity, self.density, self.poisson_ratio, math.inf
        )
        layers = [base]
        if self.crust_modulus is not None:
            crust = Layer(
                factor * self.crust_modulus,
                self.viscosity,
                self.density,
                self.poisson_ratio,
                self.crust_thickness,
            )
            layers = [crust, base]
        if math.isinf(self.bedrock_depth):
            return Ground(tuple(layers), "none")
        rest = self.bedrock_depth - sum(layer.thickness for layer in layers[:-1])
        layers[-1] = Layer(
            base.modulus, base.viscosity, base.density, base.poisson_ratio, thickness=rest
        )
        return Ground(tuple(layers), "rigid")


@dataclass(frozen=True)
class HammerSettings:
    """The falling weight and its spring."""

    mass: float = key(10.0, POSITIVE, "kg")
    stiffness: float = key(5.6e5, POSITIVE, "of the spring, N/m")
    drop_height: float = key(0.9, POSITIVE, "m")

    @property
    def velocity(self) -> float:
        """At the first touch, m/s."""
        return math.sqrt(2 * STANDARD_GRAVITY * self.drop_height)


@dataclass(frozen=True)
class ChannelSettings:
    """One channel: what the instrument says of it, and what it does beyond that."""

    name: str = key("", ANY, "up to 32 characters, sent")
    role: str = key(
        "geophone",
        one_of(*(role.value for role in Role)),
        "what it measures, sent: one of the roles",
    )
    offset: float = key(
        0.0, ANY, "from the plate centre, m, negative on the other side of the plate, sent"
    )
    sensitivity: float = key(1.0, ANY, "V per N, V per m/s or V per m, sent")
    zero: float = key(0.0, ANY, "volts at rest, sent")
    natural_frequency: float | None = key(
        None, POSITIVE, "of the geophone, Hz, sent; else no response is simulated"
    )
    damping: float | None = key(None, POSITIVE, "of the geophone, sent")
    shunt: float | None = key(None, POSITIVE, "what the calibration shunt simulates, N, sent")
    calibrated: datetime.date | None = field(
        default=None, metadata=about(ANY, "day of the calibration, sent")
    )
    due: datetime.date | None = field(
        default=None, metadata=about(ANY, "day on which it expires, sent")
    )
    rest: float = key(0.0, ANY, "reading at rest beyond `zero`, SI unit of the role")
    noise: float = key(0.0, AT_LEAST_0, "white noise, root mean square, SI unit of the role")
    hum: float = key(0.0, AT_LEAST_0, "amplitude of the mains hum, SI unit of the role")
    drift: float = key(0.0, AT_LEAST_0, "amplitude of the slow wander, SI unit of the role")

    def identity(self) -> ChannelIdentity:
        """What is sent."""
        return ChannelIdentity(
            name=self.name,
            role=Role(self.role),
            offset=self.offset,
            sensitivity=self.sensitivity,
            zero=self.zero,
            natural_frequency=self.natural_frequency,
            damping=self.damping,
            shunt=self.shunt,
            calibrated=self.calibrated,
            due=self.due,
        )


@dataclass(frozen=True)
class DeviceSettings:
    """The instrument."""

    serial_number: str = key("PFWD-0042", ANY, "up to 32 characters, sent")
    model: str = key("Simulated PFWD", ANY, "up to 32 characters, sent")
    firmware: str = key("1.0.0", ANY, "up to 32 characters, sent")
    sampling_rate: float = key(10e3, POSITIVE, "after switching on, Hz, sent")
    sampling_rates: tuple[float, ...] = key(
        (1e3, 2e3, 5e3, 10e3, 20e3, 50e3), POSITIVE, "what it can be configured to, Hz"
    )
    adc_bits: int = key(18, one_of(*range(8, 25)), "8 to 24, sent")
    adc_range: float = key(5.0, POSITIVE, "volts at full scale, sent")
    plate_radius: float = key(0.15, POSITIVE, "m, sent")
    plate_mass: float = key(10.6, AT_LEAST_0, "kg, sent")
    plate_declared: bool = key(True, ANY, "whether radius and mass are sent at all")
    centre_sensor: str = key("plate", one_of("plate", "ground"), "sent")
    hum_frequency: float = key(50.0, POSITIVE, "of the mains, Hz")
    battery: float = key(7.4, AT_LEAST_0, "V, sent")
    temperature: float = key(21.5, ANY, "degrees Celsius, sent")
    clock_start_us: int = key(0, AT_LEAST_0, "clock when it is switched on, microseconds")
    clock_drift_ppm: float = key(0.0, ANY, "how much faster the clock runs than the samples")
    message: str = key("", ANY, "text of its events, sent")
    channels: tuple[ChannelSettings, ...] = key(
        (
            ChannelSettings("load", "load", sensitivity=4e-4, noise=4.0, rest=12.0, shunt=5000.0),
            ChannelSettings(
                "centre", sensitivity=28.8, natural_frequency=4.5, damping=0.6, noise=4e-5
            ),
        ),
        ANY,
        "tables of their own, see below",
        table=ChannelSettings,
    )

    def identity(self, sampling_rate: float) -> Identity:
        """What is sent when it is configured so."""
        declared = self.plate_declared
        return Identity(
            serial_number=self.serial_number,
            model=self.model,
            firmware=self.firmware,
            sampling_rate=sampling_rate,
            adc_bits=self.adc_bits,
            adc_range=self.adc_range,
            channels=tuple(channel.identity() for channel in self.channels),
            plate_radius=self.plate_radius if declared else None,
            plate_mass=self.plate_mass if declared else None,
            centre_sensor="ground" if self.centre_sensor == "ground" else "plate",
        )

    @property
    def plate(self) -> Plate:
        """For the finite elements."""
        return Plate(self.plate_radius, self.plate_mass)


@dataclass(frozen=True)
class DropSettings:
    """When the hammer falls, and how it differs from drop to drop."""

    first: float = key(3.0, POSITIVE, "first touch after START, s")
    interval: float = key(5.0, POSITIVE, "between drops, s")
    jitter: float = key(0.05, AT_LEAST_0, "largest deviation from that, s")
    height_scatter: float = key(0.02, FRACTION, "standard deviation of the load between drops")
    seating: tuple[float, ...] = key(
        (0.85, 0.94), POSITIVE, "factors of the modulus under the first drops of a point"
    )
    drops_per_point: int = key(0, AT_LEAST_0, "after so many drops the next point; 0: never")
    bounces: tuple[int, ...] = key((2, 4), AT_LEAST_0, "fewest and most rebounds of the hammer")
    bounce_interval: tuple[float, ...] = key((0.25, 0.5), POSITIVE, "between rebounds, s, range")
    bounce_ratio: tuple[float, ...] = key(
        (0.3, 0.5), FRACTION, "load over that of the impact before, range"
    )
    knock_probability: float = key(0.0, FRACTION, "of a knock between two drops")
    knock_load: float = key(400.0, POSITIVE, "peak of a knock, N")
    quiet: float = key(3.0, AT_LEAST_0, "streamed after the last rebound of the last drop, s")


@dataclass(frozen=True)
class LinkSettings:
    """How the instrument talks, and how badly the cable carries it."""

    dialect: str = key(
        "pfwd", one_of(*LANGUAGES), "language, by the name that a setup file has for it"
    )
    block_samples: int = key(0, AT_LEAST_0, "samples in a block; 0: 5 ms, as far as they fit")
    buffer: float = key(1.0, POSITIVE, "output the instrument can hold before it overruns, s")
    bit_error_rate: float = key(0.0, FRACTION, "bytes with a flipped bit, fraction")
    lost_rate: float = key(0.0, FRACTION, "frames that never arrive, fraction")
    repeated_rate: float = key(0.0, FRACTION, "frames that arrive twice, fraction")
    reordered_rate: float = key(0.0, FRACTION, "frames that arrive after their follower, fraction")
    garbage_at_start: int = key(0, AT_LEAST_0, "random bytes before the first frame")
    ring: float = key(0.0, AT_LEAST_0, "so many of the last samples can be asked for again, s")
    kept_drops: int = key(0, AT_LEAST_0, "drops that wait until they are acknowledged; 0: none")
    kept_seconds: float = key(0.4, POSITIVE, "length of the longest drop that is kept, s")
    streams: bool = key(True, ANY, "whether samples can be sent as they are taken")


_EARLIER_DIALECTS = {"binary": "pfwd"}
"""Names that scenarios of earlier versions have for dialects."""


_EFFECTS: dict[str, tuple[str, ...]] = {
    "gain": ("factor",),
    "tilted": ("angle",),
    "reversed": (),
    "dead": (),
    "delay": ("seconds",),
    "ringing": ("frequency", "damping"),
}


@dataclass(frozen=True)
class ChannelEffect:
    """What one channel does that its calibration does not tell."""

    KEYS: ClassVar = _EFFECTS
    """Of each kind: the keys it takes besides `kind` and `channel`."""

    kind: str = key("", one_of(*_EFFECTS), "one of the effects below")
    channel: str = key("", ANY, "name of the channel")
    factor: float = key(1.0, ANY, "gain: true sensitivity over the declared one")
    angle: float = key(0.0, ANY, "tilted: from the vertical, radians")
    seconds: float = key(0.0, AT_LEAST_0, "delay: how much later the channel is")
    frequency: float = key(180.0, POSITIVE, "ringing: of the sensor on its loose seat, Hz")
    damping: float = key(0.05, POSITIVE, "ringing: damping ratio of the same")


_FAULTS: dict[str, tuple[str, ...]] = {
    "lost": ("count",),
    "repeated": ("count",),
    "reordered": ("count",),
    "bit-errors": ("count",),
    "garbage": ("count",),
    "overrun": ("count",),
    "stall": ("seconds",),
    "clock-jump": ("seconds",),
    "reset": (),
    "unplug": ("seconds", "powered"),
    "knock": ("load",),
    "trigger": (),
    "low-battery": (),
}


@dataclass(frozen=True)
class Fault:
    """Something that happens once, at a given time."""

    KEYS: ClassVar = _FAULTS
    """Of each kind: the keys it takes besides `kind` and `at_s`."""

    kind: str = key("", one_of(*_FAULTS), "one of the faults below")
    at_s: float = key(0.0, AT_LEAST_0, "seconds of sampling since the first START")
    count: int = key(1, POSITIVE, "frames, bits, bytes or samples, see below")
    seconds: float = key(1.0, ANY, "stall, unplug: how long; clock-jump: how far, s")
    powered: bool = key(False, ANY, "unplug: the instrument goes on sampling meanwhile")
    load: float = key(400.0, POSITIVE, "knock: peak, N")


@dataclass(frozen=True)
class Scenario:
    """Everything that is simulated."""

    base: str = key("", ANY, "name of a built-in scenario whose keys hold where these are silent")
    soil: Soil = field(default=Soil(), metadata=about(ANY, "table", Soil))
    hammer: HammerSettings = field(
        default=HammerSettings(), metadata=about(ANY, "table", HammerSettings)
    )
    device: DeviceSettings = field(
        default=DeviceSettings(), metadata=about(ANY, "table", DeviceSettings)
    )
    drops: DropSettings = field(default=DropSettings(), metadata=about(ANY, "table", DropSettings))
    link: LinkSettings = field(default=LinkSettings(), metadata=about(ANY, "table", LinkSettings))
    effects: tuple[ChannelEffect, ...] = field(
        default=(), metadata=about(ANY, "array of tables", ChannelEffect)
    )
    faults: tuple[Fault, ...] = field(default=(), metadata=about(ANY, "array of tables", Fault))
    name: str = field(default="", metadata={"hidden": True})

    def faults_of(self, *kinds: str) -> tuple[Fault, ...]:
        """Those of these kinds, in order of time."""
        chosen = [fault for fault in self.faults if fault.kind in kinds]
        return tuple(sorted(chosen, key=lambda fault: fault.at_s))


def builtin_scenarios() -> list[str]:
    """Names of the scenarios that come with the program."""
    names = (entry.name for entry in FOLDER.iterdir())
    return sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml"))


def load_scenario(source: str | Path | Mapping[str, Any]) -> Scenario:
    """The scenario of a built-in name, of a TOML file, or of tables as TOML would give them.

    Raises
    ------
    ScenarioError
        If there is none of this name, or a key is unknown or holds what it cannot; the message
        names the key.
    """
    if isinstance(source, Mapping):
        return scenario_from(source, "scenario")
    names = builtin_scenarios()
    if isinstance(source, str) and source in names:
        return scenario_from(_builtin_tables(source), source)
    path = Path(source)
    if not path.is_file():
        known = ", ".join(names)
        raise ScenarioError(f"scenario {source}: expected a file or one of {known}")
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as err:
        raise ScenarioError(f"scenario {source}: expected a TOML file, got {err}") from err
    return scenario_from(tables, str(source))


def scenario_from(tables: Mapping[str, Any], name: str) -> Scenario:
    """The scenario that TOML tables describe; see `load_scenario`."""
    base = tables.get("base", "")
    if base:
        if base not in builtin_scenarios():
            raise ScenarioError(f"{name}: base: expected a built-in scenario, got {base!r}")
        tables = merged(_builtin_tables(base), tables)
    tables = _with_present_names(tables)
    scenario: Scenario = read_table(Scenario, {**tables, "name": name}, name, "")
    _check(scenario)
    return scenario


def _with_present_names(tables: Mapping[str, Any]) -> Mapping[str, Any]:
    """The tables with the names of today for those of earlier versions."""
    link = tables.get("link")
    if isinstance(link, Mapping) and isinstance(dialect := link.get("dialect"), str):
        link = {**link, "dialect": _EARLIER_DIALECTS.get(dialect, dialect)}
        return {**tables, "link": link}
    return tables


def _builtin_tables(name: str) -> Mapping[str, Any]:
    tables = tomllib.loads(FOLDER.joinpath(f"{name}.toml").read_text(encoding="utf-8"))
    base = tables.get("base", "")
    return merged(_builtin_tables(base), tables) if base else tables


def _check(scenario: Scenario) -> None:
    """What two keys have to agree on."""

    def require(holds: bool, where: str, expected: str) -> None:
        if not holds:
            raise ScenarioError(f"{scenario.name}: {where}: expected {expected}")

    device, drops, soil = scenario.device, scenario.drops, scenario.soil
    try:
        soil.ground()
    except GroundError as err:
        raise ScenarioError(f"{scenario.name}: soil: {err}") from err
    try:
        device.identity(device.sampling_rate)
    except SetupError as err:
        raise ScenarioError(f"{scenario.name}: device: {err}") from err
    fits = device.sampling_rate in device.sampling_rates
    require(fits, "device.sampling_rate", "one of device.sampling_rates")
    link = scenario.link
    require(link.streams or link.kept_drops > 0, "link.streams", "true, or kept_drops > 0")
    fits = link.kept_drops == 0 or link.ring == 0 or link.ring > link.kept_seconds
    require(fits, "link.ring", "0 or longer than kept_seconds")
    names = [channel.name for channel in device.channels]
    require(len(set(names)) == len(names), "device.channels", "names that differ")
    for pair in ("bounces", "bounce_interval", "bounce_ratio"):
        values = getattr(drops, pair)
        good = len(values) == 2 and values[0] <= values[1]
        require(good, f"drops.{pair}", "two numbers, the smaller first")
    require(drops.jitter < min(drops.interval / 2, drops.first), "drops.jitter", "a shorter time")
    for number, effect in enumerate(scenario.effects, start=1):
        known = effect.channel in names
        require(known, f"effects[{number}].channel", f"one of {', '.join(names)}")
