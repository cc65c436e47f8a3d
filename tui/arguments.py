"""Types of option values, and options that several commands share.

A type is a function that converts the text of an option, and raises ArgumentTypeError if the text
is not what it expects. A function ``add_...`` adds options to a parser. Nothing that takes long to
import is imported here.
"""

import argparse

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


def depth(text: str) -> float | str:
    """Convert a text to a depth in m, or return ``none`` (also for infinity) or ``unknown``."""
    if text in ("unknown", "none"):
        return text
    try:
        value = float(text)
    except ValueError:
        raise _refused("a depth in m, unknown or none", text) from None
    return "none" if value == float("inf") else value


def layers(text: str) -> int | str:
    """Convert a text to a number of layers, or return ``auto``."""
    if text == "auto":
        return text
    try:
        return int(text)
    except ValueError:
        raise _refused("a whole number from 1 to 4, or auto", text) from None


def thickness(text: str) -> tuple[float, ...] | str:
    """Convert numbers separated by commas to thicknesses in m, or return ``unknown``."""
    if text == "unknown":
        return text
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise _refused("numbers in m with commas between, or unknown", text) from None


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
        "url", metavar="URL", help="port of the instrument: /dev/ttyUSB0, COM3, socket://HOST:PORT"
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


def add_job(parser: Arguments) -> None:
    """Add the settings of a survey that ``live``, ``log`` and ``job`` can change."""
    parser.add_argument(
        "--target",
        type=number,
        metavar="V",
        help="target of points without their own, in the unit of the procedure: MPa, or mm for a "
        "deflection",
    )
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
    add_layers(expert, "default: 1")
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


def add_declared(parser: argparse.ArgumentParser) -> None:
    """Add the options that replace declarations in the headers of files."""
    group = parser.add_argument_group("declared values, in place of those in the files")
    group.add_argument("--header", metavar="FILE.toml", help="header keys in a file of their own")
    group.add_argument(
        "--plate-radius", type=number, metavar="M", help="radius of the load plate, m"
    )
    group.add_argument(
        "--poisson-ratio", type=number, metavar="NU", help="of the soil, 0 <= NU < 0.5"
    )
    group.add_argument("--density", type=number, metavar="RHO", help="of the soil, kg/m3")
    group.add_argument(
        "--plate-mass", type=number, metavar="KG", help="mass below the load cell, kg"
    )


def add_layers(parser: Arguments, default: str) -> None:
    """Add the options for number and thickness of the layers of the ground; `default` is for the
    help.
    """
    parser.add_argument(
        "--layers",
        type=layers,
        metavar="N",
        help=f"number of layers, the ground below them included, 1 to 4 ({default}), or auto: as "
        "many as the record supports",
    )
    parser.add_argument(
        "--thickness",
        type=thickness,
        metavar="M[,M...]",
        help="thickness of all layers but the lowest, from the top, m, or unknown (default: "
        "fitted)",
    )


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
