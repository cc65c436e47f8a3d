"""The instrument's core in C, compiled and run as a process that plays samples.

The sources stand in the folder ``firmware`` of a checkout and travel in the wheel. Any C compiler
will do; where there is none, `pip install pfwd[firmware]` brings one.
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
from simulators.instrument.truth import drop_truth
from simulators.instrument.units import UnitDrops, with_drawn_soil
from simulators.mesh import SimulationError

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-Wconversion")
"""What the core is compiled with everywhere."""
LONGEST_BUILD = 300.0
"""s; zig compiles its own C library the first time."""
LONGEST_START = 20.0
"""s until a board that does not say where it is is given up."""
LONGEST_STOP = 5.0
"""s."""
DROP_SAMPLES = 4000
"""Of the longest drop that the host board keeps."""
MOST_DROPS = 60
"""Drops that are played when nobody says how many: five minutes."""
PLAYED_RANGE = 5.0
"""V; of the converter that plays recorded drops."""
_BEGIN = 20
"""Samples of a record that tell what a channel shows at rest, and its noise."""
PLAYED_REST = 2.0
"""s between two of them: longer than bounces are looked for."""
_HEAD = struct.Struct("<8sII")
_MAGIC = b"PFWDPLAY"


class FirmwareError(SimulationError):
    """The core cannot be compiled or does not run."""


def firmware_folder() -> Path:
    """Where the sources are.

    Raises
    ------
    FirmwareError
        If this installation has none.
    """
    here = Path(__file__).resolve().parent
    for folder in (here.parent / "firmware", here / "firmware_sources"):
        if (folder / "core" / "pfwd.h").is_file():
            return folder
    raise FirmwareError(
        "firmware: expected the sources of the core, got none; install pfwd from its wheel or use "
        "a checkout of the project"
    )


def find_compiler() -> list[str] | None:
    """The command of a C compiler: that of the variable CC, the platform's, or zig; None: none."""
    said = os.environ.get("CC")
    if said and shutil.which(shlex.split(said)[0]):
        return shlex.split(said)
    for name in ("cc", "gcc", "clang"):
        found = shutil.which(name)
        if found:
            return [found]
    return zig_command("cc")


def zig_command(*arguments: str) -> list[str] | None:
    """A command of zig, None where it is not installed."""
    if importlib.util.find_spec("ziglang") is not None:
        return python_command("-m", "ziglang", *arguments)
    found = shutil.which("zig")
    return [found, *arguments] if found else None


def core_sources() -> list[Path]:
    """The C files of the core."""
    return sorted((firmware_folder() / "core").glob("*.c"))


def build_host(*flags: str, main: str = "host/board.c") -> Path:
    """The host board, compiled; kept for the next time.

    Parameters
    ----------
    *flags : str
        Further ones for the compiler, as ``-DPFWD_FAULT=3``.
    main : str
        Below the folder of the sources.

    Raises
    ------
    FirmwareError
        If there is no compiler, or it refuses.
    """
    compiler = find_compiler()
    if compiler is None:
        raise FirmwareError(
            "firmware: expected a C compiler (cc, gcc, clang, or the variable CC), got none; "
            "`pip install ziglang` brings one (400 MB)"
        )
    folder = firmware_folder()
    sources = [folder / main, *core_sources()]
    digest = hashlib.sha256(repr((compiler, STRICT, flags, main)).encode())
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
        command = [*compiler, *STRICT, "-O2", *flags, *map(str, sources)]
        run_compiler([*command, "-o", str(built), *libraries])
        os.replace(built, cache)
    return cache


def run_compiler(command: Sequence[str]) -> None:
    """Run it; `FirmwareError` with its first complaint when it refuses."""
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=LONGEST_BUILD, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as err:
        raise FirmwareError(f"firmware: {command[0]}: expected it to compile, got {err}") from err
    if done.returncode:
        said = [line for line in done.stderr.splitlines() if "error" in line] or ["nothing"]
        raise FirmwareError(f"firmware: {command[0]}: expected it to compile, got {said[0]}")


def _cache() -> Path:
    from platformdirs import user_cache_path

    return Path(user_cache_path("pfwd", appauthor=False)) / "firmware"


@dataclass(frozen=True, eq=False, slots=True)
class Played:
    """What a board plays, and what it says of itself."""

    identity: Identity
    counts: NDArray[np.int32]
    """(n, channels)."""
    truth: tuple[dict[str, Any], ...] = ()
    """Of each drop, with `touch_sample`."""
    rates: tuple[float, ...] = ()
    """Hz, what it can be configured to; empty: as it is."""


def play_scenario(
    source: str | Path | Mapping[str, Any] | Scenario = "default",
    *,
    drops: int = 6,
    seed: int = 0,
) -> Played:
    """The finite-element drops of a scenario as one long row of samples.

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
    assert end is not None  # it has a last drop
    truth = tuple(
        {**drop_truth(bench, number), "touch_sample": timeline.touch_index(number)}
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
    """Recorded drops as one long row of samples, with the plate at rest in between.

    Parameters
    ----------
    records : sequence of (n, 1 + sensors) ndarray
        Load, N, and what each sensor measured, m/s or m.
    sampling_rate : float, Hz
    sensors : sequence of (role, offset)
        `geophone` or `displacement`, and the distance from the plate centre, m.
    plate_radius : float or None, m
    name : str
        Stands in for a serial number.

    Returns
    -------
    Played
        24 bits; each channel uses half of the converter's range.
    """
    peaks = np.max([np.nanmax(np.abs(record), axis=0) for record in records], axis=0)
    volts = PLAYED_RANGE / 2 / np.where(peaks > 0, peaks, 1.0)
    begins = [np.nan_to_num(record[:_BEGIN]) for record in records]
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
    quiet = round(PLAYED_REST * sampling_rate)
    generator = np.random.default_rng(0)
    parts = []
    last = begins[0][0]
    for record in [*records, records[0][:1]]:
        whole = np.nan_to_num(record)
        rest = np.linspace(last, whole[0], quiet)
        parts += [rest + noise / math.sqrt(2) * generator.standard_normal(rest.shape), whole]
        last = np.median(whole[:_BEGIN], axis=0)  # at rest: how a record ends says nothing of it
    counts = np.rint(np.concatenate(parts) * volts * (1 << 23) / PLAYED_RANGE)
    identity = Identity(
        serial_number=name[:LONGEST_NAME],
        model="PFWD core, host board",
        firmware=core_version(),
        sampling_rate=float(round(sampling_rate)),
        adc_bits=24,
        adc_range=PLAYED_RANGE,
        channels=tuple(channels),
        plate_radius=plate_radius,
    )
    return Played(identity, counts.astype(np.int32))


def write_play(path: Path, counts: NDArray[np.int32]) -> None:
    """A file of samples for the host board."""
    sets, channels = counts.shape
    data = np.ascontiguousarray(counts, dtype="<i4").tobytes()
    path.write_bytes(_HEAD.pack(_MAGIC, channels, sets) + data)


def identity_text(
    identity: Identity,
    rates: Sequence[float] = (),
    *,
    streams: bool = True,
    drop_samples: int = DROP_SAMPLES,
) -> str:
    """What the host board is told to say of itself."""

    def said(value: float | None) -> str:
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
    others = [rate for rate in rates if rate != identity.sampling_rate]
    lines = [
        f"serial_number={identity.serial_number}",
        f"model={identity.model}",
        f"firmware={identity.firmware}",
        f"adc_bits={identity.adc_bits}",
        f"adc_range={identity.adc_range!r}",
        f"plate_radius={said(identity.plate_radius)}",
        f"plate_mass={said(identity.plate_mass)}",
        f"centre_seat={int(identity.centre_sensor == 'ground')}",
        f"streams={int(streams)}",
        f"drop_samples={drop_samples}",
        f"shunt_channel={number}",
        f"shunt_counts={counts}",
        *(f"rate={rate:g}" for rate in (identity.sampling_rate, *others)),
    ]
    roles = ("unused", "load", "geophone", "displacement")
    for each in identity.channels:
        fields = (
            each.name,
            roles.index(each.role.value),
            *map(repr, (each.offset, each.sensitivity, each.zero)),
            *map(said, (each.natural_frequency, each.damping, each.shunt)),
            day(each.calibrated),
            day(each.due),
        )
        lines.append("channel=" + "|".join(map(str, fields)))
    return "\n".join(lines) + "\n"


@dataclass(frozen=True, slots=True)
class BoardOptions:
    """How the host board runs."""

    listen: str = "tcp://127.0.0.1:0"
    """Or `pty`."""
    streams: bool = True
    drop_samples: int = DROP_SAMPLES
    """0: it keeps no drops."""
    store: Path | None = None
    """File in which drops outlast the process; None: they do not."""
    store_size: int = 262_144
    memory: int = 262_144
    """Bytes for samples."""
    speed: float = 1.0
    """Times real time."""
    link_rate: float = 0.0
    """Bytes a second that the link carries; 0: as many as come."""
    begin: int = 0
    """Sample with which to begin."""
    loop: bool = False
    log: Path | None = None
    """File that gets a line for every drop that is kept."""
    flags: tuple[str, ...] = ()
    """For the compiler."""


class HostBoard:
    """The core in a process of its own.

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
            # Its standard input is its lifeline: it ends when this process does.
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
            )
        except OSError as err:
            self._folder.cleanup()
            raise FirmwareError(f"firmware: {program}: {err}") from err
        self.url = self._first_line()
        """What to open."""

    def _first_line(self) -> str:
        assert self._process.stdout is not None
        timer = threading.Timer(LONGEST_START, self._process.kill)
        timer.start()
        try:
            line = self._process.stdout.readline().decode().strip()
        finally:
            timer.cancel()
        if not line:
            self._process.wait()
            assert self._process.stderr is not None
            said = self._process.stderr.read().decode(errors="replace").strip()
            self.close()
            raise FirmwareError(said or "firmware: the board ended without a word")
        return line

    def truth(self) -> list[dict[str, Any]]:
        """What is played, one mapping per drop."""
        return list(self._truth)

    def kill(self) -> None:
        """As when the power goes."""
        self._process.kill()
        self._process.wait()

    def stop(self) -> None:
        """End it."""
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
        try:
            self._process.wait(LONGEST_STOP)
        except subprocess.TimeoutExpired:
            self.kill()

    def close(self) -> None:
        """End it and leave nothing behind."""
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
    """The compiled core that plays the drops of a scenario; open its `url`.

    Parameters
    ----------
    scenario : as for `simulators.instrument.serve`
    drops : int or None
        None: `MOST_DROPS`.
    seed : int
    rate : float
        Times real time, > 0.
    listen : str

    Raises
    ------
    FirmwareError
        If it cannot be compiled, or what is asked for cannot be played.

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
    played = play_scenario(loaded, drops=drops or MOST_DROPS, seed=seed)
    named = replace(played.identity, model="PFWD core, host board", firmware=core_version())
    options = BoardOptions(listen=listen, speed=rate)
    return HostBoard(replace(played, identity=named), options)


def core_version() -> str:
    """Version of the core's sources: the beginning of their digest."""
    digest = hashlib.sha256()
    for path in core_sources():
        digest.update(path.read_bytes())
    return f"core {digest.hexdigest()[:8]}"
