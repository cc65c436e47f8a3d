"""Payloads: what goes in comes out bit by bit, and nothing else than RecordingError is raised."""

import contextlib
import json
import math
import struct
import zlib
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pfwd_device import Channel, Drop
from pfwd_device.errors import RecordingError
from pfwd_device.recording import DropRecord, ReboundRecord
from pfwd_device.recording.drop_file import drop_file_bytes, drop_from_file_bytes
from pfwd_device.recording.drop_payload import (
    drop_from_parts,
    drop_parts,
    rebound_from_payload,
    rebound_payload,
    with_rebounds,
)
from pfwd_device.recording.payload import decode_json, decode_payload, encode_payload, payload_data

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)
OBJECTS = st.dictionaries(st.text(), JSON, max_size=4)
# Every pattern of bits, hence every NaN.
FLOATS = hnp.arrays(np.uint64, 7).map(lambda bits: bits.view(np.float64))
COUNTS = st.integers(0, 4).flatmap(lambda k: hnp.arrays(np.int32, (7, k)))


def same_json(first: Any, second: Any) -> bool:
    return json.dumps(first, sort_keys=True) == json.dumps(second, sort_keys=True)


@given(OBJECTS, FLOATS, COUNTS, st.booleans())
def test_data_and_arrays_come_back_bit_by_bit(
    data: dict[str, Any], floats: Any, counts: Any, pack: bool
) -> None:
    payload = encode_payload(data, {"floats": floats, "counts": counts}, pack=pack)
    decoded, arrays = decode_payload(payload)
    assert same_json(decoded, data)
    assert same_json(payload_data(payload), data)
    assert arrays["floats"].tobytes() == floats.tobytes()
    assert arrays["counts"].shape == counts.shape
    assert arrays["counts"].dtype == np.int32
    assert arrays["counts"].tobytes() == counts.tobytes()
    assert encode_payload(decoded, arrays, pack=pack) == payload


@st.composite
def records(draw: st.DrawFn) -> DropRecord:
    channels = tuple(
        Channel(draw(st.floats(0, 3)), draw(st.sampled_from(["velocity", "displacement"])), values)
        for values in draw(st.lists(FLOATS, max_size=3))
    )
    rebounds = tuple(
        ReboundRecord(draw(st.floats()), draw(st.floats()), number, draw(COUNTS))
        for number in range(draw(st.integers(0, 2)))
    )
    return DropRecord(
        point=draw(st.text(min_size=1, max_size=20).filter(lambda text: text.strip() != "")),
        drop=Drop(draw(st.integers(1, 999)), draw(FLOATS), draw(FLOATS), channels),
        counts=draw(st.none() | COUNTS),
        declared=draw(OBJECTS),
        metadata=draw(OBJECTS),
        rebounds=rebounds,
    )


def bits(record: DropRecord) -> bytes:
    return encode_payload(*drop_parts(record), pack=False)


@settings(max_examples=40)
@given(records())
def test_a_drop_comes_back_from_its_record(record: DropRecord) -> None:
    data, arrays = decode_payload(encode_payload(*drop_parts(record)))
    decoded = drop_from_parts(data, arrays)
    assert bits(decoded) == bits(record)
    assert decoded.drop.load.tobytes() == record.drop.load.tobytes()
    assert (decoded.counts is None) == (record.counts is None)
    assert [c.quantity for c in decoded.drop.channels] == [c.quantity for c in record.drop.channels]
    assert [r.counts.tobytes() for r in decoded.rebounds] == [
        r.counts.tobytes() for r in record.rebounds
    ]


@settings(max_examples=40)
@given(records())
def test_a_drop_comes_back_from_its_file(record: DropRecord) -> None:
    data = drop_file_bytes(record, 17, bytes(range(16)))
    decoded, number, survey = drop_from_file_bytes(data, "file")
    assert (number, survey) == (17, bytes(range(16)))
    assert bits(decoded) == bits(record)
    assert decoded.point == record.point


def test_a_rebound_comes_back_and_is_joined_once() -> None:
    rebound = ReboundRecord(0.4, 900.0, 77, np.ones((5, 2), np.int32))
    decoded = rebound_from_payload(rebound_payload(3, rebound))
    assert (decoded.delay, decoded.peak_load, decoded.first_sample) == (0.4, 900.0, 77)
    base = DropRecord("P", Drop(1, np.arange(4.0), np.zeros(4), ()))
    once = with_rebounds(base, (decoded,))
    assert with_rebounds(once, (decoded,)).rebounds == once.rebounds
    assert len(once.rebounds) == 1


@given(st.binary(max_size=200))
def test_any_bytes_are_a_payload_or_refused(data: bytes) -> None:
    for decode in (decode_payload, payload_data, rebound_from_payload):
        with contextlib.suppress(RecordingError):
            decode(data)


@given(JSON, st.binary(max_size=40))
def test_any_json_is_a_payload_or_refused(head: Any, rest: bytes) -> None:
    text = json.dumps(head).encode()
    with contextlib.suppress(RecordingError):
        decode_payload(struct.pack("<I", len(text)) + text + rest)


def crafted(rest: bytes = b"", packed: bool = False, **array: Any) -> bytes:
    described = {"name": "a", "dtype": "<f8", "shape": [1]} | array
    text = json.dumps({"data": {}, "arrays": [described], "packed": packed}).encode()
    return struct.pack("<I", len(text)) + text + rest


@pytest.mark.parametrize(
    ("payload", "match"),
    [
        (crafted(bytes(7)), "arrays of 8 bytes, got 7"),
        (crafted(bytes(8), dtype="O"), "a name and one of"),
        (crafted(bytes(8), dtype=["<f8"]), "a name and one of"),
        (crafted(bytes(8), shape=[-1]), "another shape"),
        (crafted(bytes(8), shape=[True]), "another shape"),
        (crafted(bytes(8), shape=[1, 1, 1]), "another shape"),
        (crafted(bytes(8), shape=[2**27, 2**27]), "arrays of at most"),
        (crafted(zlib.compress(bytes(10**7)), packed=True), "compressed arrays of 8 bytes"),
        (crafted(zlib.compress(bytes(8)) + b"x", packed=True), "compressed arrays of 8 bytes"),
        (crafted(b"\x00", packed=True), "compressed arrays"),
        (struct.pack("<I", 9) + b"{}", "9 bytes of JSON"),
        (struct.pack("<I", 200_000) + b"[" * 200_000, "JSON"),
        (b"", "expected a payload"),
    ],
)
def test_crafted_payloads_are_refused(payload: bytes, match: str) -> None:
    with pytest.raises(RecordingError, match=match):
        decode_payload(payload)


def test_data_that_json_cannot_hold_are_refused() -> None:
    for data in ({"a": object()}, {1: 2, "b": 3}, {"a": {1, 2}}):
        with pytest.raises(RecordingError, match="expected texts, numbers"):
            encode_payload(data)  # type: ignore[arg-type]
    with pytest.raises(RecordingError, match="array a: expected one of"):
        encode_payload({}, {"a": np.zeros(2, np.float32)})


def test_numbers_of_numpy_and_infinity_are_stored() -> None:
    data = {"a": np.float64(0.1), "b": np.int64(3), "c": np.arange(2), "d": math.inf}
    assert payload_data(encode_payload(data)) == {"a": 0.1, "b": 3, "c": [0, 1], "d": math.inf}


def test_records_are_validated_and_read_only() -> None:
    drop = Drop(1, np.arange(4.0), np.zeros(4), ())
    assert DropRecord(" A\x1b[31m ", drop).point == "A\N{REPLACEMENT CHARACTER}[31m"
    for name in ("", "   ", "x" * 65):
        with pytest.raises(RecordingError, match="expected 1 to 64 characters"):
            DropRecord(name, drop)
    with pytest.raises(RecordingError, match=r"P/1: expected counts as integers"):
        DropRecord("P", drop, np.zeros((4, 1)))  # type: ignore[arg-type]
    with pytest.raises(RecordingError, match="expected counts of 32 bits"):
        DropRecord("P", drop, np.full((4, 1), 2**40))
    counts = np.zeros((4, 1), np.int32)
    record = DropRecord("P", drop, counts)
    counts[0] = 1
    assert record.counts[0] == 0
    with pytest.raises(ValueError, match="read-only"):
        record.counts[0] = 2


@pytest.mark.parametrize("pack", [True, False])
def test_unrequested_arrays_are_not_unpacked(pack: bool) -> None:
    arrays = {name: np.arange(500.0) + n for n, name in enumerate("abcd")}
    payload = encode_payload({"said": 1}, arrays, pack=pack)
    for names in ("", "a", "ac", "d", "abcd"):
        data, decoded = decode_payload(payload, names.__contains__)
        assert data == {"said": 1}
        assert list(decoded) == list(names)
        assert all(np.array_equal(decoded[name], arrays[name]) for name in names)
    with pytest.raises(RecordingError, match=r"expected (compressed )?arrays"):
        decode_payload(payload[: -len(payload) // 2], "abc".__contains__)


@pytest.mark.parametrize(
    "change",
    [
        {"sensors": 3},
        {"sensors": [[0.0]]},
        {"rebounds": None},
        {"declared": []},
        {"point": 7},
        {"drop": "1"},
        {"metadata": "x"},
    ],
)
def test_data_of_another_kind_are_no_drop(change: dict[str, Any]) -> None:
    array = np.zeros(4)
    sound = {
        "point": "P",
        "drop": 1,
        "sensors": [[0.0, "velocity"]],
        "rebounds": [],
        "declared": {},
        "metadata": {},
    }
    arrays = {"time": np.arange(4.0), "load": array, "sensor 1": array}
    assert drop_from_parts(sound, arrays).point == "P"
    with pytest.raises(RecordingError):
        drop_from_parts(sound | change, arrays)
    for key in sound:
        with pytest.raises(RecordingError, match="expected the data of a drop, got other data"):
            drop_from_parts({k: v for k, v in sound.items() if k != key}, arrays)


@given(
    JSON, *(st.sampled_from([b"", b" ", b"\n", b"\r\n\t ", b"\x0b", b"\x00", b"\xa0", b"1"]),) * 2
)
def test_json_between_blanks_is_read_as_python_does(data: Any, before: bytes, after: bytes) -> None:
    text = before + json.dumps(data).encode() + after
    try:
        expected = json.loads(text)
    except ValueError:
        with pytest.raises(RecordingError, match="expected JSON"):
            decode_json(text)
        return
    assert repr(decode_json(text)) == repr(expected)
