"""Which sources of an archive are done: an index on the disk, so that a million are not in memory.

The Parquet tables are the truth. The ledger is brought in line with them when it is opened, and
made anew from them when it is lost or damaged.
"""

from __future__ import annotations

import contextlib
import sqlite3
import time
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from pfwd.archive.dataset import Dataset
from pfwd.archive.sources import Source
from pfwd.errors import SurveyError, refusal

_TABLES = """
create table if not exists parts (run text, number integer, primary key (run, number));
create table if not exists sources (
    run text, file text, piece integer, pieces integer, digest text, size integer,
    mtime_ns integer, failures integer, same_as text, number integer,
    primary key (run, file, piece)
);
create index if not exists by_digest on sources (run, digest, piece);
create table if not exists stale (
    run text, number integer, digest text, primary key (run, number, digest)
);
"""


LARGEST = 2 * 2**30
"""Bytes; an archive of a million sources takes a sixth of it. What is larger is made anew."""

LARGEST_OF_A_PART = 16 * 2**20
"""Bytes that it takes for a part, and as much at the beginning; 10,000 sources take 4 MB."""

LONGEST_TEXT = 100_000
"""Bytes of a value; paths are the longest."""

LONGEST_LOOK = 8.0
"""s for a look at the whole file before it is used; what takes longer is made anew."""

MOST_MISSING = 1000
"""Parts that it may name and nobody finds; of more it is made anew, in less time."""

_STEPS = 100_000
"""Of SQLite's machine between two looks at the clock."""


class Ledger:
    """The index of one run.

    Parameters
    ----------
    dataset : Dataset

    Raises
    ------
    SurveyError
        If it cannot be written, or a part that it needs is damaged.
    """

    def __init__(self, dataset: Dataset) -> None:
        self._dataset, self._run = dataset, dataset.key
        path = dataset.folder / "ledger.sqlite"
        try:
            self._base = _open(path, len(dataset.parts()), dataset.key)
        except sqlite3.DatabaseError:
            # Damaged, or none of ours: what it says is in the tables too.
            path.unlink(missing_ok=True)
            try:
                self._base = _open(path)
            except sqlite3.DatabaseError as err:
                expected = "a disk that takes it"
                raise SurveyError(refusal(str(path), expected, str(err))) from err
        self._bring_in_line()

    def close(self) -> None:
        """Close the file."""
        self._base.close()

    def next_number(self) -> int:
        """Number of the next part."""
        (largest,) = self._one("select max(number) from parts where run = ?")
        return 1 + (largest or 0)

    def is_known(self, source: Source) -> bool:
        """Whether a source of this path, size and time is done, with all its pieces."""
        found = self._base.execute(
            "select count(*), max(pieces) from sources"
            " where run = ? and file = ? and size = ? and mtime_ns = ?",
            (self._run, source.path, source.size, source.mtime_ns),
        ).fetchone()
        return bool(found[0] > 0 and found[0] == found[1])

    def has_piece(self, source: Source) -> bool:
        """Whether this very piece of this file is done, with this content."""
        row = self._base.execute(
            "select 1 from sources"
            " where run = ? and file = ? and piece = ? and pieces = ? and digest = ?",
            (self._run, source.path, source.piece, source.pieces, source.digest),
        ).fetchone()
        return row is not None

    def file_with(self, digest: str, piece: int, pieces: int) -> str | None:
        """A file with this content, the piece of which is done."""
        row = self._base.execute(
            "select file from sources where run = ? and digest = ? and piece = ? and pieces = ?",
            (self._run, digest, piece, pieces),
        ).fetchone()
        return None if row is None else str(row[0])

    def touch(self, source: Source) -> None:
        """The same content has another time now."""
        with self._base:
            self._base.execute(
                "update sources set size = ?, mtime_ns = ?"
                " where run = ? and file = ? and digest = ?",
                (source.size, source.mtime_ns, self._run, source.path, source.digest),
            )

    def add(self, number: int, rows: Iterable[Mapping[str, Any]]) -> None:
        """The sources of a part that is written. What a file held before becomes stale."""
        with self._base:
            self._add(number, rows)

    def stale(self) -> dict[int, set[str]]:
        """Digests whose rows are out of date, by part."""
        found: dict[int, set[str]] = {}
        for number, digest in self._base.execute(
            "select number, digest from stale where run = ?", (self._run,)
        ):
            found.setdefault(number, set()).add(digest)
        return found

    def clean(self, number: int) -> None:
        """The stale rows of a part are gone."""
        with self._base:
            self._base.execute(
                "delete from stale where run = ? and number = ?", (self._run, number)
            )

    def refused(self) -> int:
        """Sources with failures."""
        (count,) = self._one(
            "select count(distinct file) from sources where run = ? and failures > 0"
        )
        return int(count)

    def _one(self, question: str) -> tuple[Any, ...]:
        row: tuple[Any, ...] = self._base.execute(question, (self._run,)).fetchone()
        return row

    def _bring_in_line(self) -> None:
        there = set(self._dataset.parts())
        known = {
            number
            for (number,) in self._base.execute(
                "select number from parts where run = ?", (self._run,)
            )
        }
        with self._base:
            for number in known - there:
                for table in ("parts", "sources", "stale"):
                    self._base.execute(
                        f"delete from {table} where run = ? and number = ?", (self._run, number)
                    )
        for number in sorted(there - known):
            self.add(number, self._dataset.sources(number))

    def _add(self, number: int, rows: Iterable[Mapping[str, Any]]) -> None:
        run = self._run
        self._base.execute("insert or replace into parts values (?, ?)", (run, number))
        for row in rows:
            file, digest = row["file"], row["source_sha256"]
            # Not `distinct` in the question: it would be answered by the other index, row by row.
            old = set(
                self._base.execute(
                    "select digest, number from sources where run = ? and file = ? and digest <> ?",
                    (run, file, digest),
                )
            )
            if old:
                self._base.execute(
                    "delete from sources where run = ? and file = ? and digest <> ?",
                    (run, file, digest),
                )
            for former, place in old:
                # Rows stay as long as another file has this content.
                kept = self._base.execute(
                    "select 1 from sources where run = ? and digest = ?", (run, former)
                ).fetchone()
                if kept is None:
                    self._base.execute(
                        "insert or replace into stale values (?, ?, ?)", (run, place, former)
                    )
            self._base.execute(
                "insert or replace into sources values (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (
                    run,
                    file,
                    row["piece"],
                    row["pieces"],
                    digest,
                    row["size_bytes"],
                    row["mtime_ns"],
                    row["failures"],
                    row["same_as"],
                    number,
                ),
            )


def _open(path: Path, parts: int = 0, run: str = "") -> sqlite3.Connection:
    """The index; DatabaseError when it is damaged, or has anything in it that we do not make."""
    largest = min(LARGEST, LARGEST_OF_A_PART * (1 + parts))
    if path.exists() and path.stat().st_size > largest:
        raise sqlite3.DatabaseError("larger than any of ours")
    base = sqlite3.connect(path)
    try:
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST_TEXT)
        # A view or a rule of a stranger's would be computed with every question, maybe for ever.
        if not _described(base) <= _expected():
            raise sqlite3.DatabaseError("other tables than ours")
        deadline = time.monotonic() + LONGEST_LOOK
        base.set_progress_handler(lambda: int(time.monotonic() > deadline), _STEPS)
        (sound,) = base.execute("pragma quick_check(1)").fetchone()
        if sound != "ok":
            raise sqlite3.DatabaseError(sound)
        if _described(base):
            known = base.execute("select count(*) from parts where run = ?", (run,)).fetchone()[0]
            if known > parts + MOST_MISSING:
                raise sqlite3.DatabaseError("names parts that are not there")
        base.set_progress_handler(None, 0)
        # Whatever a power failure costs here is read from the tables again.
        base.execute("pragma synchronous = off")
        base.executescript(_TABLES)
    except BaseException:
        with contextlib.suppress(sqlite3.Error):
            base.close()
        raise
    return base


def _described(base: sqlite3.Connection) -> set[tuple[str, ...]]:
    """Tables, indexes and whatever else there is, with the words that made them."""
    limit = 100  # ours are a few
    found = base.execute("select type, name, tbl_name, sql from sqlite_master limit ?", (limit,))
    return {tuple(map(str, row)) for row in found}


def _expected() -> set[tuple[str, ...]]:
    with contextlib.closing(sqlite3.connect(":memory:")) as base:
        base.executescript(_TABLES)
        return _described(base)
