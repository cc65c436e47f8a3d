"""Broken trace files are rejected by a line with what is wrong and where."""

import os
import zipfile
from pathlib import Path

import pytest

from pfwd.errors import SurveyError, TraceError, quote
from pfwd.files import traces
from pfwd.files.foreign import archive
from pfwd.files.foreign.common import distinct_names
from pfwd.files.header import parse_header
from pfwd.files.traces import read_traces
from pfwd_device.errors import RecordingError
from pfwd_device.recording import payload
from tests.pfwd.files.trace_lines import HEADER, NAMES, Write, rows

# The header


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("plate_mass_kg = -1", "plate_mass_kg: expected a number >= 0, in kg, got -1"),
        ("poisson_ratio = 0.5", "got 0.5; 0.5 is an incompressible soil.*use 0.49"),
        ("density_kg_m3 = 0", "density_kg_m3: expected a number > 0, in kg/m3, got 0"),
        ("density_kg_m3 = 1" + 400 * "0", r"got 10+\.\.\."),
        ("bedrock_depth_m = 0", "bedrock_depth_m: expected a number from 0.01 to 10000, in m, or"),
        ("bedrock_depth_m = 1e300", "to 10000, in m, or inf for none, got 1e\\+300"),
        ('centre_sensor = "hole"', 'centre_sensor: expected "plate" or "ground", got \'hole\''),
        ("geophone_damping = 0", "geophone_damping: expected a number > 0, got 0"),
        ("geophone_natural_frequency_hz = -1", "a number >= 0, in Hz, got -1; 0 where"),
        ("load_delay_s = inf", "load_delay_s: expected a finite number, in s, got inf"),
        ("seating_drops = -1", "seating_drops: expected a whole number >= 0, got -1"),
        ("model_floor_m = -1e-6", "model_floor_m: expected"),
        ("site = true", "site: expected text in quotation marks or a finite number, got True"),
        ("plate_mass_kg = 5,0", "expected one TOML key = value, got 'plate_mass_kg = 5,0'"),
        ("site = km 12", "text goes in quotation marks"),
        ("[table]", "write the key without a table in square brackets"),
        ("plate_radius_m = 0.15", "expected every key once, got 'plate_radius_m' again"),
        ("a = " + 5000 * "[", "expected one TOML key = value"),
    ],
)
def test_a_bad_header_line_is_refused_with_its_number(
    write: Write, line: str, message: str
) -> None:
    with pytest.raises(TraceError, match=f"point.csv, line 3.*{message}"):
        read_traces(write([*HEADER, f"# {line}", NAMES, *rows()]))


@pytest.mark.parametrize("radius", ["0", "150"])
def test_a_bad_plate_radius_is_refused(write: Write, radius: str) -> None:
    lines = ["# pfwd-traces = 1", f"# plate_radius_m = {radius}", NAMES, *rows()]
    with pytest.raises(
        TraceError, match=r"line 2, plate_radius_m: expected a number from 0\.01 to"
    ):
        read_traces(write(lines))


def test_a_missing_plate_radius_is_refused(write: Write) -> None:
    lines = ["# pfwd-traces = 1", "# plate_radius = 0.15", NAMES, *rows()]
    message = "line 3: expected a header key plate_radius_m, got none; .*--plate-radius .*'plate_r"
    with pytest.raises(TraceError, match=message):
        read_traces(write(lines))


@pytest.mark.parametrize(
    ("declared", "missing"),
    [
        ("geophone_damping = 0.7", "geophone_natural_frequency_hz"),
        ("geophone_natural_frequency_hz = 4.5", "geophone_damping"),
    ],
)
def test_half_a_geophone_is_refused(write: Write, declared: str, missing: str) -> None:
    with pytest.raises(TraceError, match=f"{declared.split()[0]} alone; declare {missing} too"):
        read_traces(write([*HEADER, f"# {declared}", NAMES, *rows()]))


@pytest.mark.parametrize("version", ["2", "1.0", '"1"', "true"])
def test_another_version_is_refused(write: Write, version: str) -> None:
    lines = [f"# pfwd-traces = {version}", HEADER[1], NAMES, *rows()]
    with pytest.raises(TraceError, match="line 1: expected pfwd-traces = 1, got"):
        read_traces(write(lines))


@pytest.mark.parametrize("first", ["# plate_radius_m = 0.15", "", NAMES, "# by pfwd-traces"])
def test_a_file_of_another_program_needs_a_header_file(write: Write, first: str) -> None:
    with pytest.raises(TraceError, match=r"line 1: expected # pfwd-traces = 1, .*--header"):
        read_traces(write([first, *HEADER[1:], NAMES, *rows()]))


# The columns


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ("drop,load_N,displacement_m@0", "line 3: expected a column time_s, got columns"),
        ("drop,time_s,displacement_m@0", "line 3: expected a column load_N"),
        (NAMES + ",temperature", "line 3: expected a column drop, .*got 'temperature'"),
        (NAMES + ",jerk_m_s3@0.3", "got 'jerk_m_s3@0.3'"),
        (NAMES + ",velocity_m_s", "the centre sensor is velocity_m_s@0.0000"),
        (NAMES + ",velocity_m_s@-1e999", "got 'velocity_m_s@-1e999'"),
        (NAMES + ",velocity_m_s@0.3.1", "got 'velocity_m_s@0.3.1'"),
        (NAMES + ",load_N", "expected every column once, got 'load_N' again"),
        (NAMES + ",displacement_m@0", "expected every column once, got 'displacement_m@0' again"),
        (NAMES + ",displacement_m@-0.0", "once, got 'displacement_m@-0.0' again"),
        (NAMES.replace(",", ";"), "separate the columns with commas"),
    ],
)
def test_bad_columns_are_refused(write: Write, names: str, message: str) -> None:
    with pytest.raises(TraceError, match=message):
        read_traces(write([*HEADER, names, *rows()]))


def test_a_velocity_and_a_displacement_may_share_a_place(write: Write) -> None:
    numbers = [row + ",0" for row in rows()]
    drop = read_traces(write([*HEADER, NAMES + ",velocity_m_s@0", *numbers])).drops[0]
    assert len(drop.channels) == 2


# The numbers


def broken(index: int, row: str, lines: list[str] | None = None) -> list[str]:
    """A sound file of 40 rows (or `lines`) with row `index` replaced; row 0 is line 4."""
    numbers = lines or [*rows(1), *rows(2)]
    numbers[index] = row
    return [*HEADER, NAMES, *numbers]


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ("1,0.007,700", r"expected 4 values, one per column, got 3: '1,0.007,700'"),
        ("1,0.007,700,1e-6,", "expected 4 values, one per column, got 5"),
        ("1,0.007,,1e-6", "expected a number in load_N, got ''"),
        ("1,0.007,7OO,1e-6", "expected a number in load_N, got '7OO'"),
        ("1,0.007,1_000,1e-6", "expected a number in load_N, got '1_000'"),
        ("1,0.007,nan,1e-6", "expected a finite number in load_N, got nan"),
        ("1,0.007,700,inf", "expected a finite number in displacement_m@0.0000, got inf"),
        ("1,0.007,700,-1e999", "expected a finite number in displacement_m@0.0000, got -inf"),
        ("1.5,0.007,700,1e-6", "expected a whole drop number from 1, got 1.5"),
        ("0,0.007,700,1e-6", "expected a whole drop number from 1, got 0"),
        ("1e9,0.007,700,1e-6", "expected a whole drop number from 1, got 1e"),
        ("1,0.00702,700,1e-6", "expected even time steps, each within 1 % of 0.001 s, got"),
        ("1,0.006,700,1e-6", "expected even time steps"),
        ("# a remark,0,0,0", "expected a number in drop, got '# a remark'"),
        ("  ", "expected 4 values, one per column, got 1"),
    ],
)
def test_a_bad_row_is_refused_with_its_line(write: Write, row: str, message: str) -> None:
    with pytest.raises(TraceError, match=f"point.csv, line 11: {message}"):
        read_traces(write(broken(7, row)))


def test_the_line_counts_blank_lines_too(write: Write) -> None:
    numbers = rows()
    numbers[3:3] = ["", ""]
    numbers[12] = "1,0.010,nan,0"
    with pytest.raises(TraceError, match="line 16: expected a finite number"):
        read_traces(write([*HEADER, NAMES, *numbers]))


SIXTEEN = "expected at least 16 samples"


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ([row.rsplit(",", 1)[0] for row in rows()], "4: expected 4 values, one per column, got 3"),
        ([*rows(count=30), *rows(count=40)[31:]], "34: expected even time steps.* step of 0.002"),
        ([*rows(1), *rows(2), *rows(1)], "44: expected the rows of a drop together, got drop 1"),
        ([], f"3: {SIXTEEN}, got 0"),
        (rows(count=15), f"3: {SIXTEEN}, got 15"),
        ([*rows(1), *rows(2, 3)], f"24: {SIXTEEN} in drop 2, got 3"),
    ],
)
def test_wrong_rows_are_refused_with_their_line(
    write: Write, numbers: list[str], message: str
) -> None:
    with pytest.raises(TraceError, match=f"line {message}"):
        read_traces(write([*HEADER, NAMES, *numbers]))


def test_steps_uneven_by_rounding_are_accepted(write: Write) -> None:
    numbers = [f"1,{index / 15000:.7f},{index},0" for index in range(100)]
    read_traces(write([*HEADER, NAMES, *numbers]))


def test_time_that_restarts_requires_a_drop_column(write: Write) -> None:
    numbers = [row.split(",", 1)[1] for row in [*rows(), *rows()]]
    with pytest.raises(
        TraceError, match=r"line 24: .*several drops in one file need a column drop"
    ):
        read_traces(write([*HEADER, NAMES.removeprefix("drop,"), *numbers]))


def test_16_samples_are_enough(write: Write) -> None:
    assert read_traces(write([*HEADER, NAMES, *rows(count=16)])).drops[0].time.size == 16


# No trace file at all


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "point.csv: expected a row of column names, got the end of the file"),
        (b"# pfwd-traces = 1\n", "expected a row of column names, got the end of the file"),
        (bytes(range(256)) * 40, "expected UTF-8 text"),
        (b"\0" * 100, "line 1: expected a line of text, got binary data"),
        (b"\x89PNG\r\n\x1a\n" + b"\0\1\2" * 100, "expected UTF-8 text"),
        ("\n".join(HEADER).encode("utf-16"), "expected UTF-8 text"),
        (b"x" * 100_000, "line 1: expected a line of text, got binary data"),
    ],
)
def test_binary_data_is_rejected(write: Write, data: bytes, message: str) -> None:
    with pytest.raises(TraceError, match=message):
        read_traces(write(data))


@pytest.mark.parametrize(
    "rubbish", [b"1,0.02,\xff\xfe,0\n", b"1,0.02,1\0,0\n", "1,0.02,١,0\n".encode()]
)
def test_rubbish_among_the_numbers_is_refused(write: Write, rubbish: bytes) -> None:
    text = "\n".join([*HEADER, NAMES, *rows(), ""]).encode()
    with pytest.raises(TraceError, match=r"point\.csv.*: expected (UTF-8|a line of) text"):
        read_traces(write(text + rubbish))


def test_a_missing_file_and_a_folder_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as missing:
        (tmp_path / "none.csv").stat()
    for path, message in (("none.csv", missing.value.strerror or ""), (".", "got a folder")):
        with pytest.raises(TraceError, match=message):
            read_traces(tmp_path / path)


@pytest.mark.posix
def test_a_pipe_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(TraceError, match="got a device or pipe"):
        read_traces(tmp_path / "pipe")


def test_a_file_that_may_not_be_read_is_refused(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    def denied(*_: object, **__: object) -> None:  # a superuser may read whatever chmod says
        raise PermissionError(13, "Permission denied")

    path = write([*HEADER, NAMES, *rows()])
    monkeypatch.setattr("builtins.open", denied)
    with pytest.raises(TraceError, match="expected a readable trace file, got Permission denied"):
        read_traces(path)


@pytest.mark.timeout(5)
def test_a_huge_file_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "huge.csv"
    with open(path, "wb") as stream:
        stream.truncate(2_000_000_000)
    with pytest.raises(TraceError, match=r"expected at most 500 MB, got 2000\.0 MB"):
        read_traces(path)


def test_a_message_is_a_printable_line(write: Write) -> None:
    line = "# x = \x1b[31m" + 300 * "y"
    with pytest.raises(TraceError) as caught:
        read_traces(write([*HEADER, line, NAMES, *rows()]))
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 400
    assert isinstance(caught.value, SurveyError)


# Limits of the size of files, beyond the files of all instruments


def table(number_rows: int, line: str = "0,0,0") -> list[str]:
    return [*HEADER, "time_s,load_N,velocity_m_s@0.0", *[line] * number_rows]


DROPS = [f"{n},{t / 1000},0,0" for n in (1, 2, 3) for t in range(16)]


@pytest.mark.parametrize(
    ("name", "limit", "lines", "message"),
    [
        ("MAX_FILE_NUMBERS", 300, table(200), "at most 300 numbers, got over 203 lines of 3"),
        ("MAX_FILE_DROPS", 2, [*HEADER, NAMES, *DROPS], "at most 2 drops, got 3"),
        ("LARGEST_TOML", 60, table(20), "line 3: expected a header of at most 60 characters"),
        (
            None,
            0,
            table(1, "1," * 100_000),
            "line 4: expected the end of a line, got none in 65536",
        ),
    ],
)
def test_the_size_of_a_trace_file_is_limited(
    write: Write,
    monkeypatch: pytest.MonkeyPatch,
    name: str | None,
    limit: int,
    lines: list[str],
    message: str,
) -> None:
    if name is not None:
        monkeypatch.setattr(traces, name, limit)
    with pytest.raises(TraceError, match=message):
        read_traces(write(lines))


@pytest.mark.parametrize("row", [0, 4095, 4096, 9000])
def test_a_bad_line_is_named_by_its_number(row: int, write: Write) -> None:
    lines = [f"{n / 1000},0,0" for n in range(10_000)]
    for bad, match in (("0,x,0", "expected a number in load_N"), ("0,0", "expected 3 values")):
        changed = [*lines[:row], bad, *lines[row + 1 :]]
        with pytest.raises(TraceError, match=f"line {row + 4}: {match}"):
            read_traces(write([*table(0), *changed]))


def test_json_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    assert payload.decode_json('{"a": [1, 2]}') == {"a": [1, 2]}
    monkeypatch.setattr(payload, "MAX_JSON_VALUES", 3)
    for text in ('{"a": [1, 2]}', b'{"a": [1, 2]}'):
        with pytest.raises(RecordingError, match="at most 3 values, got 4"):
            payload.decode_json(text)
    monkeypatch.setattr(payload, "MAX_JSON_BYTES", 3)
    with pytest.raises(RecordingError, match="at most 3 bytes, got 4"):
        payload.decode_json("1234")
    with pytest.raises(RecordingError, match="at most 3 bytes"):  # nor is it written
        payload.encode_payload({"a": 1})


def test_members_of_an_archive_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.dynz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name in ("a", "b"):
            file.writestr(name, bytes(1000))
    monkeypatch.setattr(archive, "MAX_ARCHIVE_BYTES", 1500)
    with archive.Archive(str(path)) as opened:
        assert len(opened.read("a")) == 1000
        with pytest.raises(TraceError, match="got more"):
            opened.read("b")
    monkeypatch.setattr(archive, "MAX_DIRECTORY_BYTES", 90)
    with pytest.raises(TraceError, match="a list of members of"):
        archive.Archive(str(path))


def test_repeated_names_become_distinct() -> None:
    names = [f"a ({n})" for n in range(2, 300)] + ["a"] * 300
    distinct = distinct_names(names)
    assert len(set(distinct)) == len(names)
    assert distinct[:298] == names[:298]
    assert distinct[298:301] == ["a", "a (300)", "a (301)"]


def test_a_number_that_python_does_not_write_is_quoted() -> None:
    assert quote([16**5000]) == "a number of thousands of digits"


def test_keys_have_the_lines_where_they_stand() -> None:
    text = "a = 1\n\n  'b c' = 2\n\"d\" = 3\nf.g = 4\n[e]\n"
    distinct = {key: declaration.where for key, declaration in parse_header(text, "h.toml").items()}
    lines = {key: where.removeprefix("h.toml") for key, where in distinct.items()}
    assert lines == {"a": ", line 1", "b c": ", line 3", "d": ", line 4", "e": "", "f": ", line 5"}
