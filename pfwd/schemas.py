"""JSON Schemas of the files that users write, by which editors complete and check them."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from pfwd.files import header, report_settings
from pfwd.files.foreign import column_map
from pfwd.judging.job import JOB_KEYS
from pfwd.procedures import reading
from pfwd.session.setup_file import SETUP_KEYS
from pfwd_device.schema import JSON_SCHEMA, Integer, Key, table_schema


class _Description(NamedTuple):
    title: str
    keys: Mapping[str, Key]
    more_keys: bool = False


def _version(name: str, version: int) -> dict[str, Key]:
    return {name: Key(Integer(version, version), meaning="Version of the format.")}


_VERSIONED_HEADER_KEYS = {
    **_version(header.TRACES_FORMAT_KEY, header.TRACES_FORMAT_VERSION),
    **header.HEADER_KEYS,
}
_PROCEDURE_VERSION = _version(reading.PROFILE_FORMAT_KEY, reading.FORMAT_VERSION)

_DESCRIPTIONS = {
    "setup": _Description("Setup file of a measurement", SETUP_KEYS),
    "header": _Description(
        "Header of a trace file, or a file of --header", _VERSIONED_HEADER_KEYS, True
    ),
    "column-map": _Description(
        "Column map of a delimited text", {**header.HEADER_KEYS, **column_map.COLUMN_MAP_KEYS}, True
    ),
    "procedure": _Description(
        "Measuring procedure", {**_PROCEDURE_VERSION, **reading.PROFILE_KEYS}
    ),
    "report": _Description("Settings of all reports: report.toml", report_settings.REPORT_KEYS),
    "job": _Description("Job of a survey: details of an event job", JOB_KEYS, True),
}

DEVICE = "device"


def schema_names() -> list[str]:
    """Return the names of the kinds of files that have a schema."""
    return [*_DESCRIPTIONS, DEVICE]


def json_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind of file.

    Parameters
    ----------
    name : str
        One of :func:`schema_names`.
    """
    if name == DEVICE:
        from pfwd.analysis.diagnosis.device_file import device_keys  # loads the diagnosis

        description = _Description("Effects of a device, for pfwd diagnose --device", device_keys())
    else:
        description = _DESCRIPTIONS[name]
    title, keys, more_keys = description
    # Not required, because the radius may be in another file or an option.
    keys = {
        key: item.optional() if key == header.RADIUS_KEY else item for key, item in keys.items()
    }
    return {
        "$schema": JSON_SCHEMA,
        "title": title,
        **table_schema(keys, more_keys=more_keys),
    }
