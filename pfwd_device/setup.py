"""What a setup file says of the instrument: link, channels with calibration, detection.

Whatever it says wins over what the instrument says of itself. An instrument that says nothing (the
ASCII lines of a microcontroller) is described by it completely.
"""

import dataclasses
import datetime
import difflib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from pfwd_device.acquisition.detection import DetectionSettings
from pfwd_device.errors import SetupError
from pfwd_device.identity import (
    FASTEST_SAMPLING,
    LONGEST_NAME,
    ChannelIdentity,
    Identity,
    Role,
)
from pfwd_device.text import clean
from pfwd_device.wire.dialect import Dialect
from pfwd_device.wire.registry import (
    DEFAULT,
    DeclaredLink,
    DialectEntry,
    dialect_names,
    find_dialect,
)

MOST_COLUMNS = 64

Table = Mapping[str, Any]


class SetupKey(NamedTuple):
    """How one key is checked and where its value goes."""

    attribute: str
    """Field of `Identity`, `ChannelIdentity`, `DetectionSettings` or `DeviceSetup`."""
    expected: str | Callable[[], str]
    """What is accepted, in words, for the message; a function where it takes time to know."""
    accepts: Callable[[Any], bool]
    """Whether a value is accepted."""


def _number(low: float, high: float = math.inf, *, or_low: bool = False) -> Callable[[Any], bool]:
    """Accepts finite numbers above `low`, up to `high`; `or_low`: that one too."""

    def accepts(value: Any) -> bool:
        if isinstance(value, bool) or not isinstance(value, int | float):
            return False
        try:
            number = float(value)
        except OverflowError:  # an integer of hundreds of digits
            return False
        return (low < number or (or_low and low == number)) and number <= high and number < math.inf

    return accepts


def _whole(low: int, high: int) -> Callable[[Any], bool]:
    return lambda value: type(value) is int and low <= value <= high


def _word(value: Any) -> bool:
    return isinstance(value, str) and 0 < len(value) <= LONGEST_NAME and value.isprintable()


def _one_of(*words: str) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, str) and value in words


def _is_dialect(value: Any) -> bool:
    return isinstance(value, str) and find_dialect(value) is not None


def _alternatives(words: Sequence[str]) -> str:
    return " or ".join(f'"{word}"' for word in words)


def _date(value: Any) -> bool:
    return isinstance(value, datetime.date) and not isinstance(value, datetime.datetime)


_TEXT = f"text of 1 to {LONGEST_NAME} letters on one line"
_DATE = "a date as 2026-05-31, without quotation marks"

LINK_KEYS = {
    "dialect": SetupKey("dialect", lambda: _alternatives(dialect_names()), _is_dialect),
    "baud_rate": SetupKey(
        "baud_rate", "a whole number from 300 to 20000000", _whole(300, 20_000_000)
    ),
    "sampling_rate_hz": SetupKey(
        "sampling_rate",
        f"a number > 0 up to {FASTEST_SAMPLING:g}, in Hz",
        _number(0, FASTEST_SAMPLING),
    ),
}
INSTRUMENT_KEYS = {
    "serial_number": SetupKey("serial_number", _TEXT, _word),
    "model": SetupKey("model", _TEXT, _word),
    "adc_bits": SetupKey("adc_bits", "a whole number from 8 to 24", _whole(8, 24)),
    "adc_range_v": SetupKey("adc_range", "a number > 0, in V", _number(0)),
}
CHANNEL_KEYS = {
    "name": SetupKey("name", _TEXT, _word),
    "role": SetupKey("role", _alternatives(tuple(Role)), _one_of(*Role)),
    "column": SetupKey(
        "column", f"a whole number from 1 to {MOST_COLUMNS}", _whole(1, MOST_COLUMNS)
    ),
    "resolution": SetupKey("resolution", "a number > 0: what one count stands for", _number(0)),
    "offset_m": SetupKey("offset", "a finite number, in m", _number(-math.inf)),
    "sensitivity": SetupKey(
        "sensitivity",
        "a number other than 0, in V per N, V per m/s or V per m",
        lambda value: _number(-math.inf)(value) and value != 0,
    ),
    "zero_v": SetupKey("zero", "a finite number, in V", _number(-math.inf)),
    "natural_frequency_hz": SetupKey("natural_frequency", "a number > 0, in Hz", _number(0)),
    "damping": SetupKey("damping", "a number > 0", _number(0)),
    "shunt_n": SetupKey("shunt", "a number > 0, in N", _number(0)),
    "calibrated": SetupKey("calibrated", _DATE, _date),
    "due": SetupKey("due", _DATE, _date),
}
DETECTION_KEYS = {
    key: SetupKey(attribute, f"a number > 0{unit}", _number(0))
    for key, attribute, unit in (
        ("threshold_n", "threshold", ", in N"),
        ("noise_factor", "noise_factor", ""),
        ("hysteresis", "hysteresis", " and < 1"),
        ("confirm_s", "confirm", ", in s"),
        ("pre_trigger_s", "pre_trigger", ", in s"),
        ("post_trigger_s", "post_trigger", ", in s"),
        ("rebound_window_s", "rebound_window", ", in s"),
        ("rebound_pre_trigger_s", "rebound_pre_trigger", ", in s"),
        ("rebound_post_trigger_s", "rebound_post_trigger", ", in s"),
    )
}
TABLES = {
    "link": LINK_KEYS,
    "instrument": INSTRUMENT_KEYS,
    "channels": CHANNEL_KEYS,
    "detection": DETECTION_KEYS,
}
"""The tables of a setup file that speak of the instrument, and their keys."""


@dataclass(frozen=True, slots=True)
class DeviceSetup:
    """What is declared about the instrument; empty: the instrument says it all."""

    dialect: str = DEFAULT
    """Name of one in `pfwd_device.wire.registry`."""
    baud_rate: int = 115_200
    """Of a serial port; a USB port with its own protocol ignores it."""
    sampling_rate: float | None = None
    """Asked of the instrument, Hz; with ASCII lines: what it does."""
    instrument: Mapping[str, Any] = field(default_factory=dict)
    """Fields of `Identity` that win over the instrument's own."""
    channels: tuple[Mapping[str, Any], ...] = ()
    """Fields of `ChannelIdentity` by channel, with "name", and "column" of the ASCII lines."""
    detection: DetectionSettings = field(default_factory=DetectionSettings)
    """When a drop begins and how much of it is kept."""

    @property
    def _entry(self) -> DialectEntry:
        entry = find_dialect(self.dialect)
        if entry is None:
            came = clean(ascii(self.dialect))
            expected = _alternatives(dialect_names())
            raise SetupError(f"setup, dialect: expected {expected}, got {came}")
        return entry

    @property
    def needs_identity(self) -> bool:
        """Whether the instrument says nothing of itself, so that all of it has to be declared."""
        return self._entry.needs_identity

    def apply(self, identity: Identity) -> Identity:
        """The identity with what the file says in place of what the instrument says.

        Raises
        ------
        SetupError
            If a channel is named that the instrument does not have, or two values clash.
        """
        if self.needs_identity:
            return identity
        channels = list(identity.channels)
        names = [channel.name for channel in channels]
        for said in self.channels:
            name = said["name"]
            if names.count(name) != 1:
                has = ", ".join(map(repr, names))
                raise SetupError(f"setup, channels: expected a name among {has}, got {name!r}")
            fields = {key: value for key, value in said.items() if key in _CHANNEL_FIELDS}
            index = names.index(name)
            channels[index] = dataclasses.replace(channels[index], **fields)
        return dataclasses.replace(identity, **self.instrument, channels=tuple(channels))

    def make_dialect(self, first_stream: int = 0) -> Dialect:
        """The language that the instrument speaks.

        Parameters
        ----------
        first_stream : int
            Number of the first run of a sampler that does not number its runs itself; tells its
            drops from those of another day.

        Raises
        ------
        SetupError
            If something is not declared that an instrument of this dialect does not say.
        """
        entry = self._entry
        identity = self.declared_identity() if self.needs_identity else None
        columns: list[int] = []
        if entry.needs_columns:
            columns = [said["column"] - 1 for said in self.channels]
        resolution = [said.get("resolution", 1.0) for said in self.channels]
        return entry.make(DeclaredLink(identity, tuple(columns), tuple(resolution), first_stream))

    def declared_identity(self) -> Identity:
        """The identity of an instrument that says nothing of itself.

        Raises
        ------
        SetupError
            If the file does not say all of it.
        """
        title = self._entry.title
        needed = ("column", "role", "sensitivity")[0 if self._entry.needs_columns else 1 :]
        if self.sampling_rate is None:
            raise SetupError(_missing("link: sampling_rate_hz", title))
        if not self.channels:
            raise SetupError(_missing("[[channels]]", title))
        for said in self.channels:
            for key in needed:
                if key not in said:
                    raise SetupError(_missing(f"channels, {said['name']!r}: {key}", title))
        for key in ("adc_bits", "adc_range"):
            if key not in self.instrument:
                raise SetupError(_missing(f"instrument: {key.replace('range', 'range_v')}", title))
        channels = [
            ChannelIdentity(**{key: value for key, value in said.items() if key in _CHANNEL_FIELDS})
            for said in self.channels
        ]
        if sum(channel.role is Role.LOAD for channel in channels) != 1:
            raise SetupError('channels: expected one with role = "load", got none or several')
        if not any(channel.role in (Role.GEOPHONE, Role.DISPLACEMENT) for channel in channels):
            raise SetupError(
                'channels: expected one with role = "geophone" or "displacement", got none'
            )
        about = {"serial_number": "unknown", "model": title, "firmware": ""}
        return Identity(
            **{**about, **self.instrument},
            sampling_rate=self.sampling_rate,
            channels=tuple(channels),
        )


_CHANNEL_FIELDS = {known.name for known in dataclasses.fields(ChannelIdentity)}


def read_device_setup(table: Table, where: str) -> DeviceSetup:
    """The instrument's part of a setup file.

    Parameters
    ----------
    table : mapping
        As TOML read it; only the keys of `TABLES` are looked at.
    where : str
        Name of the file, for messages.

    Returns
    -------
    DeviceSetup

    Raises
    ------
    SetupError
        If a key is unknown or a value outside its range; the message names file, table and key.
    """
    link = _read(table.get("link", {}), LINK_KEYS, f"{where}, [link]")
    instrument = _read(table.get("instrument", {}), INSTRUMENT_KEYS, f"{where}, [instrument]")
    detection = _read(table.get("detection", {}), DETECTION_KEYS, f"{where}, [detection]")
    entries = table.get("channels", [])
    if not isinstance(entries, list):
        raise SetupError(f"{where}: channels: expected tables under [[channels]]")
    channels = []
    for number, entry in enumerate(entries, 1):
        place = f"{where}, [[channels]] {number}"
        said = _read(entry, CHANNEL_KEYS, place)
        if "name" not in said:
            raise SetupError(f"{place}: expected a name, got none; `pfwd ports` shows the names")
        if "role" in said:
            said["role"] = Role(said["role"])
        channels.append(said)
    _refuse_twice([said["name"] for said in channels], f"{where}, [[channels]]: name")
    _refuse_twice([said.get("column") for said in channels], f"{where}, [[channels]]: column")
    try:
        settings = DetectionSettings(**detection)
    except SetupError as err:
        raise SetupError(f"{where}: {err}") from err
    setup = DeviceSetup(**link, instrument=instrument, channels=tuple(channels), detection=settings)
    try:
        if setup.needs_identity:
            setup.declared_identity()
    except SetupError as err:
        raise SetupError(f"{where}: {err}") from err
    return setup


def _read(table: Any, rules: Mapping[str, SetupKey], where: str) -> dict[str, Any]:
    if not isinstance(table, Mapping):
        raise SetupError(f"{where}: expected a table, got {clean(ascii(table))}")
    values = {}
    for key, value in table.items():
        if key not in rules:
            near = difflib.get_close_matches(key, rules, 1)
            hint = f"did you mean {near[0]}?" if near else f"known are {', '.join(rules)}"
            raise SetupError(f"{where}: expected a key of it, got {clean(ascii(key))}; {hint}")
        rule = rules[key]
        if not rule.accepts(value):
            came = clean(ascii(value))
            expected = rule.expected if isinstance(rule.expected, str) else rule.expected()
            raise SetupError(f"{where}: {key}: expected {expected}, got {came}")
        values[rule.attribute] = value
    return values


def _refuse_twice(values: Sequence[object], where: str) -> None:
    said = [value for value in values if value is not None]
    for value in said:
        if said.count(value) > 1:
            came = clean(ascii(value))
            raise SetupError(f"{where}: expected each value once, got {came} twice")


def _missing(what: str, title: str) -> str:
    return f"{what}: expected a value, got none; {title} say nothing of the instrument"
