"""Formats that ``pfwd import`` reads again: ``survey``, the survey in one file, and ``csv``, a
folder of traces.
"""

import os
import re
from collections.abc import Mapping
from dataclasses import replace
from itertools import count, groupby
from typing import Any

from inversion.notices import text_of
from pfwd.analysis.screening.drops import unbroken_part
from pfwd.errors import SurveyError, refusal
from pfwd.export.output import new_file, new_folder
from pfwd.export.rows import Order
from pfwd.files.header import PointSetup
from pfwd.files.reading import points_of
from pfwd.files.survey_file import write_survey_file
from pfwd.files.traces import TracePoint, write_traces
from pfwd_device import Drop
from pfwd_device.errors import RecordingError

MAX_FILE_NAME_CHARACTERS = 60
"""Largest number of characters of the point's name in the name of its file."""

TRACE_SUFFIX = ".csv"


def write_survey(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write the survey into one file (``.pfwdz``), which every command accepts in place of its
    folder.

    Parameters
    ----------
    order : Order
    path : path of the file

    Returns
    -------
    list of str
        One sentence for each damaged or omitted file.
    """
    with new_file(path, force=order.force) as draft:
        return write_survey_file(draft, order.content)


def write_csv(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write the traces of all drops that are not discarded, one file for each test point.

    Parameters
    ----------
    order : Order
    path : path of the folder

    Returns
    -------
    list of str
        One sentence for each omission.

    Raises
    ------
    SurveyError
        If no drop has traces, or a drop is damaged.
    """
    notes: list[str] = []
    has_peaks_only = False
    numbers = count(1)
    with new_folder(path, TRACE_SUFFIX, force=order.force) as folder:
        for content in order.content.points:
            try:
                points = list(points_of(order.content.path, content))
            except RecordingError as err:
                raise SurveyError(f"{err}; pfwd edit --discard leaves it out") from err
            for point in points:
                drops = [drop for drop in point.drops if _is_exportable(drop, point, notes)]
                has_peaks_only |= any(drop.only_peaks is not None for drop in point.drops)
                parts = [unbroken_part(drop)[0] for drop in drops]
                # A trace file has one set of sensors for all its drops.
                for _, group in groupby(parts, key=_sensors):
                    name = f"{next(numbers):04d}-{safe_name(content.title)}{TRACE_SUFFIX}"
                    write_traces(folder / name, TracePoint(name, _plain(point.setup), tuple(group)))
        discarded = sum(
            point.discarded or drop.discarded
            for point in order.content.points
            for drop in point.drops
        )
        if discarded:
            notes.append(f"{discarded} discarded drops are left out")
        if next(numbers) == 1:
            where = order.content.path
            if has_peaks_only:
                raise SurveyError(
                    f"{where}: expected drops with traces for the format csv, got peaks only; "
                    "export them with --format table, jsonl or pddx"
                )
            raise SurveyError(refusal(where, "drops to export", "none"))
    return notes


def safe_name(text: str) -> str:
    """Return a text as a part of a file name that every operating system accepts.

    Examples
    --------
    >>> safe_name('km 12/3: "north"')
    'km 12_3_ _north_'
    """
    name = re.sub(r'[<>:"/\\|?*\x00-\x1f\x7f\ufffd]', "_", text)[:MAX_FILE_NAME_CHARACTERS]
    return name.rstrip(". ") or "point"


def _is_exportable(drop: Drop, point: TracePoint, notes: list[str]) -> bool:
    _, reason, warning = unbroken_part(drop)
    name = f"{point.setup.point}/{drop.number}"
    if reason is not None:
        notes.append(f"drop {name} is left out: {text_of(reason)}")
    elif warning is not None:
        notes.append(f"drop {name}: {text_of(warning)}")
    return reason is None


def _sensors(drop: Drop) -> tuple[tuple[str, float], ...]:
    return tuple((channel.quantity, channel.offset) for channel in drop.channels)


def _plain(setup: PointSetup) -> PointSetup:
    """Return the setup without values of None, which TOML cannot hold."""
    extra = {key: value for key, value in setup.extra.items() if value is not None}
    return replace(setup, extra=_without_null(extra))


def _without_null(value: Any) -> Any:
    match value:
        case Mapping():
            return {str(k): _without_null(v) for k, v in value.items() if v is not None}
        case list() | tuple():
            return [_without_null(item) for item in value if item is not None]
    return value
