"""Size of the firmware's core on a Cortex-M3, for docs/build-an-instrument.md, and its fuzzing."""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.firmware_fuzz import fuzz
from benchmarks.output import Reporter
from simulators.emulated import build_emulated, section_sizes
from simulators.firmware import FirmwareError, Played, play_scenario

MAX_CODE_BYTES, MAX_MEMORY_BYTES = 24 * 1024, 16 * 1024
"""Limits of code and memory on a Cortex-M3, without the ring buffer of samples."""


def run(arguments: list[str]) -> int:
    """Compile for a Cortex-M3 and print the sizes.

    Return 1 if a size is too large, 2 without zig.
    """
    parser = argparse.ArgumentParser(prog="pfwd bench firmware")
    parser.add_argument("--fuzz", type=int, metavar="S", help="fuzz for so many seconds instead")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args(arguments)
    reporter = Reporter(arguments)
    if options.fuzz is not None:
        return _fuzz(reporter, options.fuzz)
    reporter.title("core and emulated board on a Cortex-M3, bytes")
    try:
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


def _fuzz(reporter: Reporter, seconds: int) -> int:
    reporter.title("the core under libFuzzer, address and undefined-behaviour sanitizers")
    try:
        clean, tried, errors = fuzz(seconds)
    except FirmwareError as err:
        print(err)
        return 2
    reporter.record(seconds=seconds, inputs=tried, found=errors or "nothing")
    return 0 if clean else 1


def _sizes() -> dict[str, int]:
    played: Played = play_scenario(drops=1)
    short = replace(played, counts=np.ascontiguousarray(played.counts[:10]))
    with tempfile.TemporaryDirectory() as work:
        image = Path(work) / "board.elf"
        build_emulated(short, image)
        return section_sizes(image)
