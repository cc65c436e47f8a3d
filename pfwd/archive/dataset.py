"""The tables of an archive's results, as Parquet; needs pyarrow (extra ``parquet``).

::

    OUT/archive.json                          what this folder is
    OUT/runs/KEY.json                         options and software of a run
    OUT/results/run=KEY/part-000001.parquet   a row a drop
    OUT/diagnoses/run=KEY/part-000001.parquet  a row a point, of runs of `pfwd diagnose`
    OUT/failures/run=KEY/part-000001.parquet  a row for whatever gave none, with the reason
    OUT/sources/run=KEY/part-000001.parquet   a row a source: the other two are valid with it
    OUT/ledger.sqlite                         an index of the sources; made anew when it is lost

Every file is written under another name, brought to the disk and renamed; of a part the sources
come last. What a crash leaves without them is removed when the archive is continued.
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
from pfwd.files.disk import disk_errors, sync
from pfwd.files.output_path import refuse_inside_survey

if TYPE_CHECKING:
    from pfwd.analysis.results import DiagnosisResult, DropResult

TABLES = ("results", "diagnoses", "failures", "sources")
_MARK = {"format": "pfwd-archive", "version": 1}
_PART = re.compile(r"part-(\d{6,})\.parquet", re.ASCII)

MOST_ROWS = 100_000
"""Of a table in a part; a part is ended at 10,000."""

LARGEST_PART = 64 * 2**20
"""Bytes of a table in a part, packed or not; 10,000 results with their warnings take 10 MB. A few
packed bytes can announce any number."""

_ROWS_AT_ONCE = 100
"""Unpacked before their bytes are counted: one text may stand for all of them in the file."""

_LARGEST_HEADER = 2**20
"""Entries, and bytes of a text, of what describes a file."""

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
    # Behind all others: parts of before end here.
    *(
        (column.name, "int64" if column.kind == "whole" else "float64")
        for column in result_columns("layers")
    ),
    ("deflection_recorded_m", "float64"),
    ("deflection_corrected_m", "float64"),
)
"""Names with the SI unit at their end, and types."""

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
"""``same_as``: the file with the same content that has the rows."""

EARLIER_COLUMNS = (48, 48 + len(result_columns("layers")))
"""Of a result in parts that were written before there were layers, and before there were
deflections; the others are null in them."""

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
"""Of a point after its effects were added; `before_`: with the base model."""

_COLUMNS = dict(
    zip(TABLES, (RESULT_COLUMNS, DIAGNOSIS_COLUMNS, FAILURE_COLUMNS, SOURCE_COLUMNS), strict=True)
)
Row = Mapping[str, Any]


def result_row(result: DropResult, digest: str) -> dict[str, Any]:
    """One result as a row."""
    flat = result.to_json() | {"source_sha256": digest}
    flat |= nested_cells(result)
    return {name: _fitting(flat.get(name), kind) for name, kind in RESULT_COLUMNS}


def diagnosis_row(result: DiagnosisResult, digest: str) -> dict[str, Any]:
    """One diagnosis as a row."""
    flat = result.to_json() | {"source_sha256": digest, "drops": len(result.drops or ())}
    flat |= {f"before_{key}": value for key, value in (flat.get("before") or {}).items()}
    flat |= {f"held_out_{key}": value for key, value in (flat.get("held_out") or {}).items()}
    flat |= flat.get("after") or {}
    ends = flat.get("modulus_interval_pa") or (None, None)
    flat["modulus_interval_low_pa"], flat["modulus_interval_high_pa"] = ends
    flat["effects"] = [str(effect.name) for effect in result.effects or ()]
    return {name: _fitting(flat.get(name), kind) for name, kind in DIAGNOSIS_COLUMNS}


def _fitting(value: Any, kind: str) -> Any:
    if value is None:
        return [] if kind == "strings" else None
    if kind == "string":
        return str(value)
    if kind == "float64":
        # Free text where a number could stand, as the coordinates of a header.
        return float(value) if is_number(value) else None
    return value


class Dataset:
    """The folder with the tables of one run among those of others.

    Parameters
    ----------
    folder : path
        Is made if it does not exist; otherwise it is empty or of this kind.
    key : str
        Of the run.
    identity : mapping
        What the key stands for.

    Raises
    ------
    OptionError
        If pyarrow is not installed or the folder holds something else.
    SurveyError
        If the disk does not take it.
    """

    def __init__(self, folder: str | os.PathLike[str], key: str, identity: Row) -> None:
        _parquet()
        self.folder = Path(folder)
        self.key = key
        with disk_errors(self.folder):
            self._claim()
            runs = self.folder / "runs"
            runs.mkdir(exist_ok=True)
            described = runs / f"{key}.json"
            if not described.exists():
                _publish(described, json.dumps({"run": key, **identity}, indent=1).encode())

    def _claim(self) -> None:
        refuse_inside_survey(self.folder, "--archive")
        mark = self.folder / "archive.json"
        if mark.exists():
            return
        if self.folder.exists() and (not self.folder.is_dir() or any(self.folder.iterdir())):
            came = "something else in it" if self.folder.is_dir() else "a file"
            expected = "a folder that is new, empty or an archive of results"
            raise OptionError(refusal(f"--archive {self.folder}", expected, came))
        self.folder.mkdir(parents=True, exist_ok=True)
        _publish(mark, json.dumps(_MARK).encode())

    def parts(self) -> list[int]:
        """Numbers of the parts that are whole, in order."""
        return sorted(self._numbers("sources"))

    def clear_leftovers(self) -> None:
        """Remove what a crash left behind: drafts, and tables of parts without sources."""
        with disk_errors(self.folder):
            whole = self._numbers("sources")
            for name in TABLES:
                place = self._place(name)
                for path in place.glob("*.tmp"):
                    path.unlink()
                for number in self._numbers(name) - whole:
                    self._file(name, number).unlink()

    def write(
        self,
        number: int,
        results: Sequence[Row],
        diagnoses: Sequence[Row],
        failures: Sequence[Row],
        sources: Sequence[Row],
    ) -> None:
        """Write one part; it counts when this returns, and is not there at all before.

        Raises
        ------
        SurveyError
            If the disk does not take it.
        """
        with disk_errors(self.folder):
            for name, rows in zip(TABLES, (results, diagnoses, failures, sources), strict=True):
                if rows or name == "sources":
                    self._write_table(name, number, _table(name, rows))

    def sources(self, number: int) -> list[dict[str, Any]]:
        """The sources of a part.

        Raises
        ------
        SurveyError
            If the part is damaged.
        """
        return self._read("sources", number).to_pylist()  # type: ignore[no-any-return]

    def remove_content(self, number: int, digests: Iterable[str]) -> None:
        """Write a part anew without the rows of some contents.

        Raises
        ------
        SurveyError
            If the part is damaged or the disk does not take it.
        """
        gone = set(digests)
        for name in TABLES:
            if not self._file(name, number).exists():
                continue
            table = self._read(name, number)
            keep = [digest not in gone for digest in table["source_sha256"].to_pylist()]
            if not all(keep):
                with disk_errors(self.folder):
                    self._write_table(name, number, table.filter(keep))

    def failures(self) -> Iterator[dict[str, Any]]:
        """All failures of the run, part by part."""
        for number in sorted(self._numbers("failures") & self._numbers("sources")):
            yield from self._read("failures", number).to_pylist()

    def _read(self, name: str, number: int) -> Any:
        path = self._file(name, number)
        try:
            # Not as a data set: the folder's name would become a column of its own.
            # And closed again: elsewhere than here an open file cannot be replaced.
            if path.stat().st_size > LARGEST_PART:
                raise ValueError(f"a file of more than {LARGEST_PART} bytes")
            limits = dict.fromkeys(
                ("thrift_string_size_limit", "thrift_container_size_limit"), _LARGEST_HEADER
            )
            with _parquet().ParquetFile(path, **limits) as file:
                return _unpacked(file, _schema(name))
        except (OSError, ValueError, MemoryError) as err:
            hint = "remove it: what it held is inverted again"
            came = (str(err).splitlines() or [type(err).__name__])[0]
            raise SurveyError(refusal(str(path), "a Parquet table", came, hint)) from err

    def _write_table(self, name: str, number: int, table: Any) -> None:
        path = self._file(name, number)
        path.parent.mkdir(parents=True, exist_ok=True)
        # What begins with a dot no reader of data sets takes for a part of the table.
        draft = path.with_name(f".{path.name}.tmp")
        _parquet().write_table(table, draft, compression="zstd")
        _settle(draft, path)

    def _numbers(self, name: str) -> set[int]:
        try:
            names = os.listdir(self._place(name))
        except FileNotFoundError:
            return set()
        return {int(match[1]) for match in map(_PART.fullmatch, names) if match}

    def _place(self, name: str) -> Path:
        return self.folder / name / f"run={self.key}"

    def _file(self, name: str, number: int) -> Path:
        return self._place(name) / f"part-{number:06d}.parquet"


def _unpacked(file: Any, schema: Any) -> Any:
    """The table of an open file; ValueError when it is none of ours, or is too large."""
    import pyarrow

    about = file.metadata
    groups = [about.row_group(n) for n in range(min(about.num_row_groups, MOST_ROWS))]
    announced = sum(group.total_byte_size for group in groups)
    if about.num_rows > MOST_ROWS or about.num_row_groups > MOST_ROWS or announced > LARGEST_PART:
        raise ValueError(f"{about.num_rows} rows of {announced} bytes")
    there = len(file.schema_arrow)
    old = there in EARLIER_COLUMNS and there < len(schema)
    written = pyarrow.schema(list(schema)[:there]) if old else schema
    if not file.schema_arrow.equals(written):
        raise ValueError("other columns")
    batches, size = [], 0
    for batch in file.iter_batches(batch_size=_ROWS_AT_ONCE):
        size += batch.nbytes
        if size > LARGEST_PART:
            raise ValueError(f"more than {LARGEST_PART} bytes when it is unpacked")
        batches.append(batch)
    table = pyarrow.Table.from_batches(batches, written).combine_chunks()
    for field in list(schema)[len(written) :]:
        table = table.append_column(field, pyarrow.nulls(table.num_rows, field.type))
    return table


def _table(name: str, rows: Sequence[Row]) -> Any:
    import pyarrow

    columns = [[row[column] for row in rows] for column, _ in _COLUMNS[name]]
    return pyarrow.table(columns, schema=_schema(name))


def _schema(name: str) -> Any:
    import pyarrow

    kinds = {
        "string": pyarrow.string(),
        "strings": pyarrow.list_(pyarrow.string()),
        "int64": pyarrow.int64(),
        "float64": pyarrow.float64(),
        "bool": pyarrow.bool_(),
    }
    return pyarrow.schema([(column, kinds[kind]) for column, kind in _COLUMNS[name]])


def _parquet() -> Any:
    try:
        from pyarrow import parquet
    except ImportError as err:
        hint = 'python -m pip install "pfwd[parquet]"'
        raise OptionError(refusal("--archive", "the package pyarrow", "none", hint)) from err
    return parquet


def _publish(path: Path, content: bytes) -> None:
    draft = path.with_name(path.name + ".tmp")
    draft.write_bytes(content)
    _settle(draft, path)


def _settle(draft: Path, path: Path) -> None:
    """Bring a draft to the disk and give it its name."""
    sync(draft)
    os.replace(draft, path)
    if os.name != "nt":  # where a folder cannot be opened, and needs not be
        handle = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
