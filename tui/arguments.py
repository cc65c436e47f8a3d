"""Types of option values, and options that several commands share.

A type is a function that converts the text of an option, and raises ArgumentTypeError if the text
is not what it expects. A function ``add_...`` adds options to a parser. Nothing that takes long to
import is imported here.
"""

import argparse
import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pfwd.analysis.options import AnalysisOptions

Arguments = argparse._ActionsContainer
"""Parser, or a group of options of a parser."""

PLOT_FORMATS = (".pdf", ".png", ".svg")


def integer(text: str) -> int:
    """Convert a text to a whole number."""
    try:
        return int(text)
    except ValueError:
        raise _refused("a whole number", text) from None


def count(text: str) -> int:
    """Convert a text to a whole number of at least 1."""
    value = integer(text)
    if value < 1:
        raise _refused("a whole number from 1", text)
    return value


def number(text: str) -> float:
    """Convert a text to a number."""
    try:
        return float(text)
    except ValueError:
        raise _refused("a number", text) from None


def not_negative(text: str) -> float:
    """Convert a text to a finite number of at least 0."""
    value = number(text)
    if not 0 <= value < float("inf"):
        raise _refused("a number >= 0", text)
    return value


def positive(text: str) -> float:
    """Convert a text to a finite number above 0."""
    value = not_negative(text)
    if value == 0:
        raise _refused("a number > 0", text)
    return value


def report_file(text: str) -> str:
    """Return a file name if it ends with .html, .pdf or .xlsx."""
    if not text.lower().endswith((".html", ".pdf", ".xlsx")):
        raise _refused("a name ending in .html or .pdf, or in .xlsx with --template", text)
    return text


def plot_file(text: str) -> str:
    """Return a file name if its ending is one of `PLOT_FORMATS`."""
    if not text.lower().endswith(PLOT_FORMATS):
        raise _refused(f"a name ending in {', '.join(PLOT_FORMATS)}", text)
    return text


def _refused(expected: str, got: str) -> argparse.ArgumentTypeError:
    return argparse.ArgumentTypeError(f"expected {expected}, got {got}")


def add_files(parser: Arguments, metavar: str, text: str) -> None:
    """Add the positional argument ``files``, which takes one or more files and patterns."""
    parser.add_argument("files", nargs="+", metavar=metavar, action=_Files, help=text)


class _Files(argparse.Action):
    """Argument for files, in which patterns such as ``*.csv`` stand for the files that match.

    The command lines of Windows pass a pattern as it was typed.
    """

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        setattr(namespace, self.dest, [name for value in values for name in _expand(value)])


def _expand(pattern: str) -> list[str]:
    if not any(letter in pattern for letter in "*?["):
        return [pattern]
    if os.path.exists(pattern):  # brackets may belong to a name
        return [pattern]
    import glob

    return sorted(glob.glob(pattern)) or [pattern]


def add_json(parser: Arguments, per: str | None = None) -> None:
    """Add ``--json``.

    Parameters
    ----------
    parser : Arguments
    per : str, optional
        What one JSON object describes, as in "one JSON object per drop"; None: there is one object.
    """
    each = "one JSON object" if per is None else f"one JSON object per {per}"
    parser.add_argument("--json", action="store_true", help=f"print {each}, in SI units")


def add_expert_group(parser: argparse.ArgumentParser) -> Arguments:
    """Add a group for options that everyday work does not need; it comes last in the help."""
    return parser.add_argument_group("expert options")


def add_instrument(parser: argparse.ArgumentParser) -> None:
    """Add the options that ``live`` and ``log`` share, such as port, survey, setup and point."""
    parser.add_argument(
        "url",
        metavar="URL",
        help="port of the instrument: /dev/ttyUSB0, COM3, socket://HOST:PORT; of a logger also "
        "dataq://HOST or labjack://HOST",
    )
    parser.add_argument(
        "-o",
        "--output",
        metavar="SURVEY",
        required=True,
        help="folder to record into; an existing survey is continued",
    )
    parser.add_argument(
        "--setup",
        metavar="FILE.toml",
        help="plate, sensors and soil; replaces what the instrument declares",
    )
    parser.add_argument("--point", metavar="NAME", help="test point (default: the last one)")
    parser.add_argument(
        "--procedure",
        metavar="NAME",
        help="how a point is measured: a name listed by pfwd procedures, or a TOML file",
    )
    add_job(parser)
    parser.add_argument(
        "--gps", metavar="PORT", help="port of a satellite receiver (NMEA) for positions"
    )


def add_changed_calibration(parser: Arguments) -> None:
    """Add the option to record with an instrument whose calibration has changed."""
    parser.add_argument(
        "--accept-calibration",
        action="store_true",
        help="record even if the calibration differs from that of the instrument's drops in SURVEY",
    )


def add_target(parser: Arguments) -> None:
    """Add the option for the target of the points of a survey."""
    parser.add_argument(
        "--target",
        type=number,
        metavar="V",
        help="target of points without their own, in the unit of the procedure: MPa, or mm for a "
        "deflection",
    )


def add_job(parser: Arguments) -> None:
    """Add the settings of a survey that ``live``, ``log`` and ``job`` can change."""
    add_target(parser)
    parser.add_argument(
        "--stations",
        metavar="FILE",
        help="points to measure: .csv (name, chainage, latitude, longitude, target) or .gpx",
    )
    parser.add_argument("--step", type=number, metavar="M", help="distance between stations, m")
    parser.add_argument("--operator", metavar="T", help="name of the person who measures")


def add_analysis(parser: Arguments, expert: Arguments, *, diagnose: bool) -> None:
    """Add the options for the analysis of drops while they are measured or replayed.

    Parameters
    ----------
    parser, expert : Arguments
        Parser, and its group of expert options.
    diagnose : bool
        Default of ``--diagnose``.
    """
    parser.add_argument("--no-invert", action="store_true", help="record without a modulus")
    parser.add_argument(
        "--diagnose",
        action=argparse.BooleanOptionalAction,
        default=diagnose,
        help="diagnose each point in the background, seconds after its drops, and store the result "
        f"(default: {'yes' if diagnose else 'no'})",
    )
    add_options(expert, "layers", "thickness")
    add_seed(expert)
    add_spare(expert)


def add_spare(parser: Arguments) -> None:
    """Add the option for the spare folder, which takes drops that the survey cannot store."""
    parser.add_argument(
        "--spare",
        metavar="FOLDER",
        help="folder for drops that SURVEY cannot store, for example on a full disk (default: "
        "PFWD_SPARE, or the data folder of this computer)",
    )


_METAVARS = {
    "bedrock_depth": "M",
    "layers": "N",
    "thickness": "M[,M...]",
    "header": "FILE.toml",
    "plate_radius": "M",
    "poisson_ratio": "NU",
    "density": "RHO",
    "plate_mass": "KG",
}
"""Names of the values of the options of an analysis in the help."""


def add_options(parser: Arguments, *names: str, **help_texts: str) -> None:
    """Add options of an analysis.

    Parameters
    ----------
    parser : Arguments
    *names : str
        Fields of AnalysisOptions.
    **help_texts : str
        Help of a field, in place of its own one.
    """
    from pfwd.analysis.options import OPTIONS, flag_of, parse_option
    from pfwd.errors import OptionError

    def parser_of(name: str) -> Callable[[str], Any]:
        def parse(text: str) -> Any:
            try:
                return parse_option(name, text)
            except OptionError as err:
                raise argparse.ArgumentTypeError(str(err)) from None

        return parse

    for name in names:
        schema = OPTIONS[name].value.json_schema()
        kinds: dict[str, Any] = {"type": parser_of(name), "metavar": _METAVARS.get(name)}
        if schema.get("type") == "boolean":
            kinds = {"action": "store_false" if name == "priors" else "store_true", "dest": name}
        elif "enum" in schema:
            kinds = {"choices": schema["enum"]}
        text = help_texts.get(name, OPTIONS[name].meaning)
        parser.add_argument(flag_of(name), help=text, **kinds)


def add_declared(parser: argparse.ArgumentParser) -> None:
    """Add the options that replace declarations in the headers of files."""
    group = parser.add_argument_group("declared values, in place of those in the files")
    add_options(group, "header", "plate_radius", "poisson_ratio", "density", "plate_mass")


def analysis_options(args: argparse.Namespace) -> "AnalysisOptions":
    """Return the options of an analysis that the command line states.

    Raises
    ------
    OptionError
        If an option is outside its range, or options contradict each other.
    """
    from pfwd.analysis.options import OPTIONS, AnalysisOptions
    from pfwd.errors import OptionError, refusal

    stated = {name: value for name, value in vars(args).items() if name in OPTIONS}
    header = stated.get("header")
    if header is not None and not os.path.isfile(header):
        raise OptionError(refusal(f"--header {header}", "a TOML file", "no such file"))
    return AnalysisOptions(**stated)


def add_stored(parser: Arguments) -> None:
    """Add the options for results stored in the survey: compute again, do not store."""
    parser.add_argument(
        "--refit", action="store_true", help="compute again, even if the survey stores the result"
    )
    parser.add_argument("--no-store", action="store_true", help="do not store the results")


def add_archive(parser: Arguments) -> None:
    """Add the options for many files: tables as output, computation on a cluster."""
    parser.add_argument(
        "--archive",
        metavar="OUT",
        help="write results to this folder as Parquet tables; a run that was stopped is continued",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="compute on a dask cluster instead of processes: tls://HOST:8786 with dask's "
        "certificates, or tcp://HOST:8786",
    )


def add_seed(parser: Arguments) -> None:
    """Add the option for the seed of random numbers."""
    parser.add_argument(
        "--seed", type=integer, metavar="S", default=0, help="seed of random numbers (default: 0)"
    )


def add_jobs(parser: Arguments) -> None:
    """Add the option for the number of processes."""
    parser.add_argument(
        "--jobs", type=count, metavar="N", default=1, help="number of processes (default: 1)"
    )


def add_plot(parser: Arguments) -> None:
    """Add the option for the file of a plot."""
    formats = ", ".join(PLOT_FORMATS)
    parser.add_argument("--plot", type=plot_file, metavar="FILE", help=f"draw a plot ({formats})")
