"""Exported surveys: writing, reading and checking a survey in one HDF5 file.

Each group ``drops/000001`` ... has the layout of a drop file. ``survey`` is a JSON text with
points, edits, events and checks. ``results/000001/1`` ... are the results of a drop, ``captures``
the raw bytes that were received from instruments, ``photos/000001`` ... the bytes of photos.
docs/files.md describes the layout.

Digests (SHA-256) protect the content. In format version 2 they cover everything that a reader
uses: ``survey`` holds the digests of drops, results and captures, and the attribute
``visible_sha256`` of the file is the digest of ``survey`` and of the other attributes. In version 1
attributes had no digests.

h5py is imported by the functions that need it, because its import is slow. It documents no
errors for damaged files, hence the handlers of any exception.
"""

import contextlib
import hashlib
import io
import os
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import cached_property, partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, NoReturn

import numpy as np

from pfwd.files.photos import MAX_PHOTO_BYTES, photos_of
from pfwd.spawning import WorkerPool
from pfwd_device.errors import RecordingError
from pfwd_device.recording import DropRecord, SurveyDrop, SurveyPoint
from pfwd_device.recording.drop_file import (
    DIGEST,
    FILE_VERSION,
    drop_digest,
    read_drop,
    software_version,
    write_drop,
)
from pfwd_device.recording.drop_payload import DropFacts, facts_of
from pfwd_device.recording.hdf5_tree import (
    Attribute,
    Dataset,
    Group,
    Place,
    digest,
    find,
    member_names,
    opened,
    read_attribute,
    read_attributes,
    read_dataset,
    refuse_chunks,
    refuse_storage,
    write_attributes,
    write_dataset,
)
from pfwd_device.recording.payload import decode_json, encode_json, json_excess
from pfwd_device.recording.survey_content import (
    DropElsewhere,
    Result,
    ResultFile,
    SurveyContent,
    same_peaks,
)
from pfwd_device.text import clean

SURVEY_FORMAT = "pfwd-survey"
SURVEY_FORMAT_VERSION = 2
"""Version of the format that is written; version 1 can be read as well."""

MAX_SURVEY_DROPS = 1_000_000
"""Drops of a survey, a hundred times a large one; all names are listed before a drop is read."""

PART_DROPS = 200
"""Drops that are checked before the file is opened again: the memory of HDF5 for an open file grows
with the square of their number, to gigabytes with 10,000."""

MIN_PARALLEL_PARTS = 5
"""Number of parts of `PART_DROPS` above which several processes check a file: with fewer, starting
the processes takes longer than the check."""

MAX_DROP_RESULTS = 10_000
"""Largest number of results of a drop."""

MAX_CAPTURE_BYTES = 2**31
"""Largest capture, reached by an hour of eight channels at 50 kHz."""

_CHUNK_BYTES = 1 << 20


def is_survey_file(path: str | os.PathLike[str]) -> bool:
    """Return whether a file is an exported survey, by the format attribute of its HDF5 file."""
    try:
        with opened(path) as file:
            return read_attribute(file, "format", os.fspath(path)) == SURVEY_FORMAT
    except Exception:
        return False


def write_survey_file(path: str | os.PathLike[str], content: SurveyContent, jobs: int = 1) -> None:
    """Write a survey into an HDF5 file and check the file by reading its drops.

    Parameters
    ----------
    path : path of the file, which is overwritten
    content : SurveyContent
    jobs : int
        Number of processes that check the file.

    Raises
    ------
    RecordingError
        If a drop of the survey is damaged, or the written file differs from the survey.
    """
    import h5py

    # First the groups are copied from the drop files, which is fast. If one differs from the
    # journal in spite of its digest, all drops are written again from the journal.
    for from_files in (True, False):
        try:
            with h5py.File(path, "w") as file:
                digests = _write(file, content, from_files=from_files)
                file.flush()
        except RecordingError:
            raise
        except Exception as err:  # a full disk, for instance
            raise RecordingError(f"{path}: the export failed: {err}. Is the disk full?") from err
        # HDF5 may report success on a full disk.
        damaged = _check(os.fspath(path), digests, jobs)[0]["damaged"]
        if not damaged:
            return
    raise RecordingError(
        f"{path}: the exported file differs from the survey: {'; '.join(damaged)}. "
        "Export it to another disk"
    )


class SurveyPhoto(NamedTuple):
    """Photo of a test point."""

    point: str
    """Name of the point."""
    name: str
    """Name of the file."""
    data: bytes


def photos_of_survey(content: SurveyContent) -> Iterator[SurveyPhoto]:
    """Yield the photos of all points of a survey, which may be a folder or an exported file.

    Raises
    ------
    RecordingError
        If a photo of an exported survey is damaged.
    """
    if isinstance(content, ExportedSurvey):
        yield from content.read_photos()
        return
    for point in content.points:
        for photo in photos_of(content.path, point.name):
            yield SurveyPhoto(point.name, photo.name, photo.read_bytes())


class ExportedSurvey:
    """Content of an exported survey, made by :func:`read_survey_file`.

    It has the interface of a survey in a folder. Methods take the number of a drop within the
    survey.
    """

    def __init__(
        self, path: str, survey_id: str, survey: Mapping[str, Any], groups: Container[str]
    ) -> None:
        self.path = path
        self.survey_id = survey_id
        self.info: dict[str, Any] = dict(survey["info"])
        self.events: tuple[Mapping[str, Any], ...] = tuple(survey["events"])
        self.checks: tuple[Mapping[str, Any], ...] = tuple(survey["checks"])
        self.captures: tuple[Path, ...] = ()
        self.damage: tuple[str, ...] = tuple(map(str, survey["damage"]))
        self._photos = [
            (str(photo["point"]), str(photo["name"]), str(photo["sha256"]))
            for photo in survey.get("photos", ())
        ]
        self._facts = {int(drop["number"]): drop for drop in survey["drops"]}
        # Compared by name: opening each of up to a million groups takes too long.
        self._missing = {number for number in self._facts if f"{number:06d}" not in groups}
        self._keys: dict[int, str | None] = {}
        self.points: tuple[SurveyPoint, ...] = tuple(map(self._point, survey["points"]))
        drops = [drop for point in self.points for drop in point.drops]
        self.drops: tuple[SurveyDrop, ...] = tuple(sorted(drops, key=lambda drop: drop.number))

    def key_of(self, number: int) -> str | None:
        """Return the key by which the instrument identifies a drop; None: it has none."""
        return self._keys[number]

    def results_of(self, _number: int) -> tuple[ResultFile, ...]:
        """Return an empty tuple: results have no files of their own."""
        return ()

    def result_count_of(self, number: int) -> int:
        """Return the number of stored results of a drop."""
        digests = self._facts[number].get("results_sha256")
        if digests is not None:
            return len(digests)
        with _opened(self.path) as file:
            return len(_names(file, f"results/{number:06d}", self.path))

    def place_of(self, _number: int) -> None:
        """Return None: an exported survey has no journal to read a drop from."""

    def file_of(self, _number: int) -> None:
        """Return None: drops have no files of their own."""

    def file_bytes_of(self, _number: int) -> None:
        """Return None: drops have no files of their own."""

    def read_drop(self, number: int) -> DropRecord:
        """Return a drop with its rebounds and raw counts.

        Raises
        ------
        RecordingError
            If the drop is damaged.
        """
        if number in self._missing:
            _no_drop(self.path, number)
        with _opened(self.path) as file:
            return _read_drop(file, number, self.path, self._facts[number].get("sha256"))

    def read_traces(self, number: int) -> DropRecord:
        """Return a drop without rebounds and without raw counts of the converter."""
        return replace(self.read_drop(number), counts=None, rebounds=())

    def same_peaks_of(self, number: int) -> DropElsewhere | None:
        """Return the first drop of another point with the same peaks; None: there is none."""
        return self._same_peaks.get(number)

    @cached_property
    def _same_peaks(self) -> dict[int, DropElsewhere]:
        return same_peaks(self.points, {})

    def read_facts(self, number: int) -> DropFacts:
        """Return peaks or traces of a drop with its declarations."""
        return facts_of(self.read_drop(number))

    def read_results(self, number: int) -> tuple[Result, ...]:
        """Return the results of a drop in the order in which they were stored.

        Raises
        ------
        RecordingError
            If a result is damaged.
        """
        digests = self._facts[number].get("results_sha256")
        with _opened(self.path) as file:
            return _read_results(file, number, self.path, digests)

    def readable_results(self, number: int) -> Iterator[Result]:
        """Yield the results of a drop, the last one first; none if one of them is damaged."""
        with contextlib.suppress(RecordingError):
            yield from reversed(self.read_results(number))

    def read_last_result(self, number: int) -> Result | None:
        """Return the last stored result of a drop; None: it has no result."""
        return next(iter(self.read_results(number)[::-1]), None)

    def read_diagnosis(self, number: int) -> Result | None:
        """Return the diagnosis that is stored with a drop; None: it has none."""
        diagnosis = self._facts[number].get("diagnosis")
        return diagnosis if isinstance(diagnosis, dict) else None

    def read_photos(self) -> Iterator[SurveyPhoto]:
        """Yield the photos.

        Raises
        ------
        RecordingError
            If a photo is damaged.
        """
        for number, (point, name, checksum) in enumerate(self._photos, start=1):
            with _opened(self.path) as file:
                member = f"photos/{number:06d}"
                data = _read_bytes(file, member, self.path, checksum, MAX_PHOTO_BYTES)
            if data is None:
                raise RecordingError(f"{self.path}, {member}: expected a photo, got damage")
            yield SurveyPhoto(point, name, data)

    def _point(self, entry: Mapping[str, Any]) -> SurveyPoint:
        return SurveyPoint(
            name=str(entry["name"]),
            title=str(entry["title"]),
            order=int(entry["order"]),
            declared=dict(entry["declared"]),
            discarded=bool(entry["discarded"]),
            notes=tuple(map(str, entry["notes"])),
            position=entry["position"],
            target=entry["target"],
            edits=tuple(map(_edit, entry["edits"])),
            drops=tuple(self._drop(self._facts[int(number)]) for number in entry["drops"]),
        )

    def _drop(self, entry: Mapping[str, Any]) -> SurveyDrop:
        number, key = int(entry["number"]), entry["key"]
        self._keys[number] = key if isinstance(key, str) else None
        return SurveyDrop(
            number=number,
            point=str(entry["point"]),
            drop=int(entry["drop"]),
            discarded=bool(entry["discarded"]),
            notes=tuple(map(str, entry["notes"])),
            position=entry["position"],
            target=entry["target"],
            edits=tuple(map(_edit, entry["edits"])),
            source="export",
            _origin=self,
        )


def read_survey_file(path: str | os.PathLike[str]) -> ExportedSurvey:
    """Open an exported survey; traces and results are read when they are used.

    Raises
    ------
    RecordingError
        If the file is damaged, or of a newer version.
    """
    name = os.fspath(path)
    with _opened(name) as file:
        survey = _survey(file, name)
        survey_id = str(read_attribute(file, "survey_id", name) or "")
        groups = set(_names(file, "drops", name, MAX_SURVEY_DROPS))
    try:
        return ExportedSurvey(name, survey_id, survey, groups)
    except (KeyError, TypeError, ValueError, AttributeError) as err:
        raise RecordingError(
            f"{name}: the entries of points and drops are damaged: {err!r}; export it again"
        ) from err


def check_survey_file(
    path: str | os.PathLike[str], jobs: int = 1
) -> tuple[dict[str, Any], list[str]]:
    """Compare everything in an exported survey with its digests.

    Parameters
    ----------
    path : path of the file
    jobs : int
        Number of processes that check it.

    Returns
    -------
    record : dict
        Keys as in ``pfwd check --json``.
    notes : list of str
        Sentences about parts that have no digest.

    Raises
    ------
    RecordingError
        If it cannot be read at all.
    """
    return _check(os.fspath(path), {}, jobs)


def _check(
    name: str, digests: Mapping[int, str], jobs: int = 1
) -> tuple[dict[str, Any], list[str]]:
    """Check an exported survey as :func:`check_survey_file` does.

    Parameters
    ----------
    name : str
        Path of the file.
    digests : mapping of drop number to digest
        Expected digests of drops, in addition to those in the file; may be empty.
    jobs : int
        Number of processes.
    """
    damaged: list[str] = []
    n_intact = 0
    with _opened(name) as file:
        version = read_attribute(file, "format_version", name)
        try:
            survey = _survey(file, name)
            damaged += [str(text) for text in survey.get("damage", ())]
            drops = {int(drop["number"]): drop for drop in survey["drops"]}
            n_acknowledged = int(read_attributes(file, name)["drops_acknowledged"])
        except (RecordingError, KeyError, TypeError, ValueError, AttributeError) as err:
            damaged.append(f"survey: {err}")
            names: list[str] = []
            with contextlib.suppress(RecordingError):
                names = _names(file, "drops", name, MAX_SURVEY_DROPS)
            numbers = sorted(int(each) for each in names if each.isascii() and each.isdecimal())
            drops = {number: {} for number in numbers}
            n_acknowledged = len(drops)
            survey = {}
    numbers = list(drops)
    parts = [
        [(number, drops[number], digests.get(number)) for number in numbers[first:][:PART_DROPS]]
        for first in range(0, len(numbers), PART_DROPS)
    ]
    check_part = partial(_drops_damage, name)
    with contextlib.ExitStack() as stack:
        # A few drops take less time than the start of a process.
        parallel = jobs > 1 and len(parts) >= MIN_PARALLEL_PARTS
        run = stack.enter_context(WorkerPool(jobs)).map if parallel else map
        for n_intact_in_part, problems in run(check_part, parts):
            n_intact += n_intact_in_part
            damaged += problems
    with _opened(name) as file:
        captures = survey.get("captures") if version != 1 else None
        damaged += _bytes_damage(file, "captures", name, captures)
        damaged += _bytes_damage(file, "photos", name, _photo_digests(survey))
        damaged += _unexpected_members(file, name, drops)
    notes = []
    if version == 1:
        notes = [f"{name}: attributes are not covered by the digests of format version 1"]
    return {
        "survey": name,
        "drops_acknowledged": n_acknowledged,
        "drops_published": n_intact,
        "recovered": 0,
        "damaged": damaged,
        "ok": not damaged and n_intact == n_acknowledged,
    }, notes


def _drops_damage(
    name: str, drops: Sequence[tuple[int, Mapping[str, Any], str | None]]
) -> tuple[int, list[str]]:
    """Check several drops of an exported survey.

    Returns
    -------
    n_intact : int
        Number of intact drops.
    damaged : list of str
        Messages about damaged drops and results.
    """
    n_intact, damaged = 0, []
    with _opened(name) as file:
        for number, facts, expected in drops:
            drop_problem, *result_problems = _drop_damage(file, number, name, facts, expected)
            n_intact += drop_problem is None
            damaged += [text for text in (drop_problem, *result_problems) if text is not None]
    return n_intact, damaged


def _drop_damage(
    file: Place, number: int, name: str, facts: Mapping[str, Any], expected: str | None
) -> list[str | None]:
    """Check one drop and its results.

    Returns
    -------
    list of str or None
        Message about the drop (None: intact), then messages about its results.
    """
    problems: list[str | None] = [None]
    try:
        record = _read_drop(file, number, name, facts.get("sha256"))
        if expected is not None and drop_digest(record, number) != expected:
            problems[0] = f"{name}, drop {number}: differs from the drop in the survey"
    except RecordingError as err:
        problems[0] = str(err)
    try:
        _read_results(file, number, name, facts.get("results_sha256"))
    except RecordingError as err:
        problems.append(str(err))
    return problems


def _photo_digests(survey: Mapping[str, Any]) -> Any:
    """Return the digests of the photos by member name; a text if their entries are damaged."""
    try:
        photos = enumerate(survey.get("photos", ()), start=1)
        return {f"{number:06d}": photo["sha256"] for number, photo in photos}
    except (KeyError, TypeError) as err:
        return repr(err)


def _bytes_damage(file: Place, group: str, path: str, expected: Any) -> list[str]:
    """Check captures or photos; return messages about damage.

    Parameters
    ----------
    file : Place
    group : str
        "captures" or "photos".
    path : str
        Path of the file, for messages.
    expected : mapping of member name to digest, or None
        None: format version 1, in which only the members themselves have digests.
    """
    try:
        names = _names(file, group, path)
        damaged = [
            f"{path}, {group}/{name}: other bytes than were written"
            for name in names
            if _read_bytes(file, f"{group}/{name}", path, expected and expected[name]) is None
        ]
        missing = sorted(set(expected or ()) - set(names))
        return damaged + [f"{path}, {group}/{clean(name)}: missing" for name in missing]
    except (RecordingError, KeyError, TypeError) as err:
        return [f"{path}, {group}: {err}"]


def _unexpected_members(file: Place, path: str, drops: Mapping[int, Any]) -> list[str]:
    """Return messages about members and attributes that do not belong to an exported survey."""
    drop_names = {f"{number:06d}" for number in drops}
    expected = {"survey": None, "drops": drop_names, "results": drop_names}
    expected |= {"captures": None, "photos": None}
    problems = []
    try:
        for name in member_names(file, path):
            if name not in expected:
                problems.append(f"{path}, {clean(name)}: does not belong to an exported survey")
            elif name != "survey":
                group = find(file, name, path)
                if group is None or read_attributes(group, f"{path}, {name}"):
                    problems.append(f"{path}, {name}: missing, or has unexpected attributes")
                for member in _names(file, name, path, MAX_SURVEY_DROPS):
                    allowed = expected[name]
                    if allowed is not None and member not in allowed:
                        where = f"{path}, {name}/{clean(member)}"
                        problems.append(f"{where}: does not belong to an exported survey")
    except RecordingError as err:
        problems.append(str(err))
    except Exception as err:
        problems.append(f"{path}: expected groups, got damage: {err}")
    return problems


def _names(file: Place, group: str, path: str, max_names: int = MAX_DROP_RESULTS) -> list[str]:
    """Return the member names of a group, sorted by number; a missing group has none."""
    where = f"{path}, {group}"
    try:
        parent = find(file, group, path)
        names = [] if parent is None else member_names(parent, where, max_names)
    except RecordingError:
        raise
    except Exception as err:
        raise RecordingError(f"{where}: expected a group, got damage: {err}") from err
    return sorted(names, key=lambda name: (len(name), name))


@contextlib.contextmanager
def _opened(path: str) -> Iterator[Place]:
    with contextlib.ExitStack() as stack:
        try:
            file = stack.enter_context(opened(path))
            version = read_attribute(file, "format_version", path)
        except Exception as err:
            raise RecordingError(f"{path}: expected an exported survey, got damage: {err}") from err
        if isinstance(version, int) and version > SURVEY_FORMAT_VERSION:
            raise RecordingError(
                f"{path}: expected format version {SURVEY_FORMAT_VERSION}, got {version}; a newer "
                "version of this program reads it"
            )
        if version not in (1, SURVEY_FORMAT_VERSION):
            raise RecordingError(f"{path}: expected a format version, got {version!r:.40}")
        yield file


def _survey(file: Place, path: str) -> dict[str, Any]:
    """Return the JSON content of ``survey``, in version 2 after comparison with its digest."""
    try:
        attributes = read_attributes(file, path)
        expected = attributes.pop(DIGEST, None)
        content = _text(file, "survey", path)
        if attributes["format_version"] == 1:
            # The number is an attribute and not enough to recognise version 1.
            if expected is not None or "format_version" in content:
                raise RecordingError(f"{path}: states format version 1, but has another layout")
            return content
        survey = Group({"survey": read_dataset(file, "survey", path)}, attributes)
    except RecordingError as err:
        raise _placed(err, path) from err
    except Exception as err:
        raise RecordingError(
            f"{path}: expected a survey, got a damaged file ({err}); copy or export it again"
        ) from err
    if expected != digest(survey):
        raise RecordingError(
            f"{path}: attributes or survey differ from their digest; copy or export it again"
        )
    return content


def _write(file: Any, content: SurveyContent, *, from_files: bool) -> dict[int, str]:
    """Write a survey into an open HDF5 file; return the digests of its drops by number."""
    survey = bytes.fromhex(content.survey_id) if content.survey_id else b""
    drops = content.drops
    drop_entries = []
    groups = file.create_group("drops")
    digests = {}
    for drop in drops:
        record = drop.read()
        name = f"{drop.number:06d}"
        copied = _copy_drop(groups, name, drop.read_file(), record) if from_files else None
        facts = _drop_facts(drop, record)
        facts["sha256"] = copied or write_drop(
            groups.create_group(name), record, drop.number, survey
        )
        digests[drop.number] = drop_digest(record, drop.number)
        diagnosis = drop.read_diagnosis()
        if diagnosis is not None:
            facts["diagnosis"] = dict(diagnosis)
        facts["results_sha256"] = [
            _write_text(file, f"results/{drop.number:06d}/{index}", encode_json(result))
            for index, result in enumerate(drop.read_results(), start=1)
        ]
        drop_entries.append(facts)
    entries = {
        "format_version": SURVEY_FORMAT_VERSION,
        "info": dict(content.info),
        "points": [_point_facts(point) for point in content.points],
        "drops": drop_entries,
        "events": list(content.events),
        "checks": list(content.checks),
        "damage": list(content.damage),
        "captures": {capture.name: _write_capture(file, capture) for capture in content.captures},
    }
    photos = _write_photos(file, content)
    if photos:  # earlier versions refuse nothing in a file without photos
        entries["photos"] = photos
    text = encode_json(entries)
    if (problem := json_excess(text)) is not None:  # readers would refuse it
        raise RecordingError(f"{content.path}: {problem}; export it in parts")
    _write_text(file, "survey", text)
    attributes: dict[str, Attribute] = {
        "format": SURVEY_FORMAT,
        "format_version": SURVEY_FORMAT_VERSION,
        "pfwd_version": software_version(),
        "survey_id": content.survey_id,
        "exported_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "drops_acknowledged": len(drops),
    }
    visible = Group({"survey": _text_dataset(text)}, attributes)
    write_attributes(file, {**attributes, DIGEST: digest(visible)})
    return digests


def _copy_drop(groups: Any, name: str, image: bytes | None, record: DropRecord) -> str | None:
    """Copy a drop from its own file, which is ten times as fast as writing its traces.

    Returns
    -------
    str or None
        Digest of the drop; None: its file has another version or fewer rebounds than the survey.
    """
    from h5py import File, h5f, h5g, h5o

    if image is None:
        return None
    source = h5f.open_file_image(image)
    try:
        attributes = File(source).attrs
        version, recorded = attributes.get("format_version"), attributes.get(DIGEST)
        if version != FILE_VERSION or not isinstance(recorded, str):
            return None  # a drop file of an earlier version is written anew in this one
        root = h5g.open(source, b"/")
        has_rebounds = root.links.exists(b"rebounds")
        rebounds = h5g.open(root, b"rebounds").get_num_objs() if has_rebounds else 0
        if rebounds != len(record.rebounds):  # some were recorded after the file was written
            return None
        h5o.copy(source, b"/", groups.id, name.encode("ascii"))
    finally:
        source.close()
    return recorded


def _point_facts(point: SurveyPoint) -> dict[str, Any]:
    return {
        "name": point.name,
        "title": point.title,
        "order": point.order,
        "declared": dict(point.declared),
        "discarded": point.discarded,
        "notes": list(point.notes),
        "position": point.position,
        "target": point.target,
        "edits": [dict(edit) for edit in point.edits],
        "drops": [drop.number for drop in point.drops],
    }


def _drop_facts(drop: SurveyDrop, record: DropRecord) -> dict[str, Any]:
    key = record.metadata.get("key")
    return {
        "number": drop.number,
        "point": drop.point,
        "drop": drop.drop,
        "key": key if isinstance(key, str) else drop.key,
        "discarded": drop.discarded,
        "notes": list(drop.notes),
        "position": drop.position,
        "target": drop.target,
        "edits": [dict(edit) for edit in drop.edits],
    }


def _edit(entry: Mapping[str, Any]) -> dict[str, Any]:
    return {**entry, "what": str(entry["what"])}


def _no_drop(path: str, number: int) -> NoReturn:
    raise RecordingError(f"{path}, drop {number}: expected its group, got none")


def _read_drop(file: Place, number: int, path: str, expected: str | None) -> DropRecord:
    """Return a drop of the file.

    Parameters
    ----------
    file : Place
    number : int
        Number of the drop within the survey.
    path : str
        Path of the file, for messages.
    expected : str or None
        Digest of the drop; None in format version 1.
    """
    where = f"{path}, drop {number}"
    try:
        group = find(file, f"drops/{number:06d}", path)
    except RecordingError:
        raise
    except Exception as err:
        raise RecordingError(f"{where}: expected its group, got damage: {err}") from err
    if group is None:
        _no_drop(path, number)
    stored = read_drop(group, where)
    if stored.number != number:
        raise RecordingError(f"{where}: expected drop {number}, got drop {stored.number}")
    if (stored.digest if stored.version > 1 else None) != expected:
        raise RecordingError(f"{where}: the content differs from its digest")
    return stored.record


def _read_results(
    file: Place, number: int, path: str, digests: Sequence[str] | None
) -> tuple[Result, ...]:
    """Return the results of a drop; `digests`: their expected digests, None in format version 1."""
    folder = f"results/{number:06d}"
    names = _names(file, folder, path)
    if digests is not None and names != [str(n) for n in range(1, len(digests) + 1)]:
        raise RecordingError(f"{path}, {folder}: expected {len(digests)} results, got {len(names)}")
    if not names:
        return ()
    results = []
    for index, name in enumerate(names):
        expected = None if digests is None else digests[index]
        results.append(_text(file, f"{folder}/{name}", path, expected))
    group = find(file, folder, path)
    if digests is not None and group is not None and read_attributes(group, folder):
        raise RecordingError(f"{path}, {folder}: has unexpected attributes")
    return tuple(results)


def _text_dataset(text: str) -> Dataset:
    return Dataset(
        text, {"units": "JSON", "sha256": hashlib.sha256(text.encode("ascii")).hexdigest()}
    )


def _write_text(file: Any, name: str, text: str) -> str:
    """Write a text as a dataset of the HDF5 file; return its SHA-256 digest."""
    dataset = _text_dataset(text)
    write_dataset(file, name, dataset)
    return str(dataset.attributes["sha256"])


def _text(file: Place, name: str, path: str, expected: str | None = None) -> dict[str, Any]:
    """Return the JSON object in a text dataset after comparison with its digest.

    Parameters
    ----------
    file : Place
    name : str
        Member of the file.
    path : str
        Path of the file, for messages.
    expected : str, optional
        Digest that another part of the file states; None: it states none.
    """
    where = f"{path}, {name}"
    try:
        dataset = read_dataset(file, name, path)
        text = dataset.value
        if not isinstance(text, str):
            raise RecordingError(f"{where}: expected a text, got numbers")
        attributes = _text_dataset(text).attributes
    except RecordingError as err:
        raise _placed(err, where) from err
    except Exception as err:
        raise RecordingError(f"{where}: expected a text, got damage: {err}") from err
    actual = attributes["sha256"]
    if dataset.attributes.get("sha256") != actual or expected not in (None, actual):
        raise RecordingError(f"{where}: the text differs from its digest")
    if expected is not None and dataset.attributes != attributes:
        raise RecordingError(f"{where}: the attributes differ from those that were written")
    try:
        content = decode_json(text)
    except RecordingError as err:
        raise _placed(err, where) from err
    if not isinstance(content, dict):
        raise RecordingError(f"{where}: expected a JSON object, got {type(content).__name__}")
    return content


def _placed(err: RecordingError, where: str) -> RecordingError:
    """Return an error whose message begins with file and member; unchanged if it does already."""
    text = str(err)
    return err if text.startswith(where.partition(", ")[0]) else RecordingError(f"{where}: {text}")


def _write_capture(file: Any, capture: Path) -> str:
    """Write a capture (bytes received from an instrument) into the HDF5 file; return its digest."""
    size = capture.stat().st_size
    if size > MAX_CAPTURE_BYTES:
        raise RecordingError(
            f"{capture}: expected a capture of at most 2 GiB, got {size / 2**30:.1f} GiB; "
            "export without it"
        )
    with capture.open("rb") as stream:
        return _write_bytes(file, f"captures/{capture.name}", stream, size)


def _write_photos(file: Any, content: SurveyContent) -> list[dict[str, str]]:
    """Write the photos of a survey into the HDF5 file; return point, name and digest of each."""
    return [
        {
            "point": photo.point,
            "name": photo.name,
            "sha256": _write_bytes(
                file, f"photos/{number:06d}", io.BytesIO(photo.data), len(photo.data)
            ),
        }
        for number, photo in enumerate(photos_of_survey(content), start=1)
    ]


def _write_bytes(file: Any, name: str, stream: BinaryIO, size: int) -> str:
    """Write the first `size` bytes of a stream as an HDF5 dataset; return their digest."""
    dataset = file.create_dataset(
        name,
        shape=(size,),
        dtype=np.uint8,
        chunks=(min(size, _CHUNK_BYTES),) if size else None,
        compression="gzip" if size else None,
    )
    checksum = hashlib.sha256()
    at = 0
    while (chunk := stream.read(_CHUNK_BYTES)) and at + len(chunk) <= size:
        dataset[at : at + len(chunk)] = np.frombuffer(chunk, np.uint8)
        checksum.update(chunk)
        at += len(chunk)
    write_attributes(dataset, {"units": "bytes", "sha256": checksum.hexdigest()})
    return checksum.hexdigest()


def _read_bytes(
    file: Place, name: str, path: str, recorded: str | None, max_size: int | None = None
) -> bytes | None:
    """Compare bytes with their digest and return them.

    Parameters
    ----------
    file : Place
    name : str
        Member of the file.
    path : str
        Path of the file, for messages.
    recorded : str or None
        Digest that ``survey`` states; None in format version 1.
    max_size : int, optional
        Largest size, bytes. None: any size is checked, piece by piece, and no bytes are returned.

    Returns
    -------
    bytes or None
        None: missing or damaged.
    """
    where = f"{path}, {clean(name)}"
    checksum, content = hashlib.sha256(), bytearray()
    try:
        place = find(file, name, path)
        if place is None:
            return None
        dataset = place.item
        refuse_storage(dataset.id, where)
        refuse_chunks(dataset.id, where)
        if dataset.ndim != 1 or dataset.dtype != np.uint8 or dataset.maxshape != dataset.shape:
            return None
        if max_size is not None and dataset.shape[0] > max_size:
            return None
        for at in range(0, dataset.shape[0], _CHUNK_BYTES):
            chunk = np.asarray(dataset[at : at + _CHUNK_BYTES]).tobytes()
            checksum.update(chunk)
            if max_size is not None:  # a capture may be larger than the memory
                content += chunk
        attributes = read_attributes(place, where)
    except Exception:
        return None
    actual = checksum.hexdigest()
    if recorded is None:  # format version 1
        return bytes(content) if attributes.get("sha256") == actual else None
    is_intact = attributes == {"units": "bytes", "sha256": actual} and recorded == actual
    return bytes(content) if is_intact else None
