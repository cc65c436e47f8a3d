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

# `.ci/run` installs zig and QEMU where it can, and reports where it cannot.
needs_zig = pytest.mark.skipif(zig_command() is None, reason="needs zig (pip install ziglang)")
needs_qemu = pytest.mark.skipif(
    emulator() is None or sys.platform == "win32", reason="needs qemu-system-arm and a terminal"
)
# Slow: zig takes 6 s; the same core runs as a process in the everyday tests.
pytestmark = [needs_zig, pytest.mark.slow]

MAX_CODE_BYTES = 24 * 1024
MAX_MEMORY_BYTES = 16 * 1024
"""Memory with the stack and without the ring, as documented for a Cortex-M3."""
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
        run = pfwd("log", board.url, "-o", tmp_path / "survey", "--drops", 2, "--no-invert")
    assert run.status == 0, run.err
    assert len(read_survey(tmp_path / "survey").drops) == 2
    assert_recorded_bit_for_bit(tmp_path / "survey", played)


def test_code_and_memory_are_within_the_documented_limits(image: Path) -> None:
    sizes = section_sizes(image)
    assert sizes[".ring"] == RING
    assert 4000 < sizes[".text"] + sizes[".ARM.exidx"] < MAX_CODE_BYTES
    memory = sizes[".bss"] + sizes[".stack"] + sizes.get(".data", 0)
    assert 2000 < memory < MAX_MEMORY_BYTES


@needs_qemu
@pytest.mark.posix
def test_it_keeps_the_protocol(image: Path) -> None:
    with EmulatedBoard(image) as board:
        results = list(conform(lambda: open_transport(board.url)))
    failures = [each for each in results if each.result != "passed"]
    # Without permanent memory it stores no calibration, and states it.
    manual = {number for number, (_, test) in REQUIREMENTS.items() if test is by_hand}
    assert {each.requirement for each in failures} == manual | {"P-40", "P-41"}, failures
    assert {each.result for each in failures} == {"not-offered"}, failures


def test_the_untried_board_compiles_and_is_marked(tmp_path: Path) -> None:
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
