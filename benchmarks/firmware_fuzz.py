"""Fuzzing of the firmware's core by libFuzzer, with its two sanitizers."""

import random
import shutil
import struct
import subprocess
import tempfile
from pathlib import Path

from simulators.firmware import COMPILER_FLAGS, FirmwareError, core_sources, firmware_folder

_FRAMED, _LETTERS = 1, "BTLPRWEDNT"
"""A first byte below 128 starts a message that is put into a frame; other bytes select one of these
steps of the test program."""
LONGEST_INPUT = 4000


def fuzz(seconds: int, folder: Path | None = None) -> tuple[bool, int, str]:
    """Fuzz the core for a number of seconds.

    Returns
    -------
    bool, int, str
        True without errors, the number of inputs, and the first errors.

    Raises
    ------
    FirmwareError
        If there is no clang with libFuzzer.
    """
    clang = shutil.which("clang")
    if clang is None:
        raise FirmwareError("firmware: expected clang, which has libFuzzer, got none")
    source = firmware_folder() / "host" / "steps.c"
    with tempfile.TemporaryDirectory(prefix="pfwd-fuzz-", dir=folder) as work:
        program, corpus = Path(work) / "fuzz", Path(work) / "corpus"
        corpus.mkdir()
        for number, seed in enumerate(seeds()):
            (corpus / f"seed-{number}").write_bytes(seed)
        flags = ["-g", "-O1", "-DPFWD_LIBFUZZER", "-fsanitize=fuzzer,address,undefined"]
        command = [clang, *COMPILER_FLAGS, *flags, "-fno-sanitize-recover=all", str(source)]
        command += [*map(str, core_sources()), "-o", str(program)]
        built = subprocess.run(command, capture_output=True, text=True, check=False)
        if built.returncode:
            raise FirmwareError(f"firmware: clang: {built.stderr.strip().splitlines()[-1]}")
        ran = subprocess.run(
            [
                str(program),
                f"-max_total_time={seconds}",
                f"-max_len={LONGEST_INPUT}",
                "-print_final_stats=1",
                str(corpus),
            ],
            capture_output=True,
            text=True,
            check=False,
            cwd=work,
        )
    tried = [line for line in ran.stderr.splitlines() if "number_of_executed_units" in line]
    count = int(tried[0].split()[-1]) if tried else 0
    marks = ("ERROR", "runtime error")
    errors = [line for line in ran.stderr.splitlines() if any(mark in line for mark in marks)]
    return ran.returncode == 0, count, "; ".join(errors[:3])


def seeds(count: int = 200) -> list[bytes]:
    """Return sequences of valid messages in random order.

    A fuzzer would not guess the first message.
    """
    generator = random.Random(1)
    hello = b"\x01PFWD\x01\x02"
    armed = b"\x06" + struct.pack("<BBIHIII", 1, 0, 5000, 3, 100, 400, 100)
    name = struct.pack("<IQ", 1, 900)
    messages = [
        hello,
        b"\x01PFWD\x01\x01",
        b"\x02" + struct.pack("<d", 10_000.0),
        b"\x02" + struct.pack("<d", 1000.0),
        b"\x03",
        b"\x04",
        b"\x05\x01",
        b"\x05\x00",
        armed,
        b"\x07" + name + struct.pack("<HH", 0, 0),
        b"\x08" + name,
        b"\x09" + name + struct.pack("<I", 500),
    ]
    sequences = []
    for _ in range(count):
        parts = [hello, generator.choice([armed, b"\x03"])]
        parts += generator.choices(messages, k=generator.randrange(12))
        text = b""
        for part in parts:
            text += bytes([_FRAMED, len(part)]) + part
            for _ in range(generator.randrange(4)):
                text += _step("T", struct.pack("<I", generator.choice([1000, 50_000, 300_000])))
            if generator.random() < 0.2:
                text += _step(generator.choice("LPRW"), generator.randbytes(2))
        sequences.append(text)
    return sequences


def _step(letter: str, data: bytes) -> bytes:
    # The letter is taken from the byte modulo ten.
    code = next(code for code in range(128, 256) if _LETTERS[code % len(_LETTERS)] == letter)
    return bytes([code, len(data)]) + data
