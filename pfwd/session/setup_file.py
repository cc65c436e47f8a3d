"""Setup file of a measurement: declarations about instrument, plate, ground and procedure, as TOML.

On its first level are the header keys of a trace file (plate_radius_m, poisson_ratio,
seating_drops, ...). Below are the tables of the instrument ([link], [instrument], [[channels]],
[detection]) and [procedure], with the name or file of a measuring procedure. The values of the file
override those of the instrument.
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
from pfwd.toml_reading import read_toml_text
from pfwd_device.drop import nearest_first
from pfwd_device.errors import RecordingError, SetupError
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_device.recording.record import point_name
from pfwd_device.schema import AnyOf, Flag, Key, TableReader, Text, TomlTable, unknown_key
from pfwd_device.setup import (
    CHANNEL_KEYS,
    INSTRUMENT_KEYS,
    TABLES,
    DeviceSetup,
    read_device_setup,
)
from pfwd_plugins.quantities import Measurand

MAX_FILE_CHARACTERS = 100_000
"""Largest length of a setup file; it usually has a few thousand characters."""

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
        AnyOf((Text(min_length=1), TomlTable(PROCEDURE_KEYS)), "a name or a table [procedure]"),
        meaning="Measuring procedure.",
    ),
    **TABLES,
}
"""Keys of a setup file, with type, unit and range."""

FULL_SCALE_RANGE = 1e-9, 1e12
"""Range of the full scale of a channel, N, m/s or m: wider than that of any real sensor."""

RESPONSE_TOLERANCE = 0.05
"""Relative tolerance of natural frequency and damping: makers match geophones to this, and a
deviation changes a modulus by less than a tenth of a percent."""


@dataclass(frozen=True, slots=True)
class MeasuringSetup:
    """Declarations before a measurement; an empty one leaves everything to the instrument."""

    device: DeviceSetup = field(default_factory=DeviceSetup)
    """Settings of the link, calibration of the channels, settings of the detection."""
    declared: Mapping[str, Any] = field(default_factory=dict)
    """Values by header key of a trace file."""
    file: str | None = None
    """Path of the setup file; None: the setup is not from a file."""
    text: str = ""
    """Text of the file, recorded so that a replay reads the same setup."""
    procedure: Procedure | None = None
    """Measuring procedure; None: not declared. Its name and its number of seating drops are in
    `declared` as well."""

    def identity_with(self, identity: Identity) -> Identity:
        """Return the identity of an instrument, with the values of the setup in place of its own.

        Raises
        ------
        SetupError
            If the setup does not fit the instrument, or a sensitivity is impossible; the message
            names the file.
        """
        try:
            effective = self.device.apply(identity)
            for channel in effective.channels:
                _refuse_scale(channel, effective.adc_range)
        except SetupError as err:
            raise SetupError(f"{self.file}: {err}" if self.file else str(err)) from err
        return effective

    def declared_with(self, identity: Identity) -> dict[str, Any]:
        """Return the declarations by header key; the setup overrides the instrument.

        Raises
        ------
        SetupError
            If neither setup nor instrument declares the plate radius.
        """
        declared: dict[str, Any] = {
            "plate_radius_m": identity.plate_radius,
            "plate_mass_kg": identity.plate_mass,
            "centre_sensor": identity.centre_sensor,
            "device": identity.serial_number,
            "calibrated": _calibration_date(identity),
            **_geophone_response(identity),
            **self.declared,
        }
        if declared["plate_radius_m"] is None:
            raise SetupError(
                "plate radius: expected it from the instrument or the setup file, got none. "
                "Recording does not start: write plate_radius_m = 0.15 (in m) into a file and name "
                "it with --setup"
            )
        return {key: value for key, value in declared.items() if value is not None}

    def setup_with(self, identity: Identity) -> PointSetup:
        """Return the declarations of setup and instrument as a checked `PointSetup`."""
        return setup_of(self.declared_with(identity), self.file or "setup")

    def differences(self, identity: Identity) -> list[str]:
        """Return the values in which setup and instrument differ, one sentence each."""
        effective = self.device.apply(identity)
        reported = MeasuringSetup(declared={"plate_radius_m": 1.0}).declared_with(identity)
        reported["plate_radius_m"] = identity.plate_radius
        lines = [
            f"{key} = {value!r} from the setup file; the instrument reports {reported[key]!r}"
            for key, value in self.declared.items()
            if reported.get(key) is not None and reported[key] != value
        ]
        lines += _differences(effective, identity, INSTRUMENT_KEYS, "")
        for by_file, by_instrument in zip(effective.channels, identity.channels, strict=True):
            where = f"channel {by_file.name!r}: "
            lines += _differences(by_file, by_instrument, CHANNEL_KEYS, where)
        requested, rate = self.device.sampling_rate, identity.sampling_rate
        if requested is not None and requested != rate:
            lines.append(
                f"sampling_rate_hz = {requested:g} was requested, the instrument uses {rate:g}"
            )
        return lines


def _refuse_scale(channel: ChannelIdentity, adc_range: float) -> None:
    """Raise SetupError if the sensitivity of a channel is implausible."""
    full_scale = adc_range / abs(channel.sensitivity)
    smallest, largest = FULL_SCALE_RANGE
    if channel.is_used and not smallest <= full_scale <= largest:
        unit = channel.quantity.unit
        raise SetupError(
            f"channel {channel.name!r}: sensitivity: expected one with a full scale from "
            f"{smallest:g} to {largest:g} {unit}, got {channel.sensitivity:g} V per {unit} and "
            f"{adc_range:g} V, which is {full_scale:g} {unit}. Recording does not start: correct "
            "the calibration of the instrument, or write sensitivity into the setup file"
        )


def _differences(
    by_file: Identity | ChannelIdentity,
    by_instrument: Identity | ChannelIdentity,
    keys: Mapping[str, Key],
    where: str,
) -> list[str]:
    """Return one sentence for each key of a table in which setup and instrument differ."""
    lines = []
    for key, rule in keys.items():
        name = rule.attribute or key
        new, old = (getattr(side, name, None) for side in (by_file, by_instrument))
        if new != old:
            old_text = "none" if old is None else _text_of(old)
            lines.append(
                f"{where}{key} = {_text_of(new)} from the setup file; the instrument reports "
                f"{old_text}"
            )
    return lines


def _text_of(value: object) -> str:
    if isinstance(value, Measurand):
        return value.role
    return str(value) if isinstance(value, datetime.date) else repr(value)


def _calibration_date(identity: Identity) -> str | None:
    """Return the date of the oldest calibration of a channel; None: one is missing or expired."""
    dates = []
    for channel in identity.channels:
        if not channel.is_used:
            continue
        has_expired = channel.due is not None and channel.due < datetime.date.today()
        if channel.calibrated is None or has_expired:
            return None
        dates.append(channel.calibrated)
    return min(dates).isoformat() if dates else None


def _geophone_response(identity: Identity) -> dict[str, float]:
    """Return the header keys for the response of the centre geophone; {}: it is not known.

    One response is declared for all geophones.
    """
    geophones = _geophones(identity)
    if not geophones:
        return {}
    frequency, damping = geophones[0].natural_frequency, geophones[0].damping
    if frequency is None or damping is None:
        return {}
    return {"geophone_natural_frequency_hz": frequency, "geophone_damping": damping}


def _geophones(identity: Identity) -> list[ChannelIdentity]:
    geophones = [each for each in identity.channels if each.quantity is Measurand.VELOCITY]
    return sorted(geophones, key=lambda channel: nearest_first(channel.offset))


def response_warnings(identity: Identity) -> list[str]:
    """Return one sentence for each geophone whose response differs from that of the centre
    geophone.

    All geophones are analysed with the response of the centre geophone.
    """
    geophones = _geophones(identity)
    lines = []
    for geophone in geophones[1:]:
        response = (geophone.natural_frequency or 0.0, geophone.damping or 0.0)
        first = (geophones[0].natural_frequency or 0.0, geophones[0].damping or 0.0)
        pairs = zip(response, first, strict=True)
        if any(abs(a - b) > RESPONSE_TOLERANCE * b for a, b in pairs):
            lines.append(
                f"geophone {geophone.name} ({response[0]:g} Hz, damping {response[1]:g}) is "
                f"analysed with the response of {geophones[0].name} ({first[0]:g} Hz, damping "
                f"{first[1]:g})"
            )
    return lines


def setup_of(declared: Mapping[str, Any], where: str) -> PointSetup:
    """Check declarations and return them as the setup of an analysis.

    Parameters
    ----------
    declared : mapping of header key to value
    where : str
        Place of the declarations, for messages.

    Raises
    ------
    TraceError
        If a value is outside its range; the message names the key.
    """
    return setup_from({key: Declaration(value, where) for key, value in declared.items()}, where)


def read_setup_file(path: str | os.PathLike[str]) -> MeasuringSetup:
    """Read a setup file.

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
    text = read_toml_text(file, TraceError, MAX_FILE_CHARACTERS)
    return parse_setup(text, file)


def parse_setup(text: str, file: str, procedure_text: str = "") -> MeasuringSetup:
    """Return the setup in the text of a setup file; errors as for `read_setup_file`.

    Parameters
    ----------
    text : str
    file : str
        Path of the file, for messages.
    procedure_text : str
        Text of the procedure's file, recorded in a capture; empty: the file is read.
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
    except OptionError as err:  # the error is in a file, not in an option
        raise TraceError(str(err)) from err


def with_procedure(
    setup: MeasuringSetup, procedure: Procedure, where: str = "--procedure"
) -> MeasuringSetup:
    """Return the setup with a procedure and its number of seating drops.

    Parameters
    ----------
    setup : MeasuringSetup
    procedure : Procedure
    where : str
        Option or file in which the procedure was chosen, for messages.

    Raises
    ------
    OptionError
        If the setup declares another number of seating drops than the procedure requires.
    """
    declared_number, required = setup.declared.get("seating_drops"), procedure.seating_drops
    if None not in (declared_number, required) and declared_number != required:
        raise OptionError(
            refusal(
                f"{where}: seating_drops",
                f"{required}, as the procedure {procedure.name} requires",
                f"{declared_number}",
                "leave seating_drops out of the setup, or write your own procedure",
            )
        )
    declared = {**setup.declared, PROCEDURE_KEY: procedure.name}
    if required is not None:
        declared["seating_drops"] = required
    return replace(setup, declared=declared, procedure=procedure)


def _procedure(chosen: Declaration, file: str, text: str) -> Procedure:
    value, where = chosen
    SETUP_KEYS[PROCEDURE_KEY].check(value, f"{where}, {PROCEDURE_KEY}", TraceError)
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
    try:
        return find_procedure(name, enforce_unverified=unverified)
    except OptionError as err:
        raise OptionError(f"{where}: {err}") from err


def _check_point(name: str, where: str) -> None:
    try:
        point_name(name)
    except RecordingError as err:
        raise TraceError(refusal(where, "point: 1 to 64 characters", quote(name))) from err
