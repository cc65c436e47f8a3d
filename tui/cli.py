"""Console command ``pfwd``: parses the arguments, runs a command, returns the exit status.

Modules that take long to import are not imported here, so that ``pfwd --help`` answers at once. The
module of a command is imported when the command is used.
"""

import atexit
import errno
import os
import stat
import sys
import warnings
from collections.abc import Sequence

import pfwd_plugins
from pfwd.errors import DeviceError, OptionError, PortError, SurveyError
from pfwd.processes import children_shielded
from tui.interrupts import ignore_signals, stopped_by_signals
from tui.output import say, spell_signs
from tui.parser import FIRST_STEPS, build_parser, command_module

SUCCESS, REFUSED, USAGE, LOST = 0, 1, 2, 3


def main(argv: Sequence[str] | None = None) -> int:
    """Run ``pfwd`` and return its exit status.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments; None: those of the process.

    Returns
    -------
    int
        0 done, also after SIGINT or SIGTERM; 1 data refused; 2 wrong usage; 3 device lost, or its
        port cannot be opened.
    """
    for stream in (sys.stdout, sys.stderr):
        spell_signs(stream)
    command = ""
    # Warnings of plug-ins are printed at the end, as messages.
    warnings.simplefilter("ignore", pfwd_plugins.PluginWarning)
    # On a disk without locks, filelock uses the existence of the file, which works as well.
    warnings.filterwarnings("ignore", message="flock not supported", category=UserWarning)
    try:
        with stopped_by_signals(), children_shielded():
            # Within the block, because parsing imports the module of the command.
            args = build_parser().parse_args(argv)
            command = args.command
            if command is None:
                print(FIRST_STEPS)
                return SUCCESS
            status = int(command_module(command).run(args))
        sys.stdout.flush()  # so that a closed pipe raises here
    except KeyboardInterrupt:
        say("stopped")
        status = SUCCESS
    except Exception as err:
        if _is_closed_pipe(err):
            # The program behind the pipe has ended. The rest of the output is discarded, because
            # Python would report an error at its end.
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return SUCCESS
        if os.environ.get("PFWD_DEBUG"):
            raise
        say(_explain(err, command))
        status = USAGE if isinstance(err, OptionError) else REFUSED
        status = LOST if isinstance(err, PortError) else status
    for remark in pfwd_plugins.remarks():
        say(remark)
    # Registered last and therefore called first: an interrupt while Python ends would change the
    # exit status although the work is finished.
    atexit.register(ignore_signals)
    return status


def _is_closed_pipe(err: Exception) -> bool:
    if isinstance(err, BrokenPipeError):
        return True
    # The C library of Windows reports a closed pipe as an invalid argument, and so it does a lost
    # network share, an unplugged USB device and a disk error.
    if os.name != "nt" or not isinstance(err, OSError) or err.errno != errno.EINVAL:
        return False
    if getattr(err, "winerror", None) is not None or err.filename is not None:
        return False
    if not stat.S_ISFIFO(os.fstat(1).st_mode):
        return False
    try:
        sys.stdout.flush()  # its buffer still holds what could not be written
    except OSError:
        return True
    return False


def _is_writable_file(path: object) -> bool:
    return isinstance(path, str) and os.path.isfile(path) and os.access(path, os.W_OK)


def _explain(err: Exception, command: str) -> str:
    if isinstance(err, SurveyError | DeviceError):
        return f"{command}: {err}"
    if isinstance(err, OSError):
        reason = err.strerror or str(err)
        if os.name == "nt" and isinstance(err, PermissionError) and _is_writable_file(err.filename):
            from pfwd.files.output_path import IN_USE

            reason = IN_USE
        return f"{command}: {err.filename or 'input or output'}: {reason}"
    return (
        f"{command}: an unexpected error, please report it: {type(err).__name__}: {err} "
        "(set PFWD_DEBUG=1 to see where)"
    )
