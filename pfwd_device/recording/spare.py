"""The spare folder, which receives records while the folder of a survey (home) cannot be written.

It has a subfolder, here called a part, for each survey that needed it. A part is named after the
survey and its identity, and has a journal and a ledger like those of the survey. The records have
the identity of the survey and the numbers that they would have at home, so that they can be merged
unchanged. ``home.json`` contains the path of home. ``returned.json`` lists records that were merged
under other numbers.
"""

import contextlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_device.recording.files import sync_journal
from pfwd_device.recording.index import build_index
from pfwd_device.recording.layout import Layout, names_in, refuse_links
from pfwd_device.recording.ledger import Entry
from pfwd_device.recording.lock import SurveyLock
from pfwd_device.recording.payload import decode_json, encode_json
from pfwd_device.recording.storage import Storage
from pfwd_device.text import clean

HOME_FILE = "home.json"

RETURNED_FILE = "returned.json"

_MAX_JSON_FILE_BYTES = 64 * 2**20
"""Largest JSON file of the spare folder, bytes; a million merged records take less."""

_MAX_FOLDER_NAME_LENGTH = 40


@dataclass(frozen=True, slots=True)
class SparePart:
    """Subfolder of the spare folder for one survey, open for writing."""

    layout: Layout
    """Paths of the subfolder."""
    entries: list[Entry]
    """Records that its ledger or its journal contains."""
    lost: frozenset[int]
    """Sequence numbers of the records among them that its journal does not contain."""
    lock: SurveyLock
    """Lock that excludes other programs."""


@dataclass(frozen=True, slots=True)
class SpareFolder:
    """Folder that receives records of surveys whose own folders cannot be written."""

    root: Path
    """Path of the folder, which contains a subfolder for each survey."""

    def layout_of(self, home: Path, survey: bytes) -> Layout:
        """Return the paths of the subfolder for a survey.

        Parameters
        ----------
        home : Path
            Folder of the survey.
        survey : bytes
            Identity of the survey, 16 bytes.
        """
        name = "".join(c if c.isalnum() and c.isascii() else "-" for c in home.name)
        return Layout(self.root / f"{name[:_MAX_FOLDER_NAME_LENGTH] or 'survey'}-{survey.hex()}")

    def open(self, home: Path, survey: bytes, storage: Storage) -> SparePart:
        """Open the subfolder for a survey, and create it if it is missing.

        Parameters
        ----------
        home : Path
            Folder of the survey.
        survey : bytes
            Identity of the survey, 16 bytes.
        storage : Storage
            Access to the files.

        Raises
        ------
        OSError, RecordingError
            If the subfolder cannot be created or written, or another program writes it.
        """
        layout = self.layout_of(home, survey)
        storage.make_folder(layout.journal)
        refuse_links(layout)
        lock = SurveyLock(layout, storage)
        try:
            where = layout.folder / HOME_FILE
            if not where.exists():
                text = encode_json({"survey": str(home), "survey_id": survey.hex()})
                storage.write_file(where, text.encode("ascii") + b"\n")
            index = build_index(layout)
            # The records of a killed program can be read, but may not be on the disk yet.
            sync_journal(layout, storage, layout.segments())
        except BaseException:
            lock.release()
            raise
        entries = [entry for _, entry in sorted((index.lost | index.entries).items())]
        return SparePart(layout, entries, frozenset(index.lost), lock)

    def parts(self, *, home: Path | None = None, survey: bytes | None = None) -> list[Layout]:
        """Return the subfolders with records of a survey, the last written first.

        Parameters
        ----------
        home : Path, optional
            Folder of the survey, if its identity is not known.
        survey : bytes, optional
            Identity of the survey, 16 bytes.
        """
        layouts = []
        for name in names_in(self.root):
            layout = Layout(self.root / name)
            facts = home_of(layout.folder)
            if facts is None:
                continue
            if survey is not None:
                fits = facts["survey_id"] == survey.hex()
            else:
                fits = home is not None and facts["survey"] == str(home)
            if fits:
                layouts.append(layout)
        return sorted(layouts, key=_last_write, reverse=True)


def _last_write(layout: Layout) -> float:
    try:
        return layout.ledger.stat().st_mtime
    except OSError:
        return 0.0


def home_of(folder: Path) -> dict[str, str] | None:
    """Return the survey to which a subfolder of the spare folder belongs.

    The keys are ``survey`` (path of its folder) and ``survey_id`` (its identity, hexadecimal). None
    if the folder is not a part of a spare folder.
    """
    data = _read_json(folder / HOME_FILE)
    if not isinstance(data, dict):
        return None
    survey, identity = data.get("survey"), data.get("survey_id")
    if not isinstance(survey, str) or not isinstance(identity, str):
        return None
    with contextlib.suppress(ValueError):
        if len(bytes.fromhex(identity)) == 16:
            return {"survey": clean(survey, limit=4096), "survey_id": identity}
    return None


def renumbered_records(layout: Layout) -> set[tuple[int, int]]:
    """Return the records of a subfolder of the spare folder that were merged under other numbers.

    Each is a pair of its sequence number and the CRC-32 in its header.
    """
    data = _read_json(layout.folder / RETURNED_FILE)
    pairs = data if isinstance(data, list) else []
    return {
        (pair[0], pair[1])
        for pair in pairs
        if isinstance(pair, list) and len(pair) == 2 and all(type(value) is int for value in pair)
    }


def store_renumbered_records(layout: Layout, storage: Storage, pairs: set[tuple[int, int]]) -> None:
    """Store the pairs that `renumbered_records` returns; raise OSError if that fails."""
    text = json.dumps(sorted(pairs)) + "\n"
    storage.write_file(layout.folder / RETURNED_FILE, text.encode("ascii"))


def _read_json(path: Path) -> Any:
    """Return the content of a small JSON file; None if it is missing or damaged."""
    try:
        if path.is_symlink() or not path.is_file() or path.stat().st_size > _MAX_JSON_FILE_BYTES:
            return None
        return decode_json(path.read_bytes())
    except (OSError, RecordingError):
        return None
