"""Limits of the size of files, beyond the files of all instruments."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest

from pfwd.errors import TraceError, quote
from pfwd.files import traces
from pfwd.files.foreign import archive
from pfwd.files.foreign.common import distinct_names
from pfwd.files.header import parse_header
from pfwd.files.traces import read_traces
from pfwd_device.errors import RecordingError
from pfwd_device.recording import payload

Write = Callable[..., Path]


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
