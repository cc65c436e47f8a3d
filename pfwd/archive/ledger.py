"""Index of the completed sources of an archive; on the disk, since a million would fill memory.

The Parquet tables count. The ledger is brought in line with them when it is opened, and rebuilt
from them when it is lost or damaged.
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

_LEDGER_SCHEMA = """
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

MAX_LEDGER_BYTES = 2 * 2**30
"""Largest ledger; a larger one is rebuilt. An archive of a million sources takes a sixth of it."""

MAX_LEDGER_BYTES_PER_PART = 16 * 2**20
"""Largest ledger for each part, and for none; 10,000 sources take 4 MB."""

MAX_VALUE_BYTES = 100_000
"""Longest value in the ledger; paths are the longest."""

MAX_CHECK_S = 8.0
"""Longest check of the file before it is used; rebuilding it takes less time."""

MAX_MISSING_PARTS = 1000
"""Parts that the ledger may list without a file; with more, rebuilding it takes less time."""

_N_STEPS_PER_CLOCK_CHECK = 100_000
"""Steps of SQLite's virtual machine between two looks at the clock."""


class Ledger:
    """Index of one run.

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
            # Damaged, or written by another program: its content is in the tables too.
            path.unlink(missing_ok=True)
            try:
                self._base = _open(path)
            except sqlite3.DatabaseError as err:
                raise SurveyError(refusal(str(path), "a writable disk", str(err))) from err
        self._bring_in_line()

    def close(self) -> None:
        """Close the file."""
        self._base.close()

    def next_number(self) -> int:
        """Return the number of the next part."""
        (largest,) = self._query_row("select max(number) from parts where run = ?")
        return 1 + (largest or 0)

    def is_complete(self, source: Source) -> bool:
        """Return whether all pieces of a source of this path, size and time are stored."""
        stored, pieces = self._base.execute(
            "select count(*), max(pieces) from sources"
            " where run = ? and file = ? and size = ? and mtime_ns = ?",
            (self._run, source.path, source.size, source.mtime_ns),
        ).fetchone()
        return bool(stored > 0 and stored == pieces)

    def has_piece(self, source: Source) -> bool:
        """Return whether this piece of this file is stored, with this content."""
        row = self._base.execute(
            "select 1 from sources"
            " where run = ? and file = ? and piece = ? and pieces = ? and digest = ?",
            (self._run, source.path, source.piece, source.pieces, source.digest),
        ).fetchone()
        return row is not None

    def file_with(self, digest: str, piece: int, pieces: int) -> str | None:
        """Return a file with this content whose piece is stored; None if there is none."""
        row = self._base.execute(
            "select file from sources where run = ? and digest = ? and piece = ? and pieces = ?",
            (self._run, digest, piece, pieces),
        ).fetchone()
        return None if row is None else str(row[0])

    def touch(self, source: Source) -> None:
        """Record the present size and time of a source whose content is the same."""
        with self._base:
            self._base.execute(
                "update sources set size = ?, mtime_ns = ?"
                " where run = ? and file = ? and digest = ?",
                (source.size, source.mtime_ns, self._run, source.path, source.digest),
            )

    def add(self, number: int, rows: Iterable[Mapping[str, Any]]) -> None:
        """Add the sources of a written part; earlier contents of their files become stale."""
        with self._base:
            self._add(number, rows)

    def stale(self) -> dict[int, set[str]]:
        """Return the digests whose rows are out of date, by number of the part."""
        digests: dict[int, set[str]] = {}
        for number, digest in self._base.execute(
            "select number, digest from stale where run = ?", (self._run,)
        ):
            digests.setdefault(number, set()).add(digest)
        return digests

    def clean(self, number: int) -> None:
        """Record that the stale rows of a part are removed."""
        with self._base:
            self._base.execute(
                "delete from stale where run = ? and number = ?", (self._run, number)
            )

    def refused(self) -> int:
        """Return the number of sources with failures."""
        (count,) = self._query_row(
            "select count(distinct file) from sources where run = ? and failures > 0"
        )
        return int(count)

    def _query_row(self, query: str) -> tuple[Any, ...]:
        row: tuple[Any, ...] = self._base.execute(query, (self._run,)).fetchone()
        return row

    def _bring_in_line(self) -> None:
        parts = set(self._dataset.parts())
        listed = {
            number
            for (number,) in self._base.execute(
                "select number from parts where run = ?", (self._run,)
            )
        }
        with self._base:
            for number in listed - parts:
                for table in ("parts", "sources", "stale"):
                    self._base.execute(
                        f"delete from {table} where run = ? and number = ?", (self._run, number)
                    )
        for number in sorted(parts - listed):
            self.add(number, self._dataset.sources(number))

    def _add(self, number: int, rows: Iterable[Mapping[str, Any]]) -> None:
        run = self._run
        self._base.execute("insert or replace into parts values (?, ?)", (run, number))
        for row in rows:
            file, digest = row["file"], row["source_sha256"]
            # No `distinct` in the query: SQLite would use the other index, row by row.
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
                holder = self._base.execute(
                    "select 1 from sources where run = ? and digest = ?", (run, former)
                ).fetchone()
                if holder is None:
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
    """Open the index; DatabaseError if it is damaged or holds anything but our tables."""
    max_bytes = min(MAX_LEDGER_BYTES, MAX_LEDGER_BYTES_PER_PART * (1 + parts))
    if path.exists() and path.stat().st_size > max_bytes:
        raise sqlite3.DatabaseError("larger than any of ours")
    base = sqlite3.connect(path)
    try:
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_VALUE_BYTES)
        # A foreign view or trigger would be computed with every query, maybe for ever.
        with contextlib.closing(sqlite3.connect(":memory:")) as expected:
            expected.executescript(_LEDGER_SCHEMA)
            ours = _schema_of(expected)
        present = _schema_of(base)
        if not present <= ours:
            raise sqlite3.DatabaseError("other tables than ours")
        deadline = time.monotonic() + MAX_CHECK_S
        base.set_progress_handler(
            lambda: int(time.monotonic() > deadline), _N_STEPS_PER_CLOCK_CHECK
        )
        (sound,) = base.execute("pragma quick_check(1)").fetchone()
        if sound != "ok":
            raise sqlite3.DatabaseError(sound)
        if present:
            (listed,) = base.execute("select count(*) from parts where run = ?", (run,)).fetchone()
            if listed > parts + MAX_MISSING_PARTS:
                raise sqlite3.DatabaseError("names parts that are not there")
        base.set_progress_handler(None, 0)
        # Whatever a power failure costs here is read from the tables again.
        base.execute("pragma synchronous = off")
        base.executescript(_LEDGER_SCHEMA)
    except BaseException:
        with contextlib.suppress(sqlite3.Error):
            base.close()
        raise
    return base


def _schema_of(base: sqlite3.Connection) -> set[tuple[str, ...]]:
    """Return tables, indexes and all other objects, with the statements that made them."""
    limit = 100  # ours are a few
    objects = base.execute("select type, name, tbl_name, sql from sqlite_master limit ?", (limit,))
    return {tuple(map(str, row)) for row in objects}
