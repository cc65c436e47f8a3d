"""The ledger: every line is checked, and any bytes are read without an error."""

import zlib
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from pfwd_device.errors import StorageFull
from pfwd_device.recording import check, ledger, read_survey
from pfwd_device.recording.framing import RecordKind
from pfwd_device.recording.ledger import (
    MAX_LEDGER_BYTES,
    Entry,
    LedgerWriter,
    about_drop,
    ledger_bytes,
    parse_ledger,
    read_ledger,
)
from tests.campaigns.noted_disk import NotingStorage
from tests.pfwd_device.recording.records import open_survey, record_of

ME = bytes(range(16))
ENTRIES = [
    Entry(1, 1, 1, 0, 90, 0xABC),
    Entry(2, 3, 1, 90, 700, 0xFFFFFFFF, about_drop(1, "A ü/1", 1)),
]


def test_lines_come_back() -> None:
    parsed = parse_ledger(ledger_bytes(ME, ENTRIES))
    assert parsed.survey == ME
    assert list(parsed.entries) == ENTRIES
    assert parsed.damaged == ()
    assert parsed.entries[1].drop == (1, "A ü/1", 1)
    assert parsed.entries[0].drop is None


def test_every_flipped_bit_is_detected() -> None:
    data = ledger_bytes(ME, ENTRIES)
    for bit in range(8 * len(data)):
        broken = bytearray(data)
        broken[bit // 8] ^= 1 << bit % 8
        assert parse_ledger(bytes(broken)).damaged


def test_a_cut_within_a_line_is_detected() -> None:
    data = ledger_bytes(ME, ENTRIES)
    ends = [0, *(index + 1 for index, byte in enumerate(data) if byte == 10)]
    for size in range(len(data)):
        parsed = parse_ledger(data[:size])
        assert bool(parsed.damaged) == (size not in ends[1:])


@given(st.binary(max_size=300))
def test_any_bytes_are_read(data: bytes) -> None:
    parse_ledger(data)


def test_a_missing_ledger_is_reported(tmp_path: Path) -> None:
    assert read_ledger(tmp_path / "none").missing
    assert read_ledger(tmp_path).damaged == (1,)


NUMBERS = st.from_regex(r"0{0,2}[0-9]{1,12}", fullmatch=True)


@settings(max_examples=50)
@example(["07", "3", "1", "9", "9"], "0000000a", "-", True)
@example(["7", "03", "1", "9", "9"], "0000000a", "-", True)
@example(["7", "3", "01", "9", "9"], "0000000a", "-", True)
@example(["7", "3", "1", "09", "9"], "0000000a", "-", True)
@example(["7", "3", "1", "9", "09"], "0000000a", "-", True)
@example(["7", "3", "0", "0", "0"], "0000000a", "-", True)
@example(["7", "3", "1", "9", "9"], "0000000A", "-", True)
@example(["7", "3", "1", "9", "9"], "0000000a", "-", False)
@given(
    numbers=st.lists(NUMBERS, min_size=5, max_size=5),
    check=st.from_regex(r"[0-9a-fA-F]{8}", fullmatch=True),
    about=st.sampled_from(["-", "1:A/1", "", "a b", "\x7f", "~" * 1000]),
    seal=st.booleans(),
)
def test_a_line_is_accepted_if_its_entry_writes_the_same(
    numbers: list[str], check: str, about: str, seal: bool
) -> None:
    text = f"{' '.join(numbers)} {check} {about}"
    line = f"{text} {zlib.crc32(text.encode()) if seal else 0:08x}\n".encode()
    sequence, kind, segment, offset, length = map(int, numbers)
    entry = Entry(sequence, kind, segment, offset, length, int(check, 16), about)
    limits = max(sequence, offset) < 10**18 and max(kind, segment, length) < 10**9
    good = entry.line() == line and limits and about in ("-", "1:A/1")
    assert parse_ledger(line).entries == ((entry,) if good else ())


@pytest.mark.parametrize("call", ["write", "sync"])
def test_after_a_failure_the_next_line_follows_an_intact_ledger(tmp_path: Path, call: str) -> None:
    failing = False
    writes = 0

    def fault(name: str, _: int) -> OSError | int | None:
        nonlocal writes
        if not failing:
            return None
        writes += name == "write"
        if call == "write" and name == "write" and writes == 1:
            return 3  # the disk takes a little, then nothing, and cannot even be cut back
        if name in (call, "truncate"):
            return OSError(5, "input/output error")
        return None

    path = tmp_path / "acknowledged.txt"
    writer = LedgerWriter(path, ME, [], NotingStorage(tmp_path, fault))
    writer.append(ENTRIES[0])
    failing = True
    with pytest.raises(OSError, match="input/output"):
        writer.append(ENTRIES[1])
    assert path.read_bytes() != ledger_bytes(ME, ENTRIES[:1])
    failing = False
    writer.append(ENTRIES[1])
    writer.close()
    assert path.read_bytes() == ledger_bytes(ME, ENTRIES)


def test_a_torn_long_line_leaves_no_bytes_behind_a_short_line(tmp_path: Path) -> None:
    remaining: list[int] = []

    def fault(name: str, _: int) -> OSError | int | None:
        if not remaining or name != "write":
            return None
        return remaining.pop() or OSError(28, "no space")

    path = tmp_path / "acknowledged.txt"
    writer = LedgerWriter(path, ME, [], NotingStorage(tmp_path, fault))
    writer.append(ENTRIES[0])
    remaining.extend([0, 45])  # 45 bytes, then nothing
    with pytest.raises(OSError, match="no space"):
        writer.append(ENTRIES[1])
    assert path.read_bytes() == ledger_bytes(ME, ENTRIES[:1])
    writer.append(Entry(2, 1, 1, 90, 9, 1))
    writer.close()
    assert path.read_bytes() == ledger_bytes(ME, [ENTRIES[0], Entry(2, 1, 1, 90, 9, 1)])


def test_a_full_ledger_accepts_no_line(survey: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with open_survey(survey) as writer:
        writer.save_drop(record_of(1))
        size = (survey / "acknowledged.txt").stat().st_size
        monkeypatch.setattr(ledger, "MAX_LEDGER_BYTES", size + 10)
        with pytest.raises(StorageFull, match="begin another survey"):
            writer.save_drop(record_of(2))
        monkeypatch.undo()
        assert writer.save_drop(record_of(2)) == 2
    assert check(survey).ok


def test_a_thousand_lost_records_are_reported_in_a_line(survey: Path) -> None:
    with open_survey(survey) as writer:
        identity = bytes.fromhex(writer.survey_id)
    path = survey / "acknowledged.txt"
    more = [Entry(n, RecordKind.EDIT, 1, 10**6 + n, 50, 7) for n in range(10, 1100)]
    drop = Entry(1100, RecordKind.DROP, 1, 10**8, 50, 7, "1:P%201/4")
    lines = (*parse_ledger(path.read_bytes()).entries, *more, drop)
    path.write_bytes(ledger_bytes(identity, lines))
    damage = read_survey(survey).damage
    assert "1090 records between 10 and 1099 are lost" in damage
    assert "drop P 1/4 is lost" in damage
    assert len(damage) < 5
    assert damage == tuple(text for text in check(survey).damaged if "lost" in text)


def writer(path: Path, entries: list[Entry]) -> tuple[LedgerWriter, NotingStorage]:
    """A ledger that is in place, and what is done to the disk from here on."""
    path.write_bytes(ledger_bytes(ME, entries))
    storage = NotingStorage(path.parent)
    return LedgerWriter(path, ME, list(entries), storage), storage


NEXT = Entry(3, 4, 1, 790, 60, 0x1234)


def test_a_ledger_that_is_in_place_is_appended_to(tmp_path: Path) -> None:
    ledger, storage = writer(tmp_path / "acknowledged.txt", ENTRIES)
    ledger.append(NEXT)
    ledger.close()
    assert read_ledger(tmp_path / "acknowledged.txt").entries == (*ENTRIES, NEXT)
    assert [note[0] for note in storage.notes] == ["write", "sync"], "nothing is written anew"


def test_a_ledger_with_different_lines_is_rewritten(tmp_path: Path) -> None:
    path = tmp_path / "acknowledged.txt"
    ledger, storage = writer(path, ENTRIES)
    path.write_bytes(ledger_bytes(ME, ENTRIES[:1]) + b"1 2 3\n")
    ledger.append(NEXT)
    ledger.close()
    assert read_ledger(path).entries == (*ENTRIES, NEXT)
    assert read_ledger(path).damaged == ()
    assert "replace" in [note[0] for note in storage.notes]


def test_a_forgotten_record_has_no_line(tmp_path: Path) -> None:
    path = tmp_path / "acknowledged.txt"
    ledger, _ = writer(path, [*ENTRIES, NEXT])
    ledger.forget(2)
    assert ledger.entries == (ENTRIES[0],)
    assert ledger.problem() is None
    second = Entry(2, 3, 2, 0, 500, 7)
    ledger.append(second)
    assert read_ledger(path).entries == (ENTRIES[0], second)
    assert ledger.problem() is None
    path.write_bytes(b"")
    assert ledger.problem() is not None, "others do not find the lines"
    ledger.close()


def test_an_oversized_ledger_is_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "acknowledged.txt"
    path.write_bytes(ledger_bytes(ME, ENTRIES))
    assert MAX_LEDGER_BYTES == 24 * 2**20
    monkeypatch.setattr("os.path.getsize", lambda _: MAX_LEDGER_BYTES)
    assert read_ledger(path).entries == tuple(ENTRIES)
    monkeypatch.setattr("os.path.getsize", lambda _: MAX_LEDGER_BYTES + 1)
    assert read_ledger(path).damaged == (1,)
