"""Declarations of a test point: what an operator or file states about plate, ground and instrument.

They are written as TOML lines ``key = value`` in the header of a trace file, in a separate header
file, or in a setup file. `PointSetup` holds the keys, with unit and range of each.
"""

import dataclasses
import datetime
import math
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from inversion.notices import Notice, from_json
from pfwd.errors import TraceError, quote, refusal
from pfwd.files.toml import toml_line
from pfwd.procedures.point import LARGEST_PLATE_RADIUS_M
from pfwd.toml_reading import parse_toml, parse_user_toml, read_toml_text
from pfwd_device.schema import (
    AnyOf,
    Choice,
    Date,
    Integer,
    Key,
    Number,
    Text,
    declared,
    describe,
    keys_of,
)
from pfwd_device.text import clean
from pfwd_plugins.quantities import Measurand

if TYPE_CHECKING:
    from pfwd_device import Drop

TRACES_FORMAT_KEY = "pfwd-traces"
TRACES_FORMAT_VERSION = 1

RADIUS_KEY = "plate_radius_m"
RESPONSE_KEY = "geophone_natural_frequency_hz"

PEAK_DEVIATIONS = "peak_deviations"
"""Key under `IMPORTED`: for each drop number the relative difference between the peaks of the
traces and the peaks that the other program stored."""

IMPORTED = "imported"
"""Key with further data from the file of another program; the texts under its ``remarks`` are shown
as warnings."""

REMARK_CODES = "remark_codes"
"""Key under `IMPORTED`: codes and values of the remarks, as under ``warning_codes``."""

MAX_REMARK_CHARACTERS = 300
"""Characters of a remark under `IMPORTED` that are shown."""

MIN_PLATE_RADIUS_M = 0.01
"""Smallest plausible plate radius: the smallest plate of a light device has 0.05 m, a smaller value
is in another unit."""

MIN_BEDROCK_DEPTH_M, MAX_BEDROCK_DEPTH_M = 0.01, 10_000.0
"""Range of the depth of a rigid base: no plate can stand on a layer thinner than the first, and one
deeper than the second has no influence."""

MAX_PLATE_RADIUS_M = 1.0
"""Largest plausible plate radius: real ones are up to 0.4 m, a larger value is in another unit."""

MIN_PLATE_MASS_KG_M2 = 15.0
"""Smallest plausible mass of a plate by its area: a sheet of steel 2 mm thick. Load plates are of
steel or aluminium, 15 mm and more."""

_KEY = re.compile(r"""[ \t]*(?:([\w-]+)|"([^"\\]*)"|'([^']*)')[ \t]*[.=]""")
"""Pattern of a key at the beginning of a line."""

FreeText = str | int | float

_FREE = AnyOf((Text(), Number()), "text in quotation marks or a finite number")


@dataclass(frozen=True, slots=True)
class PointSetup:
    """Declarations of one test point; None: not declared, hence unknown.

    Raises
    ------
    TraceError
        If a value is outside its range or of the wrong type; the message names the header key.
    """

    plate_radius: float = field(
        metadata=describe(
            Number("m", minimum=MIN_PLATE_RADIUS_M, maximum=LARGEST_PLATE_RADIUS_M),
            "Radius of the load plate; 0 in a stiffness test, which needs none.",
            key=RADIUS_KEY,
        )
    )
    plate_mass: float | None = declared(
        None,
        Number("kg", minimum=0),
        "Mass that moves between load cell and ground.",
        key="plate_mass_kg",
    )
    poisson_ratio: float | None = declared(
        None,
        Number(minimum=0, below=0.5),
        "Poisson's ratio of the ground.",
        hint="0.5 is an incompressible soil, whose pressure waves are infinitely fast and "
        "which no model here supports: use 0.49 for saturated clay",
    )
    density: float | None = declared(
        None, Number("kg/m3", above=0), "Density of the ground.", key="density_kg_m3"
    )
    bedrock_depth: float | None = declared(
        None,
        Number(
            "m",
            minimum=MIN_BEDROCK_DEPTH_M,
            maximum=MAX_BEDROCK_DEPTH_M,
            infinity_means="none",
        ),
        "Depth of a rigid base; inf: known to have none.",
        key="bedrock_depth_m",
    )
    centre_sensor: Literal["plate", "ground"] = declared(
        "plate",
        Choice(("plate", "ground")),
        'Support of the sensor at offset 0; "ground" is through a hole in the plate.',
    )
    geophone_natural_frequency: float | None = declared(
        None,
        Number("Hz", minimum=0),
        "Natural frequency of the response that the velocity columns still carry; 0: the "
        "record is corrected.",
        key=RESPONSE_KEY,
        hint="0 where the record is corrected",
    )
    geophone_damping: float | None = declared(
        None,
        Number(above=0),
        "Damping ratio of that response; declared together with the frequency, and not needed "
        "with 0 Hz.",
    )
    load_filter_frequency: float | None = declared(
        None,
        Number("Hz", above=0),
        "Corner frequency of the filter in the load channel.",
        key="load_filter_hz",
    )
    load_delay: float | None = declared(
        None, Number("s"), "Delay of the load channel.", key="load_delay_s"
    )
    seating_drops: int = declared(0, Integer(0), "Number of seating drops, the first of a point.")
    model_floor: float | None = declared(
        None,
        Number("m", minimum=0),
        "Displacement error that the user concedes to the model.",
        key="model_floor_m",
    )
    calibrated: str | None = declared(
        None,
        Date(text=True),
        "Date of the calibration of load cell and sensors.",
    )
    device: FreeText | None = declared(
        None,
        _FREE,
        "Identity of the instrument; points with the same one share the device's effects.",
    )
    site: FreeText | None = declared(None, _FREE, "Name of the site.")
    point: FreeText | None = declared(None, _FREE, "Name of the test point.")
    operator: FreeText | None = declared(None, _FREE, "Name of the operator.")
    latitude: FreeText | None = declared(None, _FREE, "Degrees, north positive, when a number.")
    longitude: FreeText | None = declared(None, _FREE, "Degrees, east positive, when a number.")
    time_utc: FreeText | None = declared(
        None, _FREE, "Time of the test; dates and times of TOML are stored as their ISO 8601 text."
    )
    source: FreeText | None = declared(None, _FREE, "Origin of the record.")
    procedure: FreeText | None = declared(
        None,
        _FREE,
        "Name of the measuring procedure; with one, rejected drops do not count as seating.",
    )
    material: FreeText | None = declared(
        None, _FREE, "Soil or layer, as a procedure's targets name it."
    )
    photos: FreeText | None = declared(
        None, _FREE, "Names of pictures of the point, separated by commas."
    )
    zone: FreeText | None = declared(
        None, _FREE, "Part of the site that the point counts to in statistics."
    )
    plate_load_modulus: float | None = declared(
        None,
        Number("Pa", above=0),
        "Modulus of a static plate load test at the point.",
        key="plate_load_modulus_pa",
    )
    moisture: float | None = declared(
        None,
        Number("percent by mass", minimum=0),
        "Moisture of the ground.",
        key="moisture_percent",
    )
    test: Literal["ground", "stiffness"] = declared(
        "ground",
        Choice(("ground", "stiffness")),
        'Object of the test; "stiffness" is a rig of springs, which has no modulus.',
    )
    rig_stiffness: float | None = declared(
        None, Number("N/m", above=0), "Known stiffness of that rig.", key="stiffness_n_per_m"
    )
    temperature: float | None = declared(
        None,
        Number("degrees Celsius", minimum=-90, maximum=100),
        "Temperature of air or ground.",
        key="temperature_c",
    )
    extra: Mapping[str, Any] = field(default_factory=dict, hash=False)
    """Keys that the format does not define, with their TOML values."""

    def __post_init__(self) -> None:
        for key, description in HEADER_KEYS.items():
            value = getattr(self, description.attribute)
            if key == RADIUS_KEY and value == 0 and self.is_stiffness_test:
                continue
            if value is not None:
                check_value(key, value, "header")
        corrected = self.geophone_natural_frequency == 0 and self.geophone_damping is None
        incomplete = (self.geophone_natural_frequency is None) != (self.geophone_damping is None)
        if incomplete and not corrected:
            present, missing = RESPONSE_KEY, "geophone_damping"
            if self.geophone_natural_frequency is None:
                present, missing = missing, present
            expected = f"{RESPONSE_KEY} and geophone_damping together"
            hint = f"declare {missing} too, or {RESPONSE_KEY} = 0 if the record is corrected"
            raise TraceError(refusal("header", expected, f"{present} alone", hint))
        clashing = sorted(set(self.extra) & (set(HEADER_KEYS) | {TRACES_FORMAT_KEY}))
        if clashing:
            raise TraceError(refusal("header", "keys unknown to the format in extra", clashing[0]))

    @property
    def is_stiffness_test(self) -> bool:
        """True if the drops fell on a calibration rig of springs and not on ground."""
        return self.test == "stiffness" or self.rig_stiffness is not None


HEADER_KEYS: Mapping[str, Key] = keys_of(PointSetup)
"""Header keys in their order, each with its attribute of `PointSetup`, type, unit and range."""


def check_value(key: str, value: object, where: str) -> None:
    """Raise TraceError if a header key does not accept a value.

    Parameters
    ----------
    key : str
        One of `HEADER_KEYS`.
    value : object
        TOML value.
    where : str
        File and line, or option, for the message.
    """
    HEADER_KEYS[key].check(value, f"{where}, {key}", TraceError)


class Declaration(NamedTuple):
    """Declared value with the place where it is written."""

    value: Any
    """TOML value."""
    where: str
    """File and line, for messages."""


Declarations = dict[str, Declaration]


def parse_declaration(text: str, where: str) -> tuple[str, Declaration] | None:
    """Return key and value of one header line.

    Parameters
    ----------
    text : str
        The line without the ``#`` before it.
    where : str
        File and line, for messages.

    Returns
    -------
    tuple of str and Declaration, or None
        None: the line is blank or a comment.

    Raises
    ------
    TraceError
        If the line is not one ``key = value`` of TOML.
    """
    expected = "one TOML key = value"
    try:
        table = parse_toml(text)
    except ValueError as err:  # also for numbers of any length
        hint = 'text goes in quotation marks, as in site = "km 12"; a decimal sign is a point'
        raise TraceError(refusal(where, expected, quote(text.strip()), hint)) from err
    if not table:
        return None
    ((key, value),) = table.items()
    if text.lstrip().startswith("["):
        hint = "write the key without a table in square brackets"
        raise TraceError(refusal(where, expected, quote(text.strip()), hint))
    return key, Declaration(value, where)


def declarations_of(
    header: str | os.PathLike[str] | None, overrides: Mapping[str, object] | None = None
) -> Declarations:
    """Return the declarations that replace those of files.

    Parameters
    ----------
    header : path of a TOML file or None
    overrides : mapping of header key to value, optional
        Override those of the header file.

    Raises
    ------
    TraceError
        If the file cannot be read or is not TOML.
    """
    declared: Declarations = {}
    if header is not None:
        declared = parse_header(read_toml_text(header, TraceError), os.fspath(header))
    return declared | {key: Declaration(v, "command line") for key, v in (overrides or {}).items()}


def parse_header(text: str, file: str) -> Declarations:
    """Return the declarations of a TOML text, each with its line for messages.

    Parameters
    ----------
    text : str
    file : str
        File name for messages.

    Returns
    -------
    dict of str to Declaration
        By header key.

    Raises
    ------
    TraceError
        If the text is not TOML.
    """
    table = parse_user_toml(text, file, TraceError)
    lines: dict[str, int] = {}
    for number, line in enumerate(text.split("\n"), start=1):
        if (match := _KEY.match(line)) is not None:
            lines.setdefault(match[1] or match[2] or match[3], number)
    return {
        key: Declaration(value, f"{file}, line {lines[key]}" if key in lines else file)
        for key, value in table.items()
    }


def setup_from(declarations: Mapping[str, Declaration], where: str) -> PointSetup:
    """Check declarations and return them as a `PointSetup`.

    Parameters
    ----------
    declarations : mapping of str to Declaration
        By header key.
    where : str
        Place for messages about missing keys: the file, and the line at which its header ends.

    Returns
    -------
    PointSetup

    Raises
    ------
    TraceError
        If the plate radius is missing, a value is outside its range, or only one of the two keys of
        the geophone is declared.
    """
    values: dict[str, Any] = {}
    extra: dict[str, Any] = {}
    for key, (value, place) in declarations.items():
        if key == TRACES_FORMAT_KEY:
            if type(value) is not int or value != TRACES_FORMAT_VERSION:
                expected = f"{TRACES_FORMAT_KEY} = {TRACES_FORMAT_VERSION}"
                hint = "a file of a newer version needs a newer program"
                raise TraceError(refusal(place, expected, quote(value), hint))
            continue
        if key not in HEADER_KEYS:
            extra[key] = value
            continue
        kind = HEADER_KEYS[key].value
        if isinstance(value, datetime.date | datetime.time) and (
            kind is _FREE or isinstance(kind, Date)
        ):
            value = value.isoformat()
        check_value(key, value, place)
        values[HEADER_KEYS[key].attribute] = value
    if values.get("test") == "stiffness" or "rig_stiffness" in values:
        values.setdefault("plate_radius", 0.0)
    if "plate_radius" not in values:
        hint = (
            f"declare it there, or write {RADIUS_KEY} = 0.15 (in m) into a TOML file and give it "
            "with --header; invert and diagnose take --plate-radius 0.15 as well"
        )
        if extra:
            hint += f" (keys outside the format: {quote(', '.join(extra))})"
        raise TraceError(refusal(where, "a header key plate_radius_m", "none", hint))
    try:
        return PointSetup(**values, extra=extra)
    except TraceError as err:
        raise TraceError(f"{where}: {err}") from err


def declared_values(setup: PointSetup) -> dict[str, Any]:
    """Return the values of a setup by header key, without those that equal the default."""
    defaults = {item.name: item.default for item in dataclasses.fields(PointSetup)}
    values = {key: getattr(setup, rule.attribute) for key, rule in HEADER_KEYS.items()}
    stated = {key: v for key, v in values.items() if v != defaults[HEADER_KEYS[key].attribute]}
    if setup.is_stiffness_test and setup.plate_radius == 0:
        del stated[RADIUS_KEY]
    return {**stated, **setup.extra}


def declared_lines(setup: PointSetup) -> Iterator[str]:
    """Yield the header lines of a setup without ``#``, the format version first."""
    yield toml_line(TRACES_FORMAT_KEY, TRACES_FORMAT_VERSION)
    for key, value in declared_values(setup).items():
        yield toml_line(key, value)


def setup_warnings(setup: PointSetup, drops: "Sequence[Drop]" = ()) -> tuple[Notice, ...]:
    """Return the warnings about missing or implausible declarations.

    Parameters
    ----------
    setup : PointSetup
    drops : sequence of Drop
        Drops of the point; a velocity channel among them needs a declared geophone response.
    """
    warnings = []
    if setup.is_stiffness_test:
        warnings.append(Notice("stiffness-test"))
    elif setup.plate_mass is None:
        warnings.append(Notice("plate-mass-not-declared"))
    elif (
        setup.plate_radius <= MAX_PLATE_RADIUS_M
        and setup.plate_mass < MIN_PLATE_MASS_KG_M2 * math.pi * setup.plate_radius**2
    ):
        values = {"plate_mass_kg": setup.plate_mass, "plate_radius_m": setup.plate_radius}
        warnings.append(Notice("plate-mass-too-small", values))
    if setup.geophone_natural_frequency is None and any(
        channel.quantity is Measurand.VELOCITY for drop in drops for channel in drop.channels
    ):
        warnings.append(Notice("geophone-not-declared"))
    if setup.plate_radius > MAX_PLATE_RADIUS_M:
        warnings.append(Notice("plate-radius-suspect", {"plate_radius_m": setup.plate_radius}))
    warnings += [
        Notice("header-key-unknown", {"key": quote(key)}) for key in setup.extra if key != IMPORTED
    ]
    return (*warnings, *remark_notices(setup.extra))


def remark_notices(values: Mapping[str, Any]) -> tuple[Notice, ...]:
    """Return the remarks of `remarks_of` as warnings, with the codes of the file's reader."""
    sentences = [clean(text, limit=MAX_REMARK_CHARACTERS) for text in remarks_of(values)]
    details = values.get(IMPORTED)
    codes = details.get(REMARK_CODES) if isinstance(details, Mapping) else None
    return from_json(sentences, codes)


def remarks_of(values: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the remarks on how another program's file was read.

    Parameters
    ----------
    values : mapping of header key to value
        The remarks are the list ``remarks`` under the key `IMPORTED`; anything else yields none.
    """
    details = values.get(IMPORTED)
    remarks = details.get("remarks") if isinstance(details, Mapping) else None
    if not isinstance(remarks, list | tuple):
        return ()
    return tuple(text for text in remarks if isinstance(text, str))


def is_position(latitude: float, longitude: float) -> bool:
    """Return whether two numbers in degrees are in the range of a latitude and of a longitude."""
    return abs(latitude) <= 90 and abs(longitude) <= 180
