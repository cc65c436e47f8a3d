"""Instrument part of a setup file: link, channels with calibration, detection of drops.

A setup file is a TOML file of the user. Its values override those of the identity that the
instrument reports. An instrument that reports no identity, such as a microcontroller that prints
ASCII lines, is described by the file completely.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pfwd_device.acquisition.detection import DetectionSettings
from pfwd_device.calibration import load_channel, sensor_channels
from pfwd_device.errors import SetupError, quote, refusal
from pfwd_device.identity import (
    FASTEST_SAMPLING,
    LONGEST_NAME,
    ChannelIdentity,
    Identity,
)
from pfwd_device.schema import (
    Array,
    Choice,
    Date,
    Integer,
    Key,
    Number,
    TableReader,
    Text,
    TomlTable,
)
from pfwd_device.wire.ascii_lines import LineLayout
from pfwd_device.wire.dialect import Dialect
from pfwd_device.wire.fixed_frames import CHECKSUMS, MAX_FIXED_BYTES, NUMBER_TYPES, FrameLayout
from pfwd_device.wire.registry import (
    DEFAULT,
    DeclaredLink,
    DialectEntry,
    dialect_names,
    find_dialect,
)
from pfwd_plugins.quantities import QUANTITY_BY_ROLE

MAX_COLUMNS = 64
"""Largest number of columns of an ASCII line."""

_NAME = Text(LONGEST_NAME, min_length=1)
_POSITIVE = Number(above=0)

LINK_KEYS = {
    "dialect": Key(
        Choice(dialect_names), meaning="Language of the instrument, as `pfwd ports` lists it."
    ),
    "baud_rate": Key(Integer(300, 20_000_000), meaning="Speed of a serial port."),
    "sampling_rate_hz": Key(
        Number("Hz", above=0, maximum=FASTEST_SAMPLING),
        "sampling_rate",
        "Sampling rate requested of the instrument; with ASCII lines the rate that it has.",
    ),
}
_TIME_UNITS = {"us": 1e-6, "ms": 1e-3, "s": 1.0}
LOGGER_KEYS = {
    "start": Key(Text(), meaning="Command after which the logger sends, with its line end."),
    "stop": Key(Text(), meaning="Command after which the logger stops."),
    "separator": Key(
        Choice((",", ";", " ", "\t")), meaning="Sign between two values of a line (dialect ascii)."
    ),
    "time_column": Key(
        Integer(0, MAX_COLUMNS), meaning="Column of the time in a line, from 1; 0: there is none."
    ),
    "time_unit": Key(Choice(_TIME_UNITS), meaning="Unit of the time in a line."),
    "counter_column": Key(
        Integer(1, MAX_COLUMNS), meaning="Column of the number of the sample, instead of a time."
    ),
    "counter_bits": Key(Integer(4, 63), meaning="Bits of the number of the sample in a line."),
    "head": Key(
        Text(32, min_length=2), meaning="First bytes of each frame as hexadecimal digits: AA55."
    ),
    "frame_bytes": Key(Integer(2, MAX_FIXED_BYTES), meaning="Length of a frame (dialect frames)."),
    "counter_byte": Key(
        Integer(0, MAX_FIXED_BYTES), meaning="Place of the number of the sample in a frame, from 0."
    ),
    "counter_type": Key(
        Choice([kind for kind in NUMBER_TYPES if kind.startswith("u")]),
        meaning="Type of the number of the sample in a frame.",
    ),
    "checksum": Key(
        Choice(CHECKSUMS), meaning="Checksum at the end of a frame, of all bytes before it."
    ),
}
INSTRUMENT_KEYS = {
    "serial_number": Key(_NAME, meaning="Serial number of the instrument."),
    "model": Key(_NAME, meaning="Product name of the instrument."),
    "adc_bits": Key(Integer(8, 24), meaning="Bits of the converter."),
    "adc_range_v": Key(
        Number("V", above=0), "adc_range", "Full scale: the converter covers -range to +range."
    ),
}
CHANNEL_KEYS = {
    "name": Key(
        _NAME,
        meaning="Name of the channel.",
        hint="`pfwd ports` shows the names",
        required=True,
    ),
    "role": Key(Choice(QUANTITY_BY_ROLE), "quantity", "Measured quantity."),
    "column": Key(Integer(1, MAX_COLUMNS), meaning="Column of the ASCII lines, from 1."),
    "byte": Key(Integer(0, MAX_FIXED_BYTES), meaning="Place in the frame of a logger, from 0."),
    "type": Key(
        Choice([kind for kind in NUMBER_TYPES if not kind.startswith("u32")]),
        meaning="Type of the number in the frame of a logger.",
    ),
    "input": Key(Integer(0, 255), meaning="Number of the input of a logger, as printed on it."),
    "range_v": Key(
        Number("V", above=0),
        "adc_range",
        "Full scale of the input of a logger: it covers -range to +range.",
    ),
    "delay_s": Key(
        Number("s", minimum=0, maximum=0.01),
        "delay",
        "Time of its sample after the start of the scan, if the converter samples one channel "
        "after the other.",
    ),
    "resolution": Key(_POSITIVE, meaning="Value of one count of the ASCII lines."),
    "offset_m": Key(
        Number("m"),
        "offset",
        "Distance from the plate centre; negative on the other side of the plate.",
    ),
    "sensitivity": Key(
        Number("V per N, V per m/s or V per m", nonzero=True),
        meaning="Sensitivity; negative for a sensor that is mounted upside down.",
    ),
    "zero_v": Key(Number("V"), "zero", "Reading at rest."),
    "natural_frequency_hz": Key(
        Number("Hz", above=0),
        "natural_frequency",
        "Natural frequency of the geophone.",
        hint="for a corrected velocity leave it out, and write geophone_natural_frequency_hz = 0.0 "
        "at the top of the file",
    ),
    "damping": Key(_POSITIVE, meaning="Damping ratio of the geophone."),
    "shunt_n": Key(
        Number("N", above=0), "shunt", "Load that the calibration shunt of the load cell simulates."
    ),
    "calibrated": Key(Date(), meaning="Date of the calibration."),
    "due": Key(Date(), meaning="Date on which the calibration expires."),
}
DETECTION_KEYS = {
    "threshold_n": Key(Number("N", above=0), "threshold", "Load above which a drop may begin."),
    "noise_factor": Key(
        _POSITIVE, meaning="Smallest threshold over the standard deviation of the noise."
    ),
    "hysteresis": Key(
        Number(above=0, below=1), meaning="Load at which an impact ends, over the threshold."
    ),
    "confirm_s": Key(
        Number("s", above=0), "confirm", "Time that the load must stay above the threshold."
    ),
    "pre_trigger_s": Key(Number("s", above=0), "pre_trigger", "Record before the trigger."),
    "post_trigger_s": Key(Number("s", above=0), "post_trigger", "Record after the trigger."),
    "rebound_window_s": Key(
        Number("s", above=0),
        "rebound_window",
        "Time after a drop in which an impact is a rebound of the weight.",
    ),
    "rebound_pre_trigger_s": Key(
        Number("s", above=0), "rebound_pre_trigger", "Record before the trigger of a rebound."
    ),
    "rebound_post_trigger_s": Key(
        Number("s", above=0), "rebound_post_trigger", "Record after the trigger of a rebound."
    ),
}
TABLES = {
    "link": Key(TomlTable(LINK_KEYS), meaning="Link to the instrument."),
    "logger": Key(TomlTable(LOGGER_KEYS), meaning="Lines or frames of a logger without a driver."),
    "instrument": Key(TomlTable(INSTRUMENT_KEYS), meaning="Instrument."),
    "channels": Key(Array(TomlTable(CHANNEL_KEYS)), meaning="Channels, one table each."),
    "detection": Key(TomlTable(DETECTION_KEYS), meaning="Detection of drops."),
}
"""Tables of a setup file that describe the instrument, and their keys."""


@dataclass(frozen=True, slots=True)
class DeviceSetup:
    """Values of a setup file that describe the instrument.

    Without any value the identity that the instrument reports is used unchanged.
    """

    dialect: str = DEFAULT
    """Name of a dialect in `pfwd_device.wire.registry`."""
    baud_rate: int = 115_200
    """Speed of a serial port; a USB port with its own protocol ignores it."""
    sampling_rate: float | None = None
    """Requested rate, Hz; with ASCII lines the rate that the instrument has."""
    logger: Mapping[str, Any] = field(default_factory=dict)
    """Values of `LOGGER_KEYS`."""
    instrument: Mapping[str, Any] = field(default_factory=dict)
    """Fields of `Identity` that override those of the instrument."""
    channels: tuple[Mapping[str, Any], ...] = ()
    """Declared values of each channel: "name", other fields of `ChannelIdentity`, and for ASCII
    lines "column" and "resolution"."""
    detection: DetectionSettings = field(default_factory=DetectionSettings)
    """Settings of the detection of drops."""

    @property
    def _entry(self) -> DialectEntry:
        entry = find_dialect(self.dialect)
        if entry is None:
            expected = LINK_KEYS["dialect"].value.expected
            raise SetupError(refusal("setup, dialect", expected, quote(self.dialect)))
        return entry

    @property
    def needs_identity(self) -> bool:
        """True if the file has to declare the identity, because the instrument reports none."""
        return self._entry.needs_identity

    def apply(self, identity: Identity) -> Identity:
        """Return an identity in which the values of the file replace those of the instrument.

        Parameters
        ----------
        identity : Identity
            Identity that the instrument reported.

        Raises
        ------
        SetupError
            If the file names a channel that the instrument does not have, or a value is invalid.
        """
        if self.needs_identity:
            return identity
        channels = list(identity.channels)
        names = [channel.name for channel in channels]
        for declared in self.channels:
            name = declared["name"]
            if names.count(name) != 1:
                expected = f"a name among {', '.join(map(repr, names))}"
                raise SetupError(refusal("setup, channels", expected, repr(name)))
            fields = {key: value for key, value in declared.items() if key in _CHANNEL_FIELDS}
            index = names.index(name)
            channels[index] = dataclasses.replace(channels[index], **fields)
        return dataclasses.replace(identity, **self.instrument, channels=tuple(channels))

    def make_dialect(self, first_stream: int = 0) -> Dialect:
        """Return a new decoder and encoder for the protocol (dialect) of the instrument.

        Parameters
        ----------
        first_stream : int
            Number of the first stream, for an instrument that does not number its streams. A
            stream is a run of samples between a start or reset and the next. Stream and sample
            index identify a drop, so different days need different numbers.

        Raises
        ------
        SetupError
            If a value is missing that an instrument of this dialect does not report.
        """
        entry = self._entry
        identity = self.declared_identity() if self.needs_identity else None
        columns: list[int] = []
        inputs: list[int] = []
        if entry.needs_columns:
            columns = [channel["column"] - 1 for channel in self.channels]
        if entry.needs_inputs:
            inputs = [channel["input"] for channel in self.channels]
        resolution = [channel.get("resolution", 1.0) for channel in self.channels]
        numbers: list[tuple[int, str]] = []
        if entry.needs_frames:
            numbers = [(channel["byte"], channel["type"]) for channel in self.channels]
        return entry.make(
            DeclaredLink(
                identity,
                tuple(columns),
                tuple(inputs),
                tuple(resolution),
                self._line_layout() if entry.needs_columns else None,
                self._frame_layout() if entry.needs_frames else None,
                tuple(numbers),
                first_stream,
            )
        )

    def _line_layout(self) -> LineLayout:
        declared = self.logger
        counter, time = declared.get("counter_column"), declared.get("time_column", 1)
        return LineLayout(
            declared.get("separator", ","),
            counter or time or None,
            None if counter else _TIME_UNITS[declared.get("time_unit", "us")],
            declared.get("counter_bits", 32),
            declared.get("start", "").encode(),
            declared.get("stop", "").encode(),
        )

    def _frame_layout(self) -> FrameLayout:
        """Return the declared layout of frames.

        Raises
        ------
        SetupError
            If a value is missing, or the head has no hexadecimal digits.
        """
        declared = self.logger
        for key in ("head", "frame_bytes"):
            if key not in declared:
                raise SetupError(_missing(f"logger: {key}", self._entry.title))
        try:
            head = bytes.fromhex(declared["head"])
        except ValueError:
            expected = "pairs of hexadecimal digits, as in AA55"
            raise SetupError(refusal("logger: head", expected, quote(declared["head"]))) from None
        place = declared.get("counter_byte")
        return FrameLayout(
            head,
            declared["frame_bytes"],
            None if place is None else (place, declared.get("counter_type", "u16le")),
            declared.get("checksum"),
            declared.get("start", "").encode(),
            declared.get("stop", "").encode(),
        )

    def declared_identity(self) -> Identity:
        """Return the declared identity of an instrument that does not report one.

        Raises
        ------
        SetupError
            If the file does not declare each value that this needs; the message names the key.
        """
        entry, title = self._entry, self._entry.title
        required = ["quantity", "sensitivity"]
        if entry.needs_columns or entry.needs_inputs:
            required.insert(0, "column" if entry.needs_columns else "input")
        if entry.needs_frames:
            required = ["byte", "type", *required]
        if self.sampling_rate is None:
            raise SetupError(_missing("link: sampling_rate_hz", title))
        if not self.channels:
            raise SetupError(_missing("[[channels]]", title))
        for channel in self.channels:
            where = f"channels, {channel['name']!r}"
            for key in required:
                if key not in channel:
                    raise SetupError(_missing(f"{where}: {key.replace('quantity', 'role')}", title))
        converter = {"adc_bits": 16, "adc_range": 10.0} if entry.needs_inputs else {}
        for key in ("adc_bits", "adc_range"):
            if key not in converter and key not in self.instrument:
                raise SetupError(_missing(f"instrument: {key.replace('range', 'range_v')}", title))
        identities = [
            ChannelIdentity(
                **{key: value for key, value in channel.items() if key in _CHANNEL_FIELDS}
            )
            for channel in self.channels
        ]
        defaults = {"serial_number": "unknown", "model": title, "firmware": ""}
        identity = Identity(
            **{**defaults, **converter, **self.instrument},
            sampling_rate=self.sampling_rate,
            channels=tuple(identities),
        )
        load_channel(identity)  # refuses channels without a load cell
        sensor_channels(identity)  # and without a sensor of motion
        return identity


_CHANNEL_FIELDS = {item.name for item in dataclasses.fields(ChannelIdentity)}


def read_device_setup(table: Mapping[str, Any], where: str) -> DeviceSetup:
    """Return the instrument part of a setup file.

    Parameters
    ----------
    table : mapping
        Content of the file as the TOML parser returned it, restricted to the keys of `TABLES`.
    where : str
        Name of the file, for messages.

    Raises
    ------
    SetupError
        If a key is unknown or a value outside its range; the message names file, table and key.
    """
    values = TableReader(SetupError, where).read(table, TABLES)
    channels: tuple[dict[str, Any], ...] = values.get("channels", ())
    for channel in channels:
        if "quantity" in channel:
            channel["quantity"] = QUANTITY_BY_ROLE[channel["quantity"]]
    for key in ("name", "column", "input"):
        values_of_key = [channel.get(key) for channel in channels]
        for value in values_of_key:
            if value is not None and values_of_key.count(value) > 1:
                place = f"{where}, channels: {key}"
                raise SetupError(refusal(place, "each value once", f"{quote(value)} twice"))
    try:
        detection = DetectionSettings(**values.get("detection", {}))
        setup = DeviceSetup(
            **values.get("link", {}),
            logger=values.get("logger", {}),
            instrument=values.get("instrument", {}),
            channels=channels,
            detection=detection,
        )
        if setup.needs_identity:
            setup.declared_identity()
    except SetupError as err:
        raise SetupError(f"{where}: {err}") from err
    return setup


def _missing(key: str, title: str) -> str:
    reason = f"an instrument with the dialect {title!r} does not report it: add it to the file"
    return refusal(key, "a value", "none", reason)
