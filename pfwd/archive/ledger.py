"""Index of the sources with stored results of an archive, as an SQLite file.

It is on the disk because the index of a million sources would fill the memory. The Parquet tables
are decisive: when the index is opened, it is updated from them, and it is rebuilt from them if it
is lost or damaged.
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
"""Largest accepted index file; a larger one is rebuilt. That of a million sources has a sixth of
it."""

MAX_LEDGER_BYTES_PER_PART = 16 * 2**20
"""Largest accepted size of the index for each part of the archive plus one; 10,000 sources take 4
MB."""

MAX_VALUE_BYTES = 100_000
"""Longest text in the index; paths are the longest."""

MAX_CHECK_S = 8.0
"""Longest duration of the check of an index file, s; after that, rebuilding it takes less time."""

MAX_MISSING_PARTS = 1000
"""Largest number of parts that the index may list although their files are missing; with more,
rebuilding it takes less time."""

_N_STEPS_PER_CLOCK_CHECK = 100_000
"""Steps of SQLite's virtual machine between two readings of the clock."""


class Ledger:
    """Index of the sources with stored results of one run.

    A piece is the whole source, or some of the points of a large survey.

    Parameters
    ----------
    dataset : Dataset
        Tables of the run.

    Raises
    ------
    SurveyError
        If the index cannot be written, or a part that it needs is damaged.
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
        """Close the SQLite file."""
        self._base.close()

    def next_number(self) -> int:
        """Return the number for the next part of the archive."""
        (largest,) = self._query_row("select max(number) from parts where run = ?")
        return 1 + (largest or 0)

    def is_complete(self, source: Source) -> bool:
        """Return whether results of all pieces of this source are stored.

        Path, size and time have to agree.
        """
        stored, pieces = self._base.execute(
            "select count(*), max(pieces) from sources"
            " where run = ? and file = ? and size = ? and mtime_ns = ?",
            (self._run, source.path, source.size, source.mtime_ns),
        ).fetchone()
        return bool(stored > 0 and stored == pieces)

    def has_piece(self, source: Source) -> bool:
        """Return whether results of this piece of the source are stored for its present content."""
        row = self._base.execute(
            "select 1 from sources"
            " where run = ? and file = ? and piece = ? and pieces = ? and digest = ?",
            (self._run, source.path, source.piece, source.pieces, source.digest),
        ).fetchone()
        return row is not None

    def file_with(self, digest: str, piece: int, pieces: int) -> str | None:
        """Return a file whose results for a piece with the same content are stored.

        The result is None if there is no such file.

        Parameters
        ----------
        digest : str
            SHA-256 of the content of the source.
        piece, pieces : int
            Number of the piece, and number of pieces of the source.
        """
        row = self._base.execute(
            "select file from sources where run = ? and digest = ? and piece = ? and pieces = ?",
            (self._run, digest, piece, pieces),
        ).fetchone()
        return None if row is None else str(row[0])

    def touch(self, source: Source) -> None:
        """Store the present size and time of a source whose content has not changed."""
        with self._base:
            self._base.execute(
                "update sources set size = ?, mtime_ns = ?"
                " where run = ? and file = ? and digest = ?",
                (source.size, source.mtime_ns, self._run, source.path, source.digest),
            )

    def add(self, number: int, rows: Iterable[Mapping[str, Any]]) -> None:
        """Add the sources of a part; earlier results of changed files become stale.

        Parameters
        ----------
        number : int
            Number of the part.
        rows : iterable of mapping
            Rows of its table ``sources``.
        """
        with self._base:
            self._add(number, rows)

    def stale(self) -> dict[int, set[str]]:
        """Return the contents whose rows have to be removed, by the number of the part.

        A content is given by its SHA-256.
        """
        digests: dict[int, set[str]] = {}
        for number, digest in self._base.execute(
            "select number, digest from stale where run = ?", (self._run,)
        ):
            digests.setdefault(number, set()).add(digest)
        return digests

    def clean(self, number: int) -> None:
        """Record that the stale rows of a part were removed."""
        with self._base:
            self._base.execute(
                "delete from stale where run = ? and number = ?", (self._run, number)
            )

    def refused(self) -> int:
        """Return the number of sources with at least one failure."""
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
            # `distinct` in the query would be slow: SQLite would then use the other index.
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
    """Open or create the index; sqlite3.DatabaseError if it is damaged or has other tables."""
    max_bytes = min(MAX_LEDGER_BYTES, MAX_LEDGER_BYTES_PER_PART * (1 + parts))
    if path.exists() and path.stat().st_size > max_bytes:
        raise sqlite3.DatabaseError(f"more than {max_bytes} bytes")
    base = sqlite3.connect(path)
    try:
        base.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_VALUE_BYTES)
        # A view or trigger in a manipulated file would run with every query, possibly endlessly.
        with contextlib.closing(sqlite3.connect(":memory:")) as expected:
            expected.executescript(_LEDGER_SCHEMA)
            ours = _schema_of(expected)
        present = _schema_of(base)
        if not present <= ours:
            raise sqlite3.DatabaseError("tables of another program")
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
                raise sqlite3.DatabaseError("an index of parts that do not exist")
        base.set_progress_handler(None, 0)
        # Entries that a power failure destroys are read from the tables again.
        base.execute("pragma synchronous = off")
        base.executescript(_LEDGER_SCHEMA)
    except BaseException:
        with contextlib.suppress(sqlite3.Error):
            base.close()
        raise
    return base


def _schema_of(base: sqlite3.Connection) -> set[tuple[str, ...]]:
    """Return all objects of a database, with the statements that made them."""
    limit = 100  # an index of this program has fewer than ten
    objects = base.execute("select type, name, tbl_name, sql from sqlite_master limit ?", (limit,))
    return {tuple(map(str, row)) for row in objects}
