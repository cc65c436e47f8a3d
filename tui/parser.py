"""The arguments of ``pfwd``. Nothing heavy is imported here: ``pfwd --help`` answers at once."""

import argparse
import difflib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from pfwd.export.registry import BUILT_IN_FORMATS as EXPORT_FORMATS
from tui.argument_values import (
    PLOT_FORMATS,
    count,
    depth,
    layers,
    not_negative,
    number,
    plot_file,
    report_file,
    thickness,
    whole,
)

if TYPE_CHECKING:
    Commands = argparse._SubParsersAction[argparse.ArgumentParser]
    Parser = argparse._ActionsContainer  # a parser, or a group of one

_JSON = "one JSON object a line, SI units"


FIRST_STEPS = """\
pfwd measures the modulus of the ground with a portable falling weight deflectometer.

  pfwd demo                                nothing attached: a simulated instrument
  pfwd ports                               which port is the instrument at?
  pfwd live PORT -o "Ring road"            measure, on the screen
  pfwd open "Ring road"                    look at what was measured
  pfwd report "Ring road" -o report.html   for others

pfwd --help names every command, pfwd COMMAND --help its options."""
"""What bare ``pfwd`` says."""


class _Parser(argparse.ArgumentParser):
    """Proposes what may have been meant."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As ever; options that are not known are said with the nearest ones."""
        found, rest = self.parse_known_args(args, namespace)
        if rest:
            owner = self._owner_of(found)
            hints = [_did_you_mean(word.split("=")[0], owner.options) for word in rest]
            owner.error(f"unrecognized arguments: {' '.join(rest)}{next(filter(None, hints), '')}")
        return found

    def _owner_of(self, found: argparse.Namespace) -> "_Parser":
        commands = self.commands
        return commands.get(getattr(found, "command", None) or "", self)

    @property
    def commands(self) -> "dict[str, _Parser]":
        """By name."""
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                return dict(action.choices)
        return {}

    @property
    def options(self) -> list[str]:
        """All long ones."""
        known = [name for action in self._actions for name in action.option_strings]
        return [name for name in known if name.startswith("--")]

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as err:
            choices = [str(choice) for choice in action.choices or ()]
            hint = _did_you_mean(str(value), choices)
            if not hint:
                raise
            if isinstance(action, argparse._SubParsersAction):
                raise argparse.ArgumentError(
                    None, f"{value!r} is no command{hint}; pfwd --help names them all"
                ) from err
            raise argparse.ArgumentError(action, f"invalid choice: {value!r}{hint}") from err


def _did_you_mean(word: str, known: Sequence[str]) -> str:
    near = difflib.get_close_matches(word, known, 1, 0.6)
    return f"; did you mean {near[0]}?" if near else ""


def build_parser() -> argparse.ArgumentParser:
    """The parser of the command line."""
    parser = _Parser(
        prog="pfwd",
        description="Subgrade modulus from portable falling weight deflectometer drops.",
        epilog="Exit status: 0 done, 1 data refused, 2 wrong usage, 3 device lost.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version)
    commands: Any = parser.add_subparsers(dest="command", metavar="COMMAND")
    for add in (
        _add_demo,
        _add_ports,
        _add_simulate,
        _add_live,
        _add_log,
        _add_replay,
        _add_import,
        _add_map,
        _add_invert,
        _add_diagnose,
        _add_calibrate,
        _add_edit,
        _add_job,
        _add_open,
        _add_report,
        _add_procedures,
        _add_export,
        _add_recover,
        _add_check,
        _add_conform,
        _add_bench,
    ):
        add(commands)
    return parser


class _Version(argparse.Action):
    """Looks the version up only when it is asked for."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="show the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import PackageNotFoundError, version

        try:
            found = version("pfwd")
        except PackageNotFoundError:
            found = "(not installed)"
        print(f"pfwd {found}")
        parser.exit()


def _add_demo(commands: "Commands") -> None:
    demo = commands.add_parser(
        "demo",
        help="the main job with nothing attached",
        description="A simulated instrument on a virtual serial port (TCP where there is none), "
        "measured, recorded and inverted like a real one, and judged by the procedure "
        "tp-bf-stb-b8.3 against a target of 45 MPa. What was simulated is shown at the end.",
        allow_abbrev=False,
    )
    demo.add_argument(
        "--drops",
        type=count,
        metavar="N",
        help="drops (default: 6; of another scenario on the screen: no end)",
    )
    demo.add_argument("-o", "--output", metavar="SURVEY", help="folder to record into")
    _add_seed(demo)
    demo.add_argument(
        "--scenario",
        metavar="NAME",
        help="as for simulate; all but the default have no procedure and no target (default: "
        "compacted; with --firmware: default)",
    )
    demo.add_argument(
        "--rate",
        type=not_negative,
        metavar="X",
        help="times real time, in which a drop falls every 5 s (default: 3; on the screen 1)",
    )
    demo.add_argument(
        "--firmware",
        action="store_true",
        help="the instrument's core in C, compiled here, plays the drops (needs a C compiler, or "
        "pip install 'pfwd[firmware]')",
    )
    demo.add_argument(
        "--play", metavar="FILE", help="with --firmware: a trace file whose drops are played"
    )
    demo.add_argument("--json", action="store_true", help="one JSON object a line")
    demo.add_argument("--lines", action="store_true", help="lines on a terminal too, no screen")
    _add_plot(demo)


def _add_invert(commands: "Commands") -> None:
    invert = commands.add_parser(
        "invert",
        help="modulus per drop",
        description="Modulus, viscosity, density and bedrock depth per drop of surveys and trace "
        "files. An option wins over a header, a header over a default; an undeclared depth is "
        "fitted. A folder that is no survey stands for all that is below it; with --archive a run "
        "over any number of drops can be cut off and continued.",
        allow_abbrev=False,
    )
    invert.add_argument(
        "files", nargs="+", metavar="FILE", help="survey, drop or trace file, or a folder of them"
    )
    model = invert.add_argument_group("model")
    model.add_argument("--model", choices=["layer", "half-space"])
    model.add_argument(
        "--bedrock-depth",
        type=depth,
        metavar="M",
        help="depth of the rigid base in m, or unknown, or none",
    )
    _add_layers(model, "default 1")
    model.add_argument("--elastic", action="store_true", help="no viscosity")
    model.add_argument("--load", choices=["measured", "half-sine"])
    model.add_argument("--plate", choices=["rigid-rough", "rigid-smooth", "published", "uniform"])
    model.add_argument("--sensors", choices=["all", "centre"])
    model.add_argument("--joint", action="store_true", help="one soil for all drops of a point")
    search = invert.add_argument_group("search")
    search.add_argument("--method", choices=["mpga", "least-squares"])
    search.add_argument("--published", action="store_true", help="the paper's method as a whole")
    search.add_argument(
        "--no-priors",
        action="store_true",
        help="where the record leaves the depth of rock open, any ground that fits will do, not "
        "the one that nature is likely to have",
    )
    search.add_argument(
        "--diagnose",
        action="store_true",
        help="ask what is behind the residuals too: the modulus that a point has then stands "
        "beside the fit's",
    )
    _add_seed(search)
    _add_jobs(search)
    _add_scheduler(search)
    _add_known(invert)
    output = invert.add_argument_group("output")
    output.add_argument(
        "--archive",
        metavar="OUT",
        help="keep the results in this folder, as Parquet; what it has already is not done again",
    )
    _add_plot(output)
    _add_store(output)
    output.add_argument(
        "--by",
        choices=["point", "drop"],
        default="drop",
        help="what has a line of its own in the text (default: drop)",
    )
    output.add_argument("--json", action="store_true", help="one JSON object a line, SI units")


def _add_scheduler(parser: "argparse.ArgumentParser | argparse._ArgumentGroup") -> None:
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="work on a dask cluster in place of processes, as tls://host:8786 with dask's "
        "certificates, or tcp://host:8786",
    )


def _add_store(parser: "argparse.ArgumentParser | argparse._ArgumentGroup") -> None:
    parser.add_argument(
        "--refit",
        action="store_true",
        help="compute anew, whatever the survey keeps of the same question",
    )
    parser.add_argument(
        "--no-store", action="store_true", help="leave the survey as it is: results are not kept"
    )


def _add_ports(commands: "Commands") -> None:
    ports = commands.add_parser(
        "ports",
        help="serial ports, with what answers as a PFWD",
        description="Lists the serial ports of this computer and asks each for an instrument. What "
        "does not answer is listed with the reason and what to try.",
        allow_abbrev=False,
    )
    ports.add_argument(
        "urls",
        nargs="*",
        metavar="URL",
        help="look at these only, for example /dev/ttyUSB0, COM3 or socket://host:port",
    )
    ports.add_argument("--no-probe", action="store_true", help="do not open the ports")
    ports.add_argument("--json", action="store_true", help="one JSON object a line")


def _add_simulate(commands: "Commands") -> None:
    simulate = commands.add_parser(
        "simulate",
        help="a mock instrument",
        description="Runs a simulated instrument on a virtual serial port or on TCP until ctrl+c. "
        "Its drops come from finite elements; scenarios add faults. Connect pfwd live or pfwd log "
        "to the address that it prints.",
        allow_abbrev=False,
    )
    simulate.add_argument(
        "--listen",
        metavar="WHERE",
        help="pty or tcp://HOST:PORT, port 0 for a free one (default: pty where there are any)",
    )
    simulate.add_argument(
        "--scenario",
        metavar="NAME",
        default="default",
        help="built-in name, or a TOML file (default: default)",
    )
    simulate.add_argument(
        "--drops", type=count, metavar="N", help="end after N drops (default: for ever)"
    )
    _add_seed(simulate)
    simulate.add_argument(
        "--rate",
        type=not_negative,
        metavar="X",
        default=1.0,
        help="times real time, 0 as fast as possible (default: 1)",
    )
    simulate.add_argument(
        "--truth", metavar="FILE", help="write what was simulated, as JSON, at the end"
    )
    simulate.add_argument("--json", action="store_true", help='first line {"url": ...}')


def _add_live(commands: "Commands") -> None:
    live = commands.add_parser(
        "live",
        help="the screen: live traces, fit, modulus per drop",
        description="Measures with an instrument, on a screen that fills the terminal; ? shows its "
        "keys. An existing survey is continued, a lost instrument waited for.",
        allow_abbrev=False,
    )
    _add_instrument(live)
    live.add_argument("--point", metavar="NAME", help="test point (default: the last one)")
    _add_procedure_and_gps(live)
    _add_job_options(live)
    live.add_argument("--no-invert", action="store_true", help="record only")
    _add_layers(live, "default 1")
    _add_diagnosing(live, default=True)
    _add_seed(live)
    live.add_argument("--json", action="store_true", help="no screen: " + _JSON)
    live.set_defaults(drops=None, capture=False, give_up=None, no_bell=True)


def _add_log(commands: "Commands") -> None:
    log = commands.add_parser(
        "log",
        help="headless logging, with a modulus per drop",
        description="Records the drops of an instrument into a survey, new or begun. A drop is "
        "printed only when it is safe on the disk. Ends after --drops, or when the instrument "
        "has no more, or on SIGINT or SIGTERM; a lost instrument is waited for.",
        allow_abbrev=False,
    )
    _add_instrument(log)
    _add_procedure_and_gps(log)
    log.add_argument("--point", metavar="NAME", help="test point (default: the last one)")
    _add_job_options(log)
    log.add_argument("--drops", type=count, metavar="N", help="end after N drops")
    log.add_argument("--no-invert", action="store_true", help="record only")
    log.add_argument("--capture", action="store_true", help="keep every byte of the link too")
    log.add_argument(
        "--give-up",
        type=not_negative,
        metavar="S",
        help="end with status 3 when the instrument is lost for so long (default: wait for ever)",
    )
    log.add_argument("--no-bell", action="store_true", help="no bell for a safe drop")
    _add_layers(log, "default 1")
    _add_diagnosing(log, default=False)
    _add_seed(log)
    log.add_argument("--json", action="store_true", help=_JSON)


def _add_replay(commands: "Commands") -> None:
    replay = commands.add_parser(
        "replay",
        help="recorded drops through the same pipeline",
        description="Detects, judges and inverts again what was recorded: the drops of a survey, "
        "or the bytes of a link that pfwd log --capture kept.",
        allow_abbrev=False,
    )
    replay.add_argument("survey", metavar="SURVEY", help="survey, or a capture (.pfwdc)")
    replay.add_argument(
        "--speed",
        type=not_negative,
        metavar="X",
        help="times real time, 0 as fast as possible (default: 0; with --live 1)",
    )
    replay.add_argument("--live", action="store_true", help="on the screen; space pauses")
    replay.add_argument("--setup", metavar="FILE.toml", help="for a capture: in place of its own")
    replay.add_argument("-o", "--output", metavar="SURVEY", help="record into this survey")
    _add_spare(replay)
    replay.add_argument("--drops", type=count, metavar="N", help="end after N drops")
    replay.add_argument("--no-invert", action="store_true", help="detect and judge only")
    _add_layers(replay, "default 1")
    _add_diagnosing(replay, default=False)
    _add_seed(replay)
    replay.add_argument("--json", action="store_true", help=_JSON)


def _add_import(commands: "Commands") -> None:
    importing = commands.add_parser(
        "import",
        help="trace files and other programs' files into a survey",
        description="Reads trace files (.csv) and exported surveys (.h5); time histories of "
        "Rincent Minidyn, Maxidyn and Heavydyn (.dynz, .prjz, .mpvz) and JILS (.thy); peaks of "
        "JILS (.dat), Dynatest (.f25, .fwd), Sweco (.fwd) and PDDX (.pdx, .pddx); and any "
        "delimited text whose columns a TOML file describes (--map). Nothing is imported twice; a "
        "refused file does not keep the others out.",
        allow_abbrev=False,
    )
    importing.set_defaults(command="import_")  # import is a word of Python
    importing.add_argument("files", nargs="+", metavar="TRACES", help="file, whoever wrote it")
    importing.add_argument("-o", "--output", metavar="SURVEY", required=True, help="folder")
    importing.add_argument("--header", metavar="FILE.toml", help="header keys in a file")
    importing.add_argument(
        "--map", metavar="FILE.toml", help="what the columns of a text hold (docs/files.md)"
    )
    importing.add_argument(
        "--channels",
        choices=["raw", "stored"],
        help="raw channels, or those the other program processed (default: raw where there are "
        "any)",
    )
    importing.add_argument("--json", action="store_true", help="one JSON object a line")


def _add_map(commands: "Commands") -> None:
    drafting = commands.add_parser(
        "map",
        help="a first column map for a delimited text",
        description="Looks at a text (CSV, tabs, blanks), says what its columns seem to hold, asks "
        "on a terminal, and writes a column map for pfwd import --map. Exit status 1 when "
        "something is still to be said in it.",
        allow_abbrev=False,
    )
    drafting.add_argument("file", metavar="FILE", help="delimited text of any program")
    drafting.add_argument(
        "-o", "--output", metavar="MAP.toml", help="default: FILE with .map.toml at its end"
    )
    drafting.add_argument("--force", action="store_true", help="write over what is there")
    drafting.add_argument(
        "--no-questions", action="store_true", help="write what was found, ask nothing"
    )


def _add_export(commands: "Commands") -> None:
    export = commands.add_parser(
        "export",
        help="a survey as a file for other programs",
        description="Writes a survey as one file, or for csv as a folder; it is there whole or not "
        "at all. Results are those that the survey holds (the last one of each drop) and always "
        "come with uncertainty, model, plate radius, Poisson's ratio and warnings.",
        allow_abbrev=False,
    )
    export.add_argument("survey", metavar="SURVEY", help="folder, or an exported survey (.h5)")
    export.add_argument(
        "--format",
        # No choices: another installed package may have the format, which is looked for later.
        metavar="FORMAT",
        help="; ".join(f"{form.name}: {form.holds}" for form in EXPORT_FORMATS.values())
        + "; or a format of another installed package (default: as the ending of PATH says)",
    )
    export.add_argument("-o", "--output", metavar="PATH", required=True, help="file or folder")
    export.add_argument("--force", action="store_true", help="write over what is there")
    export.add_argument(
        "--delimiter",
        metavar="SIGN",
        help="between the columns of table and points: a sign, or tab (default: a comma, or a "
        "semicolon with a decimal comma)",
    )
    export.add_argument(
        "--decimal", metavar="SIGN", help="of table and points: . or , (default: .)"
    )
    export.add_argument(
        "--invert", action="store_true", help="invert, in place of the results the survey holds"
    )
    export.add_argument(
        "--seed", type=whole, metavar="S", default=0, help="seed of --invert (default: 0)"
    )
    export.add_argument("--json", action="store_true", help="one JSON object")


def _add_diagnose(commands: "Commands") -> None:
    diagnose = commands.add_parser(
        "diagnose",
        help="residual, effects, error before and after",
        description="Asks which real effect would leave just the residual that is there, adds it, "
        "fits again and says what it changed - or that it cannot explain it. Files with the same "
        "device are one survey.",
        allow_abbrev=False,
    )
    diagnose.add_argument("files", nargs="+", metavar="FILE", help="survey, drop or trace file")
    diagnose.add_argument(
        "--archive",
        metavar="OUT",
        help="keep the diagnoses in this folder, as Parquet; what it has already is not done again",
    )
    _add_scheduler(diagnose)
    diagnose.add_argument("--device", metavar="D.toml", help="device effects that are known")
    diagnose.add_argument("--write-device", metavar="D.toml", help="keep the device effects found")
    diagnose.add_argument(
        "--leave-out",
        choices=("next", "drop", "sensor", "point"),
        help="predict the last drop of each point, each drop or each sensor without using it; "
        "point: transfer the device of the other points",
    )
    diagnose.add_argument(
        "--allow",
        choices=("stiffness",),
        help="fit this one number to the held-out drop, with --leave-out next or drop",
    )
    _add_jobs(diagnose)
    _add_known(diagnose)
    diagnose.add_argument("--elastic", action="store_true", help="a base model without dashpot")
    diagnose.add_argument(
        "--load", choices=("measured", "half-sine"), help="what the model is loaded with"
    )
    _add_plot(diagnose)
    _add_store(diagnose)
    diagnose.add_argument(
        "--details", action="store_true", help="each of several points in full, and the warnings"
    )
    diagnose.add_argument("--json", action="store_true", help="one JSON object a point, SI units")


def _add_calibrate(commands: "Commands") -> None:
    calibrate = commands.add_parser(
        "calibrate",
        help="load cell and geophone from a rig of known stiffness",
        description="Fits gain, natural frequency, damping and delay to drops on a rig of springs, "
        "with their intervals, or says why they do not repeat. A spring tells the ratio of the "
        "gains of load cell and geophone: one of them is taken for right.",
        allow_abbrev=False,
    )
    calibrate.add_argument("files", nargs="+", metavar="FILE", help="survey, drop or trace file")
    calibrate.add_argument(
        "--stiffness",
        type=number,
        metavar="N/m",
        help="of the rig; wins over stiffness_n_per_m of the files",
    )
    calibrate.add_argument(
        "--point", metavar="NAME", help="only points whose names begin so: those of one rig"
    )
    calibrate.add_argument(
        "--gain-of",
        choices=("sensor", "load"),
        default="sensor",
        help="which channel has the gain; the other is taken for right (default: sensor)",
    )
    calibrate.add_argument("-o", "--output", metavar="D.toml", help="keep it, for --device")
    calibrate.add_argument("--header", metavar="FILE.toml", help="wins over what the files declare")
    calibrate.add_argument("--json", action="store_true", help="one JSON object, SI units")


def _add_edit(commands: "Commands") -> None:
    edit = commands.add_parser(
        "edit",
        help="note, target, position, discard, restore",
        description="Says something of a point or drop and shows the points. Nothing recorded is "
        "changed or deleted: what was said last counts.",
        allow_abbrev=False,
    )
    edit.add_argument("survey", metavar="SURVEY", help="folder")
    edit.add_argument("--point", metavar="NAME", help="needed when there are several")
    edit.add_argument("--drop", type=count, metavar="N", help="about this drop of the point")
    edit.add_argument("--note", action="append", metavar="TEXT")
    edit.add_argument("--discard", nargs="?", const="", metavar="REASON", help="leave it out")
    edit.add_argument("--restore", action="store_true", help="undo --discard")
    edit.add_argument(
        "--move", metavar="POINT", help="the drop belongs to this point, known or new (with --drop)"
    )
    edit.add_argument("--position", metavar="LAT,LON", help="degrees")
    edit.add_argument(
        "--target",
        type=number,
        metavar="V",
        help="in the unit of the survey's procedure: MPa, or mm for a deflection",
    )
    edit.add_argument("--name", metavar="NAME", help="another name for the point")
    edit.add_argument("--operator", metavar="NAME")
    edit.add_argument(
        "--set", action="append", metavar="KEY=VALUE", help="declare, as plate_mass_kg=12.5"
    )
    edit.add_argument("--json", action="store_true", help="one JSON object a point")


def _add_job(commands: "Commands") -> None:
    job = commands.add_parser(
        "job",
        help="what a survey is measured by: procedure, targets, stations",
        description="Shows what a survey is measured by, with the date of every change, or says "
        "it anew. All points are judged by what was said last; live and log take the same "
        "options and keep the same.",
        allow_abbrev=False,
    )
    job.add_argument("survey", metavar="SURVEY", help="folder")
    job.add_argument(
        "--procedure", metavar="NAME", help="a name of pfwd procedures, or a TOML file"
    )
    _add_job_options(job)
    job.add_argument(
        "--time-zone",
        metavar="+HH:MM",
        help="of local times that say no zone, as imported ones: exports have UTC then (west of "
        "Greenwich: --time-zone=-05:00)",
    )
    job.add_argument("--json", action="store_true", help="one JSON object, SI units")


def _add_open(commands: "Commands") -> None:
    opened = commands.add_parser(
        "open",
        help="stored results on the screen, nothing recomputed",
        description="Points (sorted, filtered), profile, map, drops over each other, two points "
        "compared, the job; a report or an export by a key. Nothing of the survey is changed.",
        allow_abbrev=False,
    )
    opened.add_argument("survey", metavar="SURVEY", help="folder")
    opened.add_argument(
        "--serve",
        nargs="?",
        const="",
        metavar="HOST:PORT",
        help="as a page for a browser, read only (default: 127.0.0.1:8765; on another host a code "
        "lets one browser in)",
    )
    opened.add_argument(
        "--photos",
        nargs="?",
        const="strip",
        choices=("strip", "keep"),
        help="with --serve: the page takes photos of points; strip (default) removes the position "
        "that the camera wrote into them",
    )
    opened.add_argument("--json", action="store_true", help="one JSON object a point, SI units")


def _add_report(commands: "Commands") -> None:
    report = commands.add_parser(
        "report",
        help="a report with plots, as HTML or PDF",
        description="One file that shows a survey to others: summary, map sketch, profile, a page "
        "per point with traces, fits and residuals, device, procedure, and all that is needed to "
        "compute it again. Results that the survey holds are used; what is missing is inverted.",
        allow_abbrev=False,
    )
    report.add_argument("survey", metavar="SURVEY", help="folder")
    report.add_argument(
        "-o",
        "--output",
        type=report_file,
        metavar="FILE",
        required=True,
        help=".html or .pdf; .xlsx with a workbook as --template",
    )
    report.add_argument(
        "--template",
        metavar="T",
        help="T.xlsx: a workbook whose named cells, or cells with {{ name }}, are filled; "
        "T.typ: lays out a PDF by Typst",
    )
    report.add_argument(
        "--language",
        metavar="CODE",
        default="en",
        help="en, de or zh, or a TOML file with the texts of another one (default: en)",
    )
    report.add_argument(
        "--title", metavar="TEXT", help="heading (default: the site, or the folder)"
    )
    report.add_argument(
        "--procedure", metavar="NAME", help="judge by this one (default: the one measured by)"
    )
    report.add_argument(
        "--target",
        type=number,
        metavar="V",
        help="of points that have none, in the unit of what the procedure judges (MPa or mm)",
    )
    report.add_argument(
        "--target-deflection",
        type=number,
        metavar="MM",
        help="the same, only for a procedure that judges deflections",
    )
    _add_layers(report, "given: all is inverted anew; default: what the survey holds")
    report.add_argument("--refit", action="store_true", help="invert anew, whatever is stored")
    report.add_argument(
        "--diagnose", action="store_true", help="ask what is behind the residuals (slow)"
    )
    report.add_argument(
        "--no-store", action="store_true", help="leave the survey as it is: results are not kept"
    )
    report.add_argument("--company", metavar="TEXT", help="on the first page")
    report.add_argument("--logo", metavar="FILE", help="picture for the first page (.png, .jpg)")
    _add_jobs(report)
    _add_seed(report)
    report.add_argument("--json", action="store_true", help="one JSON object a point, SI units")


def _add_procedures(commands: "Commands") -> None:
    procedures = commands.add_parser(
        "procedures",
        help="measuring procedures with their sources",
        description="Lists the procedures that come with the program: seating + measured drops "
        "(in brackets: not verified, not enforced) and what is judged. With a name or a TOML "
        "file: every number with its source.",
        allow_abbrev=False,
    )
    procedures.add_argument("name", nargs="?", metavar="NAME", help="show this one")
    procedures.add_argument("--json", action="store_true", help="one JSON object a procedure")


def _add_recover(commands: "Commands") -> None:
    recover = commands.add_parser(
        "recover",
        help="whatever a crash left",
        description="Repairs a survey after a crash, a full disk or a pulled drive: every drop "
        "that was acknowledged gets its file again, and what is damaged is moved aside byte for "
        "byte. Nothing is deleted.",
        allow_abbrev=False,
    )
    recover.add_argument("survey", metavar="SURVEY", help="folder")
    _add_spare(recover)
    recover.add_argument("--json", action="store_true", help="one JSON object")


def _add_check(commands: "Commands") -> None:
    check = commands.add_parser(
        "check",
        help="is this recording whole?",
        description="Reads every record of a survey, its drop files or an exported survey, and "
        "compares checksums and recorded peaks with the traces. Changes nothing. Exit status 1 "
        "when something is damaged or missing.",
        allow_abbrev=False,
    )
    check.add_argument("survey", metavar="SURVEY", help="folder, or an exported survey (.h5)")
    _add_spare(check)
    check.add_argument("--json", action="store_true", help="one JSON object")


def _add_conform(commands: "Commands") -> None:
    conform = commands.add_parser(
        "conform",
        help="does an instrument keep the protocol?",
        description="Tries every numbered requirement of docs/protocol.md, one line each: passed, "
        "failed, or not offered, with what came. Takes two minutes; let one drop fall when it is "
        "asked for. Exit status 1 when one failed.",
        allow_abbrev=False,
    )
    conform.add_argument("url", metavar="URL", help="port of the instrument, as for log")
    conform.add_argument(
        "--baud-rate", type=count, metavar="N", default=115_200, help="default 115200"
    )
    conform.add_argument(
        "--wait",
        type=not_negative,
        metavar="S",
        default=15.0,
        help="seconds to wait for a drop (default 15; 0: none will fall)",
    )
    conform.add_argument("--only", metavar="P-N,...", help="requirements to try (default: all)")
    conform.add_argument("--json", action="store_true", help=_JSON)


def _add_bench(commands: "Commands") -> None:
    bench = commands.add_parser(
        "bench",
        help="the project's benchmarks, from a checkout",
        usage="pfwd bench [PART] [ARGS]",
        # Every option belongs to the benchmarks, hence a prefix that no option begins with.
        prefix_chars="\0",
        add_help=False,
    )
    bench.add_argument("arguments", nargs=argparse.REMAINDER)


def _add_instrument(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("url", metavar="URL", help="/dev/ttyUSB0, COM3, socket://host:port, ...")
    parser.add_argument("-o", "--output", metavar="SURVEY", required=True, help="folder")
    parser.add_argument(
        "--setup", metavar="FILE.toml", help="what is declared; wins over the device"
    )
    parser.add_argument(
        "--accept-calibration",
        action="store_true",
        help="record though the calibration is not that of the instrument's drops in SURVEY",
    )
    _add_spare(parser)


def _add_spare(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--spare",
        metavar="FOLDER",
        help="for drops that SURVEY does not take (default: PFWD_SPARE, or the platform's place)",
    )


def _add_procedure_and_gps(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--procedure",
        metavar="NAME",
        help="how a point is measured: a name of pfwd procedures, or a TOML file",
    )
    parser.add_argument(
        "--gps", metavar="PORT", help="satellite receiver (NMEA) on a port of its own"
    )


def _add_job_options(parser: argparse.ArgumentParser) -> None:
    """What is said of a survey's job, by whichever command."""
    parser.add_argument(
        "--target",
        type=number,
        metavar="V",
        help="of points that have none, in the procedure's unit: MPa, or mm for a deflection",
    )
    parser.add_argument(
        "--stations",
        metavar="FILE",
        help="what is to be measured, .csv (name, chainage, latitude, longitude, target) or .gpx",
    )
    parser.add_argument(
        "--step", type=number, metavar="M", help="from one station to the next along the line, m"
    )
    parser.add_argument("--operator", metavar="T", help="who measures")


def _add_known(parser: argparse.ArgumentParser) -> None:
    known = parser.add_argument_group("what is known, over the files' headers")
    known.add_argument("--header", metavar="FILE.toml", help="header keys in a file of their own")
    known.add_argument("--plate-radius", type=number, metavar="M", help="m")
    known.add_argument("--poisson-ratio", type=number, metavar="NU", help="0 <= NU < 0.5")
    known.add_argument("--density", type=number, metavar="RHO", help="kg/m3")
    known.add_argument("--plate-mass", type=number, metavar="KG", help="kg below the load cell")


def _add_diagnosing(parser: "Parser", *, default: bool) -> None:
    parser.add_argument(
        "--diagnose",
        action=argparse.BooleanOptionalAction,
        default=default,
        help="diagnose the points too, seconds after their drops, beside the measurement; what is "
        f"found is kept (default: {'yes' if default else 'no'})",
    )


def _add_layers(parser: "Parser", otherwise: str) -> None:
    parser.add_argument(
        "--layers",
        type=layers,
        metavar="N",
        help=f"media with a modulus, the lowest included, 1 to 4 ({otherwise}), or auto: as many "
        "as the record can tell",
    )
    parser.add_argument(
        "--thickness",
        type=thickness,
        metavar="M[,M...]",
        help="of all layers but the lowest, from the top, m, or unknown (default: fitted)",
    )


def _add_seed(parser: "Parser") -> None:
    parser.add_argument("--seed", type=whole, metavar="S", default=0, help="seed (default: 0)")


def _add_jobs(parser: "Parser") -> None:
    parser.add_argument("--jobs", type=count, metavar="N", default=1, help="processes (default: 1)")


def _add_plot(parser: "Parser") -> None:
    formats = ", ".join(PLOT_FORMATS)
    parser.add_argument("--plot", type=plot_file, metavar="FILE", help=f"write a plot ({formats})")
