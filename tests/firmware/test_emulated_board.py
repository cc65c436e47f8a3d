"""The core on an emulated Cortex-M3: `pfwd log` records drops bit for bit as put into it."""

import sys
from pathlib import Path

import pytest

from pfwd_device.conformance import conform
from pfwd_device.conformance.requirements import REQUIREMENTS, by_hand
from pfwd_device.recording import read_survey
from pfwd_device.transport.opening import open_transport
from simulators.emulated import (
    EmulatedBoard,
    build_emulated,
    cross_compile,
    emulator,
    section_sizes,
)
from simulators.firmware import (
    COMPILER_FLAGS,
    Played,
    core_sources,
    firmware_folder,
    play_scenario,
    run_compiler,
    zig_command,
)
from tests.firmware.test_host_board import QUICK, assert_recorded_bit_for_bit
from tests.tui.console import pfwd

# A compiler for another processor is no part of an installation, and the image cannot be built
# without it. `.ci/run` installs it, and QEMU, where it can, and says where it cannot.
needs_zig = pytest.mark.skipif(zig_command() is None, reason="needs zig (pip install ziglang)")
needs_qemu = pytest.mark.skipif(
    emulator() is None or sys.platform == "win32", reason="needs qemu-system-arm and a terminal"
)
# Slow: zig takes 6 s; the same core runs as a process in the everyday tests.
pytestmark = [needs_zig, pytest.mark.slow]

MOST_CODE = 24 * 1024
MOST_MEMORY = 16 * 1024
"""Beside the ring, with all of the stack: what the docs promise of a Cortex-M3."""
RING = 48 * 1024


@pytest.fixture(scope="module")
def played() -> Played:
    return play_scenario(QUICK, drops=2, seed=3)


@pytest.fixture(scope="module")
def image(played: Played, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("image") / "board.elf"
    build_emulated(played, path)
    return path


@needs_qemu
@pytest.mark.posix
def test_log_records_drops_bit_for_bit(tmp_path: Path, image: Path, played: Played) -> None:
    with EmulatedBoard(image) as board:
        done = pfwd("log", board.url, "-o", tmp_path / "survey", "--drops", 2, "--no-invert")
    assert done.returncode == 0, done.stderr
    assert len(read_survey(tmp_path / "survey").drops) == 2
    assert_recorded_bit_for_bit(tmp_path / "survey", played)


def test_it_is_as_small_as_is_said(image: Path) -> None:
    sizes = section_sizes(image)
    assert sizes[".ring"] == RING
    assert 4000 < sizes[".text"] + sizes[".ARM.exidx"] < MOST_CODE
    memory = sizes[".bss"] + sizes[".stack"] + sizes.get(".data", 0)
    assert 2000 < memory < MOST_MEMORY


@needs_qemu
@pytest.mark.posix
def test_it_keeps_the_protocol(image: Path) -> None:
    with EmulatedBoard(image) as board:
        found = list(conform(lambda: open_transport(board.url)))
    others = [each for each in found if each.result != "passed"]
    # Without memory that lasts it keeps no calibration, and says so.
    manual = {number for number, (_, test) in REQUIREMENTS.items() if test is by_hand}
    assert {each.requirement for each in others} == manual | {"P-40", "P-41"}, others
    assert {each.result for each in others} == {"not-offered"}, others


def test_the_board_that_has_never_run_compiles_and_says_so(tmp_path: Path) -> None:
    source = firmware_folder() / "teensy41" / "board.c"
    first = source.read_text(encoding="utf-8").splitlines()[0]
    assert "NEVER RUN ON HARDWARE" in first
    target = ("-target", "thumb-freestanding-eabi", "-mcpu=cortex_m7")
    image = tmp_path / "board.o"
    cross_compile([source, *core_sources()], image, None, target=target)
    assert image.stat().st_size > 10_000


@pytest.mark.parametrize("platform", ["x86_64-windows-gnu", "aarch64-macos", "x86_64-linux-gnu"])
def test_the_host_board_compiles_for_every_platform(tmp_path: Path, platform: str) -> None:
    compiler = zig_command("cc")
    assert compiler is not None
    source = firmware_folder() / "host" / "board.c"
    built = tmp_path / "board.o"
    run_compiler(
        [*compiler, "-target", platform, *COMPILER_FLAGS, "-c", str(source), "-o", str(built)]
    )
    assert built.stat().st_size > 1000
