"""The loop closed on measured drops: a ladder of models, judged by points that were left out.

Needs a folder of trace files of real devices; they are not part of the project. Each drop has
ground of its own. Device effects are what the other points ask for in the middle; the ground alone
is fitted to the point that was left out (the drop, where there is one point only).
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.output import Reporter
from inversion import SurrogateLibrary
from inversion.diagnosis.model import FitScope, PointRecords
from inversion.diagnosis.problem import Point
from inversion.diagnosis.search import Search
from inversion.effects import BY_NAME
from inversion.measured.record import Record
from inversion.threads import single_threaded_blas
from pfwd_survey.files.reading import read_points
from pfwd_survey.inverting.analysis import record_of
from pfwd_survey.inverting.options import AnalysisOptions
from pfwd_survey.inverting.screening.drops import screen_point
from pfwd_survey.inverting.screening.missing import whole_part

SOIL = (
    ("half-space (the paper's ground)", ()),
    ("+ sensor lag", ("sensor_lag",)),
    ("+ geophone", ("geophone_response",)),
    ("+ stress dependence", ("stress_dependence",)),
    ("+ both", ("stress_dependence", "geophone_response")),
    ("+ unloading", ("stress_dependence", "hysteretic_unloading", "geophone_response")),
    (
        "+ rock",
        ("bedrock", "stress_dependence", "hysteretic_unloading", "geophone_response"),
    ),
    (
        "+ flight",
        ("bedrock", "stress_dependence", "hysteretic_unloading", "rebound", "geophone_response"),
    ),
)
RIG = (
    ("half-space (the paper's ground)", ()),
    ("springs and a mass", ("spring_rig",)),
    ("+ geophone", ("spring_rig", "geophone_response")),
    (
        "+ bending, unloading",
        ("spring_rig", "stress_dependence", "hysteretic_unloading", "geophone_response"),
    ),
    (
        "+ drift",
        (
            "spring_rig",
            "stress_dependence",
            "hysteretic_unloading",
            "geophone_response",
            "baseline_drift",
        ),
    ),
)
# Their sites carry labels of springs (2s1p and so on): no ground.
RIGS = frozenset({"minidyn-a"})
FREQUENCIES, DAMPINGS = (5.0, 7.0, 9.0, 11.0, 13.0), (0.05, 0.15, 0.3)
# Models of the contact phase so close to the best, over the peak, cannot be told apart.
ALIKE = 0.0015

Device = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True)
class Job:
    """One fit of one drop."""

    file: str
    drop: int
    names: tuple[str, ...]
    device: Device
    contact_only: bool = False


@dataclass(frozen=True)
class Fitted:
    """What it left, over the peak, and what it found."""

    job: Job
    contact: float
    whole: float
    tail: float
    modulus: float
    values: Mapping[str, float]


def run(arguments: list[str]) -> int:
    """Fit, leave out, print; 0, 1 when there is nothing to read."""
    parser = argparse.ArgumentParser(prog="pfwd bench measured", description=__doc__)
    parser.add_argument("folder", type=Path, help="trace files of real devices")
    parser.add_argument("--device", help="only this one")
    parser.add_argument("--jobs", type=int, default=2, help="processes (2)")
    parser.add_argument(
        "--no-curve", action="store_true", help="leave out the range of the modulus"
    )
    parser.add_argument("--figures", type=Path, metavar="FOLDER", help="draw the ladder there")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    options = parser.parse_args(arguments)
    devices = find_drops(options.folder)
    if options.device is not None:
        devices = {name: drops for name, drops in devices.items() if name == options.device}
    if not devices:
        print(f"pfwd bench measured: no drops of a device in {options.folder}", file=sys.stderr)
        return 1
    report = Reporter(arguments)
    with ProcessPoolExecutor(options.jobs, get_context("spawn")) as pool:
        ladders = {}
        for name, drops in devices.items():
            ladders[name] = climb(report, pool, name, drops)
            if name not in RIGS and not options.no_curve:
                curve(report, pool, name, drops)
    if options.figures is not None:
        draw(ladders, options.figures / "measured-ladder.svg")
    return 0


def draw(ladders: Mapping[str, Sequence[tuple[str, float, float]]], file: Path) -> None:
    """Bars of what each model leaves at points that its device effects were not fitted to."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 2.6 * len(ladders)), layout="constrained")
    FigureCanvasSVG(figure)
    rows = np.atleast_1d(figure.subplots(len(ladders), 1))
    for axes, (name, ladder) in zip(rows, ladders.items(), strict=True):
        places = np.arange(len(ladder))
        axes.bar(
            places - 0.2, [rung[1] for rung in ladder], 0.4, label="contact phase", color="0.35"
        )
        axes.bar(
            places + 0.2, [rung[2] for rung in ladder], 0.4, label="whole record", color="0.75"
        )
        axes.set_yscale("log")
        axes.set_xticks(places, [rung[0].replace(" (", "\n(") for rung in ladder], fontsize=7)
        axes.set_ylabel("rms over peak, %")
        axes.set_title(name, fontsize=9, loc="left")
        axes.legend(fontsize=7, frameon=False)
    figure.savefig(file, metadata={"Date": None})


def find_drops(folder: Path) -> dict[str, list[tuple[str, int]]]:
    """Files and numbers of the measured drops of each device; false triggers are none."""
    found: dict[str, list[tuple[str, int]]] = {}
    for file in sorted(folder.glob("*.csv")):
        for point in read_points(str(file)):
            screenings = screen_point(point)
            found.setdefault(str(point.setup.device), []).extend(
                (str(file), drop.number)
                for drop, screening in zip(point.drops, screenings, strict=True)
                if screening.status == "measured"
            )
    return found


def climb(
    report: Reporter, pool: ProcessPoolExecutor, name: str, drops: Sequence[tuple[str, int]]
) -> list[tuple[str, float, float]]:
    """The ladder of a device: model, contact phase and whole record of left-out points, %."""
    ladder = []
    points = len({file for file, _ in drops})
    report.title(f"{name}: {len(drops)} drops at {points} points; medians, rms over peak in %")
    for title, names in RIG if name in RIGS else SOIL:
        free = list(pool.map(fit_drop, [Job(*drop, names, {}) for drop in drops]))
        shared = [effect for effect in names if BY_NAME[effect].scope == "device"]
        held, contact = free, []
        devices = [others(free, drop, shared) for drop in drops]
        if shared:
            jobs = [Job(*drop, names, d) for drop, d in zip(drops, devices, strict=True)]
            held = list(pool.map(fit_drop, jobs))
        jobs = [Job(*drop, names, d, True) for drop, d in zip(drops, devices, strict=True)]
        contact = list(pool.map(fit_drop, jobs))
        report.record(
            device=name,
            model=title,
            left_out_contact=_median(held, lambda drop_fit: 100 * drop_fit.contact),
            left_out_whole=_median(held, lambda drop_fit: 100 * drop_fit.whole),
            contact_fit_contact=_median(contact, lambda drop_fit: 100 * drop_fit.contact),
            contact_fit_tail=_median(contact, lambda drop_fit: 100 * drop_fit.tail),
            fitted_contact=_median(free, lambda drop_fit: 100 * drop_fit.contact),
            fitted_whole=_median(free, lambda drop_fit: 100 * drop_fit.whole),
            modulus_mpa=None
            if name in RIGS
            else _median(held, lambda drop_fit: drop_fit.modulus / 1e6),
        )
        by_contact = [drop_fit.contact for drop_fit in contact]
        whole = _median(held, lambda drop_fit: 100 * drop_fit.whole)
        ladder.append((title, 100 * float(np.median(by_contact)), whole))
        if names:
            values = {key: _median(free, partial(_value, key)) for key in free[0].values}
            report.record(device=name, values_of=title, **values)
    return ladder


def others(fitted: Sequence[Fitted], drop: tuple[str, int], shared: Sequence[str]) -> Device:
    """Middle values of device effects at the other points, or at the other drops of one point."""
    far = [drop_fit for drop_fit in fitted if drop_fit.job.file != drop[0]]
    far = far or [drop_fit for drop_fit in fitted if (drop_fit.job.file, drop_fit.job.drop) != drop]
    return {
        name: {
            parameter.name: _median(far, partial(_value, f"{name}.{parameter.name}"))
            for parameter in BY_NAME[name].parameters
        }
        for name in shared
    }


def curve(
    report: Reporter, pool: ProcessPoolExecutor, name: str, drops: Sequence[tuple[str, int]]
) -> None:
    """What the contact phase alone says of the modulus, over geophones that do as well."""
    names = SOIL[-2][1]
    seated = [drop for drop in drops if drop[1] > 1]
    jobs, places = [], [(f, h) for f in FREQUENCIES for h in DAMPINGS]
    for frequency, damping in places:
        device = {"geophone_response": {"natural_frequency": frequency, "damping": damping}}
        jobs += [Job(*drop, names, device, True) for drop in seated]
    found = list(pool.map(fit_drop, jobs))
    parts = [found[i * len(seated) : (i + 1) * len(seated)] for i in range(len(places))]
    misfits = [_median(part, lambda drop_fit: drop_fit.contact) for part in parts]
    moduli = [_median(part, lambda drop_fit: drop_fit.modulus / 1e6) for part in parts]
    report.title(f"{name}: contact phase of seated drops, geophone given (Hz, -); misfit in %, MPa")
    for (frequency, damping), misfit, modulus in zip(places, misfits, moduli, strict=True):
        report.record(
            device=name,
            natural_frequency=frequency,
            damping=damping,
            contact=100 * misfit,
            modulus_mpa=modulus,
        )
    alike = [m for m, left in zip(moduli, misfits, strict=True) if left < min(misfits) + ALIKE]
    report.record(device=name, alike=len(alike), lowest_mpa=min(alike), highest_mpa=max(alike))


def fit_drop(job: Job) -> Fitted:
    """One drop on ground of its own, every sample alike."""
    record = _record(job.file, job.drop)
    with single_threaded_blas():
        point = Point(PointRecords(job.file, (record,), (job.drop,)), SurrogateLibrary())
        device = {name: dict(values) for name, values in job.device.items()}
        scope = FitScope(contact_only=job.contact_only, plain=True)
        search = Search([point], fixed=device, scope=scope)
        found = search.named([name for name in job.names if name not in device]).fit
        (predicted,) = found.problem.predict(0, found.device, found.own[0])
        ground = point.ground(found.problem.own[0], found.own[0])
    model = point.drops[0]
    late = model.context.time > model.context.contact_end
    left = (predicted - model.observed)[:, late] / model.peak[:, None]
    values = {
        f"{unknown.effect.name}.{unknown.parameter.name}": float(
            unknown.parameter.value(unit_value)
        )
        for unknown, unit_value in zip(found.unknowns, found.unit_values, strict=True)
        if unknown.effect is not None
    }
    return Fitted(
        job,
        model.residual_over_peak(predicted, contact_only=True),
        model.residual_over_peak(predicted, contact_only=False),
        float(np.sqrt(np.mean(left**2))),
        ground.modulus,
        values,
    )


def _record(file: str, number: int) -> Record:
    for point in read_points(file):
        for drop in point.drops:
            if drop.number == number:
                return record_of(whole_part(drop)[0], point.setup, AnalysisOptions())
    raise LookupError(f"{file}: no drop {number}")


def _median(fitted: Sequence[Fitted], value: Callable[[Fitted], float]) -> float:
    return float(np.median([value(drop_fit) for drop_fit in fitted]))


def _value(key: str, drop_fit: Fitted) -> Any:
    return drop_fit.values[key]
