"""``pfwd demo``: the main job with nothing attached."""

import argparse
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pfwd.analysis.options import AnalysisOptions
from pfwd.files.folders import is_survey
from pfwd.files.output_path import require_writable
from pfwd.judging import JobRequest
from pfwd.procedures import Procedure, find_procedure
from pfwd.session.measure import measure, stopped_by_signals
from pfwd.session.session import SessionPlan
from simulators.firmware import BoardOptions, HostBoard, Played, play_records, serve_firmware
from simulators.instrument import SimulatedInstrument, serve
from simulators.mesh import SimulationError
from tui.commands.log import STATUS_OF_ENDING
from tui.log_file import close_log, open_log
from tui.measuring_options import try_output
from tui.output import next_commands, on_terminal, say
from tui.session_lines import SessionLines

DROPS, RATE = 6, 3.0
"""Of the demonstration in lines: a whole point in ten seconds."""

SCENARIO, PROCEDURE, TARGET = "compacted", "tp-bf-stb-b8.3", 45e6
"""What is shown where no scenario is named, and the target, Pa: a newcomer sees a point that passes
by a procedure, and its ground is above the target too (52 MPa)."""


def run(args: argparse.Namespace) -> int:
    """Measure with a simulated instrument, which hands over nothing but what it sends.

    What was simulated is told when all is measured, to standard error.
    """
    if args.play and not args.firmware:
        say("demo: --play: expected with --firmware, whose core plays the file, got without")
        return 2
    if args.output:
        try_output(args.output)
    if not (args.json or args.lines or args.play) and on_terminal():
        return _on_screen(args)
    if args.plot:
        require_writable(args.plot, "--plot")
    folder = Path(args.output) if args.output else Path(tempfile.mkdtemp(prefix="pfwd-demo-"))
    say(f"recording into {folder}")
    scenario = _scenario(args)
    drops = args.drops or DROPS
    rate = RATE if args.rate is None else args.rate
    instrument: SimulatedInstrument | HostBoard
    try:
        if args.play:
            played = _played(args.play, args.drops)
            drops = drops if args.drops else len(played.truth)
            instrument = HostBoard(played, BoardOptions(speed=rate))
        else:
            start = serve_firmware if args.firmware else serve
            instrument = start(scenario, drops=drops, seed=args.seed, rate=rate)
    except SimulationError as err:
        say(f"demo: {err}")
        return 2
    lines = SessionLines(as_json=args.json, analysed=True, bell=False)
    plan = _plan(args, folder, None)
    plan = replace(plan, drops=drops)
    with instrument:
        what = "simulated instrument"
        if args.firmware:
            what = f"compiled core playing {args.play or 'simulated drops'}"
        say(f"{what} at {instrument.url}")
        handler = open_log(folder)
        try:
            ending = measure(instrument.url, folder, lines.tell, plan, control=stopped_by_signals)
            lines.rest()
        finally:
            close_log(handler)
        opening, reporting = next_commands(folder)
        say(f"next: {opening}  (the drops on the screen)")
        say(f"next: {reporting}  (the report)")
        instrument.stop()
        try:
            truth = instrument.truth()
        except SimulationError as err:
            say(f"demo: {err}")
            return 1
        for line in () if args.play else truth_lines(truth, lines.moduli):
            print(line, file=sys.stderr, flush=True)
    if args.plot:
        _plot(folder, args.plot)
    return STATUS_OF_ENDING[ending]


def _scenario(args: argparse.Namespace) -> str:
    """Return the scenario: the named one, else that of the demonstration or of the core's."""
    return args.scenario or ("default" if args.firmware else SCENARIO)


def _plan(args: argparse.Namespace, folder: Path, usual: Procedure | None) -> SessionPlan:
    """Return the plan of the session: judged by a procedure, or by `usual` for a named scenario.

    A survey that is there already keeps its own job.
    """
    plan = SessionPlan(options=AnalysisOptions(seed=args.seed), usual_procedure=usual)
    if args.play or _scenario(args) != SCENARIO or is_survey(folder):
        return plan
    job = JobRequest(target=TARGET)
    return replace(plan, usual_procedure=find_procedure(PROCEDURE), job=job)


def _played(file: str, drops: int | None) -> Played:
    """The drops of a trace file as samples of a converter."""
    from pfwd.files.traces import read_traces

    point = read_traces(file)
    chosen = point.drops[:drops]
    roles = {"velocity": "geophone", "displacement": "displacement"}
    sensors = [(roles[each.quantity], each.offset) for each in chosen[0].channels]
    records = [
        np.column_stack([drop.load, *(each.values for each in drop.channels)]) for drop in chosen
    ]
    rate, radius = chosen[0].sampling_rate, point.setup.plate_radius or None
    played = play_records(records, rate, sensors, radius, Path(file).stem)
    return replace(played, truth=tuple({"drop": drop.number} for drop in chosen))


def _on_screen(args: argparse.Namespace) -> int:
    from pfwd.procedures import plain_procedure
    from tui.screen.session.sources import DemoSource
    from tui.screen.show import show

    found: dict[int, float] = {}
    scenario = _scenario(args)
    folder = Path(args.output) if args.output else Path(tempfile.mkdtemp(prefix="pfwd-demo-"))
    source = DemoSource(
        scenario,
        folder,
        _plan(args, folder, plain_procedure()),
        drops=args.drops or (DROPS if scenario == SCENARIO else None),
        seed=args.seed,
        rate=1.0 if args.rate is None else args.rate,
        firmware=args.firmware,
    )
    status = show(source, "demo", moduli=found)
    for line in truth_lines([drop for drop in source.truth if drop["drop"] in found], found):
        print(line, file=sys.stderr, flush=True)
    if args.plot:
        _plot(folder, args.plot)
    return status


def truth_lines(truth: Sequence[Mapping[str, Any]], found: Mapping[int, float]) -> list[str]:
    """What was simulated, beside what was found of it.

    Parameters
    ----------
    truth : sequence of mapping
        One a drop, with ``drop`` and ``modulus_pa``.
    found : mapping of int to float
        Modulus by drop, Pa.
    """
    lines = ["what was simulated, hidden until now:"]
    for drop in truth:
        number, modulus = drop["drop"], drop["modulus_pa"]
        line = f"  drop {number}: E {modulus / 1e6:.2f} MPa"
        if number in found:
            error = 100 * (found[number] / modulus - 1)
            line += f", found {found[number] / 1e6:.2f} MPa, {error:+.2f} %"
        lines.append(line)
    return lines


def _plot(folder: Path, plot: str) -> None:
    from pfwd.analysis.analyse import analyse_files
    from pfwd.analysis.plots import plot_outcomes

    outcomes = list(analyse_files([str(folder)], AnalysisOptions()))
    for picture in plot_outcomes(outcomes, plot):
        say(f"plot {picture}")
