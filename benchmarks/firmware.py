"""Size of the firmware's core on a Cortex-M3, and its fuzzing by libFuzzer with its sanitizers."""

import random
import shutil
import struct
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.output import parse_options
from simulators.emulated import build_emulated, section_sizes
from simulators.firmware import (
    COMPILER_FLAGS,
    FirmwareError,
    core_sources,
    firmware_folder,
    play_scenario,
)

MAX_CODE_BYTES, MAX_MEMORY_BYTES = 24 * 1024, 16 * 1024
"""Limits of code and memory on a Cortex-M3, without the ring buffer of samples."""
_FRAMED, _LETTERS = 1, "BTLPRWEDNT"
"""A first byte below 128 starts a message that is put into a frame; other bytes select one of these
steps of the test program."""
LONGEST_INPUT = 4000


def run(arguments: list[str]) -> int:
    """Compile for a Cortex-M3 and print the sizes.

    Return 1 if a size is too large or the fuzzer found an error, 2 without zig or clang.
    """
    options, reporter = parse_options(
        "firmware", __doc__, arguments, fuzz=(int, "seconds of fuzzing, in place of the sizes")
    )
    try:
        if options.fuzz is not None:
            reporter.title("the core under libFuzzer, address and undefined-behaviour sanitizers")
            clean, tried, errors = fuzz(options.fuzz)
            reporter.record(seconds=options.fuzz, inputs=tried, found=errors or "nothing")
            return 0 if clean else 1
        reporter.title("core and emulated board on a Cortex-M3, bytes")
        sizes = _sizes()
    except FirmwareError as err:
        print(err)
        return 2
    code = sizes[".text"] + sizes.get(".ARM.exidx", 0)
    memory = sizes[".bss"] + sizes.get(".data", 0)
    ring = sizes[".ring"]
    for channels in (2, 4, 8):
        samples = ring // 2 // (3 * channels)
        slots = (ring // 2 - 64) // (64 + 3 * channels * 1200)
        reporter.record(
            channels=channels, ring_samples=samples, drops_of_1200_samples=min(slots, 16)
        )
    reporter.record(
        code=code,
        code_limit=MAX_CODE_BYTES,
        memory=memory,
        stack=sizes[".stack"],
        memory_limit=MAX_MEMORY_BYTES,
        ring=ring,
    )
    return 0 if code <= MAX_CODE_BYTES and memory + sizes[".stack"] <= MAX_MEMORY_BYTES else 1


def _sizes() -> dict[str, int]:
    played = play_scenario(drops=1)
    short = replace(played, counts=np.ascontiguousarray(played.counts[:10]))
    with tempfile.TemporaryDirectory() as work:
        image = Path(work) / "board.elf"
        build_emulated(short, image)
        return section_sizes(image)


def fuzz(seconds: int) -> tuple[bool, int, str]:
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
    with tempfile.TemporaryDirectory(prefix="pfwd-fuzz-") as work:
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


def seeds() -> list[bytes]:
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
    for _ in range(200):
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
