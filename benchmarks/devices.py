"""Agreement of different devices on the modulus of the same ground.

Ten uniform grounds, with and without rock below, are loaded by finite-element models of ten devices
with different plates, masses, pulses and sensors, with a load cell or with an assumed load. Every
drop passes through a trace file, which declares plate, mass and Poisson's ratio and nothing about
the ground. It is inverted by the default method, with an unknown and with a declared depth of rock.
Moduli of the peak method and of the inversion are reported relative to the true ones, and to those
of the first device.

The finite-element drops are cached (--cache), so that a second run takes a minute.
"""

import argparse
import hashlib
import math
import statistics
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import astuple, dataclass, field
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal

import numpy as np
from platformdirs import user_cache_path

from benchmarks.output import Reporter
from inversion import SurrogateLibrary
from inversion.records import known
from inversion.threads import single_threaded_blas
from pfwd.analysis.analyse import analyse_point
from pfwd.analysis.options import AnalysisOptions
from pfwd.files.traces import read_traces
from simulators.drop import DropSimulator, Hammer, SimulatedDrop
from simulators.mesh import Ground, Plate
from simulators.traces import Recording, write_traces

TARGET = 0.03
"""Largest relative deviation of a modulus from the true one, and from that of the first device."""

_TIME_STEP = 1e-4
_HAMMER_SPEED_M_S = 3.0  # m/s, of the hammer
_NOISE_OVER_PEAK = 0.002  # rms over the peak of each channel
_CACHE_VERSION = 1


def hammer_of(peak: float, pulse: float, speed: float) -> Hammer:
    """Return the hammer that has this peak force (N) and pulse duration (s) on rigid ground.

    ``speed`` is its speed at the impact, m/s.
    """
    mass = peak * pulse / (math.pi * speed)
    return Hammer(mass, mass * (math.pi / pulse) ** 2, speed)


@dataclass(frozen=True)
class Device:
    """Device with its falling weight and its sensors."""

    name: str
    radius: float
    """Radius of the plate, m."""
    plate_mass: float
    """Mass between load cell and ground, kg."""
    pulse: float
    """Pulse duration of hammer and spring on rigid ground, s."""
    pressure: float = 100e3
    """Mean pressure under the plate at the peak, on rigid ground, Pa."""
    quantity: Literal["velocity", "displacement"] = "velocity"
    centre: Literal["plate", "ground"] = "plate"
    """Object under the centre sensor."""
    offsets: tuple[float, ...] = (0.0,)
    """Distances of the sensors from the centre, m."""
    load: Literal["cell", "assumed"] = "cell"
    """"cell": measured by a load cell; "assumed": the half-sine on rigid ground."""

    @property
    def peak(self) -> float:
        """Nominal peak force on rigid ground, N."""
        return self.pressure * math.pi * self.radius**2

    @property
    def hammer(self) -> Hammer:
        """Falling weight on its spring."""
        return hammer_of(self.peak, self.pulse, _HAMMER_SPEED_M_S)


DEVICES = (
    Device("0.15 m, 10 kg, 15 ms", 0.15, 10.0, 0.015),
    Device("0.15 m, 18 kg, 22 ms", 0.15, 18.0, 0.022, quantity="displacement"),
    Device("0.05 m, 2 kg, 8 ms", 0.05, 2.0, 0.008, 300e3),
    Device("0.10 m, 6 kg, 12 ms", 0.10, 6.0, 0.012, 200e3, "displacement"),
    Device("0.20 m, 20 kg, 20 ms", 0.20, 20.0, 0.020),
    Device("0.30 m, 40 kg, 30 ms", 0.30, 40.0, 0.030),
    Device("0.15 m, 12 kg, 18 ms, on the ground", 0.15, 12.0, 0.018, centre="ground"),
    Device("0.15 m, 10 kg, 15 ms, three sensors", 0.15, 10.0, 0.015, offsets=(0.0, 0.3, 0.6)),
    Device("0.15 m, 15 kg, 17 ms, load assumed", 0.15, 15.0, 0.017, load="assumed"),
    Device("0.10 m, 9 kg, 17 ms, load assumed", 0.10, 9.0, 0.017, 200e3, load="assumed"),
)


@dataclass(frozen=True)
class Site:
    """Uniform ground: modulus (Pa), viscosity (Pa s), density (kg/m3), depth of rock (m)."""

    modulus: float
    viscosity: float
    poisson_ratio: float
    density: float
    depth: float
    """Depth of the rock, m; infinite: no rock."""

    @property
    def ground(self) -> Ground:
        """Ground of the simulator."""
        return Ground.uniform(
            self.modulus, self.viscosity, self.density, self.poisson_ratio, self.depth
        )

    @property
    def name(self) -> str:
        """Name for the report."""
        below = "no rock" if math.isinf(self.depth) else f"rock at {self.depth:g} m"
        return f"{self.modulus / 1e6:g} MPa, nu {self.poisson_ratio:g}, {below}"


SITES = (
    Site(15e6, 20e3, 0.45, 1750.0, math.inf),
    Site(25e6, 30e3, 0.35, 1800.0, 1.0),
    Site(30e6, 40e3, 0.40, 1850.0, math.inf),
    Site(40e6, 54e3, 0.35, 1900.0, 0.6),
    Site(50e6, 50e3, 0.30, 1900.0, 2.0),
    Site(60e6, 60e3, 0.25, 1950.0, math.inf),
    Site(75e6, 60e3, 0.40, 2000.0, 1.5),
    Site(90e6, 80e3, 0.35, 2000.0, math.inf),
    Site(120e6, 80e3, 0.30, 2050.0, 3.0),
    Site(150e6, 90e3, 0.25, 2100.0, math.inf),
)


Depth = Literal["unknown", "declared"]
DEPTHS: tuple[Depth, ...] = ("unknown", "declared")


@dataclass(frozen=True)
class Case:
    """One device on one ground, and whether the depth of rock is declared."""

    device: Device
    site: Site
    depth: Depth = "unknown"
    cache: Path | None = field(compare=False, default=None)
    """Folder for simulated drops."""


@dataclass(frozen=True)
class Reading:
    """Moduli that one device gives for one ground, Pa; NaN: no result."""

    case: Case
    peak: float
    """Modulus of the peak method, Pa."""
    inverted: float
    low: float
    high: float
    """Ends of the 95 % interval of the inverted modulus, Pa."""
    explained: bool
    """True if the inversion reports that its model explains the record."""

    @property
    def covered(self) -> bool:
        """True if the interval contains the true modulus."""
        return self.low <= self.case.site.modulus <= self.high


def simulate(case: Case) -> SimulatedDrop:
    """Return the finite-element drop of a case without noise, from the cache if it is there."""
    device, site = case.device, case.site
    hammer = device.hammer
    offsets = device.offsets[1:]
    text = repr((_CACHE_VERSION, astuple(site), device.radius, device.plate_mass, hammer, *offsets))
    path = None
    if case.cache is not None:
        path = case.cache / f"drop-{hashlib.sha256(text.encode()).hexdigest()[:24]}.npz"
        if path.is_file():
            with np.load(path) as stored:
                return SimulatedDrop(**{name: stored[name] for name in stored.files})
    # On soft ground the plate stays in contact with the hammer longer than the pulse.
    duration = round(4.0 * device.pulse + 0.01, 3)
    plate = Plate(device.radius, device.plate_mass)
    simulator = DropSimulator(
        site.ground, plate, device.offsets, duration, _TIME_STEP, hammer.pulse_duration
    )
    drop = simulator.run(hammer)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part.npz")
        np.savez(part, **vars(drop))
        part.replace(path)
    return drop


def recorded(device: Device, drop: SimulatedDrop) -> SimulatedDrop:
    """Return the drop as the device records it.

    If the device assumes its load, the assumed load replaces the true one.

    The assumed pulse begins exactly at the first contact, although a device cannot know that time.
    """
    if device.load == "cell":
        return drop
    inside = drop.time < device.pulse
    load = np.where(inside, device.peak * np.sin(np.pi * drop.time / device.pulse), 0.0)
    return SimulatedDrop(**(vars(drop) | {"load": load}))


def read(case: Case) -> Reading:
    """Simulate, write, read and invert the drop of one case."""
    device, site = case.device, case.site
    with single_threaded_blas():
        drop = recorded(device, simulate(case))
    motion = drop.ground_velocity if device.quantity == "velocity" else drop.ground_displacement
    recording = Recording(
        quantity=device.quantity,
        load_noise=0.0 if device.load == "assumed" else _NOISE_OVER_PEAK * float(np.max(drop.load)),
        sensor_noise=_NOISE_OVER_PEAK * float(np.max(np.abs(motion))),
    )
    seed = int.from_bytes(hashlib.sha256(f"{device.name} {site.name}".encode()).digest()[:4], "big")
    plate = Plate(device.radius, device.plate_mass)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drop.csv"
        declared = {"centre_sensor": device.centre}
        write_traces(path, [drop], plate, site.poisson_ratio, recording, seed, declared)
        point = read_traces(path)
    options = AnalysisOptions()
    if case.depth == "declared":
        options = AnalysisOptions(bedrock_depth="none" if math.isinf(site.depth) else site.depth)
    (analysis,) = analyse_point(point, options, SurrogateLibrary())
    result = analysis.result
    if result is None:
        nan = math.nan
        return Reading(case, nan, nan, nan, nan, False)
    low, high = known(result.modulus_interval_pa)
    peak, modulus = known(result.peak_modulus_pa), known(result.modulus_pa)
    return Reading(case, peak, modulus, low, high, bool(result.explained))


def run(arguments: list[str]) -> int:
    """Print the deviations; return the exit status: 0, or 1 if a target is missed."""
    parser = argparse.ArgumentParser(prog="pfwd bench devices", description=__doc__)
    parser.add_argument("--short", action="store_true", help="three grounds, six devices")
    parser.add_argument("--jobs", type=int, default=2, help="processes (2)")
    parser.add_argument("--cache", type=Path, help="folder for simulated drops")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    options = parser.parse_args(arguments)
    report = Reporter(arguments)
    cache = options.cache or user_cache_path("pfwd", appauthor=False) / "bench"
    devices = DEVICES if not options.short else (*DEVICES[:1], *DEVICES[2:4], *DEVICES[6:9])
    sites = SITES if not options.short else SITES[1:4]
    cases = [
        Case(device, site, depth, cache)
        for device, site in product(devices, sites)
        for depth in DEPTHS
    ]
    # Spawned on every platform, because a fork of a process with threads may hang.
    with ProcessPoolExecutor(options.jobs, get_context("spawn")) as pool:
        # Both depths of a drop run in one process; the second reads it from the cache.
        readings = list(pool.map(read, cases, chunksize=len(DEPTHS)))
    status = 0
    for depth in DEPTHS:
        status |= summarise(report, [r for r in readings if r.case.depth == depth])
    return status


def summarise(report: Reporter, readings: Sequence[Reading]) -> int:
    """Print the tables for unknown or declared depth.

    Return 1 if a device with a load cell misses the target.
    """
    depth = readings[0].case.depth
    devices = list(dict.fromkeys(reading.case.device for reading in readings))
    sites = list(dict.fromkeys(reading.case.site for reading in readings))
    by_case = {(r.case.device, r.case.site): r for r in readings}
    reference = devices[0]
    report.title(f"depth of rock {depth}: moduli over the truth (median, lowest, highest ground)")
    for device in devices:
        _line(report, "truth", device, [by_case[device, site] for site in sites], None)
    report.title(f"depth of rock {depth}: moduli over those of the first device")
    first = [by_case[reference, site] for site in sites]
    for device in devices[1:]:
        _line(report, "first device", device, [by_case[device, site] for site in sites], first)
    report.title(f"depth of rock {depth}: highest over lowest of the devices with a load cell")
    measuring = [device for device in devices if device.load == "cell"]
    for site in sites:
        of_site = [by_case[device, site] for device in measuring]
        report.record(
            ground=site.name,
            depth=depth,
            devices=len(of_site),
            peak_method=_spread([r.peak for r in of_site]),
            inverted=_spread([r.inverted for r in of_site]),
        )
    return _verdict(report, [by_case[key] for key in product(measuring, sites)], first)


def _line(
    report: Reporter,
    over: str,
    device: Device,
    readings: Sequence[Reading],
    first: Sequence[Reading] | None,
) -> None:
    peak_base = [r.peak for r in first] if first else [r.case.site.modulus for r in readings]
    base = [r.inverted for r in first] if first else [r.case.site.modulus for r in readings]
    peak = [r.peak / b for r, b in zip(readings, peak_base, strict=True)]
    inverted = [r.inverted / b for r, b in zip(readings, base, strict=True)]
    more = {}
    if first is None:
        more = {
            "truth_in_interval": f"{sum(r.covered for r in readings)}/{len(readings)}",
            "explained": f"{sum(r.explained for r in readings)}/{len(readings)}",
        }
    report.record(
        device=device.name,
        depth=readings[0].case.depth,
        over=over,
        peak_median=statistics.median(peak),
        peak_lowest=min(peak),
        peak_highest=max(peak),
        inverted_median=statistics.median(inverted),
        inverted_lowest=min(inverted),
        inverted_highest=max(inverted),
        **more,
    )


def _spread(values: Sequence[float]) -> float:
    return max(values) / min(values)


def _verdict(report: Reporter, measured: Sequence[Reading], first: Sequence[Reading]) -> int:
    """Report devices with a load cell beyond the target; return 1 if there are any."""
    reference = {r.case.site: r.inverted for r in first}
    deviations = []
    for reading in measured:
        bases = (reading.case.site.modulus, reference[reading.case.site])
        deviations.append((max(abs(reading.inverted / base - 1.0) for base in bases), reading))
    missed = [(d, r) for d, r in deviations if not d <= TARGET]
    depth = measured[0].case.depth
    report.title(f"depth of rock {depth}: devices with a load cell outside of {100 * TARGET:g} %")
    for _, reading in sorted(missed, key=lambda each: -each[0]):
        truth = reading.case.site.modulus
        report.record(
            device=reading.case.device.name,
            ground=reading.case.site.name,
            depth=depth,
            inverted_over_truth=reading.inverted / truth,
            interval_over_truth=f"{reading.low / truth:.3f} to {reading.high / truth:.3f}",
        )
    worst = max(d for d, _ in deviations)
    from_truth = [abs(r.inverted / r.case.site.modulus - 1.0) for r in measured]
    report.record(
        depth=depth,
        readings=len(measured),
        within_target=len(measured) - len(missed),
        within_target_of_the_truth=sum(each <= TARGET for each in from_truth),
        median_deviation_from_truth=statistics.median(from_truth),
        worst_deviation=worst,
        target=TARGET,
        met=not missed,
    )
    return 1 if missed else 0
