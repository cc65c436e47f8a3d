"""Calibration of a load cell by the momentum of a hammer, and of a geophone by its decay."""

import csv
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from inversion import InversionError
from inversion.arrays import FloatArray
from inversion.momentum import Contact, MomentumGain, contact_of, gain_by_momentum
from inversion.ring_down import Decay, decays
from pfwd.analysis.screening.drops import clipped_samples, screen_point
from pfwd.errors import SurveyError, refusal
from pfwd.files.folders import is_hdf5
from pfwd.files.reading import read_points
from pfwd.files.traces import TracePoint
from pfwd.message_groups import text_of
from pfwd_device.calibration import calibrate
from pfwd_device.errors import SetupError
from pfwd_device.identity import identity_from_dict
from pfwd_device.recording import DropRecord, read_drop_file

MAX_DECAY_BYTES = 200_000_000
"""Largest text file with the decay of a geophone."""

_PULSE_S = 0.1
"""Time after the trigger, s, to which a record is cut before its screening, because the second
contact in a longer record is no fault here."""

_SENSOR_REASONS = frozenset(
    {"stiffness-test", "no-centre-channel", "centre-dead", "centre-not-credible"}
)
"""Codes of the reasons for which a drop is rejected although its load may be right."""


def gain_of_files(
    files: Sequence[str],
    mass: float,
    height: float,
    friction: float,
    *,
    point: str | None = None,
    header: str | None = None,
) -> tuple[MomentumGain, list[str]]:
    """Return the gain of the load cell from drops of a hammer, and reasons for unused drops.

    The second contact is in a long record, or is the first rebound that a survey has recorded with
    its drop.

    Parameters
    ----------
    files : sequence of str
    mass : float, kg
    height : float, m
        Height of fall.
    friction : float
        Largest friction of the guide over the weight.
    point : str, optional
        Only points whose names begin with this text are used.
    header : path of a TOML file, optional
        Declarations for all files.

    Raises
    ------
    SurveyError
        If a file is not valid, no drop reaches a second contact, or the drops do not repeat.
    """
    contacts: list[Contact] = []
    unused: list[str] = []
    for file in files:
        for traces in read_points(file, header):
            name = str(traces.setup.point or os.path.basename(file))
            if point is not None and not name.startswith(point):
                continue
            records = [drop.read() for drop in traces.survey_drops]
            if not records and is_hdf5(file):
                records = [read_drop_file(file)]
            records = records or [DropRecord("1", drop) for drop in traces.drops]
            for record, fault in zip(records, _load_faults(traces), strict=True):
                drop = record.drop
                try:
                    if fault is not None:
                        raise InversionError(fault)
                    contacts.append(contact_of(*_with_rebounds(record)))
                except InversionError as err:
                    unused.append(f"{name}, drop {drop.number}: {err}")
    where = ", ".join(files)
    if not contacts:
        hint = (
            "let the hammer bounce, and measure into a survey, which records the bounces; or "
            "record longer, with post_trigger_s = 1.0 in [detection] of the setup file"
        )
        got = unused[0] if unused else "none"
        raise SurveyError(refusal(where, "drops up to the second contact", got, hint))
    try:
        return gain_by_momentum(contacts, mass, height, friction), unused
    except InversionError as err:
        raise SurveyError(f"{where}: {err}") from err


def _load_faults(traces: TracePoint) -> Iterator[str | None]:
    """Yield for each drop the reason why its load cannot be used; None: it can."""
    short = []
    for drop in traces.drops:
        part = slice(int(np.searchsorted(drop.time, _PULSE_S)))
        channels = tuple(replace(each, values=each.values[part]) for each in drop.channels)
        short.append(replace(drop, time=drop.time[part], load=drop.load[part], channels=channels))
    for drop, screening in zip(
        short, screen_point(replace(traces, drops=tuple(short))), strict=True
    ):
        if screening.reason is not None and screening.reason.code not in _SENSOR_REASONS:
            yield text_of(screening.reason)
        else:
            yield "the load is clipped" if clipped_samples(drop.load) else None


def _with_rebounds(record: DropRecord) -> tuple[FloatArray, FloatArray]:
    """Return times, s, and load, N, of a drop and of its rebounds behind its record."""
    drop = record.drop
    parts = [(drop.time, drop.load)]
    for rebound in record.rebounds:
        try:
            identity = identity_from_dict(record.metadata["identity"])
            detection = record.metadata["detection"]
            trigger = detection["first_sample"] + detection["trigger"] - rebound.first_sample
            later = calibrate(drop.number, rebound.counts, (), trigger, identity)
        except (KeyError, TypeError, SetupError) as err:
            raise InversionError(f"expected the record of its detection, got {err!r}") from err
        is_new = later.time > parts[-1][0][-1]
        parts.append((later.time[is_new], later.load[is_new]))
    time, load = (np.concatenate(values) for values in zip(*parts, strict=True))
    return time, load


def decays_of_file(
    file: str, column: str | None, time_column: str | None = None, header: str | None = None
) -> Iterator[tuple[str, list[Decay]]]:
    """Yield the name of each record of a file and the windows of its decay.

    Parameters
    ----------
    file : str
        File of drops, whose sensors are used; or a text file with a head line of names.
    column, time_column : str, optional
        Columns of a text file: the values, and the times in s. Without ``column`` the file is one
        of drops.
    header : path of a TOML file, optional
        Declarations for a file of drops.

    Raises
    ------
    SurveyError
        If the file is not valid, or a record has no decaying oscillation.
    """
    if column is not None:
        time, values = _columns(file, column, time_column)
        yield column, _decays(file, time, values)
        return
    for traces in read_points(file, header):
        for drop in traces.drops:
            for channel in drop.channels:
                name = f"drop {drop.number}, sensor at {channel.offset:g} m"
                yield name, _decays(f"{file}, {name}", drop.time, channel.values)


def _decays(where: str, time: FloatArray, values: FloatArray) -> list[Decay]:
    try:
        return decays(time, values)
    except InversionError as err:
        raise SurveyError(f"{where}: {err}") from err


def _columns(file: str, column: str, time_column: str | None) -> tuple[FloatArray, FloatArray]:
    """Return the times, from 0, and the values of a column of a text file."""
    try:
        if os.path.getsize(file) > MAX_DECAY_BYTES:
            raise SurveyError(refusal(file, f"at most {MAX_DECAY_BYTES / 1e6:.0f} MB", "more"))
        with open(file, encoding="utf-8-sig", errors="replace", newline="") as stream:
            first = stream.readline()
            sign = max(",;\t", key=first.count)
            names = [name.strip() for name in next(csv.reader([first], delimiter=sign), [])]
            rows = list(csv.reader(stream, delimiter=sign))
    except OSError as err:
        raise SurveyError(f"{file}: {err.strerror or err}") from err
    places = []
    for name in (time_column or names[0] if names else "", column):
        if name not in names:
            raise SurveyError(refusal(file, f"one of the columns {', '.join(names)}", name))
        places.append(names.index(name))
    numbers = []
    for line, row in enumerate(rows, start=2):
        if not row:
            continue
        try:
            numbers.append([float(row[place]) for place in places])
        except (IndexError, ValueError):
            raise SurveyError(
                refusal(f"{file}, line {line}", "two numbers", f"{row}"[:60])
            ) from None
    table = np.array(numbers).reshape(-1, 2)
    return table[:, 0] - (table[0, 0] if len(table) else 0.0), table[:, 1]
