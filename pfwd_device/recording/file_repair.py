"""Repair of the files of a survey beside its journal: HDF5 files of drops, results, raw captures.

The journal contains all records of a survey, and lists each of these files with its checksum. A
missing or damaged file is restored from the journal; a damaged one is moved to the folder
``damaged``.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording.files import file_facts, now, set_aside
from pfwd_device.recording.framing import RecordKind
from pfwd_device.recording.index import DropEntry, FileEntry, Index
from pfwd_device.recording.journal import read_record
from pfwd_device.recording.layout import names_in
from pfwd_device.recording.payload import decode_json, payload_data
from pfwd_device.recording.publishing import publish, result_of
from pfwd_device.recording.record_log import RecordLog

if TYPE_CHECKING:
    from pfwd_device.jobs import Jobs

MAX_PUBLISHING_FAILURES = 3
"""Number of files that cannot be made after which the other drops wait for the next recovery."""

MAX_RESULT_RECORD_BYTES = 64 * 2**20
"""Largest result that a record can contain, bytes."""


class FileRepair:
    """Repair of the files of drops, results and raw captures of a survey that is open for writing.

    Parameters
    ----------
    log : RecordLog
        Journal to which records of listed files are appended.
    index : Index
        Content of the journal, which is updated.
    jobs : Jobs
        Process that makes the HDF5 files of drops.
    thorough : bool
        True: compare the content of each file with its checksum, not only its size.
    """

    def __init__(self, log: RecordLog, index: Index, jobs: Jobs, *, thorough: bool) -> None:
        self.sound: set[str] = set()
        """Paths of listed files that are unchanged or restored."""
        self.damaged: list[str] = []
        """Descriptions of files that cannot be restored."""
        self.actions: list[str] = []
        """Descriptions of the actions on results, captures and unknown files."""
        self._log = log
        self._layout = log.layout
        self._folder = str(log.layout.folder)
        self._storage = log.storage
        self._index = index
        self._jobs = jobs
        self._thorough = thorough

    def remove_drafts(self) -> None:
        """Move files with a temporary name to ``damaged``, or delete them if they are copies.

        A program that was interrupted while it wrote a file leaves a file with a temporary name.
        """
        layout = self._layout
        for folder in (layout.folder, layout.drops, layout.results, layout.captures):
            for name in names_in(folder):
                if not (name.startswith(".") and name.endswith(".tmp")):
                    continue
                if folder == layout.folder:
                    # Drafts of ledger, reserve and writer.txt contain no data of their own.
                    self._storage.unlink(folder / name)
                else:
                    set_aside(layout, self._storage, folder / name)
                    self.actions.append(f"unfinished file {name} moved to damaged")
        for name in names_in(layout.damaged):
            if name.startswith(".") and name.endswith(".tmp"):
                self._storage.unlink(layout.damaged / name)  # its original is still in place

    def repair_drop_files(self, *, publish: bool) -> list[int]:
        """Verify the HDF5 files of drops, and replace missing and damaged ones.

        Parameters
        ----------
        publish : bool
            False: only verify.

        Returns
        -------
        list of int
            Numbers within the survey of the drops whose file was made now.
        """
        made: list[int] = []
        failures = 0
        for number, drop in sorted(self._index.drops.items()):
            listed = self._index.files.get(self._layout.drop_file_name(number))
            if listed is not None and self._is_sound(listed):
                self.sound.add(listed.path)
                continue
            if not publish or failures == MAX_PUBLISHING_FAILURES:
                continue
            path = self._layout.drop_file(number)
            if listed is not None and path.exists():
                set_aside(self._layout, self._storage, path)
            try:
                facts = self._publish(drop, path)
            except RecordingError as err:
                self.actions.append(f"drop {number} is only in the journal: {err}")
                failures += 1
                continue
            self._list(facts)
            made.append(number)
        for number in self._layout.drop_files() if publish else ():
            if number not in self._index.drops:
                path = self._layout.drop_file(number)
                set_aside(self._layout, self._storage, path)
                self.actions.append(f"{path.name} contains no drop and was moved to damaged")
        return made

    def repair_results_and_captures(self) -> None:
        """Verify results and captures, and restore damaged results from the journal.

        Files that the journal does not list because of a crash are listed.
        """
        for listed in list(self._index.files.values()):
            if not listed.path.startswith(("results/", "captures/")):
                continue
            if self._is_sound(listed):
                self.sound.add(listed.path)
            elif not self._rewrite_result(listed, self._layout.folder / listed.path):
                self.damaged.append(f"{listed.path} is damaged or missing")
        for folder in (self._layout.results, self._layout.captures):
            for name in names_in(folder):
                if f"{folder.name}/{name}" not in self._index.files:
                    self._list_unlisted(folder / name)

    def _is_sound(self, listed: FileEntry) -> bool:
        try:
            # Without a Path, whose creation takes longer than the system call.
            if os.stat(f"{self._folder}/{listed.path}").st_size != listed.size:
                return False
            if not self._thorough:
                return True
            facts = file_facts(self._layout, self._layout.folder / listed.path)
            return bool(facts["sha256"] == listed.sha256)
        except OSError:
            return False

    def _publish(self, drop: DropEntry, path: Path) -> dict[str, Any]:
        call = publish, self._layout, drop.places, self._storage
        try:
            return result_of(self._jobs.submit(*call))
        except RecordingError:
            if not path.exists():
                raise
        # The process refuses to replace the existing file, which is not that of this drop.
        set_aside(self._layout, self._storage, path)
        self.actions.append(f"{path.name} is not the file of its drop and was moved to damaged")
        return result_of(self._jobs.submit(*call))

    def _rewrite_result(self, listed: FileEntry, path: Path) -> bool:
        """Restore the file of a result from the journal; return True on success."""
        try:
            frame = read_record(self._layout, listed.entry.segment, listed.entry.offset)
            content = payload_data(frame.payload).get("content")
        except RecordingError:
            return False
        if not isinstance(content, str):
            return False
        if path.exists():
            set_aside(self._layout, self._storage, path)
        self._storage.write_file(path, content.encode("ascii", "replace"))
        self.actions.append(f"{listed.path} written again from the journal")
        self.sound.add(listed.path)
        return True

    def _list_unlisted(self, path: Path) -> None:
        """Record a result or capture in the journal that is missing there because of a crash."""
        if path.parent == self._layout.results:
            if path.suffix != ".json":
                return
            try:
                if path.stat().st_size > MAX_RESULT_RECORD_BYTES:
                    raise RecordingError("expected a result, got a file of more than 64 MiB")
                decode_json(path.read_bytes())
            except RecordingError:
                set_aside(self._layout, self._storage, path)
                self.actions.append(f"{path.name} was unfinished and moved to damaged")
                return
        elif path.suffix != ".pfwdc":
            return
        facts = file_facts(self._layout, path)
        parts = path.name.split("-")  # the name of a drop's result contains its number
        of_drop = len(parts) == 3 and parts[1].isdecimal()
        self._list(facts | {"number": int(parts[1]) if of_drop else None})
        self.sound.add(facts["path"])
        self.actions.append(f"{facts['path']} listed in the journal")

    def _list(self, facts: dict[str, Any]) -> None:
        data = facts | {"time_utc": now()}
        self._index.add(self._log.append(RecordKind.FILE, data), data)
        self.sound.add(facts["path"])
