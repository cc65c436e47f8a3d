"""The identity of an instrument as JSON knows it, for recordings."""

import dataclasses
import datetime
from collections.abc import Mapping
from typing import Any

from pfwd_device.errors import SetupError
from pfwd_device.identity import ChannelIdentity, Identity, Role

_DATES = ("calibrated", "due")


def identity_as_dict(identity: Identity) -> dict[str, Any]:
    """All fields, dates as ISO 8601 texts."""
    table = dataclasses.asdict(identity)
    table["channels"] = [_channel_as_dict(channel) for channel in identity.channels]
    return table


def _channel_as_dict(channel: ChannelIdentity) -> dict[str, Any]:
    table = dataclasses.asdict(channel)
    table["role"] = str(channel.role)
    for name in _DATES:
        table[name] = table[name] and table[name].isoformat()
    return table


def identity_from_dict(table: Mapping[str, Any]) -> Identity:
    """The inverse of `identity_as_dict`.

    Raises
    ------
    SetupError
        If something is missing or outside of its range.
    """
    try:
        channels = tuple(map(_channel_from_dict, table["channels"]))
        return Identity(**{**table, "channels": channels})
    except (AttributeError, KeyError, TypeError, ValueError) as err:
        if isinstance(err, SetupError):
            raise
        raise SetupError(f"recorded identity: expected all fields of an instrument: {err}") from err


def _channel_from_dict(table: Mapping[str, Any]) -> ChannelIdentity:
    dates = {
        name: datetime.date.fromisoformat(table[name]) if table.get(name) else None
        for name in _DATES
    }
    return ChannelIdentity(**{**table, "role": Role(table["role"]), **dates})
