"""A whole survey in one HDF5 file: written, read, checked.

Groups ``drops/000001`` ... are laid out as the files of drops are; ``survey`` is a JSON text with
points, edits, events and checks, ``results/000001/1`` ... are results, ``captures`` bytes of links.
The layout is described in docs/files.md. h5py is imported by the functions that need it.
"""

import contextlib
import hashlib
import os
from collections.abc import Iterator, Mapping
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pfwd_device.errors import RecordingError
from pfwd_device.recording import DropRecord
from pfwd_device.recording.drop_file import (
    drop_digest,
    read_drop,
    software_version,
    write_drop,
)
from pfwd_device.recording.payload import decode_json, encode_json
from pfwd_survey.files.survey_content import (
    DropContent,
    PointContent,
    Result,
    SurveyContent,
    parse_result,
)

FORMAT = "pfwd-survey"
FORMAT_VERSION = 1

LARGEST_CAPTURE = 2**31
"""Bytes; an hour of eight channels at 50 kHz takes as much."""

DROPS_AT_ONCE = 200
"""Looked at before the file is opened anew: what HDF5 keeps of a file that it reads grows with the
square of their number, to gigabytes with 10,000."""

_CHUNK = 1 << 20


def is_survey_file(path: str | os.PathLike[str]) -> bool:
    """Whether a file is HDF5 and says that it is an exported survey."""
    import h5py

    if not os.path.isfile(path):
        return False  # a pipe may wait for ever
    try:
        with h5py.File(path, "r") as file:
            return str(file.attrs.get("format", "")) == FORMAT
    except Exception:  # what h5py raises on damage is not documented
        return False


def write_survey_file(path: str | os.PathLike[str], content: SurveyContent) -> None:
    """Write a survey into a new HDF5 file and read its drops back.

    Parameters
    ----------
    path : path of a file that is written over
    content : SurveyContent

    Raises
    ------
    RecordingError
        If a drop of the survey is damaged, or what was written is not what is read back.
    """
    # A drop's own file holds its group ready; should one not hold what the journal does, whatever
    # its digest says, nothing is taken from files.
    for from_files in (True, False):
        digests = _write_new(path, content, from_files=from_files)
        # HDF5 may report success on a full disk.
        damaged = _check(os.fspath(path), digests)["damaged"]
        if not damaged:
            return
    raise RecordingError(f"{path}: expected what was written, came {'; '.join(damaged)}")


def _write_new(
    path: str | os.PathLike[str], content: SurveyContent, *, from_files: bool
) -> dict[int, str]:
    """Write the file; the digests of its drops by their number."""
    import h5py

    try:
        with h5py.File(path, "w") as file:
            digests = _write(file, content, from_files=from_files)
            file.flush()
    except RecordingError:
        raise
    except Exception as err:  # as above; a full disk is one of them
        raise RecordingError(f"{path}: expected room to write, came {err}") from err
    return digests


def survey_file_content(path: str | os.PathLike[str]) -> SurveyContent:
    """What an exported survey holds.

    Raises
    ------
    RecordingError
        If the file is damaged, or of a newer version.
    """
    name = os.fspath(path)
    with _opened(name) as file:
        said = _text(file, "survey", name)
        survey_id = str(file.attrs.get("survey_id", ""))
    try:
        facts = {int(drop["number"]): drop for drop in said["drops"]}
        points = tuple(_point(name, point, facts) for point in said["points"])
        return SurveyContent(
            path=name,
            survey_id=survey_id,
            info=dict(said["info"]),
            points=points,
            events=tuple(said["events"]),
            checks=tuple(said["checks"]),
            captures=(),
            damage=tuple(map(str, said["damage"])),
        )
    except (KeyError, TypeError, ValueError, AttributeError) as err:
        raise RecordingError(f"{name}: expected points and drops, came others: {err!r}") from err


def check_survey_file(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Compare everything in an exported survey with its digests.

    Returns
    -------
    dict
        With the keys of ``pfwd check --json``.

    Raises
    ------
    RecordingError
        If it cannot be read at all.
    """
    return _check(os.fspath(path), {})


def _check(name: str, digests: Mapping[int, str]) -> dict[str, Any]:
    """As `check_survey_file`, with what the drops have to be, as far as that is known."""
    damaged: list[str] = []
    whole = 0
    with _opened(name) as file:
        try:
            promised = int(file.attrs["drops_acknowledged"])
            said = _text(file, "survey", name)
            damaged += [str(text) for text in said.get("damage", ())]
            numbers = [int(drop["number"]) for drop in said["drops"]]
        except (RecordingError, KeyError, TypeError, ValueError) as err:
            damaged.append(f"survey: {err}")
            numbers = _numbers(file)
            promised = len(numbers)
    for first in range(0, len(numbers), DROPS_AT_ONCE):
        with _opened(name) as file:
            for number in numbers[first : first + DROPS_AT_ONCE]:
                found = _drop_damage(file, number, name, digests.get(number))
                whole += not any(found[:1])
                damaged += filter(None, found)
    with _opened(name) as file:
        for capture in file.get("captures", ()):
            if not _capture_is_whole(file["captures"][capture]):
                damaged.append(f"{name}, captures/{capture}: other bytes than were written")
    return {
        "survey": name,
        "drops_acknowledged": promised,
        "drops_published": whole,
        "recovered": 0,
        "damaged": damaged,
        "ok": not damaged and whole == promised,
    }


def _drop_damage(file: Any, number: int, name: str, digest: str | None) -> list[str | None]:
    """What is wrong with a drop, or None, then what is with its results."""
    found: list[str | None] = [None]
    try:
        record = _read_drop(file, number, name)
        if digest is not None and drop_digest(record, number) != digest:
            found[0] = f"{name}, drop {number}: expected what the survey holds, came another drop"
    except RecordingError as err:
        found[0] = str(err)
    for result in file.get(f"results/{number:06d}", ()):
        try:
            _text(file, f"results/{number:06d}/{result}", name)
        except RecordingError as err:
            found.append(str(err))
    return found


def _numbers(file: Any) -> list[int]:
    return sorted(int(name) for name in file.get("drops", ()) if name.isdecimal())


@contextlib.contextmanager
def _opened(path: str) -> Iterator[Any]:
    import h5py

    try:
        file = h5py.File(path, "r")
        version = int(file.attrs["format_version"])
    except Exception as err:  # as above
        raise RecordingError(f"{path}: expected an exported survey, came damage: {err}") from err
    with file:
        if version != FORMAT_VERSION:
            raise RecordingError(
                f"{path}: expected format version {FORMAT_VERSION}, came {version}; a newer "
                "version of this program reads it"
            )
        yield file


def _write(file: Any, content: SurveyContent, *, from_files: bool) -> dict[int, str]:
    survey = bytes.fromhex(content.survey_id) if content.survey_id else b""
    drops = content.drops
    file.attrs["format"] = FORMAT
    file.attrs["format_version"] = FORMAT_VERSION
    file.attrs["pfwd_version"] = software_version()
    file.attrs["survey_id"] = content.survey_id
    file.attrs["exported_utc"] = datetime.now(UTC).isoformat(timespec="seconds")
    file.attrs["drops_acknowledged"] = len(drops)
    said = {
        "info": dict(content.info),
        "points": [_point_facts(point) for point in content.points],
        "drops": [_drop_facts(drop) for drop in drops],
        "events": list(content.events),
        "checks": list(content.checks),
        "damage": list(content.damage),
    }
    _write_text(file, "survey", encode_json(said))
    groups = file.create_group("drops")
    digests = {}
    for drop in drops:
        record = drop.read()
        name = f"{drop.number:06d}"
        if not (from_files and _copy_drop(groups, name, drop.read_file(), record)):
            write_drop(groups.create_group(name), record, drop.number, survey)
        digests[drop.number] = drop_digest(record, drop.number)
        results = drop.read_results()
        folder = file.create_group(f"results/{name}") if results else None
        for index, result in enumerate(results, start=1):
            _write_text(folder, str(index), encode_json(result))
    for capture in content.captures:
        _write_capture(file, capture)
    return digests


def _copy_drop(groups: Any, name: str, image: bytes | None, record: DropRecord) -> bool:
    """Whether a drop could be copied from its file, which takes a tenth of the time."""
    from h5py import h5f, h5g, h5o

    if image is None:
        return False
    source = h5f.open_file_image(image)
    try:
        root = h5g.open(source, b"/")
        has_any = root.links.exists(b"rebounds")
        rebounds = h5g.open(root, b"rebounds").get_num_objs() if has_any else 0
        if rebounds != len(record.rebounds):  # they were recorded after it was published
            return False
        h5o.copy(source, b"/", groups.id, name.encode("ascii"))
    finally:
        source.close()
    return True


def _point_facts(point: PointContent) -> dict[str, Any]:
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


def _drop_facts(drop: DropContent) -> dict[str, Any]:
    return {
        "number": drop.number,
        "point": drop.point,
        "drop": drop.drop,
        "key": drop.read_key(),
        "discarded": drop.discarded,
        "notes": list(drop.notes),
        "position": drop.position,
        "target": drop.target,
        "edits": [dict(edit) for edit in drop.edits],
    }


def _point(path: str, said: Mapping[str, Any], facts: Mapping[int, Any]) -> PointContent:
    return PointContent(
        name=str(said["name"]),
        title=str(said["title"]),
        order=int(said["order"]),
        declared=dict(said["declared"]),
        discarded=bool(said["discarded"]),
        notes=tuple(map(str, said["notes"])),
        position=said["position"],
        target=said["target"],
        edits=tuple(map(_edit, said["edits"])),
        drops=tuple(_drop(path, facts[int(number)]) for number in said["drops"]),
    )


def _drop(path: str, said: Mapping[str, Any]) -> DropContent:
    number = int(said["number"])
    return DropContent(
        number=number,
        point=str(said["point"]),
        drop=int(said["drop"]),
        discarded=bool(said["discarded"]),
        notes=tuple(map(str, said["notes"])),
        position=said["position"],
        target=said["target"],
        edits=tuple(map(_edit, said["edits"])),
        read=partial(_drop_of, path, number),
        read_results=partial(_results_of, path, number),
        read_alone=partial(_drop_of, path, number),
        read_key=partial(_text_or_none, said["key"]),
    )


def _text_or_none(value: object) -> str | None:
    return value if isinstance(value, str) else None


def _edit(said: Mapping[str, Any]) -> dict[str, Any]:
    edit = dict(said)
    edit["what"] = str(edit["what"])
    return edit


def _drop_of(path: str, number: int) -> DropRecord:
    with _opened(path) as file:
        return _read_drop(file, number, path)


def _read_drop(file: Any, number: int, path: str) -> DropRecord:
    where = f"{path}, drop {number}"
    try:
        group = file[f"drops/{number:06d}"]
    except Exception as err:  # as above
        raise RecordingError(f"{where}: expected its group, came none") from err
    record, found = read_drop(group, where)
    if found != number:
        raise RecordingError(f"{where}: expected its number, came {found}")
    return record


def _results_of(path: str, number: int) -> tuple[Result, ...]:
    with _opened(path) as file:
        names = sorted(file.get(f"results/{number:06d}", ()), key=lambda name: (len(name), name))
        folder = f"results/{number:06d}"
        texts = [encode_json(_text(file, f"{folder}/{name}", path)) for name in names]
    return tuple(parse_result(text, f"{path}, drop {number}") for text in texts)


def _write_text(file: Any, name: str, text: str) -> None:
    dataset = file.create_dataset(name, data=text)
    dataset.attrs["units"] = "JSON"
    dataset.attrs["sha256"] = hashlib.sha256(text.encode("ascii")).hexdigest()


def _text(file: Any, name: str, path: str) -> Any:
    """A JSON text whose digest is right."""
    where = f"{path}, {name}"
    try:
        data = file[name][()]
        digest = str(file[name].attrs["sha256"])
        found = hashlib.sha256(data).hexdigest()
    except Exception as err:  # as above
        raise RecordingError(f"{where}: expected a text, came damage: {err}") from err
    if found != digest:
        raise RecordingError(f"{where}: expected the text that was written, came another")
    said = decode_json(data)
    if not isinstance(said, dict):
        raise RecordingError(f"{where}: expected an object of JSON, came another thing")
    return said


def _write_capture(file: Any, capture: Path) -> None:
    size = capture.stat().st_size
    if size > LARGEST_CAPTURE:
        raise RecordingError(f"{capture}: expected a capture of at most 2 GiB, came {size} bytes")
    dataset = file.create_dataset(
        f"captures/{capture.name}",
        shape=(size,),
        dtype=np.uint8,
        chunks=(min(size, _CHUNK),) if size else None,
        compression="gzip" if size else None,
    )
    digest = hashlib.sha256()
    at = 0
    with capture.open("rb") as stream:
        while (chunk := stream.read(_CHUNK)) and at + len(chunk) <= size:
            dataset[at : at + len(chunk)] = np.frombuffer(chunk, np.uint8)
            digest.update(chunk)
            at += len(chunk)
    dataset.attrs["units"] = "bytes"
    dataset.attrs["sha256"] = digest.hexdigest()


def _capture_is_whole(dataset: Any) -> bool:
    digest = hashlib.sha256()
    try:
        for at in range(0, dataset.shape[0], _CHUNK):
            digest.update(np.asarray(dataset[at : at + _CHUNK]).tobytes())
        return bool(digest.hexdigest() == str(dataset.attrs["sha256"]))
    except Exception:  # as above
        return False
