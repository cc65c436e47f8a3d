"""The part of a report on the instruments, their channels and the last check of the sensors."""

import math
from collections.abc import Mapping
from typing import Any

from pfwd.report import shown
from pfwd.report.blocks import Block, Heading, Pairs, Paragraph, Table
from pfwd.report.content import Report
from pfwd.report.texts import Texts


def device_blocks(report: Report, texts: Texts) -> list[Block]:
    """What measured the survey, and what its check said last."""
    blocks: list[Block] = [Heading(texts["device"])]
    if not report.instruments:
        return [*blocks, Paragraph(texts["imported"], "note")]
    for identity in report.instruments:
        rows = (
            (texts["instrument"], str(identity.get("model") or "")),
            (texts["serial"], str(identity.get("serial_number") or "")),
            (texts["firmware"], str(identity.get("firmware") or "")),
            (texts["rate"], shown.scaled(identity.get("sampling_rate"), 1.0, "Hz", 4)),
            (texts["plate"], _plate(identity, texts)),
        )
        blocks.append(Pairs(tuple(row for row in rows if row[1])))
        names = ("channel", "role", "offset", "sensitivity", "response", "calibrated", "due")
        channels = [_channel(channel, texts) for channel in identity.get("channels") or ()]
        blocks.append(Table(tuple(texts[name] for name in names), tuple(channels), (2, 3)))
    if report.check is not None:
        blocks.append(Pairs(((texts["check"], _check(report.check, texts)),)))
    return blocks


def _plate(identity: Mapping[str, Any], texts: Texts) -> str:
    radius, mass = identity.get("plate_radius"), identity.get("plate_mass")
    parts = [f"r = {radius:g} m"] if radius is not None else []
    parts += [f"m = {mass:g} kg"] if mass is not None else []
    return ", ".join([*parts, texts.word(f"sensor_on_{identity.get('centre_sensor')}")])


def _channel(channel: Mapping[str, Any], texts: Texts) -> tuple[str, ...]:
    frequency, damping = channel.get("natural_frequency"), channel.get("damping")
    response = shown.NOTHING
    if frequency is not None and damping is not None:
        response = f"{frequency:g} Hz, {damping:g}"
    return (
        str(channel.get("name") or ""),
        texts.word(str(channel.get("role") or "")),
        f"{channel.get('offset', 0):g} m",
        f"{channel.get('sensitivity', math.nan):.4g}",
        response,
        str(channel.get("calibrated") or shown.NOTHING),
        str(channel.get("due") or shown.NOTHING),
    )


def _check(check: Mapping[str, Any], texts: Texts) -> str:
    details = check.get("details", check)
    parts = [str(check.get("time_utc") or "")]
    if isinstance(details.get("zero_n"), int | float):
        parts.append(texts.say("check_zero", value=f"{details['zero_n']:.0f}"))
    if isinstance(details.get("span_ratio"), int | float):
        parts.append(texts.say("check_span", value=f"{100 * details['span_ratio']:.1f}"))
    faults = [texts.message(str(fault)) for fault in details.get("faults") or ()]
    parts += faults or [texts["check_passed"]]
    return ", ".join(part for part in parts if part)
