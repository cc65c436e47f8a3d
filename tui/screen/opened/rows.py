"""Points of a survey as rows with their verdicts, sorted and filtered; nothing is inverted."""

import dataclasses
import json
import math
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfwd.errors import DeviceError, SurveyError
from pfwd.files.folders import refuse_no_survey
from pfwd.files.output_path import replaced_at_once
from pfwd.message_groups import text_of
from pfwd.procedures import Quantity
from pfwd.units import SI, Fact
from pfwd_plugins.quantities import Unit
from tui.output import counted

if TYPE_CHECKING:
    # Loaded when the survey is read: the frame is painted before.
    from pfwd.judging import Job, PointView
    from pfwd.procedures import PointProgress

CACHE_VERSION = 6
"""Version of the cache, to be raised when rows have other fields or are judged otherwise."""

MAX_CACHE_BYTES = 50_000_000
"""Largest cache that is read, bytes; 5,000 points take 1.5 MB."""


@dataclass(frozen=True, slots=True)
class PointRow:
    """Point of a survey as a row of the table: name, place, judged value, verdict, modulus."""

    name: str
    """Name of the point in its drops."""
    title: str
    drops: int
    chainage_m: float | None = None
    latitude: float | None = None
    longitude: float | None = None
    notes: str = ""
    discarded: bool = False
    judged: bool = False
    """True once the fields below are known."""
    quantity: str = ""
    unit: str = ""
    value: float | None = None
    low: float | None = None
    high: float | None = None
    target: float | None = None
    verdict: str = ""
    """pass, fail, undecided or none."""
    reason: str = ""
    modulus: float | None = None
    """Modulus of the point in force, Pa."""
    modulus_low: float | None = None
    modulus_high: float | None = None
    """Ends of its 95 % interval, Pa; None: it has none."""
    modulus_marked: bool = False
    """True if the data do not support the modulus."""
    value_marked: bool = False
    """True if the value allows no verdict."""
    origin: str = ""
    """Origin of the value in words: mean of drops, or diagnosis."""
    use: str = ""
    """Use of the diagnosed modulus in words; empty: the point is not diagnosed."""
    unexplained: str = ""
    """Misfit of the diagnosis in percent of the peak; empty: the point is not diagnosed."""

    @property
    def judged_by(self) -> Quantity:
        """Quantity of the value; the modulus while the point is not judged."""
        return Quantity(self.quantity or Quantity.MODULUS)

    @property
    def display_unit(self) -> Unit:
        """Unit of the value on the screen."""
        return self.judged_by.display_unit

    @property
    def judged_fact(self) -> Fact:
        """Judged value with its interval; marked if it allows no verdict."""
        interval = None if self.low is None or self.high is None else (self.low, self.high)
        mark = _mark(self.value_marked)
        return Fact(self.judged_by.dimension, self.value, interval, mark=mark)

    @property
    def modulus_fact(self) -> Fact:
        """Fitted modulus in force that is not judged, with its interval."""
        low, high = self.modulus_low, self.modulus_high
        interval = None if low is None or high is None else (low, high)
        return Fact("modulus", self.modulus, interval, mark=_mark(self.modulus_marked))

    @property
    def diagnosis_text(self) -> str:
        """Use of the diagnosed modulus, and what is unexplained; empty: it is not diagnosed."""
        return f"{self.use}, {self.unexplained} of the peak unexplained" if self.use else ""

    @property
    def state(self) -> str:
        """PASS, FAIL, UNDECIDED, DISCARDED, - for no verdict, or ... while it is not judged."""
        if self.discarded:
            return "DISCARDED"
        if not self.judged:
            return "..."
        return "-" if self.verdict in ("", "none") else self.verdict.upper()


class OpenedSurvey:
    """Recorded survey whose points are rows; verdicts are stored in a cache of the platform.

    Parameters
    ----------
    folder : path of a survey
    cache : Path, optional
        File that stores the rows; None: the one of this survey in the cache of the platform.

    Raises
    ------
    SurveyError, RecordingError
        If the folder is no survey.
    """

    def __init__(self, folder: str | os.PathLike[str], cache: Path | None = None) -> None:
        refuse_no_survey(folder)
        self.folder = Path(folder)
        self._cache_file = cache
        self.survey: Any = None
        """Content of the survey, once it is read."""
        self.job: Any = None
        """Job of the survey, once it is read."""
        self.rows: list[PointRow] = []
        self.remarks: list[str] = []
        """Sentences on verdicts that this version changed, and on damage."""

    def read(self) -> list[PointRow]:
        """Read the survey and return its points as rows that are not judged yet.

        Raises
        ------
        SurveyError, RecordingError
        """
        from pfwd.files.opening import survey_content
        from pfwd.judging import job_of

        self.survey = survey_content(self.folder)
        self.job = job_of(self.survey)
        self.rows = [_bare(point, self.job) for point in self.survey.points]
        return self.rows

    def from_cache(self) -> list[PointRow] | None:
        """Return the rows of the cache; None: there is none, or the survey has changed since."""
        try:
            path = self._cache()
            if path.stat().st_size > MAX_CACHE_BYTES:
                return None
            cache = json.loads(path.read_text(encoding="utf-8"))
            if cache["key"] != self._key():
                return None
            self.rows = [PointRow(**row) for row in cache["rows"]]
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return None  # the survey is read again
        return self.rows

    def judge(self, tell: Callable[[Sequence[PointRow]], None], *, at_once: int = 50) -> None:
        """Judge the rows that are not judged yet, report them in parts, then cache them.

        Parameters
        ----------
        tell : callable
            Receives judged rows.
        at_once : int
            Number of rows in a part.
        """
        from pfwd.judging import point_view

        places = {row.name: place for place, row in enumerate(self.rows)}
        part: list[PointRow] = []
        for point in self.survey.points:
            place = places.get(point.name)
            if place is None or self.rows[place].judged:
                continue
            row = self.rows[place]
            try:
                row = judged_row(row, point_view(point, self.job))
            except (SurveyError, DeviceError) as err:
                row = dataclasses.replace(row, judged=True, verdict="none", reason=str(err))
            self.rows[place] = row
            part.append(row)
            if len(part) >= at_once:
                tell(part)
                part = []
        tell(part)
        self.remarks += self.survey.damage
        if not self.survey.damage:  # its repair may change no other file
            self._store()

    def view(self, name: str) -> "PointView | None":
        """Return a point by the name its drops have; None: it has not been read yet."""
        from pfwd.judging import point_view

        stored = () if self.survey is None else self.survey.points
        point = next((point for point in stored if point.name == name), None)
        return None if point is None else point_view(point, self.job).shown

    def _key(self) -> list[Any]:
        """Return the key of the cache, which changes with every write to the survey."""
        ledger = (self.folder / "acknowledged.txt").stat()
        return [CACHE_VERSION, os.fspath(self.folder.resolve()), ledger.st_size, ledger.st_mtime_ns]

    def _cache(self) -> Path:
        from platformdirs import user_cache_path

        if self._cache_file is not None:
            return self._cache_file
        override = os.environ.get("PFWD_CACHE")
        base = Path(override) if override else user_cache_path("pfwd", appauthor=False)
        name = re.sub(r"\W+", "-", os.fspath(self.folder.resolve()))[-80:]
        return base / "opened" / f"{name}.json"

    def _store(self) -> None:
        try:
            path = self._cache()
            path.parent.mkdir(parents=True, exist_ok=True)
            rows = [dataclasses.asdict(row) for row in self.rows]
            with replaced_at_once(path) as draft:
                draft.write_text(json.dumps({"key": self._key(), "rows": rows}), encoding="utf-8")
        except OSError:
            return  # a read-only or full disk: the survey is judged again the next time


def _bare(point: Any, job: "Job") -> PointRow:
    from pfwd.judging.places import place_in
    from pfwd.judging.stations import chainage_of_point

    place = place_in(point.position) or place_in(point.declared)
    return PointRow(
        name=point.name,
        title=point.title,
        drops=len(point.drops),
        chainage_m=chainage_of_point(point.title, job.station(point.title), [point.declared]),
        latitude=None if place is None else place.latitude,
        longitude=None if place is None else place.longitude,
        notes="; ".join(point.notes),
        discarded=point.discarded,
    )


def origin_of_value(progress: "PointProgress") -> str:
    """Return the origin of the judged value in words: the mean of drops, or the diagnosis."""
    value, modulus = progress.value, progress.modulus
    if value is None:
        return ""
    drops = counted(value.drops, "drop")
    is_diagnosed = modulus is not None and modulus.source == "diagnosed"
    if value.quantity.is_fitted and is_diagnosed:
        return f"diagnosed, {drops} measured"
    return f"mean of {drops}"


def judged_row(row: PointRow, point: "PointView") -> PointRow:
    """Return the row with value and verdict of its point."""
    progress = point.progress
    if point.position is not None:  # of a receiver it is stored with the drops
        row = dataclasses.replace(row, latitude=point.position[0], longitude=point.position[1])
    value = progress.value
    modulus = progress.modulus
    low, high = (None, None) if value is None or value.interval is None else value.interval
    other = point.job.quantity.other_fitted
    fitted, ends = (None, None) if modulus is None else modulus.in_quantity(other)
    use, unexplained = "", ""
    diagnosis = point.diagnosis_in_force
    if diagnosis is not None and diagnosis.after is not None:
        from tui.diagnosis_lines import point_cells

        judged = dataclasses.replace(diagnosis, point_modulus=modulus)
        cells = point_cells(point.shown_name, judged)
        use, unexplained = cells.use, cells.unexplained
    return dataclasses.replace(
        row,
        judged=True,
        quantity=point.job.quantity.value,
        unit="" if value is None else value.unit,
        value=None if value is None else value.value,
        low=low,
        high=high,
        target=progress.target,
        verdict=progress.verdict.value,
        reason=text_of(progress.verdict_reason),
        modulus=fitted,
        modulus_low=None if ends is None else ends[0],
        modulus_high=None if ends is None else ends[1],
        modulus_marked=fitted is not None
        and modulus is not None
        and modulus.not_supported is not None,
        value_marked=value is not None and value.not_supported is not None,
        origin=origin_of_value(progress),
        use=use,
        unexplained=unexplained,
    )


ORDERS: tuple[str, ...] = ("measured", "title", "value", "verdict", "modulus", "chainage_m")
"""Keys by which rows can be sorted; the first is the order of measuring."""

_LIMIT = re.compile(r"([<>])\s*([\d.]+)$")


def matching(rows: Iterable[PointRow], filter_text: str) -> list[PointRow]:
    """Return the rows that match a filter.

    Parameters
    ----------
    rows : iterable of PointRow
    filter_text : str
        Words that all have to match: part of a name or a note, ``pass``, ``fail``,
        ``undecided``, ``discarded``, or a limit of the value in its shown unit, as ``<40``.
    """
    words = filter_text.lower().split()
    return [row for row in rows if all(_matches(row, word) for word in words)]


def _matches(row: PointRow, word: str) -> bool:
    limit = _LIMIT.match(word)
    if limit is not None:
        if row.value is None:
            return False
        value = display_value(row)
        edge = float(limit[2]) if limit[2].strip(".") else math.nan
        return value < edge if limit[1] == "<" else value > edge
    return word in row.title.lower() or word in row.notes.lower() or word == row.state.lower()


def display_value(row: PointRow) -> float:
    """Return the judged value in MPa or mm."""
    return math.nan if row.value is None else row.value / row.display_unit.scale


def judged_cells(row: PointRow) -> dict[str, str]:
    """Return value, interval and target of a point as cells of a table, in MPa or mm."""
    from pfwd.judging.job import target_text

    value, ends = SI.value_and_ends(row.judged_fact)
    return {
        "value": value if row.value is None else f"{value} {row.display_unit.name}",
        "interval": ends,
        "target": "-" if row.target is None else target_text(row.target),
    }


def _mark(is_marked: bool) -> str:
    """Return the mark of a number that the data do not support, or nothing."""
    # Loaded when rows are shown: the frame is painted before.
    from pfwd.procedures.point import UNSUPPORTED_MARK

    return UNSUPPORTED_MARK if is_marked else ""


def in_order(rows: Sequence[PointRow], by: str, *, falling: bool = False) -> list[PointRow]:
    """Return the rows sorted by a key; rows without its value stand last."""
    if by == ORDERS[0]:
        return list(reversed(rows)) if falling else list(rows)
    if by == "title":
        return sorted(rows, key=lambda row: _natural(row.title), reverse=falling)
    present = [row for row in rows if getattr(row, by) not in (None, "")]
    missing = [row for row in rows if getattr(row, by) in (None, "")]
    return sorted(present, key=lambda row: getattr(row, by), reverse=falling) + missing


@lru_cache(maxsize=20_000)
def _natural(name: str) -> list[tuple[int, float, str]]:
    """Return a sort key that puts point 2 before point 10."""
    parts = re.split(r"(\d+)", name.lower())
    return [(0, float(part), "") if part.isdigit() else (1, 0.0, part) for part in parts if part]


def pages(count: int, size: int) -> int:
    """Return the number of pages for a number of rows, at least one."""
    return max(1, -(-count // size))


def shares(rows: Iterable[PointRow]) -> Iterator[tuple[str, int]]:
    """Yield each state that occurs and its number of points, in a fixed order."""
    titles = {"-": "without a verdict", "...": "to be judged"}
    counts: dict[str, int] = {}
    for row in rows:
        counts[row.state] = counts.get(row.state, 0) + 1
    for state in ("PASS", "FAIL", "UNDECIDED", "-", "DISCARDED", "..."):
        if counts.get(state):
            yield titles.get(state, state), counts[state]
