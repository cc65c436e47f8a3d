"""The setup file of a measurement: what is declared about instrument, plate, ground and procedure.

One TOML file. On its first level stand the keys of a trace file's header (plate_radius_m,
poisson_ratio, seating_drops, ...), below them the tables of the instrument: [link], [instrument],
[[channels]], [detection], and [procedure] with the name or file of a measuring procedure. What the
file says wins over what the instrument says.
"""

import datetime
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from pfwd.errors import OptionError, TraceError, quote, refusal
from pfwd.files.header import (
    HEADER_KEYS,
    TRACES_FORMAT_KEY,
    Declaration,
    PointSetup,
    check_value,
    parse_header,
    setup_from,
)
from pfwd.procedures import Procedure, find_procedure, parse_procedure, read_procedure
from pfwd_device.drop import nearest_first
from pfwd_device.errors import RecordingError, SetupError
from pfwd_device.identity import UNIT_OF_ROLE, ChannelIdentity, Identity, Role
from pfwd_device.recording.record import point_name
from pfwd_device.schema import AnyOf, Flag, Key, Table, TableReader, Text, unknown_key
from pfwd_device.setup import (
    CHANNEL_KEYS,
    INSTRUMENT_KEYS,
    TABLES,
    DeviceSetup,
    read_device_setup,
)

LARGEST_FILE = 100_000
"""Characters; a setup takes a few thousand."""

PROCEDURE_KEY = "procedure"
PROCEDURE_KEYS = {
    "name": Key(Text(min_length=1), meaning="Name of a procedure, as `pfwd procedures` lists it."),
    "file": Key(Text(min_length=1), meaning="File of a procedure, relative to the setup file."),
    "enforce_unverified": Key(
        Flag(), meaning="True: numbers that are not verified are enforced too."
    ),
}
SETUP_KEYS = {
    **HEADER_KEYS,
    PROCEDURE_KEY: Key(
        AnyOf((Text(min_length=1), Table(PROCEDURE_KEYS)), "a name or a table [procedure]"),
        meaning="Measuring procedure.",
    ),
    **TABLES,
}
"""Keys of a setup file."""

FULL_SCALE = 1e-9, 1e12
"""N, m/s or m; far beyond what any converter and sensor of an instrument measure at most."""

RESPONSE_TOLERANCE = 0.05
"""Of natural frequency and damping; makers match geophones to this, and it moves a modulus by less
than a tenth of a percent."""


@dataclass(frozen=True, slots=True)
class MeasuringSetup:
    """What is declared before a measurement; empty: the instrument says it all."""

    device: DeviceSetup = field(default_factory=DeviceSetup)
    """Link, channels with calibration, detection."""
    declared: Mapping[str, Any] = field(default_factory=dict)
    """Keys of a trace file's header with their values."""
    file: str | None = None
    """Where it was read from."""
    text: str = ""
    """What stands in the file, for a recording that has to be read alike."""
    procedure: Procedure | None = None
    """How a point is measured; None: no one said. Its name and its number of seating drops are
    among what is declared."""

    def identity_with(self, identity: Identity) -> Identity:
        """The identity with what the file says in place of what the instrument says.

        Raises
        ------
        SetupError
            If the file does not fit the instrument, or a channel could measure nothing; the
            message names the file.
        """
        try:
            effective = self.device.apply(identity)
            for channel in effective.channels:
                _refuse_scale(channel, effective.adc_range)
        except SetupError as err:
            raise SetupError(f"{self.file}: {err}" if self.file else str(err)) from err
        return effective

    def declared_with(self, identity: Identity) -> dict[str, Any]:
        """What is declared of a point measured with an instrument; the file wins.

        Raises
        ------
        SetupError
            If neither the file nor the instrument says the plate radius.
        """
        said: dict[str, Any] = {
            "plate_radius_m": identity.plate_radius,
            "plate_mass_kg": identity.plate_mass,
            "centre_sensor": identity.centre_sensor,
            "device": identity.serial_number,
            **_geophone_response(identity),
            **self.declared,
        }
        if said["plate_radius_m"] is None:
            raise SetupError(
                "plate radius: expected it from the instrument or the setup file, got none; "
                "nothing is armed: write plate_radius_m = 0.15 (in m) into a file and give it "
                "with --setup"
            )
        return {key: value for key, value in said.items() if value is not None}

    def setup_with(self, identity: Identity) -> PointSetup:
        """The same, checked as a whole."""
        return setup_of(self.declared_with(identity), self.file or "setup")

    def differences(self, identity: Identity) -> list[str]:
        """What the file says otherwise than the instrument, one sentence each, to be shown."""
        effective = self.device.apply(identity)
        own = MeasuringSetup(declared={"plate_radius_m": 1.0}).declared_with(identity)
        own["plate_radius_m"] = identity.plate_radius
        lines = [
            f"{key} = {value!r} from the setup file, not {own[key]!r} as the instrument says"
            for key, value in self.declared.items()
            if own.get(key) is not None and own[key] != value
        ]
        lines += _otherwise(effective, identity, INSTRUMENT_KEYS, "")
        for mine, theirs in zip(effective.channels, identity.channels, strict=True):
            lines += _otherwise(mine, theirs, CHANNEL_KEYS, f"channel {mine.name!r}: ")
        asked = self.device.sampling_rate
        if asked is not None and asked != identity.sampling_rate:
            rate = identity.sampling_rate
            lines.append(f"sampling_rate_hz = {asked:g} was asked for, the instrument has {rate:g}")
        return lines


def _refuse_scale(channel: ChannelIdentity, adc_range: float) -> None:
    """Refuse a sensitivity with which no load and no motion of the ground can be measured."""
    full_scale = adc_range / abs(channel.sensitivity)
    least, most = FULL_SCALE
    if channel.role is not Role.UNUSED and not least <= full_scale <= most:
        unit = UNIT_OF_ROLE[channel.role]
        raise SetupError(
            f"channel {channel.name!r}: sensitivity: expected one with a full scale from "
            f"{least:g} to {most:g} {unit}, got {channel.sensitivity:g} V per {unit} and "
            f"{adc_range:g} V, which is {full_scale:g} {unit}. Nothing is armed: correct the "
            "calibration of the instrument, or write sensitivity into the setup file"
        )


def _otherwise(
    mine: Identity | ChannelIdentity,
    theirs: Identity | ChannelIdentity,
    keys: Mapping[str, Key],
    where: str,
) -> list[str]:
    """The keys of a table that the file says otherwise than the instrument."""
    lines = []
    for key, rule in keys.items():
        ours, said = (getattr(side, rule.attribute or key, None) for side in (mine, theirs))
        if ours != said:
            old = "nothing" if said is None else _shown(said)
            lines.append(
                f"{where}{key} = {_shown(ours)} from the setup file, not {old} as the instrument "
                "says"
            )
    return lines


def _shown(value: object) -> str:
    return str(value) if isinstance(value, datetime.date | Role) else repr(value)


def _geophone_response(identity: Identity) -> dict[str, float]:
    """Response of the geophones; one is declared for all: that of the centre."""
    geophones = _geophones(identity)
    if not geophones:
        return {}
    frequency, damping = geophones[0].natural_frequency, geophones[0].damping
    if frequency is None or damping is None:
        return {}
    return {"geophone_natural_frequency_hz": frequency, "geophone_damping": damping}


def _geophones(identity: Identity) -> list[ChannelIdentity]:
    found = [channel for channel in identity.channels if channel.role is Role.GEOPHONE]
    return sorted(found, key=lambda channel: nearest_first(channel.offset))


def response_warnings(identity: Identity) -> list[str]:
    """Geophones that answer otherwise than the centre one, by whose response all are taken."""
    geophones = _geophones(identity)
    lines = []
    for geophone in geophones[1:]:
        mine = (geophone.natural_frequency or 0.0, geophone.damping or 0.0)
        first = (geophones[0].natural_frequency or 0.0, geophones[0].damping or 0.0)
        apart = [abs(a - b) - RESPONSE_TOLERANCE * b for a, b in zip(mine, first, strict=True)]
        if max(apart) > 0:
            lines.append(
                f"geophone {geophone.name} ({mine[0]:g} Hz, damping {mine[1]:g}) is taken for one "
                f"like {geophones[0].name} ({first[0]:g} Hz, damping {first[1]:g})"
            )
    return lines


def setup_of(declared: Mapping[str, Any], where: str) -> PointSetup:
    """What is declared, as the analysis takes it.

    Raises
    ------
    TraceError
        If a value is outside of its range; the message names the key.
    """
    return setup_from({key: Declaration(value, where) for key, value in declared.items()}, where)


def read_setup_file(path: str | os.PathLike[str]) -> MeasuringSetup:
    """The setup that a TOML file declares.

    Parameters
    ----------
    path : path of a TOML file

    Returns
    -------
    MeasuringSetup

    Raises
    ------
    TraceError, SetupError
        If it cannot be read, a key is unknown or a value outside its range; the message names the
        key.
    """
    file = os.fspath(path)
    try:
        with open(file, encoding="utf-8-sig") as stream:
            text = stream.read(LARGEST_FILE + 1)
    except OSError as err:
        raise TraceError(refusal(file, "a readable TOML file", err.strerror or str(err))) from err
    except UnicodeDecodeError as err:
        raise TraceError(refusal(file, "UTF-8 text", "other bytes")) from err
    if len(text) > LARGEST_FILE:
        raise TraceError(refusal(file, f"at most {LARGEST_FILE} characters", "more"))
    return parse_setup(text, file)


def parse_setup(text: str, file: str, procedure_text: str = "") -> MeasuringSetup:
    """The setup that a TOML text declares; see `read_setup_file`.

    Parameters
    ----------
    text : str
    file : str
        Where it is from, for messages.
    procedure_text : str
        What stands in the file of its procedure, where that file is not at hand any more.
    """
    declarations = parse_header(text, file)
    chosen = declarations.pop(PROCEDURE_KEY, None)
    tables = {key: declaration.value for key, declaration in declarations.items() if key in TABLES}
    declared = {}
    for key, (value, where) in declarations.items():
        if key in TABLES or key == TRACES_FORMAT_KEY:
            continue
        if key not in HEADER_KEYS:
            raise TraceError(unknown_key(key, SETUP_KEYS, where))
        if isinstance(value, datetime.date | datetime.datetime | datetime.time):
            value = value.isoformat()
        check_value(key, value, where)
        if key == "point":
            _check_point(str(value), where)
        declared[key] = value
    setup = MeasuringSetup(read_device_setup(tables, file), declared, file, text)
    if chosen is None:
        return setup
    try:
        return with_procedure(setup, _procedure(chosen, file, procedure_text), chosen.where)
    except OptionError as err:  # of a file here, not of the command line
        raise TraceError(str(err)) from err


def with_procedure(
    setup: MeasuringSetup, procedure: Procedure, where: str = "--procedure"
) -> MeasuringSetup:
    """The setup with a procedure, which says how many drops are seating.

    Parameters
    ----------
    setup : MeasuringSetup
    procedure : Procedure
    where : str
        Where it was chosen, for messages.

    Raises
    ------
    OptionError
        If the setup declares another number of seating drops than the procedure asks for.
    """
    said, wanted = setup.declared.get("seating_drops"), procedure.seating_drops
    if None not in (said, wanted) and said != wanted:
        raise OptionError(
            refusal(
                f"{where}: seating_drops",
                f"{wanted}, as the procedure {procedure.name} asks for",
                f"{said}",
                "leave seating_drops out of the setup, or write a profile of your own",
            )
        )
    declared = {**setup.declared, PROCEDURE_KEY: procedure.name}
    if wanted is not None:
        declared["seating_drops"] = wanted
    return replace(setup, declared=declared, procedure=procedure)


def _procedure(chosen: Declaration, file: str, text: str) -> Procedure:
    value, where = chosen
    table = {"name": value} if isinstance(value, str) else value
    choice = TableReader(TraceError, where).read(table, PROCEDURE_KEYS, PROCEDURE_KEY)
    unverified = choice.get("enforce_unverified", False)
    names = [key for key in ("name", "file") if key in choice]
    if len(names) != 1:
        place = f"{where}, {PROCEDURE_KEY}"
        raise TraceError(refusal(place, "either name or file", " and ".join(names) or "none"))
    if text:
        return parse_procedure(text, where, enforce_unverified=unverified)
    name = choice[names[0]]
    if names == ["file"]:  # relative to the setup file, not to the working directory
        name = os.path.join(os.path.dirname(file), name)
        return read_procedure(name, enforce_unverified=unverified)
    return find_procedure(name, enforce_unverified=unverified)


def _check_point(name: str, where: str) -> None:
    try:
        point_name(name)
    except RecordingError as err:
        raise TraceError(refusal(where, "point: 1 to 64 characters", quote(name))) from err
