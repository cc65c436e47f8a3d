"""Recovery of a survey after a crash or damage; each step may be interrupted and repeated.

The journal contains all records of a survey; the ledger is a text file that lists the records that
reached the disk; each drop also has an HDF5 file. A recovery restores each of them from the others
as far as possible. It also merges the records of the spare folder, a second folder that received
records while the folder of the survey could not be written.
"""

from __future__ import annotations

import contextlib
import os
import uuid
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_file import read_drop_file_parts, software_version
from pfwd_device.recording.drop_payload import (
    drop_from_parts,
    drop_parts,
    rebound_from_payload,
    rebound_payload,
)
from pfwd_device.recording.file_repair import FileRepair
from pfwd_device.recording.files import keep_copy, now, sync_journal
from pfwd_device.recording.framing import RecordKind
from pfwd_device.recording.index import (
    Index,
    build_index,
    damage_key,
    read_index,
)
from pfwd_device.recording.journal import open_segment, read_record
from pfwd_device.recording.layout import FORMAT_VERSION, Layout, no_survey, refuse_links
from pfwd_device.recording.ledger import Entry, ledger_bytes
from pfwd_device.recording.lock import SurveyLock, file_locked
from pfwd_device.recording.payload import decode_payload, payload_data
from pfwd_device.recording.publishing import publishing_process, result_of
from pfwd_device.recording.record import DropRecord, ReboundRecord
from pfwd_device.recording.record_log import RecordFiles, RecordLog, refused
from pfwd_device.recording.spare import SpareFolder, home_of
from pfwd_device.recording.spare_merge import (
    append_drop,
    append_point,
    describe_deleted_surveys,
    describe_records_only_in_spare,
    merge_spare_records,
)
from pfwd_device.recording.storage import Storage, has_content

if TYPE_CHECKING:
    from pfwd_device.jobs import Jobs

PUBLISHER_WAIT_S = 30.0
"""Longest wait for a process of a killed program to finish the drop file that it is making, s."""


MAX_NAMED_RECORDS = 1000
"""Largest number of lost records other than drops that are listed one by one."""


@dataclass(frozen=True, slots=True)
class SurveyState:
    """State of the drops and files of a survey."""

    survey: str
    """Folder of the survey."""
    drops_acknowledged: int
    """Number of drops that were reported as saved, including lost ones."""
    drops_published: int
    """Number of drops whose HDF5 file exists and is unchanged."""
    recovered: int
    """Number of drops that were restored: by this recovery, or for a check by all earlier ones."""
    damaged: tuple[str, ...]
    """Descriptions of damaged, missing or lost parts, each with its file or drop."""

    @property
    def ok(self) -> bool:
        """True if no saved data are missing or damaged."""
        return not self.damaged


@dataclass(frozen=True, slots=True)
class RecoveryReport(SurveyState):
    """Result of a recovery."""

    actions: tuple[str, ...]
    """Descriptions of the actions of the recovery."""


def recover(
    folder: str | os.PathLike[str],
    storage: Storage | None = None,
    *,
    jobs: Jobs | None = None,
    spare: SpareFolder | None = None,
) -> RecoveryReport:
    """Recover a survey after a crash or damage; a repetition changes nothing.

    Parameters
    ----------
    folder : path
        Folder of the survey. It may be missing if the spare folder has records of the survey.
    storage : Storage, optional
        Access to the files; by default that of the system.
    jobs : Jobs, optional
        Process that makes the HDF5 files of drops; it is closed at the end.
    spare : SpareFolder, optional
        Folder that received records while the folder of the survey could not be written. They are
        merged into the survey.

    Raises
    ------
    SurveyLocked
        If a program writes the survey.
    RecordingError
        If the folder contains no survey, or cannot be written.
    """
    storage = storage or Storage()
    layout = Layout(Path(folder).absolute())
    if not (prepare(layout) or (spare is not None and spare.parts(home=layout.folder))):
        raise no_survey(layout.folder)
    identity = _survey_of_spare(layout, spare)
    jobs = jobs or publishing_process()
    log: RecordLog | None = None
    try:
        log, index, actions = begin(
            layout, storage, jobs, spare, read=build_index, identity=identity
        )
        actions += describe_deleted_surveys(spare, layout.folder, log.survey)
        report = repair(log, index, jobs, thorough=True)
        if not index.closed:
            log.append(RecordKind.CLOSE, {"by": "recovery", "time_utc": now()})
        still_in_spare = describe_records_only_in_spare(spare, index)
        return replace(
            report, damaged=(*report.damaged, *still_in_spare), actions=(*actions, *report.actions)
        )
    except OSError as err:
        if isinstance(err, RecordingError):
            raise
        raise refused(err, str(layout.folder)) from err
    finally:
        if log is not None:
            log.close()
        jobs.close()


def prepare(layout: Layout) -> bool:
    """Return True if a folder contains a survey.

    Raises
    ------
    RecordingError
        If no survey may be written there: the folder belongs to the spare folder, contains links,
        or cannot be read.
    """
    facts = home_of(layout.folder)
    if facts is not None:
        raise RecordingError(
            f"{layout.folder}: expected a survey, got the records in the spare folder for "
            f"{facts['survey']}; run pfwd recover {facts['survey']}, or import them elsewhere with "
            "pfwd import"
        )
    try:
        refuse_links(layout)
        return layout.exists()
    except OSError as err:
        raise refused(err, str(layout.folder)) from err


def begin(
    layout: Layout,
    storage: Storage,
    jobs: Jobs,
    spare: SpareFolder | None = None,
    *,
    fall_back: bool = False,
    read: Callable[[Layout], Index] = read_index,
    identity: bytes | None = None,
) -> tuple[RecordLog, Index, list[str]]:
    """Lock a survey, and open its journal and ledger for writing, after their repair.

    Missing folders are created. Unfinished ends of the journal are cut, the ledger is made to agree
    with the journal, and the records in the spare folder are merged.

    Parameters
    ----------
    layout : Layout
        Paths of the survey.
    storage : Storage
        Access to the files.
    jobs : Jobs
        Process that reads the HDF5 files of drops.
    spare : SpareFolder, optional
        Folder whose records of the survey are merged.
    fall_back : bool
        True: records that the survey's folder refuses later are written to the spare folder.
    read : callable
        Function that reads the index: `read_index`, or `build_index`, which reads the content of
        every record.
    identity : bytes, optional
        Identity of a survey whose folder contains none; by default it is a new survey, even if the
        spare folder has records of a deleted survey with the same path.

    Returns
    -------
    (RecordLog, Index, list of str)
        Writer of records, content of the survey, and descriptions of the merged records.

    Raises
    ------
    OSError, RecordingError
        If the survey cannot be read or written, or another program writes it.
    """
    storage.make_folder(layout.folder)
    lock = SurveyLock(layout, storage)
    continued: tuple[int, int] | None = None
    try:
        for path in layout.folders:
            storage.make_folder(path)
        segments = layout.segments()
        if segments:
            # Lock first: nothing may be cut while another program has the file open.
            continued = segments[-1], open_segment(layout, segments[-1], storage)
        log, index = _begin(layout, storage, jobs, lock, continued, read, identity)
    except BaseException:
        if continued is not None:
            with contextlib.suppress(OSError):
                storage.close(continued[1])
        lock.release()
        raise
    try:
        actions = merge_spare_records(log, index, spare)
        if not index.info:
            data: dict[str, Any] = {
                "format_version": FORMAT_VERSION,
                "survey_id": log.survey.hex(),
                "created_utc": now(),
                "software": f"pfwd {software_version()}",
            }
            index.add(log.append(RecordKind.SURVEY, data), data)
            if identity is None:
                actions += describe_deleted_surveys(spare, layout.folder, log.survey)
    except BaseException:
        log.close()
        raise
    if fall_back:
        log.spare = spare
    return log, index, actions


def _begin(
    layout: Layout,
    storage: Storage,
    jobs: Jobs,
    lock: SurveyLock,
    continued: tuple[int, int] | None,
    read: Callable[[Layout], Index],
    identity: bytes | None,
) -> tuple[RecordLog, Index]:
    index = read(layout)
    if index.survey is None:
        index.survey = _survey_of_files(layout, jobs) or identity or uuid.uuid4().bytes
    for segment, damage in index.damage:
        if damage.at_end:
            _cut(layout, storage, segment, damage.offset, damage.length)
    # Only when the records of a killed program are on the disk may the ledger list them, and may
    # further records follow them.
    segments = {index.entries[number].segment for number in index.unacknowledged}
    sync_journal(layout, storage, sorted(segments | set(layout.segments()[-1:])))
    entries = [entry for _, entry in sorted((index.lost | index.entries).items())]
    data = _repair_ledger(layout, storage, index, entries)
    index.ledger = replace(index.ledger, data=None)  # free the memory
    home = RecordFiles(
        layout,
        index.survey,
        storage,
        entries=entries,
        ledger=data,
        continued=continued,
        lost=index.lost,
    )
    log = RecordLog(layout, index.survey, storage, home, lock)
    log.moved = index.relocate
    return log, index


def repair(
    log: RecordLog,
    index: Index,
    jobs: Jobs,
    *,
    publish: bool = True,
    thorough: bool = False,
) -> RecoveryReport:
    """Restore drops, rebounds and files of a survey that is open for writing, and report losses.

    Parameters
    ----------
    log : RecordLog
        Writer of the records of the survey.
    index : Index
        Content of the survey, which is updated.
    jobs : Jobs
        Process that makes and reads the HDF5 files of drops.
    publish : bool
        True: make missing HDF5 files.
    thorough : bool
        True: compare the content of every file with its checksum, not only its size.
    """
    layout = log.layout
    unlisted = set(index.unacknowledged)
    recovered = {d.number for d in index.drops.values() if d.entry.sequence in unlisted}
    actions = [f"drop {number} added to the ledger" for number in sorted(recovered)]
    _wait_for_publisher(layout, log.storage)
    files = FileRepair(log, index, jobs, thorough=thorough)
    files.remove_drafts()
    for number in sorted(set(layout.drop_files()) - set(index.drops)):
        if _restore(log, index, jobs, number):
            recovered.add(number)
            actions.append(f"drop {number} restored from its file")
    _restore_points(log, index)
    rebounds = _restore_rebounds(log, index, jobs)
    actions += [f"rebound of drop {number} restored from its file" for number in rebounds.values()]
    made = files.repair_drop_files(publish=publish)
    recovered |= set(made)
    actions += [f"file of drop {number} made" for number in made]
    files.repair_results_and_captures()
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
    """Return a text for each lost record: one that was saved and that the journal now lacks.

    Each drop is named. If more than `MAX_NAMED_RECORDS` other records are lost, one text has their
    first and last number.
    """
    lost = [entry for number, entry in sorted(index.lost.items()) if number not in index.settled]
    unnamed = [entry.sequence for entry in lost if entry.kind != RecordKind.DROP]
    if len(unnamed) > MAX_NAMED_RECORDS:
        lost = [entry for entry in lost if entry.kind == RecordKind.DROP]
    texts = [f"{entry.name} is lost" for entry in lost]
    if len(unnamed) > MAX_NAMED_RECORDS:
        texts.append(f"{len(unnamed)} records between {unnamed[0]} and {unnamed[-1]} are lost")
    if index.gaps:
        first, last = index.gaps[0], index.gaps[-1]
        texts.append(
            f"{len(index.gaps)} records between {first} and {last} are lost, and the ledger does "
            "not list them"
        )
    return texts


def _cut(layout: Layout, storage: Storage, segment: int, offset: int, length: int) -> None:
    """Cut the unfinished end of a file of the journal, after copying it to ``damaged``."""
    path = layout.segment(segment)
    keep_copy(layout, storage, path, f"journal-{segment:04d}-{offset}.bytes", offset, length)
    descriptor = storage.open(path)
    try:
        storage.truncate(descriptor, offset)
        storage.sync(descriptor)
    finally:
        storage.close(descriptor)


def _repair_ledger(layout: Layout, storage: Storage, index: Index, entries: list[Entry]) -> bytes:
    """Rewrite the list of saved records (ledger) if it is not exactly this; return its content."""
    assert index.survey is not None
    ledger = index.ledger
    recorded = ledger.survey == index.survey and ledger.entries == tuple(entries)
    expected = (ledger.data if recorded else None) or ledger_bytes(index.survey, entries)
    if not has_content(layout.ledger, expected):
        if index.ledger.damaged:
            keep_copy(layout, storage, layout.ledger, layout.ledger.name)
        storage.write_file(layout.ledger, expected)
    return expected


def _wait_for_publisher(layout: Layout, storage: Storage) -> None:
    """Wait for a process of a killed program that may still be making a drop file."""
    if not layout.publish_lock.exists():
        return
    try:
        with file_locked(layout.publish_lock, PUBLISHER_WAIT_S, storage):
            pass
    except TimeoutError as err:
        raise RecordingError(
            f"{layout.publish_lock}: expected no other program, got one that still makes drop "
            "files; end it and try again"
        ) from err


def _restore(log: RecordLog, index: Index, jobs: Jobs, number: int) -> bool:
    """Restore the record of a drop from its HDF5 file; return True on success."""
    try:
        record, *identity = _read_file(log.layout, jobs, number)
    except RecordingError:
        return False  # the file is damaged too, which `repair_drop_files` reports
    if identity != [number, log.survey]:
        return False
    data, arrays = drop_parts(record)
    key = record.metadata.get("key")
    lost = (entry for entry in index.lost.values() if entry.drop and entry.drop[0] == number)
    data |= {
        "number": number,
        "key": key if isinstance(key, str) else None,
        "restored_from": max((entry.sequence for entry in lost), default=0),
    }
    append_drop(log, index, data, arrays)
    return True


def _restore_rebounds(log: RecordLog, index: Index, jobs: Jobs) -> dict[int, int]:
    """Restore lost records of rebounds from the HDF5 files of their drops.

    Return the survey-wide number of the drop by the sequence number of each restored record. The
    ledger does not show to which drop a lost rebound belongs. So each rebound that only a file
    contains counts as one of the lost records.
    """
    lost = [
        number
        for number, entry in sorted(index.lost.items())
        if entry.kind == RecordKind.REBOUND and number not in index.settled
    ]
    restored: dict[int, int] = {}
    for number in sorted(index.drops) if lost else ():
        for rebound in _rebounds_of_file_alone(log, index, jobs, number):
            if not lost:
                break
            payload = rebound_payload(number, rebound)
            index.add(log.append_payload(RecordKind.REBOUND, payload), {"number": number})
            restored[lost.pop(0)] = number
    return restored


def _rebounds_of_file_alone(
    log: RecordLog, index: Index, jobs: Jobs, number: int
) -> list[ReboundRecord]:
    """Return the rebounds in the HDF5 file of a drop that the journal does not contain."""
    layout, drop = log.layout, index.drops[number]
    if not layout.drop_file(number).exists():
        return []
    try:
        in_file, *identity = _read_file(layout, jobs, number)
        if identity != [number, log.survey]:
            return []
        frame = read_record(layout, drop.entry.segment, drop.entry.offset)
        recorded = list(drop_from_parts(*decode_payload(frame.payload)).rebounds)
        for entry in drop.rebounds:
            frame = read_record(layout, entry.segment, entry.offset)
            recorded.append(rebound_from_payload(frame.payload))
    except RecordingError:
        return []  # other steps report this damage
    recorded_keys = {(rebound.first_sample, rebound.delay) for rebound in recorded}
    return [r for r in in_file.rebounds if (r.first_sample, r.delay) not in recorded_keys]


def _read_file(layout: Layout, jobs: Jobs, number: int) -> tuple[DropRecord, int, bytes]:
    return result_of(jobs.submit(read_drop_file_parts, layout.drop_file(number)))


def _survey_of_files(layout: Layout, jobs: Jobs) -> bytes | None:
    """Return the identity of the survey from the HDF5 file of a drop; None without such a file."""
    for number in layout.drop_files():
        try:
            return _read_file(layout, jobs, number)[2]
        except RecordingError:
            continue
    return None


def _survey_of_spare(layout: Layout, spare: SpareFolder | None) -> bytes | None:
    """Return the identity of the survey from the spare folder; None if it has no such records."""
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
        append_point(log, index, drop.point, payload_data(frame.payload).get("declared"))


def _settle(log: RecordLog, index: Index, *, files_listed: bool, restored: set[int]) -> None:
    """Append a record of the damage that was repaired, so that a check does not report it again."""
    replaced = {RecordKind.CLOSE, RecordKind.SURVEY} | (
        {RecordKind.FILE} if files_listed else set()
    )
    settled = sorted(
        number
        for number, entry in index.lost.items()
        if (entry.kind in replaced or number in restored) and number not in index.settled
    )
    keys = [damage_key(log.layout, *part) for part in index.damage if not part[1].at_end]
    keys += [(e.segment, e.offset, e.length, e.check) for e, _ in index.strange]
    fresh = [list(key) for key in keys if key not in index.handled_damage]
    if settled or fresh:
        data = {"event": "recovery", "settled": settled, "damage": fresh, "time_utc": now()}
        index.add(log.append(RecordKind.EVENT, data), data)
