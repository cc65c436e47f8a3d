"""Check of a survey: every byte is compared with its checksums, and nothing is changed.

The journal contains all records of a survey; the ledger (``acknowledged.txt``) has a line for each
record that reached the disk; each drop also has an HDF5 file.
"""

import os
from dataclasses import dataclass

from pfwd_device.errors import RecordingError
from pfwd_device.recording.drop_payload import peaks_problem
from pfwd_device.recording.files import file_facts
from pfwd_device.recording.index import Index, build_index, damage_key
from pfwd_device.recording.journal import read_record
from pfwd_device.recording.layout import Layout, find_survey, names_in
from pfwd_device.recording.lock import is_locked
from pfwd_device.recording.recovery import SurveyState, lost_texts
from pfwd_device.recording.spare import SpareFolder
from pfwd_device.recording.spare_merge import describe_records_only_in_spare

_HINT = "run pfwd recover"


@dataclass(frozen=True, slots=True)
class CheckReport(SurveyState):
    """Result of the check of a survey."""

    notes: tuple[str, ...]
    """Descriptions of unfinished parts that are not damaged."""
    closed: bool
    """True if the last program that wrote the survey has closed it."""


def check(folder: str | os.PathLike[str], *, spare: SpareFolder | None = None) -> CheckReport:
    """Compare every byte of a survey with its checksums, without changing anything.

    Parameters
    ----------
    folder : path
        Folder of the survey. While another program writes it, unfinished parts are not reported as
        damage but as notes.
    spare : SpareFolder, optional
        Folder that receives records while the folder of the survey cannot be written. Records that
        are only there are reported as missing.

    Raises
    ------
    RecordingError
        If there is no survey, or it cannot be read.
    """
    layout = find_survey(folder)
    written = is_locked(layout)
    index = build_index(layout)
    damaged: list[str] = []
    notes: list[str] = []
    unfinished = notes if written else damaged
    _check_journal(layout, index, damaged, unfinished)
    _check_ledger(index, damaged, unfinished)
    published = _check_listed(layout, index, damaged)
    _check_peaks(layout, index, damaged)
    damaged += lost_texts(index)
    damaged += [f"{text}: {_HINT}" for text in describe_records_only_in_spare(spare, index)]
    _check_unlisted(layout, index, unfinished)
    for number, drop in sorted(index.drops.items()):
        if layout.drop_file_name(number) not in index.files:
            notes.append(f"drop {drop.point}/{drop.drop} has no file yet: {_HINT}")
    if written:
        notes.append("a program is writing the survey")
    elif not index.closed:
        notes.append(f"the program that wrote the survey did not close it: {_HINT}")
    return CheckReport(
        str(layout.folder),
        len(index.drops) + len(index.lost_drops),
        published,
        sum(drop.restored_from is not None for drop in index.drops.values()),
        tuple(dict.fromkeys(damaged)),
        tuple(notes),
        index.closed,
    )


def _check_journal(layout: Layout, index: Index, damaged: list[str], unfinished: list[str]) -> None:
    covered = [(e.segment, e.offset) for e in index.lost.values() if e.sequence in index.settled]
    for segment, damage in index.damage:
        where = f"{layout.relative(layout.segment(segment))}, byte {damage.offset}"
        try:
            is_handled = damage_key(layout, segment, damage) in index.handled_damage
        except OSError:
            is_handled = False
        if is_handled:
            continue
        text = f"{where}: {damage.length} bytes are damaged"
        inside = [
            entry.name
            for entry in index.lost.values()
            if entry.segment == segment
            and damage.offset - entry.length < entry.offset < damage.offset + damage.length
            and (entry.segment, entry.offset) not in covered
        ]
        if inside:
            text += f" ({', '.join(inside)})"
        if damage.at_end and not inside:
            unfinished.append(f"{text}, an unfinished record: {_HINT}")
        else:
            damaged.append(f"{text}: {_HINT}")
    for entry, why in index.strange:
        if (entry.segment, entry.offset, entry.length, entry.check) not in index.handled_damage:
            where = f"{layout.relative(layout.segment(entry.segment))}, byte {entry.offset}"
            damaged.append(f"{where}: {why}")


def _check_ledger(index: Index, damaged: list[str], unfinished: list[str]) -> None:
    ledger = index.ledger
    if ledger.missing:
        damaged.append(f"acknowledged.txt is missing: {_HINT}")
        return
    texts = [f"acknowledged.txt, line {number} is damaged: {_HINT}" for number in ledger.damaged]
    if texts and ledger.unfinished:
        unfinished.append(texts.pop())
    damaged += texts
    last = 0
    for line in ledger.entries:
        if line.sequence != last + 1 and not ledger.damaged and last + 1 not in index.gaps:
            damaged.append(
                f"acknowledged.txt: expected record {last + 1} after {last}, got {line.sequence}"
            )
        last = line.sequence
        entry = index.entries.get(line.sequence)
        if entry is not None and entry != line:
            damaged.append(f"acknowledged.txt: the line of {entry.name} differs from the journal")
    if index.unacknowledged and not ledger.damaged:
        first = index.entries[min(index.unacknowledged)]
        unfinished.append(
            f"acknowledged.txt lacks {first.name}, which the journal contains: {_HINT}"
        )


def _check_listed(layout: Layout, index: Index, damaged: list[str]) -> int:
    """Compare the files that the journal lists with their checksums; append errors to `damaged`.

    Return the number of drops whose HDF5 file is undamaged.
    """
    published = 0
    for listed in index.files.values():
        path = layout.folder / listed.path
        try:
            facts = file_facts(layout, path)
        except OSError:
            facts = {"size": -1, "sha256": ""}
        if (facts["size"], facts["sha256"]) != (listed.size, listed.sha256):
            text = f"{_name(index, listed.path)} is damaged or missing"
            # A capture has no second copy from which recovery could restore it.
            damaged.append(text if listed.path.startswith("captures/") else f"{text}: {_HINT}")
        elif listed.path.startswith("drops/") and listed.number in index.drops:
            published += 1
    return published


def _check_peaks(layout: Layout, index: Index, damaged: list[str]) -> None:
    """Compare the recorded peaks of each drop with the peaks of its traces."""
    for drop in index.drops.values():
        try:
            frame = read_record(layout, drop.entry.segment, drop.entry.offset)
            problem = peaks_problem(frame.payload)
        except RecordingError as err:
            problem = str(err)
        if problem is not None:
            damaged.append(f"drop {drop.point}/{drop.drop} in the journal: {problem}")


def _check_unlisted(layout: Layout, index: Index, unfinished: list[str]) -> None:
    kinds = {layout.drops: ".h5", layout.results: ".json", layout.captures: ".pfwdc"}
    for folder, suffix in kinds.items():
        for name in names_in(folder):
            path = f"{folder.name}/{name}"
            if path not in index.files and name.endswith((suffix, ".tmp")):
                unfinished.append(f"{path} is not listed in the journal: {_HINT}")


def _name(index: Index, path: str) -> str:
    listed = index.files[path]
    drop = index.drops.get(listed.number) if listed.number is not None else None
    return path if drop is None else f"{path} (drop {drop.point}/{drop.drop})"
