"""A whole survey in one HDF5 file: written, read, checked.

Groups ``drops/000001`` ... are laid out as the files of drops are; ``survey`` is a JSON text with
points, edits, events and checks, ``results/000001/1`` ... are results, ``captures`` bytes of links.
The layout is described in docs/files.md. h5py is imported by the functions that need it.

In format version 2 everything that a reader sees is under a digest: ``survey`` names the digests of
drops, results and captures, and the attribute ``visible_sha256`` of the file is that of ``survey``
and of the other attributes. In version 1 only contents had digests, attributes had none.
"""

import contextlib
import hashlib
import os
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from pfwd.spawning import worker_pool
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
from pfwd_device.recording.survey_content import Result, SurveyContent
from pfwd_device.text import clean

FORMAT = "pfwd-survey"
FORMAT_VERSION = 2
"""1 had no digests of attributes."""

MOST_DROPS = 1_000_000
"""Of a survey; a hundred times a large one. Their names are listed before the first is read."""

DROPS_AT_ONCE = 200
"""Looked at before the file is opened anew: what HDF5 keeps of a file that it reads grows with the
square of their number, to gigabytes with 10,000."""

FEWEST_PARTS = 5
"""Of so many drops each, before several processes look at them."""

MOST_RESULTS = 10_000
"""Of a drop."""

LARGEST_CAPTURE = 2**31
"""Bytes; an hour of eight channels at 50 kHz takes as much."""

_CHUNK = 1 << 20


def is_survey_file(path: str | os.PathLike[str]) -> bool:
    """Whether a file is HDF5 and says that it is an exported survey."""
    try:
        with opened(path) as file:
            return read_attribute(file, "format", os.fspath(path)) == FORMAT
    except Exception:  # what h5py raises on damage is not documented
        return False


def write_survey_file(path: str | os.PathLike[str], content: SurveyContent, jobs: int = 1) -> None:
    """Write a survey into a new HDF5 file and read its drops back.

    Parameters
    ----------
    path : path of a file that is written over
    content : SurveyContent
    jobs : int
        Processes that read it back.

    Raises
    ------
    RecordingError
        If a drop of the survey is damaged, or what was written is not what is read back.
    """
    import h5py

    # A drop's own file holds its group ready; should one not hold what the journal does, whatever
    # its digest says, nothing is taken from files.
    for from_files in (True, False):
        try:
            with h5py.File(path, "w") as file:
                kept = _write(file, content, from_files=from_files)
                file.flush()
        except RecordingError:
            raise
        except Exception as err:  # as above; a full disk is one of them
            raise RecordingError(f"{path}: expected room to write, got {err}") from err
        # HDF5 may report success on a full disk.
        damaged = _check(os.fspath(path), kept, jobs)[0]["damaged"]
        if not damaged:
            return
    raise RecordingError(f"{path}: expected what was written, got {'; '.join(damaged)}")


class ExportedSurvey:
    """What an exported survey holds; made by :func:`read_survey_file`."""

    def __init__(
        self, path: str, survey_id: str, said: Mapping[str, Any], there: Container[str]
    ) -> None:
        self.path = path
        self.survey_id = survey_id
        self.info: dict[str, Any] = dict(said["info"])
        self.events: tuple[Mapping[str, Any], ...] = tuple(said["events"])
        self.checks: tuple[Mapping[str, Any], ...] = tuple(said["checks"])
        self.captures: tuple[Path, ...] = ()
        self.damage: tuple[str, ...] = tuple(map(str, said["damage"]))
        facts = {int(drop["number"]): drop for drop in said["drops"]}
        # Without a look into the file for each of them: there may be any number.
        self._missing = {number for number in facts if f"{number:06d}" not in there}
        self._facts = facts
        self._keys: dict[int, str | None] = {}
        self.points: tuple[SurveyPoint, ...] = tuple(map(self._point, said["points"]))
        found = [drop for point in self.points for drop in point.drops]
        self.drops: tuple[SurveyDrop, ...] = tuple(sorted(found, key=lambda drop: drop.number))

    def key_of(self, number: int) -> str | None:
        """What identifies a drop on the instrument."""
        return self._keys[number]

    def results_of(self, _number: int) -> tuple[Path, ...]:
        """None: the results are in the file of the survey."""
        return ()

    def result_count_of(self, number: int) -> int:
        """How many results of a drop are stored."""
        written = self._facts[number].get("results_sha256")
        if written is not None:
            return len(written)
        with _opened(self.path) as file:
            return len(_names(file, f"results/{number:06d}", self.path))

    def last_result_of(self, _number: int) -> None:
        """None, as `results_of`."""

    def place_of(self, _number: int) -> None:
        """None: there is no journal."""

    def file_of(self, _number: int) -> None:
        """None: the drops are in the file of the survey."""

    def file_bytes_of(self, _number: int) -> None:
        """None, as `file_of`."""

    def read_drop(self, number: int) -> DropRecord:
        """A drop with all its rebounds; raises RecordingError when it is not whole."""
        if number in self._missing:
            _no_drop(self.path, number)
        with _opened(self.path) as file:
            return _read_drop(file, number, self.path, self._facts[number].get("sha256"))

    def read_traces(self, number: int) -> DropRecord:
        """A drop without rebounds and without what the converter gave."""
        return replace(self.read_drop(number), counts=None, rebounds=())

    def read_facts(self, number: int) -> DropFacts:
        """Traces of a drop, with what is known of it."""
        return facts_of(self.read_drop(number))

    def read_results(self, number: int) -> tuple[Result, ...]:
        """The results of a drop, in order; raises RecordingError when one is not whole."""
        written = self._facts[number].get("results_sha256")
        with _opened(self.path) as file:
            return _read_results(file, number, self.path, written)

    def read_last_result(self, number: int) -> Result | None:
        """The last of them; None: there is none."""
        return next(iter(self.read_results(number)[::-1]), None)

    def read_diagnosis(self, number: int) -> Result | None:
        """The diagnosis that was kept with the drop."""
        found = self._facts[number].get("diagnosis")
        return found if isinstance(found, dict) else None

    def _point(self, said: Mapping[str, Any]) -> SurveyPoint:
        return SurveyPoint(
            name=str(said["name"]),
            title=str(said["title"]),
            order=int(said["order"]),
            declared=dict(said["declared"]),
            discarded=bool(said["discarded"]),
            notes=tuple(map(str, said["notes"])),
            position=said["position"],
            target=said["target"],
            edits=tuple(map(_edit, said["edits"])),
            drops=tuple(self._drop(self._facts[int(number)]) for number in said["drops"]),
        )

    def _drop(self, said: Mapping[str, Any]) -> SurveyDrop:
        number, key = int(said["number"]), said["key"]
        self._keys[number] = key if isinstance(key, str) else None
        return SurveyDrop(
            number=number,
            point=str(said["point"]),
            drop=int(said["drop"]),
            discarded=bool(said["discarded"]),
            notes=tuple(map(str, said["notes"])),
            position=said["position"],
            target=said["target"],
            edits=tuple(map(_edit, said["edits"])),
            source="export",
            _origin=self,
        )


def read_survey_file(path: str | os.PathLike[str]) -> ExportedSurvey:
    """What an exported survey holds; arrays and results are read when asked for.

    Raises
    ------
    RecordingError
        If the file is damaged, or of a newer version.
    """
    name = os.fspath(path)
    with _opened(name) as file:
        said = _survey(file, name)
        survey_id = str(read_attribute(file, "survey_id", name) or "")
        there = set(_names(file, "drops", name, MOST_DROPS))
    try:
        return ExportedSurvey(name, survey_id, said, there)
    except (KeyError, TypeError, ValueError, AttributeError) as err:
        raise RecordingError(f"{name}: expected points and drops, got others: {err!r}") from err


def check_survey_file(
    path: str | os.PathLike[str], jobs: int = 1
) -> tuple[dict[str, Any], list[str]]:
    """Compare everything in an exported survey with its digests.

    Parameters
    ----------
    path : path of the file
    jobs : int
        Processes that look at it.

    Returns
    -------
    record : dict
        With the keys of ``pfwd check --json``.
    notes : list of str
        What was not compared.

    Raises
    ------
    RecordingError
        If it cannot be read at all.
    """
    return _check(os.fspath(path), {}, jobs)


def _check(name: str, kept: Mapping[int, str], jobs: int = 1) -> tuple[dict[str, Any], list[str]]:
    """As `check_survey_file`; `kept`: digests of what the drops have to be, where that is known."""
    damaged: list[str] = []
    whole = 0
    with _opened(name) as file:
        version = read_attribute(file, "format_version", name)
        try:
            said = _survey(file, name)
            damaged += [str(text) for text in said.get("damage", ())]
            drops = {int(drop["number"]): drop for drop in said["drops"]}
            promised = int(read_attributes(file, name)["drops_acknowledged"])
        except (RecordingError, KeyError, TypeError, ValueError, AttributeError) as err:
            damaged.append(f"survey: {err}")
            drops = {number: {} for number in _numbers(file, name)}
            promised = len(drops)
            said = {}
    numbers = list(drops)
    parts = [
        [(number, drops[number], kept.get(number)) for number in numbers[first:][:DROPS_AT_ONCE]]
        for first in range(0, len(numbers), DROPS_AT_ONCE)
    ]
    look = partial(_drops_damage, name)
    with contextlib.ExitStack() as stack:
        # A few drops are looked at in the time that a process takes to start.
        several = jobs > 1 and len(parts) >= FEWEST_PARTS
        run = stack.enter_context(worker_pool(jobs)).map if several else map
        for good, found in run(look, parts):
            whole += good
            damaged += found
    with _opened(name) as file:
        damaged += _check_captures(file, name, said.get("captures") if version != 1 else None)
        damaged += _strangers(file, name, drops)
    notes = []
    if version == 1:
        notes = [f"{name}: attributes are not covered by the digests of format version 1"]
    return {
        "survey": name,
        "drops_acknowledged": promised,
        "drops_published": whole,
        "recovered": 0,
        "damaged": damaged,
        "ok": not damaged and whole == promised,
    }, notes


def _drops_damage(
    name: str, drops: Sequence[tuple[int, Mapping[str, Any], str | None]]
) -> tuple[int, list[str]]:
    """How many drops are whole, and what is wrong with the others and with results."""
    whole, damaged = 0, []
    with _opened(name) as file:
        for number, facts, kept in drops:
            found = _drop_damage(file, number, name, facts, kept)
            whole += not any(found[:1])
            damaged += [text for text in found if text is not None]
    return whole, damaged


def _drop_damage(
    file: Place, number: int, name: str, facts: Mapping[str, Any], kept: str | None
) -> list[str | None]:
    """What is wrong with a drop, or None, then what is with its results."""
    found: list[str | None] = [None]
    try:
        record = _read_drop(file, number, name, facts.get("sha256"))
        if kept is not None and drop_digest(record, number) != kept:
            found[0] = f"{name}, drop {number}: expected what the survey holds, got another drop"
    except RecordingError as err:
        found[0] = str(err)
    try:
        _read_results(file, number, name, facts.get("results_sha256"))
    except RecordingError as err:
        found.append(str(err))
    return found


def _check_captures(file: Place, path: str, expected: Any) -> list[str]:
    """What is wrong with the captures; `expected`: their digests, None in format version 1."""
    try:
        names = _names(file, "captures", path)
        damaged = [
            f"{path}, captures/{name}: other bytes than were written"
            for name in names
            if not _capture_is_whole(file, name, path, None if expected is None else expected[name])
        ]
        missing = sorted(set(expected or ()) - set(names))
        return damaged + [f"{path}, captures/{clean(name)}: missing" for name in missing]
    except (RecordingError, KeyError, TypeError) as err:
        return [f"{path}, captures: {err}"]


def _strangers(file: Place, path: str, drops: Mapping[int, Any]) -> list[str]:
    """What is in the file besides that of which the survey knows."""
    known = {f"{number:06d}" for number in drops}
    expected = {"survey": None, "drops": known, "results": known, "captures": None}
    found = []
    try:
        for name in member_names(file, path):
            if name not in expected:
                found.append(f"{path}, {clean(name)}: expected nothing, got something")
            elif name != "survey":
                group = find(file, name, path)
                if group is None or read_attributes(group, f"{path}, {name}"):
                    found.append(f"{path}, {name}: expected no attributes, got some")
                for member in _names(file, name, path, MOST_DROPS):
                    allowed = expected[name]
                    if allowed is not None and member not in allowed:
                        found.append(f"{path}, {name}/{clean(member)}: expected nothing")
    except RecordingError as err:
        found.append(str(err))
    except Exception as err:  # as above
        found.append(f"{path}: expected groups, got damage: {err}")
    return found


def _numbers(file: Place, path: str) -> list[int]:
    try:
        names = _names(file, "drops", path, MOST_DROPS)
    except RecordingError:
        return []
    return sorted(int(name) for name in names if name.isascii() and name.isdecimal())


def _names(file: Place, group: str, path: str, most: int = MOST_RESULTS) -> list[str]:
    """Names in a group that may be missing, in the order of their numbers."""
    where = f"{path}, {group}"
    try:
        parent = find(file, group, path)
        names = [] if parent is None else member_names(parent, where, most)
    except RecordingError:
        raise
    except Exception as err:  # as above
        raise RecordingError(f"{where}: expected a group, got damage: {err}") from err
    return sorted(names, key=lambda name: (len(name), name))


@contextlib.contextmanager
def _opened(path: str) -> Iterator[Place]:
    with contextlib.ExitStack() as stack:
        try:
            file = stack.enter_context(opened(path))
            version = read_attribute(file, "format_version", path)
        except Exception as err:  # as above
            raise RecordingError(f"{path}: expected an exported survey, got damage: {err}") from err
        if isinstance(version, int) and version > FORMAT_VERSION:
            raise RecordingError(
                f"{path}: expected format version {FORMAT_VERSION}, got {version}; a newer "
                "version of this program reads it"
            )
        if version not in (1, FORMAT_VERSION):
            raise RecordingError(f"{path}: expected a format version, got {version!r:.40}")
        yield file


def _survey(file: Place, path: str) -> dict[str, Any]:
    """What the file says of the survey; of version 2 after its digest was compared."""
    try:
        attributes = read_attributes(file, path)
        written = attributes.pop(DIGEST, None)
        said = _text(file, "survey", path)
        if attributes["format_version"] == 1:
            # Neither can be told from the other by the number alone, which is an attribute.
            if written is not None or "format_version" in said:
                raise RecordingError(f"{path}: expected format version 1, got a file of another")
            return said
        survey = Group({"survey": read_dataset(file, "survey", path)}, attributes)
    except RecordingError as err:
        raise _placed(err, path) from err
    except Exception as err:  # as above
        raise RecordingError(f"{path}: expected a survey, got damage: {err}") from err
    if written != digest(survey):
        raise RecordingError(
            f"{path}: expected the attributes and the survey that were written, got others"
        )
    return said


def _write(file: Any, content: SurveyContent, *, from_files: bool) -> dict[int, str]:
    """Write everything; digests of what is kept of the drops, by their numbers."""
    survey = bytes.fromhex(content.survey_id) if content.survey_id else b""
    drops = content.drops
    told = []
    groups = file.create_group("drops")
    kept = {}
    for drop in drops:
        record = drop.read()
        name = f"{drop.number:06d}"
        copied = _copy_drop(groups, name, drop.read_file(), record) if from_files else None
        facts = _drop_facts(drop, record)
        facts["sha256"] = copied or write_drop(
            groups.create_group(name), record, drop.number, survey
        )
        kept[drop.number] = drop_digest(record, drop.number)
        diagnosis = drop.read_diagnosis()
        if diagnosis is not None:
            facts["diagnosis"] = dict(diagnosis)
        facts["results_sha256"] = [
            _write_text(file, f"results/{drop.number:06d}/{index}", encode_json(result))
            for index, result in enumerate(drop.read_results(), start=1)
        ]
        told.append(facts)
    said = {
        "format_version": FORMAT_VERSION,
        "info": dict(content.info),
        "points": [_point_facts(point) for point in content.points],
        "drops": told,
        "events": list(content.events),
        "checks": list(content.checks),
        "damage": list(content.damage),
        "captures": {capture.name: _write_capture(file, capture) for capture in content.captures},
    }
    text = encode_json(said)
    if (problem := json_excess(text)) is not None:  # what is not read again is not written
        raise RecordingError(f"{content.path}: {problem}; export it in parts")
    _write_text(file, "survey", text)
    attributes: dict[str, Attribute] = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "pfwd_version": software_version(),
        "survey_id": content.survey_id,
        "exported_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "drops_acknowledged": len(drops),
    }
    visible = Group({"survey": _text_dataset(text)}, attributes)
    write_attributes(file, {**attributes, DIGEST: digest(visible)})
    return kept


def _copy_drop(groups: Any, name: str, image: bytes | None, record: DropRecord) -> str | None:
    """Digest of a drop that could be copied from its file, which takes a tenth of the time."""
    from h5py import File, h5f, h5g, h5o

    if image is None:
        return None
    source = h5f.open_file_image(image)
    try:
        attributes = File(source).attrs
        version, written = attributes.get("format_version"), attributes.get(DIGEST)
        if version != FILE_VERSION or not isinstance(written, str):
            return None  # of an earlier version: it is written as this one does
        root = h5g.open(source, b"/")
        has_any = root.links.exists(b"rebounds")
        rebounds = h5g.open(root, b"rebounds").get_num_objs() if has_any else 0
        if rebounds != len(record.rebounds):  # they were recorded after it was published
            return None
        h5o.copy(source, b"/", groups.id, name.encode("ascii"))
    finally:
        source.close()
    return written


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


def _edit(said: Mapping[str, Any]) -> dict[str, Any]:
    edit = dict(said)
    edit["what"] = str(edit["what"])
    return edit


def _no_drop(path: str, number: int) -> NoReturn:
    raise RecordingError(f"{path}, drop {number}: expected its group, got none")


def _read_drop(file: Place, number: int, path: str, written: str | None) -> DropRecord:
    """A drop of the file; `written`: its digest, None in format version 1."""
    where = f"{path}, drop {number}"
    try:
        group = find(file, f"drops/{number:06d}", path)
    except RecordingError:
        raise
    except Exception as err:  # as above
        raise RecordingError(f"{where}: expected its group, got damage: {err}") from err
    if group is None:
        _no_drop(path, number)
    found = read_drop(group, where)
    if found.number != number:
        raise RecordingError(f"{where}: expected its number, got {found.number}")
    if (found.digest if found.version > 1 else None) != written:
        raise RecordingError(f"{where}: expected the content that was written, got another")
    return found.record


def _read_results(
    file: Place, number: int, path: str, written: Sequence[str] | None
) -> tuple[Result, ...]:
    """The results of a drop; `written`: their digests, None in format version 1."""
    folder = f"results/{number:06d}"
    names = _names(file, folder, path)
    if written is not None and names != [str(n) for n in range(1, len(written) + 1)]:
        raise RecordingError(f"{path}, {folder}: expected {len(written)} results, got others")
    if not names:
        return ()
    results = []
    for index, name in enumerate(names):
        digest_of = None if written is None else written[index]
        results.append(_text(file, f"{folder}/{name}", path, digest_of))
    group = find(file, folder, path)
    if written is not None and group is not None and read_attributes(group, folder):
        raise RecordingError(f"{path}, {folder}: expected no attributes, got some")
    return tuple(results)


def _text_dataset(text: str) -> Dataset:
    found = hashlib.sha256(text.encode("ascii")).hexdigest()
    return Dataset(text, {"units": "JSON", "sha256": found})


def _write_text(file: Any, name: str, text: str) -> str:
    """Write a text; its digest."""
    dataset = _text_dataset(text)
    write_dataset(file, name, dataset)
    return str(dataset.attributes["sha256"])


def _text(file: Place, name: str, path: str, written: str | None = None) -> dict[str, Any]:
    """A JSON text whose digest is right; `written`: what it was, where that is known."""
    where = f"{path}, {name}"
    try:
        dataset = read_dataset(file, name, path)
        text = dataset.value
        if not isinstance(text, str):
            raise RecordingError(f"{where}: expected a text, got numbers")
        expected = _text_dataset(text).attributes
    except RecordingError as err:
        raise _placed(err, where) from err
    except Exception as err:  # as above
        raise RecordingError(f"{where}: expected a text, got damage: {err}") from err
    found = expected["sha256"]
    if dataset.attributes.get("sha256") != found or written not in (None, found):
        raise RecordingError(f"{where}: expected the text that was written, got another")
    if written is not None and dataset.attributes != expected:
        raise RecordingError(f"{where}: expected the attributes that were written, got others")
    try:
        said = decode_json(text)
    except RecordingError as err:
        raise _placed(err, where) from err
    if not isinstance(said, dict):
        raise RecordingError(f"{where}: expected an object of JSON, got another thing")
    return said


def _placed(err: RecordingError, where: str) -> RecordingError:
    """The error with its place, where it does not say that itself."""
    text = str(err)
    return err if text.startswith(where.partition(", ")[0]) else RecordingError(f"{where}: {text}")


def _write_capture(file: Any, capture: Path) -> str:
    """Write the bytes of a link; their digest."""
    size = capture.stat().st_size
    if size > LARGEST_CAPTURE:
        raise RecordingError(f"{capture}: expected a capture of at most 2 GiB, got {size} bytes")
    dataset = file.create_dataset(
        f"captures/{capture.name}",
        shape=(size,),
        dtype=np.uint8,
        chunks=(min(size, _CHUNK),) if size else None,
        compression="gzip" if size else None,
    )
    found = hashlib.sha256()
    at = 0
    with capture.open("rb") as stream:
        while (chunk := stream.read(_CHUNK)) and at + len(chunk) <= size:
            dataset[at : at + len(chunk)] = np.frombuffer(chunk, np.uint8)
            found.update(chunk)
            at += len(chunk)
    write_attributes(dataset, {"units": "bytes", "sha256": found.hexdigest()})
    return found.hexdigest()


def _capture_is_whole(file: Place, name: str, path: str, written: str | None) -> bool:
    """Whether the bytes are as they were; `written`: their digest, None in format version 1."""
    where = f"{path}, captures/{clean(name)}"
    found = hashlib.sha256()
    try:
        place = find(file, f"captures/{name}", path)
        if place is None:
            return False
        dataset = place.item
        refuse_storage(dataset.id, where)
        refuse_chunks(dataset.id, where)
        if dataset.ndim != 1 or dataset.dtype != np.uint8 or dataset.maxshape != dataset.shape:
            return False
        for at in range(0, dataset.shape[0], _CHUNK):
            found.update(np.asarray(dataset[at : at + _CHUNK]).tobytes())
        expected = {"units": "bytes", "sha256": found.hexdigest()}
        attributes = read_attributes(place, where)
    except Exception:  # as above
        return False
    if written is None:
        return attributes.get("sha256") == expected["sha256"]
    return attributes == expected and written == expected["sha256"]
