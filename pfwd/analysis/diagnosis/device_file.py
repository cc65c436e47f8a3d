"""Device file: effects of a device, written by ``--write-device`` and read by ``--device``."""

import datetime
import importlib.metadata
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from inversion.diagnosis.findings import EffectResult
from inversion.effects import BY_NAME
from inversion.inference.population import ERROR_BUDGET
from inversion.records import known
from pfwd.analysis.diagnosis.diagnose import Diagnosed
from pfwd.analysis.diagnosis.points import DeviceValues
from pfwd.errors import OptionError, refusal
from pfwd.files.output_path import replaced_at_once, require_writable
from pfwd.files.toml import toml_line
from pfwd.toml_reading import parse_user_toml, read_toml_text

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
        for effect in point.diagnosis.effects if point.diagnosis else ():
            if effect.scope == "device" and point.diagnosis is not None:
                name = known(effect.name)
                effects.setdefault(name, []).append(effect)
                drops[name] = drops.get(name, 0) + len(point.diagnosis.numbers)
    device_effects = []
    for name, found in effects.items():
        best = min(found, key=lambda effect: known(effect.numbers[0].sd))
        values = [(known(p.name), known(p.unit), known(p.value), known(p.sd)) for p in best.numbers]
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
    OptionError, OSError
        If the file cannot be written.
    """
    require_writable(path, "device file")
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


def read_device_file(path: str | os.PathLike[str]) -> DeviceValues:
    """Return the parameters of device effects that a device file states.

    Raises as `read_device`.
    """
    return read_device(path)[0]


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
    for name, entries in table.items():
        if not isinstance(entries, dict):
            continue
        if name == ERROR_BUDGET:
            values[name] = _error_budget(entries, where)
            continue
        effect = BY_NAME.get(name)
        if effect is None or effect.scope != "device":
            raise OptionError(refusal(where, "device effects of the catalogue", repr(name)))
        for p in effect.parameters:
            key = p.name + _SUFFIX.get(p.unit, "")
            value = entries.get(key)
            if isinstance(value, bool) or not isinstance(value, int | float):
                raise OptionError(refusal(where, f"[{name}] {key} as a number", repr(value)))
            if not p.lower <= value <= p.upper:
                expected = f"[{name}] {key} from {p.lower:g} to {p.upper:g}"
                raise OptionError(refusal(where, expected, f"{value:g}"))
            values.setdefault(name, {})[p.name] = float(value)
            spread = entries.get(f"{p.name}_sd{_SUFFIX.get(p.unit, '')}")
            if isinstance(spread, int | float) and not isinstance(spread, bool):
                if not 0.0 <= spread < math.inf:
                    expected = f"[{name}] {p.name}_sd as a number >= 0"
                    raise OptionError(refusal(where, expected, f"{spread:g}"))
                deviations.setdefault(name, {})[p.name] = float(spread)
    return values, deviations


def _error_budget(entries: dict[str, Any], where: str) -> dict[str, float]:
    """Return the errors of a modulus by their causes; raises OptionError for another entry."""
    budget: dict[str, float] = {}
    for name in (*CAUSES_OF_ERROR, *(entries.keys() - set(CAUSES_OF_ERROR))):
        value = entries.get(name)
        is_valid = name in CAUSES_OF_ERROR and not isinstance(value, bool)
        if is_valid and isinstance(value, int | float) and 0.0 <= value < 1.0:
            budget[name] = float(value)
            continue
        expected = f"[{ERROR_BUDGET}] with {', '.join(CAUSES_OF_ERROR)}, each from 0 to below 1"
        raise OptionError(refusal(where, expected, f"{name} = {value!r}"))
    return budget
