"""Puts a survey right after a crash or damage; each step may be interrupted and done again."""

import base64
import contextlib
import os
import uuid
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_payload import (
    drop_from_parts,
    raised_version,
    rebound_from_payload,
    rebound_payload,
)
from pfwd_device.recording.file_repair import FileRepair
from pfwd_device.recording.files import keep_copy, now
from pfwd_device.recording.framing import Kind
from pfwd_device.recording.index import (
    Index,
    about_of,
    build_index,
    damage_key,
    read_index,
)
from pfwd_device.recording.journal import open_segment, read_record
from pfwd_device.recording.layout import FORMAT_VERSION, Layout, refuse_links
from pfwd_device.recording.ledger import Entry, ledger_bytes, read_about
from pfwd_device.recording.lock import SurveyLock, file_locked
from pfwd_device.recording.payload import decode_payload, payload_data
from pfwd_device.recording.publishing import ChildPublisher, Publisher
from pfwd_device.recording.record import Rebound
from pfwd_device.recording.record_log import RecordLog, refused
from pfwd_device.recording.returning import bring_home, waiting_texts
from pfwd_device.recording.spare import SpareFolder, home_of
from pfwd_device.recording.storage import Storage

PUBLISH_TIMEOUT = 30.0
"""s; longer than the publisher of a killed program takes for the file in hand."""


MOST_NAMED = 1000
"""Lost records other than drops that are told one by one; nobody reads a list of 600,000."""


@dataclass(frozen=True, slots=True)
class RecoveryReport:
    """What recovery found and did."""

    survey: str
    """Folder."""
    drops_acknowledged: int
    """Drops that were acknowledged, lost ones with them."""
    drops_published: int
    """Drops with a verified file."""
    recovered: int
    """Drops put back: into the ledger, into the journal, or into a file."""
    damaged: tuple[str, ...]
    """What is still missing or damaged, a short text each."""
    actions: tuple[str, ...]
    """What was done."""

    @property
    def ok(self) -> bool:
        """Nothing acknowledged is missing."""
        return not self.damaged


def recover(
    folder: str | os.PathLike[str],
    storage: Storage | None = None,
    *,
    publisher: Publisher | None = None,
    spare: SpareFolder | None = None,
) -> RecoveryReport:
    """Put right whatever a crash left in a survey; doing it again changes nothing.

    What the spare folder holds of the survey is brought home; a survey of which nothing else is
    left is made anew from it.

    Raises
    ------
    SurveyLocked
        If a program writes the survey.
    RecordingError
        If the folder holds no survey, or cannot be written.
    """
    storage = storage or Storage()
    layout = Layout(Path(folder).absolute())
    if not prepare(layout):
        if not (spare is not None and spare.parts(home=layout.folder)):
            raise RecordingError(
                f"{layout.folder}: expected the folder of a survey, got none; is the path right?"
            )
        try:
            storage.make_folder(layout.folder)
        except OSError as err:
            raise refused(err, str(layout.folder)) from err
    lock = SurveyLock(layout, storage)
    helper = publisher or ChildPublisher()
    log: RecordLog | None = None
    try:
        for path in layout.folders:
            storage.make_folder(path)
        log, index, actions = begin(layout, storage, helper, lock, spare, read=build_index)
        report = repair(log, index, helper, thorough=True)
        if not index.closed:
            log.append(Kind.CLOSE, {"by": "recovery", "time_utc": now()})
        left = waiting_texts(spare, index)
        return replace(
            report, damaged=(*report.damaged, *left), actions=(*actions, *report.actions)
        )
    except OSError as err:
        if isinstance(err, RecordingError):
            raise
        raise refused(err, str(layout.folder)) from err
    finally:
        if log is not None:
            log.close()
        helper.close()
        lock.release()


def prepare(layout: Layout) -> bool:
    """Whether there is a survey; refuse a folder that is not to be written to as one.

    Raises
    ------
    RecordingError
        If it is a part of the spare folder, holds links, or cannot be looked into.
    """
    facts = home_of(layout.folder)
    if facts is not None:
        raise RecordingError(
            f"{layout.folder}: expected a survey, got what the spare folder keeps of "
            f"{facts['survey']}; try pfwd recover {facts['survey']}, or pfwd import it elsewhere"
        )
    try:
        refuse_links(layout)
        return layout.exists()
    except OSError as err:
        raise refused(err, str(layout.folder)) from err


def begin(
    layout: Layout,
    storage: Storage,
    helper: Publisher,
    lock: SurveyLock,
    spare: SpareFolder | None = None,
    *,
    fall_back: bool = False,
    read: Callable[[Layout], Index] = read_index,
) -> tuple[RecordLog, Index, list[str]]:
    """Journal and ledger ready to be appended to, and what was brought home.

    Torn ends are cut, the ledger is put right. With `fall_back` the spare folder takes what the
    survey's own refuses from then on. `read` gives what is there, once nobody else can write;
    :func:`build_index` looks at the content of every record. Raises OSError or RecordingError.
    """
    segments = layout.segments()
    continued: tuple[int, int] | None = None
    if segments:
        # First of all: while another program has it open, nothing is to be cut.
        continued = segments[-1], open_segment(layout, segments[-1], storage)
    try:
        log, index = _begin(layout, storage, helper, lock, spare, continued, read)
    except BaseException:
        if continued is not None:
            with contextlib.suppress(OSError):
                storage.close(continued[1])
        raise
    try:
        actions = bring_home(log, index, spare)
        if not index.info:
            data: dict[str, Any] = {
                "format_version": FORMAT_VERSION,
                "survey_id": log.survey.hex(),
                "created_utc": now(),
                "software": _software(),
            }
            index.add(log.append(Kind.SURVEY, data), data)
    except BaseException:
        log.close()
        raise
    if fall_back:
        log.spare = spare
    return log, index, actions


def _begin(
    layout: Layout,
    storage: Storage,
    helper: Publisher,
    lock: SurveyLock,
    spare: SpareFolder | None,
    continued: tuple[int, int] | None,
    read: Callable[[Layout], Index],
) -> tuple[RecordLog, Index]:
    index = read(layout)
    if index.survey is None:
        index.survey = (
            _survey_of_files(layout, helper)
            or _survey_of_spare(layout, spare)
            or uuid.uuid4().bytes
        )
    for stretch in index.damage:
        if stretch.damage.at_end:
            _cut(layout, storage, stretch.segment, stretch.damage.offset, stretch.damage.length)
    _sync_journal(layout, storage, index)
    entries = [entry for _, entry in sorted((index.lost | index.entries).items())]
    data = _repair_ledger(layout, storage, index, entries)
    index.ledger = replace(index.ledger, data=None)  # of no use any more, and large
    log = RecordLog(
        layout,
        index.survey,
        storage,
        entries=entries,
        ledger=data,
        lost=index.lost,
        continued=continued,
        lock=lock,
    )
    log.moved = index.relocate
    return log, index


def repair(
    log: RecordLog,
    index: Index,
    helper: Publisher,
    *,
    publish: bool = True,
    thorough: bool = False,
) -> RecoveryReport:
    """Restore drops and files, and tell what is lost.

    Parameters
    ----------
    publish : bool
        Make the files of drops that have none.
    thorough : bool
        Compare the content of every file, not only its size.
    """
    layout = log.layout
    unlisted = set(index.unacknowledged)
    recovered = {d.number for d in index.drops.values() if d.entry.sequence in unlisted}
    actions = [f"drop {number} entered in the ledger" for number in sorted(recovered)]
    _wait_for_publisher(layout, log.storage)
    files = FileRepair(log, index, helper, thorough=thorough)
    files.take_drafts_away()
    for number in _restorable(layout, index):
        if _restore(log, index, helper, number):
            recovered.add(number)
            actions.append(f"drop {number} restored from its file")
    _restore_points(log, index)
    rebounds = _restore_rebounds(log, index, helper)
    actions += [f"rebound of drop {number} restored from its file" for number in rebounds.values()]
    made = files.repair_drop_files(publish=publish)
    recovered |= set(made)
    actions += [f"drop {number} published" for number in made]
    files.repair_other_files()
    _settle(log, index, files_listed=publish, restored=set(rebounds))
    return RecoveryReport(
        str(layout.folder),
        len(index.drops) + len(index.lost_drops),
        sum(layout.drop_file_name(n) in files.sound for n in index.drops),
        len(recovered),
        (*lost_texts(index), *files.damaged),
        (*actions, *files.actions),
    )


def lost_texts(index: Index) -> list[str]:
    """A short text for everything acknowledged that is missing, by number.

    Drops are always named each; of very many other records the first and the last are.
    """
    lost = [entry for number, entry in sorted(index.lost.items()) if number not in index.settled]
    others = [entry.sequence for entry in lost if entry.kind != Kind.DROP]
    if len(others) > MOST_NAMED:
        lost = [entry for entry in lost if entry.kind == Kind.DROP]
    texts = [f"{describe(entry)} is lost" for entry in lost]
    if len(others) > MOST_NAMED:
        texts.append(f"{len(others)} records between {others[0]} and {others[-1]} are lost")
    if index.gaps:
        first, last = index.gaps[0], index.gaps[-1]
        texts.append(f"{len(index.gaps)} records between {first} and {last} are lost unnamed")
    return texts


def describe(entry: Entry) -> str:
    """Name of a record for people: a drop by its point and number."""
    about = read_about(entry.about) if entry.kind == Kind.DROP else None
    if about is not None:
        return f"drop {about[1]}/{about[2]}"
    try:
        kind = Kind(entry.kind).name.lower()
    except ValueError:
        kind = f"type {entry.kind}"
    return f"record {entry.sequence} ({kind})"


def _cut(layout: Layout, storage: Storage, segment: int, offset: int, length: int) -> None:
    """Take the torn end of a segment away; its bytes are kept."""
    path = layout.segment(segment)
    keep_copy(layout, storage, path, f"journal-{segment:04d}-{offset}.bytes", offset, length)
    descriptor = storage.open(path)
    try:
        storage.truncate(descriptor, offset)
        storage.sync(descriptor)
    finally:
        storage.close(descriptor)


def _sync_journal(layout: Layout, storage: Storage, index: Index) -> None:
    """What a killed program wrote is there to be read, and need not be on the disk.

    The ledger must not name it, and no record follow it in its segment, before it is.
    """
    segments = {index.entries[number].segment for number in index.unacknowledged}
    for segment in sorted(segments | set(layout.segments()[-1:])):
        descriptor = storage.open(layout.segment(segment))
        try:
            storage.sync(descriptor)
        finally:
            storage.close(descriptor)
    storage.sync_directory(layout.journal)


def _repair_ledger(layout: Layout, storage: Storage, index: Index, entries: list[Entry]) -> bytes:
    """What is in the ledger now."""
    assert index.survey is not None
    ledger = index.ledger
    known = ledger.survey == index.survey and ledger.entries == tuple(entries)
    whole = (ledger.data if known else None) or ledger_bytes(index.survey, entries)
    if not _holds(layout.ledger, whole):
        if index.ledger.damaged:
            keep_copy(layout, storage, layout.ledger, layout.ledger.name)
        storage.write_file(layout.ledger, whole)
    return whole


def _holds(path: Path, data: bytes) -> bool:
    """Whether a file has these bytes; one of another size is not read."""
    try:
        return path.stat().st_size == len(data) and path.read_bytes() == data
    except FileNotFoundError:
        return False


def _wait_for_publisher(layout: Layout, storage: Storage) -> None:
    """The publisher of a killed program may be at its last file."""
    if not layout.publish_lock.exists():
        return
    try:
        with file_locked(layout.publish_lock, PUBLISH_TIMEOUT, storage):
            pass
    except TimeoutError as err:
        raise RecordingError(
            f"{layout.publish_lock}: expected to be free, got a program that still publishes; "
            "end it and try again"
        ) from err


def _restorable(layout: Layout, index: Index) -> list[int]:
    return [number for number in layout.drop_files() if number not in index.drops]


def _restore(log: RecordLog, index: Index, helper: Publisher, number: int) -> bool:
    """Whether the drop, whose record is damaged, could be taken from its file."""
    lost = {
        about[0]: entry
        for entry in index.lost.values()
        if entry.kind == Kind.DROP and (about := read_about(entry.about)) is not None
    }
    try:
        found = _file_record(log.layout, helper, number)
        if found["number"] != number or found["survey_id"] != log.survey.hex():
            return False
        data, arrays = decode_payload(base64.b64decode(found["payload"]))
        key = data["metadata"].get("key")
    except (RecordingError, KeyError, ValueError, TypeError, AttributeError):
        return False  # the file is damaged too; repair_drop_files names it
    entry = lost.get(number)
    data |= {
        "number": number,
        "key": key if isinstance(key, str) else None,
        "restored_from": entry.sequence if entry else 0,
    }
    if (info := raised_version(index.info, data)) is not None:
        info = {**info, "survey_id": log.survey.hex()}
        index.add(log.append(Kind.SURVEY, info), info)
    index.add(log.append(Kind.DROP, data, arrays, about_of(Kind.DROP, data)), data)
    return True


def _restore_rebounds(log: RecordLog, index: Index, helper: Publisher) -> dict[int, int]:
    """Numbers of the drops whose lost rebounds were in their files, by number of the lost record.

    The ledger does not say whose rebound a lost record was; each that a file holds and the journal
    does not settles one of them.
    """
    lost = [
        number
        for number, entry in sorted(index.lost.items())
        if entry.kind == Kind.REBOUND and number not in index.settled
    ]
    restored: dict[int, int] = {}
    for number in sorted(index.drops) if lost else ():
        for rebound in _rebounds_of_file_alone(log, index, helper, number):
            if not lost:
                break
            payload = rebound_payload(number, rebound)
            index.add(log.append_payload(Kind.REBOUND, payload), {"number": number})
            restored[lost.pop(0)] = number
    return restored


def _rebounds_of_file_alone(
    log: RecordLog, index: Index, helper: Publisher, number: int
) -> list[Rebound]:
    """Rebounds that the drop's file holds and the journal does not."""
    layout, drop = log.layout, index.drops[number]
    if not layout.drop_file(number).exists():
        return []
    try:
        found = _file_record(layout, helper, number)
        if found["number"] != number or found["survey_id"] != log.survey.hex():
            return []
        in_file = drop_from_parts(*decode_payload(base64.b64decode(found["payload"])))
        frame = read_record(layout, drop.entry.segment, drop.entry.offset)
        known = list(drop_from_parts(*decode_payload(frame.payload)).rebounds)
        for entry in drop.rebounds:
            frame = read_record(layout, entry.segment, entry.offset)
            known.append(rebound_from_payload(frame.payload))
    except (RecordingError, KeyError, ValueError, TypeError):
        return []  # what is damaged is named by others
    there = {(rebound.first_sample, rebound.delay) for rebound in known}
    return [r for r in in_file.rebounds if (r.first_sample, r.delay) not in there]


def _file_record(layout: Layout, helper: Publisher, number: int) -> dict[str, Any]:
    return helper.ask({"do": "read", "survey": str(layout.folder), "number": number})


def _survey_of_files(layout: Layout, helper: Publisher) -> bytes | None:
    """Identity of the survey from a drop file, when journal and ledger are gone."""
    for number in layout.drop_files():
        try:
            return bytes.fromhex(str(_file_record(layout, helper, number)["survey_id"]))
        except (RecordingError, KeyError, ValueError):
            continue
    return None


def _survey_of_spare(layout: Layout, spare: SpareFolder | None) -> bytes | None:
    """Identity of the survey from the spare folder, when nothing is left at home."""
    for part in spare.parts(home=layout.folder) if spare is not None else ():
        facts = home_of(part.folder)
        if facts is not None:
            return bytes.fromhex(facts["survey_id"])
    return None


def _restore_points(log: RecordLog, index: Index) -> None:
    for drop in sorted(index.drops.values(), key=lambda drop: drop.number):
        if drop.point in index.points:
            continue
        frame = read_record(log.layout, drop.entry.segment, drop.entry.offset)
        declared = payload_data(frame.payload).get("declared")
        data = {
            "name": drop.point,
            "order": len(index.points) + 1,
            "declared": declared if isinstance(declared, dict) else {},
            "time_utc": now(),
        }
        index.add(log.append(Kind.POINT, data), data)


def _settle(log: RecordLog, index: Index, *, files_listed: bool, restored: set[int]) -> None:
    """Note which damage has been dealt with, so that a check does not name it again."""
    replaced = {Kind.CLOSE, Kind.SURVEY} | ({Kind.FILE} if files_listed else set())
    settled = sorted(
        number
        for number, entry in index.lost.items()
        if (entry.kind in replaced or number in restored) and number not in index.settled
    )
    damage = [
        damage_key(log.layout, stretch) for stretch in index.damage if not stretch.damage.at_end
    ]
    damage += [(e.segment, e.offset, e.length, e.check) for e, _ in index.strange]
    fresh = [list(key) for key in damage if key not in index.known_damage]
    if settled or fresh:
        data = {"event": "recovery", "settled": settled, "damage": fresh, "time_utc": now()}
        index.add(log.append(Kind.EVENT, data), data)


def _software() -> str:
    from pfwd_device.recording.drop_file import software_version

    return f"pfwd {software_version()}"
