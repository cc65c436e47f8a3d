"""Parquet tables with the results of an archive; needs pyarrow (extra ``parquet``).

::

    OUT/archive.json                           marks this folder as an archive
    OUT/runs/KEY.json                          options and software of a run
    OUT/results/run=KEY/part-000001.parquet    a row for each drop
    OUT/diagnoses/run=KEY/part-000001.parquet  a row for each point, of runs of `pfwd diagnose`
    OUT/failures/run=KEY/part-000001.parquet   a row for each failure, with the reason
    OUT/sources/run=KEY/part-000001.parquet    a row for each source file or survey
    OUT/ledger.sqlite                          index of the sources; rebuilt when it is lost

A run is the set of results that were made with the same options and software; KEY identifies it. A
part consists of the tables with the same number. Every file is written under another name, flushed
to the disk and renamed, and the table of sources is written last. A part without it is incomplete,
and is removed when the archive is continued.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inversion.records import is_number
from pfwd.analysis.result_columns import nested_cells, result_columns
from pfwd.errors import OptionError, SurveyError, refusal
from pfwd.files.output_path import disk_errors, refuse_inside_survey, replaced_durably

if TYPE_CHECKING:
    from pfwd.analysis.results import DiagnosisResult, DropResult

TABLE_NAMES = ("results", "diagnoses", "failures", "sources")
_ARCHIVE_MARK = {"format": "pfwd-archive", "version": 1}
_PART_NAME = re.compile(r"part-(\d{6,})\.parquet", re.ASCII)

MAX_PARQUET_ROWS = 100_000
"""Largest number of rows that is read from one table; parts are written at 10,000 rows."""

MAX_TABLE_BYTES = 64 * 2**20
"""Largest size of one table, both of the file and unpacked; 10,000 results with their warnings take
10 MB. The limit is needed because a few compressed bytes can expand to any number."""

_BATCH_ROWS = 100
"""Rows that are unpacked before their size is counted: one text in the file may be repeated in all
of them."""

_MAX_HEADER_SIZE = 2**20
"""Largest number of entries, and of bytes in one text, in the metadata of a Parquet file."""

RESULT_COLUMNS: tuple[tuple[str, str], ...] = (
    ("file", "string"),
    ("source_sha256", "string"),
    ("point", "string"),
    ("drop", "int64"),
    ("status", "string"),
    ("reason", "string"),
    ("method", "string"),
    ("model", "string"),
    ("modulus_pa", "float64"),
    ("modulus_sd_pa", "float64"),
    ("modulus_interval_low_pa", "float64"),
    ("modulus_interval_high_pa", "float64"),
    ("viscosity_pa_s", "float64"),
    ("viscosity_sd_pa_s", "float64"),
    ("density_kg_m3", "float64"),
    ("density_sd_kg_m3", "float64"),
    ("bedrock_depth_m", "float64"),
    ("bedrock_depth_sd_m", "float64"),
    ("bedrock_depth_interval_low_m", "float64"),
    ("bedrock_depth_interval_high_m", "float64"),
    ("modulus_depth_correlation", "float64"),
    ("poisson_ratio", "float64"),
    ("plate_radius_m", "float64"),
    ("plate", "string"),
    ("load", "string"),
    ("peak_load_n", "float64"),
    ("half_sine_peak_pressure_pa", "float64"),
    ("half_sine_duration_s", "float64"),
    ("half_sine_rms_over_peak", "float64"),
    ("peak_modulus_pa", "float64"),
    ("peak_factor", "float64"),
    ("r_squared", "float64"),
    ("noise_rms_m", "float64"),
    ("residual_rms_over_peak", "float64"),
    ("contact_residual_rms_over_peak", "float64"),
    ("explained", "bool"),
    ("converged", "bool"),
    ("at_bound", "strings"),
    ("forward_solves", "int64"),
    ("elapsed_s", "float64"),
    ("seed", "int64"),
    ("device", "string"),
    ("site", "string"),
    ("operator", "string"),
    ("time_utc", "string"),
    ("latitude", "float64"),
    ("longitude", "float64"),
    ("warnings", "strings"),
    # Later columns are appended: tables of earlier versions end here.
    *(
        (column.name, "int64" if column.kind == "whole" else "float64")
        for column in result_columns("layers")
    ),
    ("deflection_recorded_m", "float64"),
    ("deflection_corrected_m", "float64"),
)
"""Name and type of each column of the table ``results``; names end with the SI unit."""

FAILURE_COLUMNS: tuple[tuple[str, str], ...] = (
    ("file", "string"),
    ("source_sha256", "string"),
    ("point", "string"),
    ("kind", "string"),
    ("reason", "string"),
)

SOURCE_COLUMNS: tuple[tuple[str, str], ...] = (
    ("file", "string"),
    ("source_sha256", "string"),
    ("size_bytes", "int64"),
    ("mtime_ns", "int64"),
    ("piece", "int64"),
    ("pieces", "int64"),
    ("drops", "int64"),
    ("failures", "int64"),
    ("same_as", "string"),
)
"""Name and type of each column of the table ``sources``; ``same_as`` is the file with the same
content whose rows hold the results."""

EARLIER_COLUMN_COUNTS = (48, 48 + len(result_columns("layers")))
"""Numbers of columns of ``results`` in earlier versions: without layers, and without deflections.
Missing columns are read as null."""

DIAGNOSIS_COLUMNS: tuple[tuple[str, str], ...] = (
    ("file", "string"),
    ("source_sha256", "string"),
    ("point", "string"),
    ("device", "string"),
    ("drops", "int64"),
    ("verdict", "string"),
    ("corrected", "bool"),
    ("plate", "string"),
    ("plate_radius_m", "float64"),
    ("poisson_ratio", "float64"),
    ("model", "string"),
    ("modulus_pa", "float64"),
    ("modulus_sd_pa", "float64"),
    ("modulus_interval_low_pa", "float64"),
    ("modulus_interval_high_pa", "float64"),
    ("stress_pa", "float64"),
    ("modulus_100kpa_pa", "float64"),
    ("residual_rms_over_peak", "float64"),
    ("contact_residual_rms_over_peak", "float64"),
    ("residual_over_noise", "float64"),
    ("before_model", "string"),
    ("before_modulus_pa", "float64"),
    ("before_residual_rms_over_peak", "float64"),
    ("before_contact_residual_rms_over_peak", "float64"),
    ("held_out_mode", "string"),
    ("held_out_before", "float64"),
    ("held_out_after", "float64"),
    ("effects", "strings"),
    ("rejected", "strings"),
    ("warnings", "strings"),
)
"""Name and type of each column of the table ``diagnoses``, a row for each point. Names with
``before_`` hold values of the base model, without effects."""

_TABLE_COLUMNS = dict(
    zip(
        TABLE_NAMES,
        (RESULT_COLUMNS, DIAGNOSIS_COLUMNS, FAILURE_COLUMNS, SOURCE_COLUMNS),
        strict=True,
    )
)
Row = Mapping[str, Any]


def result_row(result: DropResult, digest: str) -> dict[str, Any]:
    """Return the result of a drop as a row of the table ``results``.

    Parameters
    ----------
    result : DropResult
    digest : str
        SHA-256 of the source's content.
    """
    flat = result.to_json() | {"source_sha256": digest}
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
    flat = result.to_json() | {"source_sha256": digest, "drops": len(result.drops or ())}
    flat |= {f"before_{key}": value for key, value in (flat.get("before") or {}).items()}
    flat |= {f"held_out_{key}": value for key, value in (flat.get("held_out") or {}).items()}
    flat |= flat.get("after") or {}
    ends = flat.get("modulus_interval_pa") or (None, None)
    flat["modulus_interval_low_pa"], flat["modulus_interval_high_pa"] = ends
    flat["effects"] = [str(effect.name) for effect in result.effects or ()]
    return {name: _cell(flat.get(name), kind) for name, kind in DIAGNOSIS_COLUMNS}


def _cell(value: Any, kind: str) -> Any:
    if value is None:
        return [] if kind == "strings" else None
    if kind == "string":
        return str(value)
    if kind == "float64":
        # Headers may hold free text in place of a number, for example as a coordinate.
        return float(value) if is_number(value) else None
    return value


class Dataset:
    """Folder of an archive's results, for reading and writing the tables of one run.

    Parameters
    ----------
    folder : path
        Created if it does not exist; otherwise it has to be empty or an archive.
    key : str
        Key of the run, see `run_key`.
    identity : mapping
        Options and software of the run, see `run_identity`.

    Raises
    ------
    OptionError
        If pyarrow is not installed or the folder holds other files.
    SurveyError
        If the folder cannot be written.
    """

    def __init__(self, folder: str | os.PathLike[str], key: str, identity: Row) -> None:
        _parquet()
        self.folder = Path(folder)
        self.key = key
        with disk_errors(self.folder):
            self._claim()
            runs = self.folder / "runs"
            runs.mkdir(exist_ok=True)
            description = runs / f"{key}.json"
            if not description.exists():
                content = json.dumps({"run": key, **identity}, indent=1).encode()
                with replaced_durably(description) as draft:
                    draft.write_bytes(content)

    def _claim(self) -> None:
        refuse_inside_survey(self.folder, "--archive")
        mark = self.folder / "archive.json"
        if mark.exists():
            return
        if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
            actual = "something else in it" if self.folder.is_dir() else "a file"
            expected = "a folder that is new, empty or an archive of results"
            raise OptionError(refusal(f"--archive {self.folder}", expected, actual))
        self.folder.mkdir(parents=True, exist_ok=True)
        with replaced_durably(mark) as draft:
            draft.write_bytes(json.dumps(_ARCHIVE_MARK).encode())

    def parts(self) -> list[int]:
        """Return the numbers of the complete parts of the run, in order."""
        return sorted(self._numbers("sources"))

    def clear_leftovers(self) -> None:
        """Remove the temporary files and incomplete parts that a crash left."""
        with disk_errors(self.folder):
            complete = self._numbers("sources")
            for folder in (self.folder / "runs", *map(self._table_folder, TABLE_NAMES)):
                for path in folder.glob("*.tmp"):
                    path.unlink()
            for name in TABLE_NAMES:
                for number in self._numbers(name) - complete:
                    self._file(name, number).unlink()

    def write(
        self,
        number: int,
        results: Sequence[Row],
        diagnoses: Sequence[Row],
        failures: Sequence[Row],
        sources: Sequence[Row],
    ) -> None:
        """Write the tables of one part.

        After a crash in between the part is incomplete and is ignored.

        Parameters
        ----------
        number : int
            Number of the part.
        results, diagnoses, failures, sources : sequence of mapping
            Rows of the four tables.

        Raises
        ------
        SurveyError
            If the folder cannot be written.
        """
        import pyarrow

        with disk_errors(self.folder):
            for name, rows in zip(
                TABLE_NAMES, (results, diagnoses, failures, sources), strict=True
            ):
                if rows or name == "sources":
                    columns = [[row[column] for row in rows] for column, _ in _TABLE_COLUMNS[name]]
                    self._write_table(name, number, pyarrow.table(columns, schema=_schema(name)))

    def sources(self, number: int) -> list[dict[str, Any]]:
        """Return the rows of the table ``sources`` of a part.

        Raises
        ------
        SurveyError
            If the file is damaged.
        """
        return self._read("sources", number).to_pylist()  # type: ignore[no-any-return]

    def remove_content(self, number: int, digests: Iterable[str]) -> None:
        """Remove the rows of some sources from all tables of a part.

        Parameters
        ----------
        number : int
            Number of the part.
        digests : iterable of str
            SHA-256 of the contents whose rows are removed.

        Raises
        ------
        SurveyError
            If the part is damaged or cannot be written.
        """
        removed = set(digests)
        for name in TABLE_NAMES:
            if not self._file(name, number).exists():
                continue
            table = self._read(name, number)
            keep = [digest not in removed for digest in table["source_sha256"].to_pylist()]
            if not all(keep):
                with disk_errors(self.folder):
                    self._write_table(name, number, table.filter(keep))

    def failures(self) -> Iterator[dict[str, Any]]:
        """Yield the rows of the table ``failures`` of the run, part by part."""
        for number in sorted(self._numbers("failures") & self._numbers("sources")):
            yield from self._read("failures", number).to_pylist()

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
            hint = "remove it: its drops are inverted again"
            reason = (str(err).splitlines() or [type(err).__name__])[0]
            raise SurveyError(refusal(str(path), "a Parquet table", reason, hint)) from err

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
    n_columns = len(file.schema_arrow)
    earlier = n_columns in EARLIER_COLUMN_COUNTS and n_columns < len(schema)
    written = pyarrow.schema(list(schema)[:n_columns]) if earlier else schema
    if not file.schema_arrow.equals(written):
        raise ValueError("other columns")
    batches, size = [], 0
    for batch in file.iter_batches(batch_size=_BATCH_ROWS):
        size += batch.nbytes
        if size > MAX_TABLE_BYTES:
            raise ValueError(f"more than {MAX_TABLE_BYTES} bytes when it is unpacked")
        batches.append(batch)
    table = pyarrow.Table.from_batches(batches, written).combine_chunks()
    for field in list(schema)[len(written) :]:
        table = table.append_column(field, pyarrow.nulls(table.num_rows, field.type))
    return table


def _schema(name: str) -> Any:
    import pyarrow

    kinds = {
        "string": pyarrow.string(),
        "strings": pyarrow.list_(pyarrow.string()),
        "int64": pyarrow.int64(),
        "float64": pyarrow.float64(),
        "bool": pyarrow.bool_(),
    }
    return pyarrow.schema([(column, kinds[kind]) for column, kind in _TABLE_COLUMNS[name]])


def _parquet() -> Any:
    try:
        from pyarrow import parquet
    except ImportError as err:
        hint = 'python -m pip install "pfwd[parquet]"'
        raise OptionError(refusal("--archive", "the package pyarrow", "none", hint)) from err
    return parquet
