"""Parquet tables with the results of an archive; needs pyarrow (extra ``parquet``).

::

    OUT/archive.json                           marks this folder as an archive
    OUT/runs/KEY.json                          options and software of a run
    OUT/results/run=KEY/part-000001.parquet    a row for each drop
    OUT/diagnoses/run=KEY/part-000001.parquet  a row for each point, of runs of `pfwd diagnose`
    OUT/failures/run=KEY/part-000001.parquet   a row for each failure, with the reason
    OUT/sources/run=KEY/part-000001.parquet    a row for each source file or survey

A run is the set of results that were made with the same options and software; KEY identifies it. A
part consists of the tables with the same number. Every table is written under another name, flushed
to the disk and renamed, the table of sources last. A part without it is incomplete, and is removed
when the archive is continued.
"""

import hashlib
import json
import os
import re
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from inversion.records import is_number
from pfwd.analysis.result_columns import (
    Kind,
    cells_of,
    columns_of,
    nested_cells,
    result_columns,
)
from pfwd.analysis.results import DiagnosisResult, DropResult, FittedState
from pfwd.errors import OptionError, SurveyError, how_to_install, refusal
from pfwd.files.output_path import disk_errors, refuse_bad_place, replaced_durably

_ARCHIVE_MARK = {"format": "pfwd-archive", "version": 1}
_PART_NAME = re.compile(r"part-(\d{6,9})\.parquet", re.ASCII)

MAX_PARQUET_ROWS = 100_000
"""Largest number of rows that is read from one table; parts are written at 10,000 rows."""

MAX_TABLE_BYTES = 64 * 2**20
"""Largest size of one table, both of the file and unpacked; 10,000 results with their warnings take
10 MB. The limit is needed because a few compressed bytes can expand to any number."""

MAX_PIECES = 100_000
"""Largest number of pieces of a survey, each of 500 drops."""

_BATCH_ROWS = 100
"""Rows that are unpacked before their size is counted: one text in the file may be repeated in all
of them."""

_MAX_HEADER_SIZE = 2**20
"""Largest number of entries, and of bytes in one text, in the metadata of a Parquet file."""

RESULT_COLUMNS: tuple[tuple[str, Kind], ...] = (
    ("file", "text"),
    ("source_sha256", "text"),
    ("point", "text"),
    ("drop", "whole"),
    ("status", "text"),
    ("reason", "text"),
    ("peak_load_n", "number"),
    ("deflection_recorded_m", "number"),
    ("deflection_corrected_m", "number"),
    *((c.name, c.kind) for c in result_columns("established")),
    ("forward_solves", "whole"),
    ("elapsed_s", "number"),
    ("device", "text"),
    ("site", "text"),
    ("operator", "text"),
    ("time_utc", "text"),
    ("latitude", "number"),
    ("longitude", "number"),
    *((c.name, c.kind) for place in ("layers", "last") for c in result_columns(place)),
)
"""Name and type of each column of the table ``results``; names end with the SI unit."""

FAILURE_COLUMNS: tuple[tuple[str, Kind], ...] = (
    ("file", "text"),
    ("source_sha256", "text"),
    ("point", "text"),
    ("kind", "text"),
    ("reason", "text"),
)


@dataclass(frozen=True, slots=True)
class SourceRow:
    """Row of the table ``sources``."""

    file: str
    source_sha256: str
    size_bytes: int
    mtime_ns: int
    piece: int
    pieces: int
    drops: int = 0
    failures: int = 0
    same_as: str | None = None
    """File with the same content whose rows hold the results; None: they are its own."""


SOURCE_COLUMNS: tuple[tuple[str, Kind], ...] = tuple(
    (field.name, "whole" if field.type is int else "text") for field in fields(SourceRow)
)

DIAGNOSIS_COLUMNS: tuple[tuple[str, Kind], ...] = (
    ("file", "text"),
    ("source_sha256", "text"),
    ("point", "text"),
    ("device", "text"),
    ("drops", "whole"),
    ("verdict", "text"),
    ("corrected", "flag"),
    ("plate", "text"),
    ("plate_radius_m", "number"),
    ("poisson_ratio", "number"),
    *((c.name, c.kind) for c in columns_of(FittedState)),
    *((c.name, c.kind) for c in columns_of(FittedState, prefix="before_")),
    ("held_out_mode", "text"),
    ("held_out_before", "number"),
    ("held_out_after", "number"),
    ("effects", "texts"),
    ("rejected", "texts"),
    ("warnings", "texts"),
)
"""Name and type of each column of the table ``diagnoses``, a row for each point. Names with
``before_`` hold values of the base model, without effects."""

TABLES: Mapping[str, tuple[tuple[str, Kind], ...]] = {
    "results": RESULT_COLUMNS,
    "diagnoses": DIAGNOSIS_COLUMNS,
    "failures": FAILURE_COLUMNS,
    "sources": SOURCE_COLUMNS,
}
"""Columns of each table, in the order in which the tables of a part are written."""

Row = Mapping[str, Any]


def result_row(result: DropResult, digest: str, declared: Row) -> dict[str, Any]:
    """Return the result of a drop as a row of the table ``results``.

    Parameters
    ----------
    result : DropResult
    digest : str
        SHA-256 of the source's content.
    declared : mapping
        Declarations of the point that are columns of the table.
    """
    flat = {**result.to_json(), **declared, "source_sha256": digest}
    flat |= nested_cells(result)
    return {name: _cell(flat.get(name), kind) for name, kind in RESULT_COLUMNS}


def diagnosis_row(result: DiagnosisResult, digest: str) -> dict[str, Any]:
    """Return the diagnosis of a point as a row of the table ``diagnoses``.

    Parameters
    ----------
    result : DiagnosisResult
    digest : str
        SHA-256 of the source's content.
    """
    flat = result.to_json() | {"source_sha256": digest, "drops": len(result.drops)}
    flat |= cells_of(result.after) | cells_of(result.before, "before_")
    flat |= {f"held_out_{key}": value for key, value in (flat.get("held_out") or {}).items()}
    flat["effects"] = [effect.name for effect in result.effects]
    return {name: _cell(flat.get(name), kind) for name, kind in DIAGNOSIS_COLUMNS}


def _cell(value: Any, kind: Kind) -> Any:
    if value is None:
        return [] if kind == "texts" else None
    if kind == "text":
        return str(value)
    if kind == "number":
        # Headers may hold free text in place of a number, for example as a coordinate.
        return float(value) if is_number(value) else None
    return value


class ArchiveFolder:
    """Folder of an archive's results, for reading and writing the tables of one run.

    Parameters
    ----------
    folder : path
        Created if it does not exist; otherwise it has to be empty or an archive.
    identity : mapping
        Options and software of the run, see `run_identity`.

    Raises
    ------
    OptionError
        If pyarrow is not installed or the folder holds other files.
    SurveyError
        If the folder cannot be written.
    """

    def __init__(self, folder: str | os.PathLike[str], identity: Row) -> None:
        _parquet()
        self.folder = Path(folder)
        text = json.dumps(identity, sort_keys=True)
        self.key = hashlib.sha256(text.encode()).hexdigest()[:12]
        refuse_bad_place(self.folder, "--archive")
        mark = self.folder / "archive.json"
        description = self.folder / "runs" / f"{self.key}.json"
        with disk_errors(self.folder):
            is_new = not mark.exists()
            if is_new and self.folder.exists():
                expected = "a folder that is new, empty or an archive of results"
                actual = "something else in it" if self.folder.is_dir() else "a file"
                if not self.folder.is_dir() or any(self.folder.iterdir()):
                    raise OptionError(refusal(f"--archive {self.folder}", expected, actual))
            self.folder.mkdir(parents=True, exist_ok=True)
            contents = {mark: _ARCHIVE_MARK, description: {"run": self.key, **identity}}
            for path, content in contents.items():
                if not path.exists():
                    path.parent.mkdir(exist_ok=True)
                    with replaced_durably(path) as draft:
                        draft.write_text(json.dumps(content, indent=1), "utf-8")

    def clear_leftovers(self) -> list[int]:
        """Remove the temporary files and incomplete parts that a crash left.

        Returns
        -------
        list of int
            Numbers of the complete parts of the run, in order.
        """
        with disk_errors(self.folder):
            complete = self._numbers("sources")
            for folder in (self.folder / "runs", *map(self._table_folder, TABLES)):
                for path in folder.glob("*.tmp"):
                    path.unlink()
            for name in TABLES:
                for number in self._numbers(name) - complete:
                    self._file(name, number).unlink()
            return sorted(complete)

    def write(self, number: int, tables: Mapping[str, Sequence[Row]]) -> None:
        """Write the tables of one part.

        After a crash in between the part is incomplete and is ignored.

        Parameters
        ----------
        number : int
            Number of the part.
        tables : mapping
            Rows of each of `TABLES`.

        Raises
        ------
        SurveyError
            If the folder cannot be written.
        """
        import pyarrow

        with disk_errors(self.folder):
            for name, columns in TABLES.items():
                if rows := tables[name]:
                    cells = [[row[column] for row in rows] for column, _ in columns]
                    self._write_table(name, number, pyarrow.table(cells, schema=_schema(name)))

    def sources(self, number: int) -> list[dict[str, Any]]:
        """Return the rows of the table ``sources`` of a part.

        Raises
        ------
        SurveyError
            If the file is damaged.
        """
        rows: list[dict[str, Any]] = self._read("sources", number).to_pylist()
        if not all(map(_is_sound_source, rows)):
            raise self._damaged("sources", number, "impossible values")
        return rows

    def remove_content(self, digests: Set[str]) -> None:
        """Remove the rows of some contents from all tables of the run.

        Parameters
        ----------
        digests : set of str
            SHA-256 of the contents whose rows are removed.

        Raises
        ------
        SurveyError
            If a part is damaged or cannot be written.
        """
        for name in TABLES:  # the table of sources last: after a crash the removal is repeated
            for number in sorted(self._numbers(name)):
                table = self._read(name, number)
                keep = [digest not in digests for digest in table["source_sha256"].to_pylist()]
                if not all(keep):
                    with disk_errors(self.folder):
                        self._write_table(name, number, table.filter(keep))

    def _read(self, name: str, number: int) -> Any:
        path = self._file(name, number)
        try:
            # Read as a single file: as a data set the folder's name would become a column.
            # The file is closed after reading because Windows cannot replace an open file.
            if path.stat().st_size > MAX_TABLE_BYTES:
                raise ValueError(f"a file of more than {MAX_TABLE_BYTES} bytes")
            limits = dict.fromkeys(
                ("thrift_string_size_limit", "thrift_container_size_limit"), _MAX_HEADER_SIZE
            )
            with _parquet().ParquetFile(path, **limits) as file:
                return _unpacked(file, _schema(name))
        except (OSError, ValueError, MemoryError) as err:
            reason = (str(err).splitlines() or [type(err).__name__])[0]
            raise self._damaged(name, number, reason) from err

    def _damaged(self, name: str, number: int, reason: str) -> SurveyError:
        hint = "remove it: its drops are inverted again"
        return SurveyError(refusal(str(self._file(name, number)), "a Parquet table", reason, hint))

    def _write_table(self, name: str, number: int, table: Any) -> None:
        path = self._file(name, number)
        path.parent.mkdir(parents=True, exist_ok=True)
        # The temporary name begins with a dot, so that readers of data sets ignore the file.
        with replaced_durably(path) as draft:
            _parquet().write_table(table, draft, compression="zstd")

    def _numbers(self, name: str) -> set[int]:
        try:
            names = os.listdir(self._table_folder(name))
        except FileNotFoundError:
            return set()
        return {int(match[1]) for match in map(_PART_NAME.fullmatch, names) if match}

    def _table_folder(self, name: str) -> Path:
        return self.folder / name / f"run={self.key}"

    def _file(self, name: str, number: int) -> Path:
        return self._table_folder(name) / f"part-{number:06d}.parquet"


def _is_sound_source(row: Row) -> bool:
    texts = (row["file"], row["source_sha256"])
    numbers = (row["size_bytes"], row["mtime_ns"], row["piece"], row["pieces"], row["failures"])
    return None not in (*texts, *numbers) and 0 <= row["piece"] < row["pieces"] <= MAX_PIECES


def _unpacked(file: Any, schema: Any) -> Any:
    """Return the table of an open Parquet file.

    It raises ValueError if the table is too large or has other columns.
    """
    import pyarrow

    metadata = file.metadata
    n_groups = min(metadata.num_row_groups, MAX_PARQUET_ROWS)
    declared_bytes = sum(metadata.row_group(n).total_byte_size for n in range(n_groups))
    n_rows = max(metadata.num_rows, metadata.num_row_groups)
    if n_rows > MAX_PARQUET_ROWS or declared_bytes > MAX_TABLE_BYTES:
        raise ValueError(f"{metadata.num_rows} rows of {declared_bytes} bytes")
    if not file.schema_arrow.equals(schema):
        raise ValueError("other columns")
    batches, size = [], 0
    for batch in file.iter_batches(batch_size=_BATCH_ROWS):
        size += batch.nbytes
        if size > MAX_TABLE_BYTES:
            raise ValueError(f"more than {MAX_TABLE_BYTES} bytes when it is unpacked")
        batches.append(batch)
    return pyarrow.Table.from_batches(batches, schema).combine_chunks()


def _schema(name: str) -> Any:
    import pyarrow

    kinds = {
        "text": pyarrow.string(),
        "texts": pyarrow.list_(pyarrow.string()),
        "whole": pyarrow.int64(),
        "number": pyarrow.float64(),
        "flag": pyarrow.bool_(),
    }
    return pyarrow.schema([(column, kinds[kind]) for column, kind in TABLES[name]])


def _parquet() -> Any:
    try:
        from pyarrow import parquet
    except ImportError as err:
        hint = how_to_install("parquet")
        raise OptionError(refusal("--archive", "the package pyarrow", "none", hint)) from err
    return parquet
