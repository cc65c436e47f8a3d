"""The console command ``pfwd``: reads the arguments, runs a sub-command, answers with a status.

Nothing heavy is imported here: ``pfwd --help`` has to answer at once, and numpy alone takes longer
than that. The modules of ``tui.commands`` import what they need when they run.
"""

import atexit
import contextlib
import errno
import os
import sys
import warnings
from collections.abc import Sequence

import pfwd_plugins
from pfwd.errors import DeviceError, OptionError, SurveyError
from pfwd.processes import children_shielded
from tui.interrupts import stopped_by_signals, take_no_more_signals
from tui.output import SPELLING, say
from tui.parser import FIRST_STEPS, build_parser, command_module

DONE, REFUSED, USAGE = 0, 1, 2


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
            stream.reconfigure(errors=SPELLING)  # type: ignore[union-attr]
    args = build_parser().parse_args(argv)
    if args.command is None:
        print(FIRST_STEPS)
        return DONE
    warnings.simplefilter("ignore", pfwd_plugins.PluginWarning)  # said in the end, as a message
    # On a disk without locks the file itself is the lock: nothing that a user could act on.
    warnings.filterwarnings("ignore", message="flock not supported", category=UserWarning)
    try:
        with stopped_by_signals(), children_shielded():
            status = int(command_module(args.command).run(args))
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
    for remark in pfwd_plugins.remarks():
        say(remark)
    # Registered last, done first: while Python itself ends, an interrupt would end it by the signal
    # though the work is done.
    atexit.register(take_no_more_signals)
    return status


def _is_reader_gone(err: Exception) -> bool:
    if os.name == "nt":  # where a closed pipe is an invalid argument
        return isinstance(err, OSError) and err.errno == errno.EINVAL
    return isinstance(err, BrokenPipeError)


def _explain(err: Exception, command: str) -> str:
    if isinstance(err, SurveyError | DeviceError):
        return f"{command}: {err}"
    if isinstance(err, OSError):
        return f"{command}: {err.filename or 'input or output'}: {err.strerror or err}"
    return (
        f"{command}: an unexpected error, please report it: {type(err).__name__}: {err} "
        "(PFWD_DEBUG=1 shows where)"
    )
