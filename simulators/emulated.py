"""Instrument firmware on an emulated processor.

The core of the firmware, in C, is compiled for a Cortex-M3 by zig and run by QEMU.
"""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pfwd_device.identity import Identity
from pfwd_device.wire.fields import day
from simulators.firmware import (
    BOARD_START_TIMEOUT_S,
    BOARD_STOP_TIMEOUT_S,
    COMPILER_FLAGS,
    FirmwareError,
    Played,
    core_sources,
    firmware_folder,
    run_compiler,
    zig_command,
)

TARGET = ("-target", "thumb-freestanding-eabi", "-mcpu=cortex_m3")
MACHINE = "mps2-an385"
_QUIET = ("-display", "none", "-monitor", "none")
EMULATOR = "qemu-system-arm"
EMULATED_DROP_SAMPLES = 1200
"""Samples of the longest drop that the emulated board stores: 0.12 s at 10 kHz. Three drops fit
into half of its 48 kB."""


def emulator() -> str | None:
    """Return the path of the program QEMU; None if it is not installed."""
    return shutil.which(EMULATOR)


def cross_compile(
    sources: Sequence[Path], image: Path, linked: Path | None, *flags: str, target: Sequence[str]
) -> None:
    """Compile C sources for a processor without operating system, by zig.

    Parameters
    ----------
    sources : sequence of Path
        C files.
    image : Path
        File to write.
    linked : Path or None
        Linker script; None: the sources are only combined to one object file.
    *flags : str
        Additional flags of the compiler.
    target : sequence of str
        Flags that select the processor.

    Raises
    ------
    FirmwareError
        If zig is missing or reports an error.
    """
    compiler = zig_command("cc")
    if compiler is None:
        raise FirmwareError(
            "firmware: expected zig, which compiles for other processors, got none; install it by "
            "`pip install 'pfwd[firmware]'` (410 MB)"
        )
    common = [*COMPILER_FLAGS, "-Os", "-ffreestanding", "-fno-sanitize=all", "-ffunction-sections"]
    common += ["-fdata-sections", "-fno-builtin"]
    script = ["-T", str(linked), "-Wl,--gc-sections"] if linked is not None else ["-r"]
    run_compiler(
        [
            *compiler,
            *target,
            *common,
            *flags,
            *map(str, sources),
            *script,
            "-o",
            str(image),
        ]
    )


def build_emulated(played: Played, image: Path, *flags: str) -> None:
    """Build the program of the emulated board, which contains the samples that it plays.

    Parameters
    ----------
    played : Played
        Samples and identity of the instrument.
    image : Path
        ELF file to write.
    *flags : str
        Additional flags of the compiler.

    Raises
    ------
    FirmwareError
        If zig is missing or reports an error.
    """
    folder = firmware_folder() / "mps2"
    with tempfile.TemporaryDirectory(prefix="pfwd-image-") as work:
        place = Path(work)
        (place / "table.h").write_text(_HEADER, encoding="utf-8")
        (place / "table.c").write_text(table_text(played), encoding="utf-8")
        sources = [folder / "start.c", folder / "board.c", place / "table.c", *core_sources()]
        include = [f"-I{place}", f"-I{folder.parent / 'core'}"]
        cross_compile(sources, image, folder / "link.ld", *include, *flags, target=TARGET)


_HEADER = """/* Written by simulators/emulated.py. */
#ifndef TABLE_H
#define TABLE_H
#include "pfwd.h"
extern const uint32_t table_sets;
extern const int32_t table[];
extern const pfwd_identity table_identity;
#define TABLE_SETS table_sets
#define TABLE_CHANNELS table_identity.channels
#endif
"""


def table_text(played: Played, drop_samples: int = EMULATED_DROP_SAMPLES) -> str:
    """Return C source with the samples and the identity of the emulated board.

    Parameters
    ----------
    played : Played
    drop_samples : int
        Samples of the longest drop that the board stores.
    """
    identity, counts = played.identity, played.counts
    shunts = [
        (number, channel.sensitivity * channel.shunt / identity.volts_per_count(channel))
        for number, channel in enumerate(identity.channels)
        if channel.shunt is not None
    ]
    shunt_channel, shunt_counts = shunts[0] if shunts else (0, 0.0)
    values = np.array2string(
        counts.reshape(-1), separator=",", threshold=counts.size + 1, max_line_width=100
    )[1:-1]
    return f"""/* Written by simulators/emulated.py. */
#include "table.h"
const uint32_t table_sets = {len(counts)}u;
__attribute__((section(".table"))) const int32_t table[] = {{
{values}
}};
static const pfwd_channel channels[] = {{
{_channels(identity)}}};
static const uint32_t rates[] = {{{identity.sampling_rate:.0f}u}};
const pfwd_identity table_identity = {{
    .serial_number = {_text(identity.serial_number)},
    .model = {_text(identity.model)},
    .firmware = {_text(identity.firmware)},
    .adc_bits = {identity.adc_bits},
    .adc_range = {identity.adc_range!r},
    .plate_radius = {_c_value(identity.plate_radius)},
    .plate_mass = {_c_value(identity.plate_mass)},
    .centre_seat = {int(identity.centre_sensor == "ground")},
    .channels = {len(identity.channels)},
    .channel = channels,
    .rates = rates,
    .rate_count = 1,
    .shunt_channel = {shunt_channel},
    .shunt_counts = {round(shunt_counts)},
    .streams = true,
    .drop_samples = {drop_samples},
}};
"""


def _channels(identity: Identity) -> str:
    lines = [
        f"    {{{_text(each.name)}, {each.quantity.code}, {each.offset!r}, "
        f"{each.sensitivity!r}, {each.zero!r}, {_c_value(each.natural_frequency)}, "
        f"{_c_value(each.damping)}, {_c_value(each.shunt)}, "
        f"{day(each.calibrated)}u, {day(each.due)}u}},"
        for each in identity.channels
    ]
    return "\n".join(lines) + "\n"


def _text(value: str) -> str:
    safe = "".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in value)
    return '"' + safe.replace("\\", "\\\\").replace('"', '\\"') + '"'


def _c_value(value: float | None) -> str:
    return "PFWD_NOT_SAID" if value is None else repr(value)


def section_sizes(image: Path) -> dict[str, int]:
    """Return the size of each section of a 32-bit ELF file that the processor loads, bytes."""
    data = image.read_bytes()
    if data[:6] != b"\x7fELF\x01\x01":
        raise FirmwareError(f"{image}: expected a 32-bit ELF file, got another kind of file")
    (offset,) = struct.unpack_from("<I", data, 32)
    size, count, names = struct.unpack_from("<HHH", data, 46)
    headers = [struct.unpack_from("<IIIIII", data, offset + k * size) for k in range(count)]
    start = headers[names][4]
    sizes: dict[str, int] = {}
    for name, _, flags, _, _, length in headers:
        if flags & 2:  # the section is in memory
            end = data.index(b"\0", start + name)
            text = data[start + name : end].decode()
            sizes[text] = sizes.get(text, 0) + length
    return sizes


class EmulatedBoard:
    """Emulated board that runs until it is closed; a host opens its `url`.

    Parameters
    ----------
    image : Path
        Program that `build_emulated` wrote.

    Raises
    ------
    FirmwareError
        If QEMU is missing or does not start.
    """

    def __init__(self, image: Path) -> None:
        program = emulator()
        if program is None or os.name == "nt":
            raise FirmwareError(
                f"firmware: expected {EMULATOR}, got none; install QEMU (Debian: "
                "qemu-system-arm); on Windows the emulated board is not supported"
            )
        self._process = subprocess.Popen(
            [program, "-M", MACHINE, "-kernel", str(image), *_QUIET, "-serial", "pty"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self.url = self._place()

    def _place(self) -> str:
        assert self._process.stdout is not None
        timer = threading.Timer(BOARD_START_TIMEOUT_S, self._process.kill)
        timer.start()
        lines = []
        try:
            for line in self._process.stdout:
                lines.append(line.strip())
                if "redirected to" in line:
                    return line.split("redirected to ")[1].split()[0]
        finally:
            timer.cancel()
        self.close()
        raise FirmwareError(f"{EMULATOR}: expected a serial port, got {' '.join(lines) or 'none'}")

    def close(self) -> None:
        """Stop the emulated board."""
        self._process.terminate()
        try:
            self._process.wait(BOARD_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def __enter__(self) -> EmulatedBoard:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()
