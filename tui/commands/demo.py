"""``pfwd demo``: measurement, recording and inversion with a simulated instrument."""

import argparse
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tui.arguments import add_expert_group, add_json, add_plot, add_seed, count, positive
from tui.output import next_commands, on_terminal, say

if TYPE_CHECKING:
    from pfwd.procedures import Procedure
    from pfwd.session.session import SessionPlan
    from pfwd.session.setup_file import MeasuringSetup
    from simulators.firmware import Played
    from simulators.instrument import SimulatedInstrument
    from simulators.loggers import LoggerName

DROPS, RATE = 6, 3.0
"""Number of drops, and speed over real time, if lines are printed: a point takes twelve seconds."""

SCENARIO, PROCEDURE, TARGET = "compacted", "tp-bf-stb-b8.3", 45e6
"""Default scenario, its procedure, and its target, Pa. The point passes, and the true modulus of
the ground, 52 MPa, is above the target as well."""

FIRST_DROP = 3.0
"""Shortest real time from the start of sampling to the first drop, s. The check of the load cell
must end before it, on a busy computer as well."""

MOST_SAMPLES_LATE = 100
"""Largest number of samples from the touch of a simulated drop to the recorded trigger, or back."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd demo`` and its description to the parser."""
    parser.description = (
        "Runs a simulated instrument on a virtual serial port (TCP where there is none). Its drops "
        "are measured, recorded and inverted like those of a real one, and judged by the procedure "
        "tp-bf-stb-b8.3 against a target of 45 MPa. The simulated moduli are shown at the end."
    )
    parser.add_argument(
        "--drops",
        type=count,
        metavar="N",
        help="number of drops (default: 6; another scenario on the screen: no limit)",
    )
    parser.add_argument(
        "-o", "--output", metavar="SURVEY", help="folder to record into (default: a temporary one)"
    )
    parser.add_argument(
        "--lines", action="store_true", help="print lines on a terminal too, instead of the screen"
    )
    add_plot(parser)
    add_json(parser, "drop")
    expert = add_expert_group(parser)
    expert.add_argument(
        "--scenario",
        metavar="NAME",
        help="as for simulate; only the default has a procedure and a target (default: compacted; "
        "with --firmware: default)",
    )
    expert.add_argument(
        "--rate",
        type=positive,
        metavar="X",
        help="speed as a multiple of real time, in which a drop comes every 5 s (default: 3; on "
        "the screen: 1)",
    )
    expert.add_argument(
        "--firmware",
        action="store_true",
        help="compile the instrument's firmware and let it play the drops (needs a C compiler, or "
        "pip install 'pfwd[firmware]')",
    )
    expert.add_argument(
        "--play", metavar="FILE", help="with --firmware: trace file whose drops are played"
    )
    expert.add_argument(
        "--logger",
        choices=("dataq", "dataq-ethernet", "labjack"),
        help="measure with a simulated data logger and a setup file, line by line, in real time",
    )
    add_seed(expert)


def run(args: argparse.Namespace) -> int:
    """Measure with a simulated instrument, then print the simulated moduli for comparison.

    The measurement uses nothing of the simulation but what the instrument sends.
    """
    from pfwd.files.output_path import require_writable
    from pfwd.session.measure import measure, stopped_by_signals
    from simulators.firmware import BoardOptions, HostBoard, serve_firmware
    from simulators.instrument import serve
    from simulators.mesh import SimulationError
    from tui.log_file import survey_log
    from tui.measuring_options import try_output
    from tui.session_lines import STATUS_OF_ENDING, SessionLines

    if args.play and not args.firmware:
        say("demo: --play: expected --firmware, which plays the file, got none")
        return 2
    if args.output:
        try_output(args.output)
    if not (args.json or args.lines or args.play or args.logger) and on_terminal():
        return _on_screen(args)
    if args.plot:
        require_writable(args.plot, "--plot")
    folder = Path(args.output) if args.output else Path(tempfile.mkdtemp(prefix="pfwd-demo-"))
    say(f"recording into {folder}")
    drops = args.drops or DROPS
    rate = RATE if args.rate is None else args.rate
    if args.logger:
        rate = 1.0  # a logger has no means to say that it is not in real time
    scenario = _scenario(args, rate)
    setup = _logger_setup(scenario, args.logger) if args.logger else None
    instrument: SimulatedInstrument | HostBoard
    try:
        if args.play:
            played = _played(args.play, args.drops)
            drops = drops if args.drops else len(played.truth)
            instrument = HostBoard(played, BoardOptions(speed=rate))
        elif args.firmware:
            instrument = serve_firmware(scenario, drops=drops, seed=args.seed, rate=rate)
        else:
            instrument = serve(scenario, drops=drops, seed=args.seed, rate=rate, logger=args.logger)
    except SimulationError as err:
        say(f"demo: {err}")
        return 2
    lines = SessionLines(as_json=args.json, analysed=True, bell=False)
    plan = replace(_plan(args, folder), drops=drops)
    if setup is not None:
        plan = replace(plan, setup=setup)
    with instrument:
        instrument_text = f"simulated {args.logger or 'instrument'}"
        if args.firmware:
            instrument_text = f"compiled firmware playing {args.play or 'simulated drops'}"
        say(f"{instrument_text} at {instrument.url}")
        with survey_log(folder):
            ending = measure(
                instrument.url, folder, lines.print_event, plan, control=stopped_by_signals
            )
            lines.finish()
        opening, reporting = next_commands(folder)
        say(f"next: {opening}  (the drops on the screen)")
        say(f"next: {reporting}  (the report)")
        instrument.stop()
        try:
            truth = instrument.truth()
        except SimulationError as err:
            say(f"demo: {err}")
            return 1
        measured = {} if args.play else measured_moduli(truth, folder, lines.moduli)
        for line in () if args.play else truth_lines(truth, measured):
            print(line, file=sys.stderr, flush=True)
    if args.plot:
        _plot(folder, args.plot)
    return STATUS_OF_ENDING[ending]


def _scenario(args: argparse.Namespace, rate: float) -> str | dict[str, Any]:
    """Return the scenario: that of the option, else the default.

    The first drop of a built-in one comes `FIRST_DROP` of real time after the start, unless it has
    faults, whose times count from the start as well.
    """
    from simulators.instrument.scenario import builtin_scenarios, load_scenario

    name = _scenario_name(args)
    if rate <= 1 or name not in builtin_scenarios():
        return name
    scenario = load_scenario(name)
    if scenario.faults or scenario.link.dialect != "pfwd":
        return name
    return {"base": name, "drops": {"first": FIRST_DROP * rate}}


def _scenario_name(args: argparse.Namespace) -> str:
    return args.scenario or ("default" if args.firmware else SCENARIO)


def _plan(
    args: argparse.Namespace, folder: Path, default: "Procedure | None" = None
) -> "SessionPlan":
    """Return the plan of the session.

    The default scenario has a procedure and a target; other scenarios have `default`. An existing
    survey keeps its own.
    """
    from pfwd.analysis.options import AnalysisOptions
    from pfwd.files.folders import is_survey
    from pfwd.judging import JobRequest
    from pfwd.procedures import find_procedure
    from pfwd.session.session import SessionPlan

    plan = SessionPlan(options=AnalysisOptions(seed=args.seed), default_procedure=default)
    if args.play or _scenario_name(args) != SCENARIO or is_survey(folder):
        return plan
    job = JobRequest(target=TARGET)
    return replace(plan, default_procedure=find_procedure(PROCEDURE), job=job)


def _logger_setup(scenario: str | Mapping[str, Any], name: "LoggerName") -> "MeasuringSetup":
    """Return what the setup file of a simulated logger declares."""
    from pfwd.session.setup_file import parse_setup
    from simulators.instrument.scenario import load_scenario
    from simulators.loggers import logger_setup

    return parse_setup(logger_setup(load_scenario(scenario), name), "setup of the simulated logger")


def _played(file: str, drops: int | None) -> "Played":
    """Return the drops of a trace file as raw samples for the firmware."""
    import numpy as np

    from pfwd.files.traces import read_traces
    from simulators.firmware import play_records

    point = read_traces(file)
    chosen = point.drops[:drops]
    sensors = [(each.quantity, each.offset) for each in chosen[0].channels]
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

    moduli: dict[int, float] = {}
    rate = 1.0 if args.rate is None else args.rate
    folder = Path(args.output) if args.output else Path(tempfile.mkdtemp(prefix="pfwd-demo-"))
    source = DemoSource(
        _scenario(args, rate),
        folder,
        _plan(args, folder, plain_procedure()),
        drops=args.drops or (DROPS if _scenario_name(args) == SCENARIO else None),
        seed=args.seed,
        rate=rate,
        firmware=args.firmware,
    )
    status = show(source, "demo", moduli=moduli)
    measured = measured_moduli(source.truth, folder, moduli)
    for line in truth_lines([drop for drop in source.truth if drop["drop"] in measured], measured):
        print(line, file=sys.stderr, flush=True)
    if args.plot:
        _plot(folder, args.plot)
    return status


def truth_lines(truth: Sequence[Mapping[str, Any]], moduli: Mapping[int, float]) -> list[str]:
    """Return lines of text that compare measured moduli with simulated ones.

    Parameters
    ----------
    truth : sequence of mapping
        Simulated drops with the keys ``drop`` and ``modulus_pa``.
    moduli : mapping of int to float
        Measured modulus by the number of the simulated drop, Pa.
    """
    lines = ["simulated moduli, which the measurement did not use:"]
    for drop in truth:
        number, modulus = drop["drop"], drop["modulus_pa"]
        line = f"  drop {number}: E {modulus / 1e6:.2f} MPa"
        if number in moduli:
            error = 100 * (moduli[number] / modulus - 1)
            line += f", measured {moduli[number] / 1e6:.2f} MPa, {error:+z.2f} %"
        lines.append(line)
    return lines


def measured_moduli(
    truth: Sequence[Mapping[str, Any]], folder: Path, moduli: Mapping[int, float]
) -> dict[int, float]:
    """Return the measured moduli, Pa, by the number of the simulated drop.

    A recorded drop belongs to the simulated one at whose touch it begins, because a drop may be
    missing in the survey. Simulated data loggers do not know the index of the touch; their drops
    are recorded in order.
    """
    from pfwd.files.opening import survey_content

    if not (moduli and all("touch_sample" in drop for drop in truth)):
        return dict(moduli)
    measured = {}
    for recorded in survey_content(folder).drops:
        if recorded.number not in moduli or recorded.key is None:
            continue
        stream, trigger = map(int, recorded.key.split("/")[1:3])
        for drop in truth:
            late = trigger - drop["touch_sample"]
            if drop.get("stream", stream) == stream and abs(late) <= MOST_SAMPLES_LATE:
                measured[drop["drop"]] = moduli[recorded.number]
    return measured


def _plot(folder: Path, plot: str) -> None:
    from pfwd.analysis.analyse import analyse_files
    from pfwd.analysis.options import AnalysisOptions
    from pfwd.analysis.plots import plot_outcomes

    outcomes = list(analyse_files([str(folder)], AnalysisOptions()))
    for picture in plot_outcomes(outcomes, plot):
        say(f"plot {picture}")
