"""Scenario: the description of a simulated instrument, read from TOML.

It consists of soil, hammer, instrument, drops, link and faults. The instrument sends to the host
only values that a real one would send, and never its scenario. Every key has a default; see
docs/simulator.md.
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

from pfwd_device.errors import SetupError, refusal
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_device.schema import (
    JSON_SCHEMA,
    Array,
    Choice,
    Date,
    Flag,
    Integer,
    Number,
    TableReader,
    Text,
    declared,
    describe,
    keys_of,
    table_of,
    table_schema,
)
from pfwd_plugins.quantities import QUANTITY_BY_ROLE
from simulators.drop import STANDARD_GRAVITY
from simulators.instrument.language import LANGUAGES
from simulators.mesh import GroundError, Plate, SimulationError, SoilLayer, SoilProfile


class ScenarioError(SimulationError, ValueError):
    """A scenario has an unknown key or an invalid value; the message names the key."""


_POSITIVE = Number(above=0)
_NOT_NEGATIVE = Number(minimum=0)
_FRACTION = Number(minimum=0, maximum=1)

FOLDER = files("simulators").joinpath("scenarios")


@dataclass(frozen=True)
class Soil:
    """Settings of the ground under the plate."""

    modulus: float = declared(45e6, _POSITIVE, "Young's modulus, Pa")
    viscosity: float = declared(54e3, _NOT_NEGATIVE, "Kelvin-Voigt viscosity, Pa s")
    density: float = declared(1900.0, _POSITIVE, "kg/m3")
    poisson_ratio: float = declared(0.35, Number(minimum=0, below=0.5), "0 to below 0.5")
    bedrock_depth: float = declared(
        1.2, Number(above=0, infinity_means="none"), "depth of a rigid base, m; `inf`: none"
    )
    crust_modulus: float | None = declared(
        None, _POSITIVE, "modulus of a layer on top, Pa; else none"
    )
    crust_thickness: float = declared(0.2, _POSITIVE, "thickness of that layer, m")
    scatter: float = declared(
        0.0, _FRACTION, "standard deviation of the logarithm of modulus and viscosity between seeds"
    )

    def ground(self, factor: float = 1.0) -> SoilProfile:
        """Return the ground for the finite elements, with every modulus multiplied by a factor."""
        base = SoilLayer(
            factor * self.modulus, self.viscosity, self.density, self.poisson_ratio, math.inf
        )
        layers = [base]
        if self.crust_modulus is not None:
            crust = SoilLayer(
                factor * self.crust_modulus,
                self.viscosity,
                self.density,
                self.poisson_ratio,
                self.crust_thickness,
            )
            layers = [crust, base]
        if math.isinf(self.bedrock_depth):
            return SoilProfile(tuple(layers), "none")
        rest = self.bedrock_depth - sum(layer.thickness for layer in layers[:-1])
        layers[-1] = SoilLayer(
            base.modulus, base.viscosity, base.density, base.poisson_ratio, thickness=rest
        )
        return SoilProfile(tuple(layers), "rigid")


@dataclass(frozen=True)
class HammerSettings:
    """Settings of the falling weight and its spring."""

    mass: float = declared(10.0, _POSITIVE, "kg")
    stiffness: float = declared(5.6e5, _POSITIVE, "of the spring, N/m")
    drop_height: float = declared(0.9, _POSITIVE, "m")
    damping: float = declared(
        0.0, _NOT_NEGATIVE, "of the spring; above 0 rebounds follow from the momentum of the hammer"
    )
    friction: float = declared(0.0, Number(minimum=0, below=0.5), "of the guide over the weight")

    @property
    def velocity(self) -> float:
        """Velocity of the falling weight when it hits the spring, m/s."""
        return math.sqrt(2 * STANDARD_GRAVITY * self.drop_height * (1 - self.friction))


@dataclass(frozen=True)
class ChannelSettings:
    """Settings of a channel: its declared properties and its undeclared errors."""

    name: str = declared("", Text(), "up to 32 characters, sent")
    role: str = declared(
        "geophone", Choice(QUANTITY_BY_ROLE), "measured quantity, sent: one of the roles"
    )
    offset: float = declared(
        0.0, Number(), "from the plate centre, m, negative on the other side of the plate, sent"
    )
    sensitivity: float = declared(1.0, Number(), "V per N, V per m/s or V per m, sent")
    zero: float = declared(0.0, Number(), "volts at rest, sent")
    natural_frequency: float | None = declared(
        None, _POSITIVE, "of the geophone, Hz, sent; else no response is simulated"
    )
    damping: float | None = declared(None, _POSITIVE, "of the geophone, sent")
    shunt: float | None = declared(
        None, _POSITIVE, "force that the calibration shunt simulates, N, sent"
    )
    calibrated: datetime.date | None = declared(
        None, Date(text=True), "day of the calibration, sent"
    )
    due: datetime.date | None = declared(None, Date(text=True), "day on which it expires, sent")
    rest: float = declared(0.0, Number(), "reading at rest beyond `zero`, SI unit of the role")
    noise: float = declared(
        0.0, _NOT_NEGATIVE, "white noise, root mean square, SI unit of the role"
    )
    hum: float = declared(0.0, _NOT_NEGATIVE, "amplitude of the mains hum, SI unit of the role")
    drift: float = declared(0.0, _NOT_NEGATIVE, "amplitude of the slow wander, SI unit of the role")

    def identity(self) -> ChannelIdentity:
        """Return the properties of the channel that the instrument reports to the host."""
        return ChannelIdentity(
            name=self.name,
            quantity=QUANTITY_BY_ROLE[self.role],
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
    """Settings of the instrument and its channels."""

    serial_number: str = declared("PFWD-0042", Text(), "up to 32 characters, sent")
    model: str = declared("Simulated PFWD", Text(), "up to 32 characters, sent")
    firmware: str = declared("1.0.0", Text(), "up to 32 characters, sent")
    sampling_rate: float = declared(10e3, _POSITIVE, "after switching on, Hz, sent")
    sampling_rates: tuple[float, ...] = declared(
        (1e3, 2e3, 5e3, 10e3, 20e3, 50e3), Array(_POSITIVE), "rates that can be configured, Hz"
    )
    adc_bits: int = declared(18, Integer(8, 24), "8 to 24, sent")
    adc_range: float = declared(5.0, _POSITIVE, "volts at full scale, sent")
    plate_radius: float = declared(0.15, _POSITIVE, "m, sent")
    plate_mass: float = declared(10.6, _NOT_NEGATIVE, "kg, sent")
    plate_declared: bool = declared(True, Flag(), "true: radius and mass are sent")
    centre_sensor: str = declared("plate", Choice(("plate", "ground")), "sent")
    hum_frequency: float = declared(50.0, _POSITIVE, "of the mains, Hz")
    battery: float = declared(7.4, _NOT_NEGATIVE, "V, sent")
    temperature: float = declared(21.5, Number(), "degrees Celsius, sent")
    clock_start_us: int = declared(0, Integer(0), "clock when it is switched on, microseconds")
    clock_drift_ppm: float = declared(0.0, Number(), "excess speed of the clock over the sampling")
    message: str = declared("", Text(), "text of its events, sent")
    random_streams: bool = declared(True, Flag(), "false: numbered from 1 after each power-on")
    channels: tuple[ChannelSettings, ...] = declared(
        (
            ChannelSettings("load", "load", sensitivity=4e-4, noise=4.0, rest=12.0, shunt=5000.0),
            ChannelSettings(
                "centre", sensitivity=28.8, natural_frequency=4.5, damping=0.6, noise=4e-5
            ),
        ),
        Array(table_of(ChannelSettings)),
        "tables, see below",
    )

    def identity(self, sampling_rate: float) -> Identity:
        """Return the identity that the instrument reports at a sampling rate (Hz)."""
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
        """Load plate for the finite elements."""
        return Plate(self.plate_radius, self.plate_mass)


@dataclass(frozen=True)
class DropSettings:
    """Settings of the times of the drops and of the differences between drops."""

    first: float = declared(3.0, _POSITIVE, "time from the start of sampling to the first touch, s")
    interval: float = declared(5.0, _POSITIVE, "time between drops, s")
    jitter: float = declared(0.05, _NOT_NEGATIVE, "largest deviation from the interval, s")
    height_scatter: float = declared(
        0.02, _FRACTION, "standard deviation of the load between drops"
    )
    seating: tuple[float, ...] = declared(
        (0.85, 0.94), Array(_POSITIVE), "factors of the modulus under the first drops of a point"
    )
    drops_per_point: int = declared(
        0, Integer(0), "number of drops after which the next point begins; 0: never"
    )
    bounces: tuple[int, ...] = declared(
        (2, 4), Array(Integer(0)), "smallest and largest number of rebounds of the hammer"
    )
    bounce_interval: tuple[float, ...] = declared(
        (0.25, 0.5), Array(_POSITIVE), "time between rebounds, s, range"
    )
    bounce_ratio: tuple[float, ...] = declared(
        (0.3, 0.5), Array(_FRACTION), "load over that of the impact before, range"
    )
    knock_probability: float = declared(0.0, _FRACTION, "probability of a knock between two drops")
    knock_load: float = declared(400.0, _POSITIVE, "peak of a knock, N")
    quiet: float = declared(
        3.0, _NOT_NEGATIVE, "time sampled after the last rebound of the last drop, s"
    )


@dataclass(frozen=True)
class LinkSettings:
    """Settings of the protocol, the memory of the instrument and the faults of the cable."""

    dialect: str = declared("pfwd", Choice(LANGUAGES), "protocol, by its name in setup files")
    block_samples: int = declared(0, Integer(0), "samples in a block; 0: 5 ms, as far as they fit")
    buffer: float = declared(
        1.0, _POSITIVE, "time of samples that can wait to be sent, s; more are lost (overrun)"
    )
    bit_error_rate: float = declared(0.0, _FRACTION, "bytes with a flipped bit, fraction")
    lost_rate: float = declared(0.0, _FRACTION, "frames that never arrive, fraction")
    repeated_rate: float = declared(0.0, _FRACTION, "frames that arrive twice, fraction")
    reordered_rate: float = declared(
        0.0, _FRACTION, "frames that arrive after the next one, fraction"
    )
    garbage_at_start: int = declared(0, Integer(0), "random bytes before the first frame")
    ring: float = declared(
        0.0, _NOT_NEGATIVE, "time of the latest samples that can be requested again, s"
    )
    kept_drops: int = declared(
        0, Integer(0), "largest number of drops stored until they are acknowledged; 0: none"
    )
    kept_seconds: float = declared(
        0.4, _POSITIVE, "length of the longest drop that can be stored, s"
    )
    streams: bool = declared(True, Flag(), "true: samples can be sent continuously")


_KEYS_BY_EFFECT: dict[str, tuple[str, ...]] = {
    "gain": ("factor",),
    "tilted": ("angle",),
    "reversed": (),
    "dead": (),
    "delay": ("seconds",),
    "ringing": ("frequency", "damping"),
}


@dataclass(frozen=True)
class ChannelEffect:
    """Undeclared fault of one channel, such as a wrong gain or a delay."""

    KEYS: ClassVar = _KEYS_BY_EFFECT
    """Keys of each kind besides `kind` and `channel`."""

    kind: str = field(metadata=describe(Choice(_KEYS_BY_EFFECT), "one of the effects below"))
    channel: str = declared("", Text(), "name of the channel")
    factor: float = declared(1.0, Number(), "gain: true sensitivity over the declared one")
    angle: float = declared(0.0, Number(), "tilted: from the vertical, radians")
    seconds: float = declared(0.0, _NOT_NEGATIVE, "delay: time by which the channel lags, s")
    frequency: float = declared(180.0, _POSITIVE, "ringing: of the sensor on its loose seat, Hz")
    damping: float = declared(0.05, _POSITIVE, "ringing: damping ratio of the same")


_KEYS_BY_FAULT: dict[str, tuple[str, ...]] = {
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
    """Event that happens once at a given time, such as a reset or an unplugged cable."""

    KEYS: ClassVar = _KEYS_BY_FAULT
    """Keys of each kind besides `kind` and `at_s`."""

    kind: str = field(metadata=describe(Choice(_KEYS_BY_FAULT), "one of the faults below"))
    at_s: float = declared(0.0, _NOT_NEGATIVE, "time of sampling since the first start, s")
    count: int = declared(1, Integer(1), "frames, bits, bytes or samples, see below")
    seconds: float = declared(1.0, Number(), "stall, unplug: duration; clock-jump: size, s")
    powered: bool = declared(False, Flag(), "unplug: the instrument continues sampling meanwhile")
    load: float = declared(400.0, _POSITIVE, "knock: peak, N")


@dataclass(frozen=True)
class Scenario:
    """Complete description of a simulated instrument and of the ground on which it stands."""

    base: str = declared(
        "", Text(), "name of a built-in scenario, whose values apply to keys that are missing here"
    )
    soil: Soil = declared(Soil(), table_of(Soil), "ground under the plate")
    hammer: HammerSettings = declared(
        HammerSettings(),
        table_of(HammerSettings),
        "falling weight and its spring",
    )
    device: DeviceSettings = declared(DeviceSettings(), table_of(DeviceSettings), "instrument")
    drops: DropSettings = declared(
        DropSettings(),
        table_of(DropSettings),
        "times and scatter of the drops",
    )
    link: LinkSettings = declared(
        LinkSettings(),
        table_of(LinkSettings),
        "link to the host and its faults",
    )
    effects: tuple[ChannelEffect, ...] = declared(
        (),
        Array(table_of(ChannelEffect)),
        "faults of single channels",
    )
    faults: tuple[Fault, ...] = declared((), Array(table_of(Fault)), "events at given times")
    name: str = ""

    def faults_of(self, *kinds: str) -> tuple[Fault, ...]:
        """Return the faults of the given kinds in the order of their times."""
        chosen = [fault for fault in self.faults if fault.kind in kinds]
        return tuple(sorted(chosen, key=lambda fault: fault.at_s))


def builtin_scenarios() -> list[str]:
    """Return the sorted names of the built-in scenarios."""
    names = (entry.name for entry in FOLDER.iterdir())
    return sorted(name.removesuffix(".toml") for name in names if name.endswith(".toml"))


def load_scenario(source: str | Path | Mapping[str, Any]) -> Scenario:
    """Return a scenario.

    Parameters
    ----------
    source : str, path or mapping
        Name of a built-in scenario, path of a TOML file, or its content.

    Raises
    ------
    ScenarioError
        If there is no such scenario, or a key is unknown or has an invalid value; the message names
        the key.
    """
    if isinstance(source, Mapping):
        return scenario_from(source, "scenario")
    names = builtin_scenarios()
    if isinstance(source, str) and source in names:
        return scenario_from(_builtin_tables(source), source)
    path = Path(source)
    if not path.is_file():
        choices = ", ".join(names)
        raise ScenarioError(
            f"scenario {source}: expected an existing file or one of {choices}, got neither"
        )
    try:
        tables = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as err:
        raise ScenarioError(f"scenario {source}: expected a TOML file, got {err}") from err
    return scenario_from(tables, str(source))


def scenario_schema() -> dict[str, Any]:
    """Return the JSON Schema of a scenario file."""
    title = "Scenario of the simulated instrument"
    return {"$schema": JSON_SCHEMA, "title": title, **table_schema(keys_of(Scenario))}


def scenario_from(tables: Mapping[str, Any], name: str) -> Scenario:
    """Return the scenario of the content of a TOML file.

    Parameters
    ----------
    tables : mapping
        Content of the file as the TOML parser returned it.
    name : str
        Name of the scenario, for messages.

    Raises
    ------
    ScenarioError
        If a key is unknown or has an invalid value; the message names the key.
    """
    base = tables.get("base", "")
    if base:
        if base not in builtin_scenarios():
            raise ScenarioError(f"{name}: base: expected a built-in scenario, got {base!r}")
        tables = merged(_builtin_tables(base), tables)
    reader = TableReader(ScenarioError, name)
    scenario = Scenario(**reader.read(tables, keys_of(Scenario)), name=name)
    for key, keys_of_kind in (("effects", _KEYS_BY_EFFECT), ("faults", _KEYS_BY_FAULT)):
        for number, table in enumerate(tables.get(key, ()), 1):
            _reject_extraneous_keys(table, keys_of_kind, f"{name}, {key}[{number}]")
    _check(scenario)
    return scenario


def merged(base: Mapping[str, Any], override: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of a scenario in which another one overrides single keys.

    Nested tables are merged key by key; arrays are replaced as a whole.

    Parameters
    ----------
    base : mapping
        Content whose keys are used unless they are overridden.
    override : mapping
        Content with the overriding keys.
    """
    result = dict(base)
    for name, value in override.items():
        inner = result.get(name)
        if isinstance(value, Mapping) and isinstance(inner, Mapping):
            value = merged(inner, value)
        result[name] = value
    return result


def _reject_extraneous_keys(
    table: Mapping[str, Any], keys_of_kind: Mapping[str, tuple[str, ...]], where: str
) -> None:
    kind = table["kind"]
    special = {name for names in keys_of_kind.values() for name in names}
    for name in table:
        if name in special and name not in keys_of_kind[kind]:
            expected = f"keys of {kind} ({', '.join(keys_of_kind[kind]) or 'none'})"
            raise ScenarioError(refusal(where, expected, name))


def _builtin_tables(name: str) -> Mapping[str, Any]:
    tables = tomllib.loads(FOLDER.joinpath(f"{name}.toml").read_text(encoding="utf-8"))
    base = tables.get("base", "")
    return merged(_builtin_tables(base), tables) if base else tables


def _check(scenario: Scenario) -> None:
    """Raise ScenarioError if values of several keys contradict each other."""

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
        require(effect.channel in names, f"effects[{number}].channel", f"one of {', '.join(names)}")
