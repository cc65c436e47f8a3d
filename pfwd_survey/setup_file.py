"""The setup file of a measurement: what is declared about instrument, plate, ground and procedure.

One TOML file. On its first level stand the keys of a trace file's header (plate_radius_m,
poisson_ratio, seating_drops, ...), below them the tables of the instrument: [link], [instrument],
[[channels]], [detection]. What the file says wins over what the instrument says.
"""

import datetime
import difflib
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pfwd_device.errors import SetupError
from pfwd_device.identity import Identity, Role
from pfwd_device.setup import TABLES, DeviceSetup, read_device_setup
from pfwd_survey.errors import TraceError, quote, refusal
from pfwd_survey.header import (
    FORMAT_KEY,
    KEYS,
    Declaration,
    Setup,
    check_value,
    read_header_file,
    setup_from,
)


@dataclass(frozen=True, slots=True)
class MeasuringSetup:
    """What is declared before a measurement; empty: the instrument says it all."""

    device: DeviceSetup = field(default_factory=DeviceSetup)
    """Link, channels with calibration, detection."""
    declared: Mapping[str, Any] = field(default_factory=dict)
    """Keys of a trace file's header with their values."""
    file: str | None = None
    """Where it was read from."""

    def declared_with(self, identity: Identity) -> dict[str, Any]:
        """What is declared of a point measured with an instrument; the file wins.

        Raises
        ------
        SetupError
            If neither the file nor the instrument says the plate radius, or the geophones differ in
            their response.
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
                "plate radius: expected it from the instrument or the setup file, came none; "
                "nothing is armed: write plate_radius_m = 0.15 (in m) into a file and give it "
                "with --setup"
            )
        return {key: value for key, value in said.items() if value is not None}

    def setup_with(self, identity: Identity) -> Setup:
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
        for mine, theirs in zip(effective.channels, identity.channels, strict=True):
            if mine != theirs:
                lines.append(f"channel {mine.name!r} calibrated by the setup file")
        return lines


def _geophone_response(identity: Identity) -> dict[str, float]:
    responses = {
        (channel.natural_frequency, channel.damping)
        for channel in identity.channels
        if channel.role is Role.GEOPHONE
    }
    if len(responses) > 1:
        came = "; ".join(f"{f or 0:g} Hz with {h or 0:g}" for f, h in sorted(responses, key=str))
        raise SetupError(
            "geophones: expected one natural frequency and damping for all channels, came "
            f"{came}; declare them alike in [[channels]] or set the odd ones to role = "
            '"unused"'
        )
    frequency, damping = responses.pop() if responses else (None, None)
    if frequency is None or damping is None:
        return {}
    return {"geophone_natural_frequency_hz": frequency, "geophone_damping": damping}


def setup_of(declared: Mapping[str, Any], where: str) -> Setup:
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
    declarations = read_header_file(file)
    tables = {key: one.value for key, one in declarations.items() if key in TABLES}
    declared = {}
    for key, (value, where) in declarations.items():
        if key in TABLES or key == FORMAT_KEY:
            continue
        if key not in KEYS:
            near = difflib.get_close_matches(key, [*KEYS, *TABLES], 1)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(KEYS)}"
            raise TraceError(refusal(where, "a key of a setup file", quote(key), hint))
        if isinstance(value, datetime.date | datetime.datetime | datetime.time):
            value = value.isoformat()
        check_value(key, value, where)
        declared[key] = value
    return MeasuringSetup(read_device_setup(tables, file), declared, file)
