"""The console command ``pfwd``: reads the arguments, runs a sub-command, answers with a status.

Nothing heavy is imported here: ``pfwd --help`` has to answer at once, and numpy alone takes longer
than that. The modules of ``tui.commands`` import what they need when they run.
"""

import argparse
import contextlib
import errno
import importlib
import os
import signal
import sys
import threading
from collections.abc import Sequence
from types import FrameType
from typing import TYPE_CHECKING

from pfwd_survey.errors import OptionError, SurveyError
from tui.output import say

if TYPE_CHECKING:
    Commands = argparse._SubParsersAction[argparse.ArgumentParser]

DONE, REFUSED, USAGE = 0, 1, 2

PLOT_FORMATS = (".pdf", ".png", ".svg")


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``pfwd`` with arguments (default: those of the process) and return its exit status.

    Returns
    -------
    int
        0 done, also after SIGINT or SIGTERM; 1 data refused; 2 wrong usage.
    """
    # A console that cannot show a letter gets a substitute, not an error.
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(AttributeError):
            stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    args = build_parser().parse_args(argv)
    try:
        _stop_cleanly_on_sigterm()
        status = int(importlib.import_module(f"tui.commands.{args.command}").run(args))
        sys.stdout.flush()  # here, so that a reader who has left is noticed here
    except KeyboardInterrupt:
        say("stopped")
        status = DONE
    except Exception as err:
        if _is_reader_gone(err):
            # It has what it wanted. What is still buffered goes nowhere, or the interpreter would
            # complain when it ends.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return DONE
        if os.environ.get("PFWD_DEBUG"):
            raise
        say(_explain(err, args.command))
        status = USAGE if isinstance(err, OptionError) else REFUSED
    return status


def _is_reader_gone(err: Exception) -> bool:
    if os.name == "nt":  # where a closed pipe is an invalid argument
        return isinstance(err, OSError) and err.errno == errno.EINVAL
    return isinstance(err, BrokenPipeError)


def _explain(err: Exception, command: str) -> str:
    if isinstance(err, SurveyError):
        return f"{command}: {err}"
    if isinstance(err, OSError):
        return f"{command}: {err.filename or 'input or output'}: {err.strerror or err}"
    return (
        f"{command}: an error nobody foresaw, please report it: {type(err).__name__}: {err} "
        "(PFWD_DEBUG=1 shows where)"
    )


def _stop_cleanly_on_sigterm() -> None:
    def stop(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    # Python hands signals to the main thread only, and refuses handlers elsewhere.
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, stop)


def build_parser() -> argparse.ArgumentParser:
    """The parser of the command line."""
    parser = argparse.ArgumentParser(
        prog="pfwd",
        description="Subgrade modulus from portable falling weight deflectometer drops.",
        epilog="Exit status: 0 done, 1 data refused, 2 wrong usage.",
        allow_abbrev=False,
    )
    parser.add_argument("--version", action=_Version)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    _add_demo(commands)
    _add_invert(commands)
    _add_bench(commands)
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
        "demo", help="the main job with nothing attached", allow_abbrev=False
    )
    demo.add_argument("--drops", type=_count, metavar="N", default=6, help="drops (default: 6)")
    demo.add_argument("-o", "--output", metavar="SURVEY", help="folder to record into")
    demo.add_argument("--seed", type=int, metavar="S", default=0, help="seed (default: 0)")
    demo.add_argument("--json", action="store_true", help="one JSON object a line")
    demo.add_argument("--plot", type=_plot_file, metavar="FILE", help=_PLOT_HELP)


def _add_invert(commands: "Commands") -> None:
    invert = commands.add_parser(
        "invert",
        help="modulus per drop",
        description="Modulus, viscosity, density and bedrock depth per drop of trace files. An "
        "option wins over a header, a header over a default; an undeclared depth is fitted.",
        allow_abbrev=False,
    )
    invert.add_argument("files", nargs="+", metavar="FILE", help="trace file")
    model = invert.add_argument_group("model")
    model.add_argument("--model", choices=["layer", "half-space"])
    model.add_argument(
        "--bedrock-depth",
        type=_depth,
        metavar="M",
        help="depth of the rigid base in m, or unknown, or none",
    )
    model.add_argument("--elastic", action="store_true", help="no viscosity")
    model.add_argument("--load", choices=["measured", "half-sine"])
    model.add_argument("--plate", choices=["rigid-rough", "rigid-smooth", "published"])
    model.add_argument("--sensors", choices=["all", "centre"])
    model.add_argument("--joint", action="store_true", help="one soil for all drops of a point")
    search = invert.add_argument_group("search")
    search.add_argument("--method", choices=["mpga", "least-squares"])
    search.add_argument("--published", action="store_true", help="the paper's method as a whole")
    search.add_argument("--seed", type=int, metavar="S", default=0, help="seed (default: 0)")
    search.add_argument(
        "--jobs", type=_count, metavar="N", default=1, help="processes (default: 1)"
    )
    known = invert.add_argument_group("what is known, over the files' headers")
    known.add_argument("--header", metavar="FILE.toml", help="header keys in a file of their own")
    known.add_argument("--plate-radius", type=float, metavar="M", help="m")
    known.add_argument("--poisson-ratio", type=float, metavar="NU", help="0 <= NU < 0.5")
    known.add_argument("--density", type=float, metavar="RHO", help="kg/m3")
    known.add_argument("--plate-mass", type=float, metavar="KG", help="kg below the load cell")
    output = invert.add_argument_group("output")
    output.add_argument("--plot", type=_plot_file, metavar="FILE", help=_PLOT_HELP)
    output.add_argument("--json", action="store_true", help="one JSON object a line, SI units")


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


_PLOT_HELP = f"write a plot ({', '.join(PLOT_FORMATS)})"


def _count(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"expected a whole number from 1, came {text}")
    return number


def _depth(text: str) -> float | str:
    if text in ("unknown", "none"):
        return text
    try:
        depth = float(text)
    except ValueError:
        message = f"expected a depth in m, unknown or none, came {text}"
        raise argparse.ArgumentTypeError(message) from None
    return "none" if depth == float("inf") else depth


def _plot_file(text: str) -> str:
    if not text.lower().endswith(PLOT_FORMATS):
        message = f"expected a name ending in {', '.join(PLOT_FORMATS)}, came {text}"
        raise argparse.ArgumentTypeError(message)
    return text
