"""Ledger and journal read side by side say what a look at every record says, or nothing."""

import json
import shutil
import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd_device.recording import SurveyWriter, agreement, check, read_survey, recover
from pfwd_device.recording import index as index_module
from pfwd_device.recording.agreement import (
    InconsistentRecords,
    ledger_columns,
    parse_common_file,
    parse_common_rebound,
    verified_records,
)
from pfwd_device.recording.framing import HEADER, Kind, encode_frame, scan_bytes
from pfwd_device.recording.index import build_index, read_index
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.ledger import Entry, ledger_bytes, parse_ledger
from pfwd_device.recording.payload import encode_json, encode_payload, payload_data
from pfwd_device.recording.publishing import InlinePublisher
from pfwd_device.recording.storage import Storage
from pfwd_device.recording.survey_reader import Survey
from tests.pfwd_device.recording.test_reading_many import record

ME = bytes(range(16))

entries = st.lists(
    st.builds(
        Entry,
        st.integers(0, 10**18 - 1),
        st.integers(0, 10**9 - 1),
        st.integers(0, 10**9 - 1),
        st.integers(0, 10**18 - 1),
        st.integers(0, 10**9 - 1),
        st.integers(0, 2**32 - 1),
        st.text(st.characters(min_codepoint=33, max_codepoint=126), min_size=1, max_size=999),
    ),
    max_size=6,
)


@given(entries=entries)
def test_the_columns_of_a_ledger_are_its_lines(entries: list[Entry]) -> None:
    data = ledger_bytes(ME, entries)
    columns, lines = ledger_columns(data), parse_ledger(data)
    assert (columns.survey, columns.entries) == (lines.survey, lines.entries) == (ME, (*entries,))
    for number, row in enumerate(columns.numbers.T.tolist()):
        assert tuple(row) == entries[number][:6]


@settings(max_examples=300)
@given(entries=entries, data=st.data())
def test_a_ledger_that_is_not_whole_is_never_taken_for_one(
    entries: list[Entry], data: st.DataObject
) -> None:
    text = bytearray(ledger_bytes(ME, entries))
    at = data.draw(st.integers(0, len(text) - 1))
    match data.draw(st.sampled_from(["flip", "cut", "insert", "double"])):
        case "flip":
            text[at] ^= data.draw(st.integers(1, 255))
        case "cut":
            del text[at]
        case "insert":
            text[at:at] = data.draw(st.binary(min_size=1, max_size=30))
        case _:
            text += text[at:]
    try:
        columns = ledger_columns(bytes(text))
    except InconsistentRecords:
        return
    lines = parse_ledger(bytes(text))
    assert (columns.survey, columns.entries, ()) == (lines.survey, lines.entries, lines.damaged)


@given(text=st.binary(max_size=200))
def test_any_bytes_are_a_ledger_or_a_disagreement(text: bytes) -> None:
    for data in (text, ledger_bytes(ME, []) + text, ledger_bytes(ME, []) + text + b"\n"):
        try:
            columns = ledger_columns(data)
        except InconsistentRecords:
            continue
        assert columns.entries == parse_ledger(data).entries
        assert not parse_ledger(data).damaged


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("agreement") / "survey", 3)


@pytest.fixture
def copy(survey: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(survey, tmp_path / "copy"))


def compared(folder: Path) -> list[int]:
    layout = Layout(folder)
    columns = ledger_columns(layout.ledger.read_bytes())
    return [found.entry.sequence for found in verified_records(layout, columns)]  # type: ignore[union-attr]


def test_a_flipped_bit_anywhere_in_the_journal_is_a_disagreement(copy: Path) -> None:
    path = copy / "journal" / "0001.pfwdj"
    whole = path.read_bytes()
    assert compared(copy) == list(range(1, len(read_index(Layout(copy)).entries) + 1))
    # Every byte of the headers, and every seventh of the rest.
    heads = {at + n for f in scan_bytes(whole)[0] for at in [f.offset] for n in range(HEADER.size)}
    for at in sorted(heads | set(range(0, len(whole), 7))):
        broken = bytearray(whole)
        broken[at] ^= 4
        path.write_bytes(broken)
        with pytest.raises(InconsistentRecords):
            compared(copy)
    for at in range(1, len(whole), 101):
        path.write_bytes(whole[:at])
        with pytest.raises(InconsistentRecords):
            compared(copy)
    path.write_bytes(whole + b"torn")
    with pytest.raises(InconsistentRecords):
        compared(copy)


def test_a_record_longer_than_what_is_looked_at_at_once(
    copy: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = compared(copy)
    for size in (1, HEADER.size, 1000, 10_000):
        monkeypatch.setattr(agreement, "_BLOCK_BYTES", size)
        assert compared(copy) == expected


def rewritten(folder: Path, change: Any) -> None:
    """Journal and ledger with other payloads, everything else as a writer makes it."""
    layout = Layout(folder)
    path = layout.segment(1)
    frames, _ = scan_bytes(path.read_bytes())
    survey, whole, entries = frames[0].identity, b"", []
    abouts = {
        entry.sequence: entry.about for entry in parse_ledger(layout.ledger.read_bytes()).entries
    }
    for frame in frames:
        data = encode_frame(frame.kind, survey, frame.sequence, change(frame))
        check = int.from_bytes(data[44:48], "little")
        about = abouts[frame.sequence]
        entries.append(Entry(frame.sequence, frame.kind, 1, len(whole), len(data), check, about))
        whole += data
    path.write_bytes(whole)
    layout.ledger.write_bytes(ledger_bytes(survey, entries))


def test_what_recovery_and_check_say_rests_on_every_record(copy: Path) -> None:
    """A record whose end is as usual and whose rest is no JSON: nobody but a stranger writes it."""

    def change(frame: Any) -> bytes:
        if frame.kind == Kind.FILE and b"drop-000001-1" in frame.payload:
            return bytes(frame.payload.replace(b"modulus_pa", b"modulus\x01pa", 1))
        return bytes(frame.payload)

    assert check(copy).ok
    rewritten(copy, change)
    layout = Layout(copy)
    assert build_index(layout).strange
    assert not read_index(layout).strange  # only what follows the result was looked at
    assert not check(copy).ok
    report = recover(copy, publisher=InlinePublisher(Storage()))
    assert any("drop-000001-1.json" in text for text in report.actions)
    assert check(copy).ok


numbers = st.integers(1, 10**9 - 1)
texts = st.text(max_size=60)


@given(
    number=numbers,
    delay=st.floats(),
    peak=st.floats(),
    first=st.integers(-5, 10**18),
    change=st.sampled_from(["", "pack", "more"]),
)
def test_the_number_of_a_rebound_is_that_of_its_json(
    number: int, delay: float, peak: float, first: int, change: str
) -> None:
    import numpy as np

    data = {"number": number, "delay": delay, "peak_load": peak, "first_sample": first}
    if change == "more":
        data["key"] = 7
    counts = np.zeros((3, 2), np.int32)
    payload = encode_payload(data, {"counts": counts}, pack=change == "pack")
    found = parse_common_rebound(memoryview(payload))
    assert found in (None, number)
    usual = np.isfinite([delay, peak]).all() and 0 <= first < 10**18 and change != "more"
    assert (found == number) == bool(usual)


@given(
    number=st.none() | numbers,
    size=st.integers(0, 10**15 - 1),
    content=st.none() | texts | st.just('","number":3,"path":"results/x"'),
)
def test_the_facts_of_a_file_are_those_of_its_json(
    number: int | None, size: int, content: str | None
) -> None:
    data = {
        "path": "results/drop-000001-1.json",
        "size": size,
        "sha256": "0f" * 32,
        "number": number,
        "time_utc": "2026-11-22T12:04:50.479Z",
    }
    if content is not None:
        data["content"] = content
    payload = encode_payload(data)
    facts = parse_common_file(memoryview(payload))
    expected = (data["path"], size, data["sha256"], number)
    # A text that ends in a backslash, or in nothing, is left to JSON.
    assert facts == expected or (facts is None and content is not None)
    if content is not None and not encode_json(content).endswith(('\\\\"', '""')):
        assert facts == expected
    said = payload_data(payload)
    assert (said["path"], said["size"], said["sha256"], said["number"]) == expected


@given(payload=st.binary(max_size=80))
def test_other_payloads_are_left_to_json(payload: bytes) -> None:
    for data in (payload, struct.pack("<I", len(payload)) + payload):
        assert parse_common_file(memoryview(data)) is None
        assert parse_common_rebound(memoryview(data)) is None


def test_numbers_that_json_does_not_know_are_left_to_it() -> None:
    usual = (
        b'{"arrays":[{"dtype":"<i4","name":"counts","shape":[3,2]}],"data":{"delay":0.5,'
        b'"first_sample":7,"number":12,"peak_load":3.5},"packed":true}'
    )
    assert json.loads(usual)
    assert parse_common_rebound(memoryview(struct.pack("<I", len(usual)) + usual)) == 12
    for wrong in (b'"number":012', b'"number":-1', b'"number":1e3', b'"number": 12'):
        text = usual.replace(b'"number":12', wrong)
        assert parse_common_rebound(memoryview(struct.pack("<I", len(text)) + text)) is None
    assert parse_common_rebound(memoryview(struct.pack("<I", len(usual) - 1) + usual)) is None


@pytest.fixture
def readings(monkeypatch: pytest.MonkeyPatch) -> list[Layout]:
    found: list[Layout] = []
    for module in ("survey_reader", "survey_writer", "recovery"):

        def noted(layout: Layout) -> object:
            found.append(layout)
            return index_module.read_index(layout)

        monkeypatch.setattr(f"pfwd_device.recording.{module}.read_index", noted)
    return found


def opened(folder: Path, known: Survey) -> SurveyWriter:
    helper = InlinePublisher(Storage())
    return SurveyWriter.open(folder, publish=False, publisher=helper, already_read=known)


def test_a_survey_that_was_read_just_now_is_not_read_again(
    copy: Path, readings: list[Layout]
) -> None:
    known = read_survey(copy)
    assert len(readings) == 1
    with opened(copy, known) as writer:
        writer.edit("note", "wet", number=2)
        assert writer.contents().drops[1].notes[-1] == "wet"
    assert len(readings) == 1
    assert read_survey(copy).drops[1].notes[-1] == "wet"
    assert check(copy).ok


def test_a_survey_that_was_written_to_since_is_read_again(
    copy: Path, readings: list[Layout]
) -> None:
    known = read_survey(copy)
    with opened(copy, read_survey(copy)) as writer:
        writer.edit("note", "said by another program", number=1)
    readings.clear()
    with opened(copy, known) as writer:
        assert writer.contents().drops[0].notes[-1] == "said by another program"
        writer.edit("note", "wet", number=2)
    assert len(readings) == 1
    assert check(copy).ok


def test_a_journal_damaged_since_is_read_again(copy: Path, readings: list[Layout]) -> None:
    known = read_survey(copy)
    path = copy / "journal" / "0001.pfwdj"
    damaged = bytearray(path.read_bytes())
    damaged[-20] ^= 1
    with path.open("r+b") as stream:  # the same file, of the same length
        stream.write(damaged)
    readings.clear()
    with opened(copy, known):
        assert len(readings) == 1


def test_another_survey_is_not_taken_for_it(
    copy: Path, survey: Path, readings: list[Layout]
) -> None:
    known = read_survey(survey)
    readings.clear()
    with opened(copy, known):
        assert len(readings) == 1
