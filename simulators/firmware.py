"""Core of the instrument in C, compiled and run as a process that plays samples.

The sources are in the folder ``firmware`` of a checkout, and in the wheel. Any C compiler is
suitable; `pip install pfwd[firmware]` installs one.
"""

from __future__ import annotations

import hashlib
import importlib.util
import math
import os
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd_device.child_python import python_command
from pfwd_device.identity import LONGEST_NAME, ChannelIdentity, Identity, Role
from pfwd_device.wire.fields import day
from simulators.instrument.scenario import Scenario, load_scenario
from simulators.instrument.timeline import Bench, Timeline
from simulators.instrument.units import UnitDrops, with_drawn_soil
from simulators.mesh import SimulationError

COMPILER_FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-Wconversion")
"""Flags of the compiler on every platform."""
BUILD_TIMEOUT_S = 300.0
"""Longest compilation, s; zig compiles its C library the first time."""
BOARD_START_TIMEOUT_S = 20.0
"""Time within which a board must report its URL, s."""
BOARD_STOP_TIMEOUT_S = 5.0
"""Time within which a board must end, s."""
HOST_DROP_SAMPLES = 4000
"""Samples of the longest drop in the memory of the host board."""
DEFAULT_DROPS = 60
"""Number of drops if none is requested: five minutes."""
PLAYED_RANGE_V = 5.0
"""Range of the converter for recorded drops, V."""
_N_REST_SAMPLES = 20
"""Number of first samples of a record that give the reading at rest and the noise."""
PLAYED_REST_S = 2.0
"""Pause between recorded drops, s, longer than the search for bounces."""
_HEAD = struct.Struct("<8sII")
_MAGIC = b"PFWDPLAY"


class FirmwareError(SimulationError):
    """Failure to compile or run the core."""


def firmware_folder() -> Path:
    """Return the folder of the sources.

    Raises
    ------
    FirmwareError
        If this installation has no sources.
    """
    package_folder = Path(__file__).resolve().parent
    for folder in (package_folder.parent / "firmware", package_folder / "firmware_sources"):
        if (folder / "core" / "pfwd.h").is_file():
            return folder
    raise FirmwareError(
        "firmware: expected the sources of the core, got none; install pfwd from its wheel or use "
        "a checkout of the project"
    )


def find_compiler() -> list[str] | None:
    """Return the command of a C compiler: of the variable CC, the platform, or zig, or None."""
    variable = os.environ.get("CC")
    if variable and shutil.which(shlex.split(variable)[0]):
        return shlex.split(variable)
    for name in ("cc", "gcc", "clang"):
        path = shutil.which(name)
        if path:
            return [path]
    return zig_command("cc")


def zig_command(*arguments: str) -> list[str] | None:
    """Return a command of zig; None: it is not installed."""
    if importlib.util.find_spec("ziglang") is not None:
        return python_command("-m", "ziglang", *arguments)
    path = shutil.which("zig")
    return [path, *arguments] if path else None


def core_sources() -> list[Path]:
    """Return the C files of the core."""
    return sorted((firmware_folder() / "core").glob("*.c"))


def build_host(*flags: str, main: str = "host/board.c") -> Path:
    """Compile the host board, or return the cached program.

    Parameters
    ----------
    *flags : str
        Additional flags of the compiler, such as ``-DPFWD_FAULT=3``.
    main : str
        Main source, relative to the folder of the sources.

    Raises
    ------
    FirmwareError
        If there is no compiler, or it reports an error.
    """
    compiler = find_compiler()
    if compiler is None:
        raise FirmwareError(
            "firmware: expected a C compiler (cc, gcc, clang, or the variable CC), got none; "
            "`pip install ziglang` brings one (400 MB)"
        )
    folder = firmware_folder()
    sources = [folder / main, *core_sources()]
    digest = hashlib.sha256(repr((compiler, COMPILER_FLAGS, flags, main)).encode())
    for path in (*sources, *sorted(folder.glob("*/*.h"))):
        digest.update(path.read_bytes())
    suffix = ".exe" if sys.platform == "win32" else ""
    cache = _cache() / f"{Path(main).stem}-{digest.hexdigest()[:20]}{suffix}"
    if cache.is_file():
        return cache
    cache.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=cache.parent) as work:
        built = Path(work) / f"built{suffix}"
        libraries = ["-lws2_32"] if sys.platform == "win32" else []
        command = [*compiler, *COMPILER_FLAGS, "-O2", *flags, *map(str, sources)]
        run_compiler([*command, "-o", str(built), *libraries])
        os.replace(built, cache)
    return cache


def run_compiler(command: Sequence[str]) -> None:
    """Run a compiler; raise `FirmwareError` with its first error."""
    try:
        completed = subprocess.run(
            command, capture_output=True, text=True, timeout=BUILD_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as err:
        raise FirmwareError(f"firmware: {command[0]}: expected it to compile, got {err}") from err
    if completed.returncode:
        errors = [line for line in completed.stderr.splitlines() if "error" in line] or ["nothing"]
        raise FirmwareError(f"firmware: {command[0]}: expected it to compile, got {errors[0]}")


def _cache() -> Path:
    from platformdirs import user_cache_path

    return Path(user_cache_path("pfwd", appauthor=False)) / "firmware"


@dataclass(frozen=True, eq=False, slots=True)
class Played:
    """Samples that a board plays, and its identity."""

    identity: Identity
    counts: NDArray[np.int32]
    """Counts of the converter, (n, channels)."""
    truth: tuple[dict[str, Any], ...] = ()
    """True values of each drop, with `touch_sample`."""
    rates: tuple[float, ...] = ()
    """Sampling rates that the host may choose, Hz; empty: only the present one."""


def play_scenario(
    source: str | Path | Mapping[str, Any] | Scenario = "default",
    *,
    drops: int = 6,
    seed: int = 0,
) -> Played:
    """Return the finite-element drops of a scenario as one long record.

    Parameters
    ----------
    source : name, file or tables of a scenario, or a Scenario
    drops : int
    seed : int
    """
    scenario = source if isinstance(source, Scenario) else load_scenario(source)
    scenario = with_drawn_soil(scenario, seed)
    settings, rate = scenario.drops, scenario.device.sampling_rate
    bench = Bench(scenario, UnitDrops(scenario, (*settings.seating[:drops], 1.0)), seed)
    timeline = Timeline(bench, rate, 1, drops)
    end = timeline.end_index()
    assert end is not None  # because there is a last drop
    truth = tuple(
        {**bench.truth(number), "touch_sample": timeline.touch_index(number)}
        for number in range(1, drops + 1)
    )
    identity = scenario.device.identity(rate)
    return Played(identity, timeline.counts(0, end), truth, scenario.device.sampling_rates)


def play_records(
    records: Sequence[NDArray[np.float64]],
    sampling_rate: float,
    sensors: Sequence[tuple[str, float]],
    plate_radius: float | None = None,
    name: str = "played",
) -> Played:
    """Return recorded drops as one long record with the plate at rest in between.

    Parameters
    ----------
    records : sequence of (n, 1 + sensors) ndarray
        Load, N, and signal of each sensor, m/s or m.
    sampling_rate : float, Hz
    sensors : sequence of (role, offset)
        `geophone` or `displacement`, and the distance from the plate centre, m.
    plate_radius : float or None, m
    name : str
        Replaces the serial number.

    Returns
    -------
    Played
        24 bits; each channel uses half of the converter's range.
    """
    peaks = np.max([np.nanmax(np.abs(record), axis=0) for record in records], axis=0)
    volts = PLAYED_RANGE_V / 2 / np.where(peaks > 0, peaks, 1.0)
    begins = [np.nan_to_num(record[:_N_REST_SAMPLES]) for record in records]
    zeros = np.median(np.concatenate(begins), axis=0) * volts
    noise = np.median([np.diff(begin, axis=0).std(axis=0) for begin in begins], axis=0)
    roles = [("load", 0.0), *sensors]
    channels = [
        ChannelIdentity(
            "load" if number == 0 else f"s{number - 1}",
            Role(role),
            offset,
            float(volts[number]),
            float(zeros[number]),
        )
        for number, (role, offset) in enumerate(roles)
    ]
    quiet = round(PLAYED_REST_S * sampling_rate)
    generator = np.random.default_rng(0)
    parts = []
    last = begins[0][0]
    for record in [*records, records[0][:1]]:
        samples = np.nan_to_num(record)
        rest = np.linspace(last, samples[0], quiet)
        parts += [rest + noise / math.sqrt(2) * generator.standard_normal(rest.shape), samples]
        last = np.median(
            samples[:_N_REST_SAMPLES], axis=0
        )  # at rest: how a record ends says nothing of it
    counts = np.rint(np.concatenate(parts) * volts * (1 << 23) / PLAYED_RANGE_V)
    identity = Identity(
        serial_number=name[:LONGEST_NAME],
        model="PFWD core, host board",
        firmware=core_version(),
        sampling_rate=float(round(sampling_rate)),
        adc_bits=24,
        adc_range=PLAYED_RANGE_V,
        channels=tuple(channels),
        plate_radius=plate_radius,
    )
    return Played(identity, counts.astype(np.int32))


def write_play(path: Path, counts: NDArray[np.int32]) -> None:
    """Write a file of samples for the host board."""
    sets, channels = counts.shape
    data = np.ascontiguousarray(counts, dtype="<i4").tobytes()
    path.write_bytes(_HEAD.pack(_MAGIC, channels, sets) + data)


def identity_text(
    identity: Identity,
    rates: Sequence[float] = (),
    *,
    streams: bool = True,
    drop_samples: int = HOST_DROP_SAMPLES,
) -> str:
    """Return the identity file of the host board."""

    def field_text(value: float | None) -> str:
        return "-1" if value is None else repr(value)

    shunts = [
        (number, channel)
        for number, channel in enumerate(identity.channels)
        if channel.shunt is not None
    ]
    number, counts = 0, 0
    if shunts:
        number, channel = shunts[0]
        volts = channel.sensitivity * (channel.shunt or 0.0)
        counts = round(volts / identity.volts_per_count)
    alternative_rates = [rate for rate in rates if rate != identity.sampling_rate]
    lines = [
        f"serial_number={identity.serial_number}",
        f"model={identity.model}",
        f"firmware={identity.firmware}",
        f"adc_bits={identity.adc_bits}",
        f"adc_range={identity.adc_range!r}",
        f"plate_radius={field_text(identity.plate_radius)}",
        f"plate_mass={field_text(identity.plate_mass)}",
        f"centre_seat={int(identity.centre_sensor == 'ground')}",
        f"streams={int(streams)}",
        f"drop_samples={drop_samples}",
        f"shunt_channel={number}",
        f"shunt_counts={counts}",
        *(f"rate={rate:g}" for rate in (identity.sampling_rate, *alternative_rates)),
    ]
    roles = ("unused", "load", "geophone", "displacement")
    for each in identity.channels:
        fields = (
            each.name,
            roles.index(each.role.value),
            *map(repr, (each.offset, each.sensitivity, each.zero)),
            *map(field_text, (each.natural_frequency, each.damping, each.shunt)),
            day(each.calibrated),
            day(each.due),
        )
        lines.append("channel=" + "|".join(map(str, fields)))
    return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True)
class BoardOptions:
    """Options of the host board."""

    listen: str = "tcp://127.0.0.1:0"
    """`tcp://HOST:PORT` or `pty`."""
    streams: bool = True
    drop_samples: int = HOST_DROP_SAMPLES
    """Samples of the longest buffered drop; 0: drops are not buffered."""
    store: Path | None = None
    """File in which drops outlast the process; None: they are lost with it."""
    store_size: int = 262_144
    memory: int = 262_144
    """Size of the memory for samples, bytes."""
    speed: float = 1.0
    """Speed over real time."""
    link_rate: float = 0.0
    """Bytes per second of the link; 0: unlimited."""
    begin: int = 0
    """Number of the first sample."""
    loop: bool = False
    log: Path | None = None
    """File with one line for every buffered drop."""
    flags: tuple[str, ...] = ()
    """Flags of the compiler."""


class HostBoard:
    """Core of the instrument in another process.

    Parameters
    ----------
    played : Played
    options : BoardOptions

    Raises
    ------
    FirmwareError
        If it cannot be compiled or does not start.
    """

    def __init__(self, played: Played, options: BoardOptions | None = None) -> None:
        options = options or BoardOptions()
        program = build_host(*options.flags)
        self._truth = played.truth
        self._folder = tempfile.TemporaryDirectory(prefix="pfwd-board-")
        folder = Path(self._folder.name)
        write_play(folder / "play", played.counts)
        text = identity_text(
            played.identity,
            played.rates,
            streams=options.streams,
            drop_samples=options.drop_samples,
        )
        (folder / "identity").write_text(text, encoding="utf-8")
        arguments = {
            "--identity": folder / "identity",
            "--play": folder / "play",
            "--listen": options.listen,
            "--memory": options.memory,
            "--speed": options.speed,
            "--link-rate": options.link_rate,
            "--from": options.begin,
            "--loop": int(options.loop),
            "--store": options.store,
            "--store-size": options.store_size,
            "--log": options.log,
        }
        command = [str(program)]
        for name, value in arguments.items():
            if value is not None:
                command += [name, str(value)]
        try:
            # The board ends with its standard input, and so with this process.
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
            )
        except OSError as err:
            self._folder.cleanup()
            raise FirmwareError(f"firmware: {program}: {err}") from err
        self.url = self._first_line()
        """URL for the host."""

    def _first_line(self) -> str:
        assert self._process.stdout is not None
        timer = threading.Timer(BOARD_START_TIMEOUT_S, self._process.kill)
        timer.start()
        try:
            line = self._process.stdout.readline().decode().strip()
        finally:
            timer.cancel()
        if not line:
            self._process.wait()
            assert self._process.stderr is not None
            message = self._process.stderr.read().decode(errors="replace").strip()
            self.close()
            raise FirmwareError(message or "firmware: the board ended without a word")
        return line

    def truth(self) -> list[dict[str, Any]]:
        """Return the true values, one mapping per drop."""
        return list(self._truth)

    def kill(self) -> None:
        """End the process at once, as a loss of power does."""
        self._process.kill()
        self._process.wait()

    def stop(self) -> None:
        """End the process."""
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
        try:
            self._process.wait(BOARD_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.kill()

    def close(self) -> None:
        """End the process and remove its files."""
        self.stop()
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()
        self._folder.cleanup()

    def __enter__(self) -> HostBoard:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def serve_firmware(
    scenario: str | Path | Mapping[str, Any] = "default",
    *,
    drops: int | None = None,
    seed: int = 0,
    rate: float = 1.0,
    listen: str = "tcp://127.0.0.1:0",
) -> HostBoard:
    """Start the compiled core with the drops of a scenario; hosts open its `url`.

    Parameters
    ----------
    scenario : as for `simulators.instrument.serve`
    drops : int or None
        None: `DEFAULT_DROPS`.
    seed : int
    rate : float
        Times real time, > 0.
    listen : str

    Raises
    ------
    FirmwareError
        If the core cannot be compiled, or the scenario cannot be played.

    Examples
    --------
    >>> with serve_firmware("soft", drops=3) as board:  # doctest: +SKIP
    ...     measure(board.url, "survey", print)
    """
    if not (math.isfinite(rate) and rate > 0):
        raise FirmwareError(f"firmware: rate: expected a number > 0, got {rate:g}")
    loaded = load_scenario(scenario)
    if loaded.link.dialect != "pfwd" or loaded.faults:
        raise FirmwareError(
            f"firmware: scenario {loaded.name}: expected one without faults in the binary "
            "protocol, which is all that the core plays; leave --firmware out for this one"
        )
    played = play_scenario(loaded, drops=drops or DEFAULT_DROPS, seed=seed)
    named = replace(played.identity, model="PFWD core, host board", firmware=core_version())
    options = BoardOptions(listen=listen, speed=rate)
    return HostBoard(replace(played, identity=named), options)


def core_version() -> str:
    """Return the version of the core's sources, the beginning of their digest."""
    digest = hashlib.sha256()
    for path in core_sources():
        digest.update(path.read_bytes())
    return f"core {digest.hexdigest()[:8]}"
