"""A second encoder of the binary protocol, written from docs/protocol.md alone.

It shares nothing with the project's own: the CRC goes bit by bit, COBS byte by byte as in the
paper. It also reads the hex dumps of the document, so that document, encoder and decoder are three
witnesses.
"""

import re
import struct
from pathlib import Path

DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "protocol.md"


def crc32(data: bytes) -> int:
    register = 0xFFFFFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = (register >> 1) ^ (0xEDB88320 if register & 1 else 0)
    return register ^ 0xFFFFFFFF


def cobs(data: bytes) -> bytes:
    out = bytearray([0])
    code_at, code = 0, 1
    for position, byte in enumerate(data):
        if byte:
            out.append(byte)
            code += 1
        full = code == 255 and position + 1 < len(data)
        if not byte or full:
            out[code_at] = code
            code_at, code = len(out), 1
            out.append(0)
    out[code_at] = code
    return bytes(out)


def uncobs(data: bytes) -> bytes:
    out = bytearray()
    at = 0
    while at < len(data):
        code = data[at]
        out += data[at + 1 : at + code]
        at += code
        if code < 255 and at < len(data):
            out.append(0)
    return bytes(out)


def u(value: int, size: int) -> bytes:
    """Unsigned, or negative as two's complement, lowest byte first."""
    return bytes(value >> 8 * at & 0xFF for at in range(size))


def f64(value: float) -> bytes:
    return struct.pack("<d", value)


def f32(value: float) -> bytes:
    return struct.pack("<f", value)


def txt(value: str) -> bytes:
    data = value.encode("utf-8")
    return bytes([len(data)]) + data


def packet(type_: int, counter: int, payload: bytes) -> bytes:
    head = bytes([type_]) + u(counter, 2) + payload
    return head + u(crc32(head), 4)


def frame(type_: int, counter: int, payload: bytes) -> bytes:
    return cobs(packet(type_, counter, payload)) + b"\0"


def samples(stream: int, first: int, clock: int, rows: list[list[int]], flags: int = 0) -> bytes:
    head = u(stream, 4) + u(first, 8) + u(clock, 8) + u(flags, 1) + u(len(rows[0]), 1)
    return head + u(len(rows), 2) + b"".join(u(value, 3) for row in rows for value in row)


LOAD = (
    txt("load")
    + u(1, 1)
    + b"".join(map(f64, [0.0, 1e-4, 0.05, float("nan"), float("nan"), 5000.0]))
    + u(20260131, 4)
    + u(20270131, 4)
)
CENTRE = (
    txt("centre")
    + u(2, 1)
    + b"".join(map(f64, [0.0, -28.8, 0.0, 4.5, 0.56, float("nan")]))
    + u(20260131, 4)
    + u(0, 4)
)
IDENTITY = (
    u(2, 1)
    + txt("PFWD-0001")
    + txt("Example")
    + txt("1.4.2")
    + f64(10_000.0)
    + u(24, 1)
    + b"".join(map(f64, [2.5, 0.15, 10.6]))
    + u(0, 1)
    + u(2, 1)
    + LOAD
    + CENTRE
    + u(20_000, 4)
    + u(4000, 4)
    + u(4, 2)
    + u(3, 1)
)
ROWS = [[0, -1], [1000, -70000], [8388607, -8388608]]
NAME = u(0x1234ABCD, 4) + u(300, 8)
TRIGGER = u(1, 1) + u(0, 1) + u(2622, 4) + u(3, 2) + u(200, 4) + u(1000, 4) + u(15000, 4)
COUNTS = b"".join(u(value, 3) for row in ROWS for value in row)
OFFER = (
    NAME
    + u(1_029_900, 8)
    + u(1, 4)
    + u(3, 4)
    + u(2, 1)
    + u(0, 1)
    + u(40, 2)
    + u(crc32(COUNTS), 4)
    + f64(10_000.0)
)
EXAMPLES = {
    "Hello": (0x01, 0, b"PFWD" + u(2, 1) + u(2, 1)),
    "Configure": (0x02, 1, f64(20_000.0)),
    "Start": (0x03, 2, b""),
    "Stop": (0x04, 3, b""),
    "Shunt": (0x05, 4, u(1, 1)),
    "Identity": (0x81, 0, IDENTITY),
    "Samples": (0x82, 1, samples(0x1234ABCD, 300, 1_030_000, ROWS)),
    "Status": (
        0x83,
        2,
        u(1_500_000, 8) + f32(12.5) + f32(-3.25) + u(7, 8) + u(1, 1) + u(2, 2) + u(1, 4),
    ),
    "Event": (0x84, 3, u(2, 2) + u(1_600_000, 8) + txt("button")),
    "Refusal": (0x85, 4, u(3, 2) + txt("sampling rate up to 10000 Hz")),
    "Arm": (0x06, 5, TRIGGER),
    "Fetch": (0x07, 6, NAME + u(7, 2) + u(1, 2)),
    "Acknowledge": (0x08, 7, NAME),
    "Resend": (0x09, 8, NAME + u(50, 4)),
    "Calibrate": (
        0x0A,
        9,
        u(1, 1)
        + b"".join(map(f64, [-27.9, 0.001, 4.6, 0.58, float("nan")]))
        + u(20260131, 4)
        + u(0, 4)
        + txt("PFWD-0002"),
    ),
    "Armed": (0x86, 7, TRIGGER),
    "Offer": (0x87, 8, OFFER),
    "Block": (0x88, 9, NAME + u(0, 2) + COUNTS),
    "Released": (0x89, 10, NAME),
    "Gone": (0x8A, 11, NAME + u(50, 4)),
}
"""Type, counter and payload of the frames that the document shows."""


def documented(name: str) -> tuple[bytes, bytes]:
    """The packet and the frame that the document shows as hex dumps."""
    text = DOCUMENT.read_text(encoding="utf-8")
    match = re.search(rf"^### Example: {name}$.*?```text\n(.*?)```", text, re.DOTALL | re.MULTILINE)
    assert match is not None, f"no example of {name} in {DOCUMENT.name}"
    parts = re.split(r"^(packet|frame):\n", match[1], flags=re.MULTILINE)
    dumps = {
        label: bytes.fromhex(
            " ".join(re.findall(r"^[0-9a-f]{4}  ((?:[0-9a-f]{2} ?)+)$", dump, re.M))
        )
        for label, dump in zip(parts[1::2], parts[2::2], strict=True)
    }
    return dumps["packet"], dumps["frame"]
