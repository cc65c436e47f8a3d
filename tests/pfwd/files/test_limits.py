"""What may be read of a file ends somewhere, beyond everything that instruments make."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from pfwd.errors import TraceError, quote
from pfwd.files import survey_file, traces
from pfwd.files.foreign import archive, rincent_xml
from pfwd.files.foreign.common import distinct_names
from pfwd.files.header import parse_header
from pfwd.files.traces import read_traces
from pfwd_device.errors import RecordingError
from pfwd_device.recording import drop_file, hdf5_tree, payload

Write = Callable[..., Path]


def test_limits_are_beyond_what_is_real() -> None:
    """Each number is derived once more from what instruments and surveys have."""
    long_drop = 10 * 50_000 * (2 * 8 + 8 * 8 + 9 * 4)  # 10 s at 50 kHz: times, 9 channels, counts
    assert 2 * long_drop < payload.MAX_ARRAY_BYTES <= 3 * long_drop
    survey = 10_000  # drops of a large survey: some 450 bytes and 30 signs of JSON of each
    assert 5 * survey * 450 < payload.MAX_JSON_BYTES
    assert 5 * survey * 30 < payload.MAX_JSON_VALUES
    # What a text may become in memory leaves room for the program itself.
    assert payload.MAX_JSON_VALUES * 100 + 3 * payload.MAX_JSON_BYTES < 400e6
    assert hdf5_tree.MAX_READ_BYTES >= payload.MAX_JSON_BYTES + 4096
    assert drop_file.MAX_DROP_FILE_BYTES >= payload.MAX_ARRAY_BYTES + payload.MAX_JSON_BYTES
    # The largest array in the chunks that are written.
    assert payload.MAX_ARRAY_BYTES / (65_536 * 4) <= hdf5_tree.MAX_CHUNKS
    assert hdf5_tree.MAX_CHUNK_BYTES >= 65_536 * 8
    assert drop_file.MAX_CALIBRATION_ATTRIBUTES + 10 < hdf5_tree.MAX_ATTRIBUTES
    assert hdf5_tree.MAX_MEMBERS > 1024
    assert 10 * survey * 160 <= survey_file.MAX_LIST_BYTES
    assert traces.MAX_FILE_NUMBERS >= 3 * 10 * 50_000 * 10
    assert traces.MAX_FILE_NUMBERS * 8 * 2 < 400e6
    assert traces.MAX_FILE_DROPS >= 100 * 10
    assert archive.MAX_ARCHIVE_BYTES > 1000 * 100_000
    assert archive.MAX_ARCHIVE_BYTES >= 2 * archive.MAX_MEMBER_BYTES
    assert archive.MAX_DIRECTORY_BYTES > 10 * 1000 * 100
    assert rincent_xml.MAX_XML_CELLS > 1000 * 10 * 20


def table(rows: int, line: str = "0,0,0") -> list[str]:
    return [
        "# pfwd-traces = 1",
        "# plate_radius_m = 0.15",
        "time_s,load_N,velocity_m_s@0.0",
        *[line] * rows,
    ]


def test_numbers_drops_header_and_lines_of_a_trace_file_end(
    write: Write, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(traces, "MAX_FILE_NUMBERS", 300)
    with pytest.raises(TraceError, match="expected at most 300 numbers, got over 203 lines of 3"):
        read_traces(write(table(200)))
    monkeypatch.undo()
    monkeypatch.setattr(traces, "MAX_FILE_DROPS", 2)
    rows = [f"{n},{t / 1000},0,0" for n in (1, 2, 3) for t in range(16)]
    lines = [*table(0)[:2], "drop," + table(0)[2], *rows]
    with pytest.raises(TraceError, match="expected at most 2 drops, got 3"):
        read_traces(write(lines))
    monkeypatch.undo()
    monkeypatch.setattr(traces, "LARGEST_TOML", 60)
    with pytest.raises(TraceError, match=r"line 3: expected a header of at most 60 characters"):
        read_traces(write(table(20)))
    monkeypatch.undo()
    with pytest.raises(TraceError, match=r"line 4: expected the end of a line, got none in 65536"):
        read_traces(write(table(1, "1," * 100_000)))


@pytest.mark.parametrize("row", [0, 4095, 4096, 9000])
def test_a_bad_line_is_found_among_many(row: int, write: Write) -> None:
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


def test_names_stay_distinct_however_many_came_before() -> None:
    names = [f"a ({n})" for n in range(2, 300)] + ["a"] * 300
    found = distinct_names(names)
    assert len(set(found)) == len(names)
    assert found[:298] == names[:298]
    assert found[298:301] == ["a", "a (300)", "a (301)"]


def test_a_number_that_python_does_not_write_is_quoted() -> None:
    assert quote([16**5000]) == "a number of thousands of digits"


def test_lines_of_keys_are_found_in_one_pass() -> None:
    text = "a = 1\n\n  'b c' = 2\n\"d\" = 3\nf.g = 4\n[e]\n"
    found = {key: said.where for key, said in parse_header(text, "h.toml").items()}
    lines = {key: where.removeprefix("h.toml") for key, where in found.items()}
    assert lines == {"a": ", line 1", "b c": ", line 3", "d": ", line 4", "e": "", "f": ", line 5"}
