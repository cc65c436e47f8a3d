"""Device file: effects of a device, written by ``--write-device`` and read by ``--device``."""

import datetime
import importlib.metadata
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from inversion.diagnosis.findings import DeviceValues, EffectResult
from inversion.effects import BY_NAME
from inversion.inference.population import ERROR_BUDGET
from pfwd.analysis.diagnosis.diagnose import Diagnosed
from pfwd.errors import OptionError, refusal
from pfwd.files.output_path import replaced_at_once
from pfwd.files.toml import toml_line
from pfwd.toml_reading import parse_user_toml, read_toml_text
from pfwd_device.schema import Integer, Key, Number, TableReader, Text, TomlTable

CAUSES_OF_ERROR = ("gain", "tilt", "clock", "linearity")
"""Causes of an error of the modulus that leaves no residual, in the table `ERROR_BUDGET`."""
_SUFFIX = {"kg": "_kg", "s": "_s", "Hz": "_hz", "m/s": "_m_s", "m": "_m", "N/m": "_n_m"}
"""Ending of a key, by the unit of its value."""


def device_of(diagnosed: Sequence[Diagnosed]) -> str | None:
    """Return the name of the device that all diagnoses are of; None: no device is declared.

    Raises
    ------
    OptionError
        If they are of several devices.
    """
    names = {found.result.device for found in diagnosed if found.result and found.result.device}
    if len(names) > 1:
        raise OptionError(
            refusal("--write-device", "files of one device", f"of {', '.join(sorted(names))}")
        )
    return names.pop() if names else None


def write_device_file(
    path: str | os.PathLike[str], diagnosed: Sequence[Diagnosed], device: str | None
) -> None:
    """Write the effects of the device, as estimated by diagnoses, to a file for ``--device``.

    The most precise estimate of each effect is written.

    Parameters
    ----------
    path : path
    diagnosed : sequence of Diagnosed
    device : str or None
        Name of the device.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    effects: dict[str, list[EffectResult]] = {}
    drops: dict[str, int] = {}
    for point in diagnosed:
        if point.result is None:
            continue
        for effect in point.result.effects:
            if effect.scope == "device":
                effects.setdefault(effect.name, []).append(effect)
                drops[effect.name] = drops.get(effect.name, 0) + len(point.result.drops)
    device_effects = []
    for name, found in effects.items():
        best = min(found, key=lambda effect: effect.parameters[0].sd)
        values = [(p.name, p.unit, p.value, p.sd) for p in best.parameters]
        device_effects.append(DeviceEffect(name, drops[name], values))
    write_effects(path, device, device_effects)


class DeviceEffect(NamedTuple):
    """Effect of a device as its file stores it."""

    name: str
    drops: int
    """Number of drops from which it was estimated."""
    values: Sequence[tuple[str, str, float, float]]
    """Name, unit, value and standard deviation of each parameter."""


def write_effects(
    path: str | os.PathLike[str], device: str | None, effects: Sequence[DeviceEffect]
) -> None:
    """Write effects of a device to a file for ``--device``.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    lines = [
        toml_line("device", device or ""),
        toml_line("date", datetime.date.today().isoformat()),
        toml_line("software_version", importlib.metadata.version("pfwd")),
    ]
    for effect in effects:
        lines += ["", f"[{effect.name}]", toml_line("drops", effect.drops)]
        for name, unit, value, deviation in effect.values:
            suffix = _SUFFIX.get(unit, "")
            lines.append(toml_line(name + suffix, value))
            if math.isfinite(deviation):
                lines.append(toml_line(f"{name}_sd{suffix}", deviation))
    text = "\n".join(lines) + "\n"
    with replaced_at_once(Path(path)) as draft:
        draft.write_text(text, encoding="utf-8", newline="\n")


def device_keys() -> dict[str, Key]:
    """Return the keys of a device file: a table for each effect of a device, and the errors."""
    keys = {name: Key(Text()) for name in ("device", "date", "software_version")}
    for effect in BY_NAME.values():
        if effect.scope == "device":
            numbers = {"drops": Key(Integer(0), meaning="Number of drops behind the values")}
            for p in effect.parameters:
                unit, suffix = p.unit.removeprefix("-"), _SUFFIX.get(p.unit, "")
                value = Number(unit, minimum=p.lower, maximum=p.upper)
                numbers[p.name + suffix] = Key(value, p.name, required=True)
                numbers[f"{p.name}_sd{suffix}"] = Key(
                    Number(unit, minimum=0.0), f"{p.name}_sd", "Standard deviation"
                )
            keys[effect.name] = Key(
                TomlTable(numbers), meaning=f"Values of the effect {effect.name}"
            )
    share = Key(Number(minimum=0.0, below=1.0), required=True)
    causes = TomlTable(dict.fromkeys(CAUSES_OF_ERROR, share))
    keys[ERROR_BUDGET] = Key(causes, meaning="Relative errors of a modulus by their causes, 95 %")
    return keys


def read_device(path: str | os.PathLike[str]) -> tuple[DeviceValues, DeviceValues]:
    """Return parameters of device effects in a device file, and standard deviations.

    The values under `ERROR_BUDGET` are relative errors (95 %) of a modulus.

    Returns
    -------
    values : dict
        Values by effect and parameter, in SI units.
    deviations : dict
        Standard deviations of those that have one.

    Raises
    ------
    OptionError
        If the file cannot be read, or names an unknown effect or parameter.
    """
    where = f"--device {os.fspath(path)}"
    table = parse_user_toml(read_toml_text(path, OptionError, where=where), where, OptionError)
    values: DeviceValues = {}
    deviations: DeviceValues = {}
    for name, entries in TableReader(OptionError, where).read(table, device_keys()).items():
        if name == ERROR_BUDGET:
            values[name] = entries
        elif isinstance(entries, dict):
            for p in BY_NAME[name].parameters:
                values.setdefault(name, {})[p.name] = entries[p.name]
                if f"{p.name}_sd" in entries:
                    deviations.setdefault(name, {})[p.name] = entries[f"{p.name}_sd"]
    return values, deviations
