"""Instrument firmware that is compiled for this computer and plays given samples.

The core of the firmware is written in C. Here it runs as a process, the host board, which sends
samples as an instrument does. The sources are in the folder ``firmware`` of a checkout, and in the
wheel. Any C compiler is suitable; `pip install pfwd[firmware]` installs one.
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
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfwd_device.child_python import python_command
from pfwd_device.identity import LONGEST_NAME, ChannelIdentity, Identity
from pfwd_device.wire.fields import day
from pfwd_plugins.quantities import Measurand
from simulators.instrument.scenario import Scenario, load_scenario
from simulators.instrument.timeline import Bench, Timeline
from simulators.instrument.units import UnitDrops, with_drawn_soil
from simulators.mesh import SimulationError

COMPILER_FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-Wconversion")
"""Flags of the compiler on every platform."""
BUILD_TIMEOUT_S = 300.0
"""Longest wait for the compiler, s; zig compiles its C library the first time."""
BOARD_START_TIMEOUT_S = 20.0
"""Longest wait for the URL that a board reports after its start, s."""
BOARD_STOP_TIMEOUT_S = 5.0
"""Longest wait for the end of a board, s."""
HOST_DROP_SAMPLES = 4000
"""Samples of the longest drop in the memory of the host board."""
DEFAULT_DROPS = 60
"""Number of drops if none is requested: five minutes."""
PLAYED_RANGE_V = 5.0
"""Range of the converter for recorded drops, V."""
_N_REST_SAMPLES = 20
"""Number of first samples of a record from which the values at rest and the noise are estimated."""
PLAYED_REST_S = 2.0
"""Pause between recorded drops, s, longer than the time in which bounces are expected."""
_HEAD = struct.Struct("<8sII")
_MAGIC = b"PFWDPLAY"


class FirmwareError(SimulationError):
    """Error while the firmware is compiled or run."""


def firmware_folder() -> Path:
    """Return the folder with the C sources of the firmware.

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
        "firmware: expected the C sources of the firmware, got none; install pfwd from its wheel "
        "or use a checkout of the project"
    )


def find_compiler() -> list[str] | None:
    """Return the command of a C compiler; None if there is none.

    It is that of the environment variable CC, else cc, gcc or clang, else zig.
    """
    variable = os.environ.get("CC")
    if variable and shutil.which(shlex.split(variable)[0]):
        return shlex.split(variable)
    for name in ("cc", "gcc", "clang"):
        path = shutil.which(name)
        if path:
            return [path]
    return zig_command("cc")


def zig_command(*arguments: str) -> list[str] | None:
    """Return a command line of the compiler zig; None if zig is not installed."""
    if importlib.util.find_spec("ziglang") is not None:
        return python_command("-m", "ziglang", *arguments)
    path = shutil.which("zig")
    return [path, *arguments] if path else None


def core_sources() -> list[Path]:
    """Return the C files of the firmware core, which all boards share."""
    return sorted((firmware_folder() / "core").glob("*.c"))


def build_host(*flags: str, main: str = "host/board.c") -> Path:
    """Compile the host board, the firmware for this computer, and return the path of the program.

    A program that was compiled before from the same sources is returned at once.

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
            "install one by `pip install 'pfwd[firmware]'` (410 MB)"
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
    """Run the command line of a compiler; raise `FirmwareError` with its first error message."""
    try:
        completed = subprocess.run(
            command, capture_output=True, text=True, timeout=BUILD_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as err:
        raise FirmwareError(f"firmware: {command[0]}: expected a program, got {err}") from err
    if completed.returncode:
        errors = [line for line in completed.stderr.splitlines() if "error" in line]
        reason = errors[0] if errors else f"exit status {completed.returncode}"
        raise FirmwareError(f"firmware: {command[0]}: expected a program, got {reason}")


def _cache() -> Path:
    from platformdirs import user_cache_path

    return Path(user_cache_path("pfwd", appauthor=False)) / "firmware"


@dataclass(frozen=True, eq=False, slots=True)
class Played:
    """Samples that a board plays in place of measured ones, and the identity that it reports."""

    identity: Identity
    """Description of the instrument."""
    counts: NDArray[np.int32]
    """Counts of the converter, (n, channels)."""
    truth: tuple[dict[str, Any], ...] = ()
    """True values of each drop, with `touch_sample`, the index of the first touch."""
    rates: tuple[float, ...] = ()
    """Sampling rates that the host may choose, Hz; empty: only the present one."""


def play_scenario(
    source: str | Path | Mapping[str, Any] | Scenario = "default",
    *,
    drops: int = 6,
    seed: int = 0,
) -> Played:
    """Return simulated drops of a scenario as one long record.

    Parameters
    ----------
    source : str, path, mapping or Scenario
        Name, file or content of the scenario, which describes a simulated instrument.
    drops : int
        Number of drops.
    seed : int
        Seed of the random numbers.
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
    sensors: Sequence[tuple[Measurand, float]],
    plate_radius: float | None = None,
    name: str = "played",
) -> Played:
    """Return recorded drops as one long record, with the plate at rest between them.

    Parameters
    ----------
    records : sequence of (n, 1 + sensors) ndarray
        Load, N, and signal of each sensor, m/s or m.
    sampling_rate : float, Hz
    sensors : sequence of (quantity, offset)
        Measured quantity, and the distance from the plate centre, m.
    plate_radius : float or None, m
    name : str
        Serial number that the board reports.

    Returns
    -------
    Played
        Samples of a converter with 24 bits; each channel uses half of its range.
    """
    peaks = np.max([np.nanmax(np.abs(record), axis=0) for record in records], axis=0)
    volts = PLAYED_RANGE_V / 2 / np.where(peaks > 0, peaks, 1.0)
    begins = [np.nan_to_num(record[:_N_REST_SAMPLES]) for record in records]
    zeros = np.median(np.concatenate(begins), axis=0) * volts
    noise = np.median([np.diff(begin, axis=0).std(axis=0) for begin in begins], axis=0)
    measured = [(Measurand.LOAD, 0.0), *sensors]
    channels = [
        ChannelIdentity(
            "load" if number == 0 else f"s{number - 1}",
            quantity,
            offset,
            float(volts[number]),
            float(zeros[number]),
        )
        for number, (quantity, offset) in enumerate(measured)
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
        )  # the start of a record is at rest, its end need not be
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
    """Write samples, (n, channels), to a file that the host board plays."""
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
    """Return the content of the file from which the host board reads its identity.

    Parameters
    ----------
    identity : Identity
        Description of the instrument.
    rates : sequence of float, Hz
        Sampling rates that the host may choose.
    streams : bool
        True if the board sends samples continuously.
    drop_samples : int
        Samples of the longest drop that the board stores; 0: it stores no drops.
    """

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
        counts = round(volts / identity.volts_per_count(channel))
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
    for each in identity.channels:
        fields = (
            each.name,
            each.quantity.code,
            *map(repr, (each.offset, each.sensitivity, each.zero)),
            *map(field_text, (each.natural_frequency, each.damping, each.shunt)),
            day(each.calibrated),
            day(each.due),
        )
        lines.append("channel=" + "|".join(map(str, fields)))
    return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True)
class BoardOptions:
    """Options of the host board, the firmware that runs on this computer."""

    listen: str = "tcp://127.0.0.1:0"
    """Port of the board: `tcp://HOST:PORT`, or `pty` for a virtual serial port."""
    streams: bool = True
    """True if the board sends samples continuously."""
    drop_samples: int = HOST_DROP_SAMPLES
    """Samples of the longest drop that the board stores; 0: it stores no drops."""
    store: Path | None = None
    """File that serves as permanent memory; None: stored drops are lost when the process ends."""
    memory: int = 262_144
    """Size of the memory for samples, bytes."""
    speed: float = 1.0
    """Speed of the board relative to real time."""
    begin: int = 0
    """Index of the sample with which the board begins."""
    log: Path | None = None
    """File to which the board writes a line for every stored drop."""
    flags: tuple[str, ...] = ()
    """Additional flags of the compiler."""


class HostBoard:
    """Host board: the firmware, compiled for this computer, in another process.

    Parameters
    ----------
    played : Played
        Samples that the board sends, and its identity.
    options : BoardOptions, optional

    Raises
    ------
    FirmwareError
        If the firmware cannot be compiled or does not start.
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
            "--from": options.begin,
            "--store": options.store,
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
        """URL that the host opens."""

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
            raise FirmwareError(message or "firmware: the board ended without a message")
        return line

    def truth(self) -> list[dict[str, Any]]:
        """Return the true values of each simulated drop, in SI units; empty for recorded drops."""
        return list(self._truth)

    def kill(self) -> None:
        """End the board at once, as a loss of power does."""
        self._process.kill()
        self._process.wait()

    def stop(self) -> None:
        """End the board regularly; kill it if it does not end in time."""
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
        try:
            self._process.wait(BOARD_STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self.kill()

    def close(self) -> None:
        """End the board and remove its temporary files."""
        self.stop()
        for pipe in (self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()
        self._folder.cleanup()

    def __enter__(self) -> HostBoard:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()


def serve_firmware(
    scenario: str | Path | Mapping[str, Any] = "default",
    *,
    drops: int | None = None,
    seed: int = 0,
    rate: float = 1.0,
    listen: str = "tcp://127.0.0.1:0",
) -> HostBoard:
    """Start the compiled firmware with simulated drops of a scenario; a host opens its `url`.

    Parameters
    ----------
    scenario : str, path or mapping
        Name, file or content of the scenario, which describes a simulated instrument.
    drops : int or None
        Number of drops; None: `DEFAULT_DROPS`.
    seed : int
        Seed of the random numbers.
    rate : float
        Speed relative to real time, > 0.
    listen : str
        Port of the board: `tcp://HOST:PORT`, or `pty` for a virtual serial port.

    Raises
    ------
    FirmwareError
        If the firmware cannot be compiled, or the scenario cannot be played by it.

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
            f"firmware: scenario {loaded.name}: expected a scenario in the binary protocol without "
            "faults, got another one, which the firmware cannot play; omit --firmware"
        )
    played = play_scenario(loaded, drops=drops or DEFAULT_DROPS, seed=seed)
    named = replace(played.identity, model="PFWD core, host board", firmware=core_version())
    options = BoardOptions(listen=listen, speed=rate)
    return HostBoard(replace(played, identity=named), options)


def core_version() -> str:
    """Return the version of the firmware: "core" and the first digits of the sources' SHA-256."""
    digest = hashlib.sha256()
    for path in core_sources():
        digest.update(path.read_bytes())
    return f"core {digest.hexdigest()[:8]}"
