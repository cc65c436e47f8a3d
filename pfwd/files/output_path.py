"""Whether a file or folder can be written at a place, checked before the work and not after it."""

import os
import stat
import tempfile
from pathlib import Path

from pfwd.errors import OptionError, refusal
from pfwd.files.folders import is_survey

STREAMS = ("/dev/stdout", "/dev/stderr", "/dev/fd/1", "/dev/fd/2")
"""Names of the streams of this process, for what is written piece by piece."""


def require_writable(path: str | os.PathLike[str], option: str, *, streams: bool = False) -> Path:
    """Refuse a place for a file that cannot be written or must not; nothing is left there.

    Parameters
    ----------
    path : of the file that is wanted
    option : str
        That named it, for the message.
    streams : bool
        Whether the streams of this process, `STREAMS`, are accepted.

    Returns
    -------
    Path

    Raises
    ------
    OptionError
        If it is inside a survey, exists and is no regular file, its folder is not there, or takes
        no file.
    """
    target = Path(path)
    if streams and str(target) in STREAMS:
        return target
    where = f"{option} {target}"
    refuse_inside_survey(target, option)
    refuse_special_file(target, option)
    if target.is_dir() or not target.name:
        raise OptionError(refusal(where, "the name of a file", "a folder"))
    if not target.parent.is_dir():
        came = "none" if not target.parent.exists() else "a file"
        raise OptionError(refusal(where, f"the folder {target.parent}", came, "make it first"))
    try:
        # Rights alone do not tell: the disk may be full, or read-only as a whole.
        with tempfile.TemporaryFile(dir=target.parent, prefix=".pfwd-"):
            pass
        if target.exists() and not os.access(target, os.W_OK):
            raise PermissionError(None, "no right to write over it")
    except OSError as err:
        came = err.strerror or str(err)
        raise OptionError(refusal(where, "a file to write", came, "name another one")) from err
    return target


def refuse_inside_survey(path: str | os.PathLike[str], option: str) -> None:
    """Refuse a place inside the folder of a survey, or a link that leads into one.

    A survey itself is no place inside it: a command that continues surveys may be given one.

    Raises
    ------
    OptionError
    """
    target = Path(path)
    # A link is replaced by some commands and written through by others: both places count.
    named = Path(os.path.realpath(target.parent)) / target.name
    for place in (named, Path(os.path.realpath(target))):
        survey = next((folder for folder in place.parents if is_survey(folder)), None)
        if survey is not None:
            raise OptionError(
                f"{option} {path}: this place is inside the survey {survey}, which holds recorded "
                "drops and nothing else. Name a place outside of it"
            )


def refuse_special_file(path: str | os.PathLike[str], option: str) -> None:
    """Refuse a device, a named pipe and the like, which a file would replace or be lost in.

    Raises
    ------
    OptionError
    """
    try:
        mode = os.stat(path).st_mode
    except OSError:  # nothing is there, or it is refused when it is written
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        kinds = ((stat.S_ISFIFO, "a named pipe"), (stat.S_ISSOCK, "a socket"))
        kind = next((name for is_kind, name in kinds if is_kind(mode)), "a device")
        raise OptionError(f"{option} {path}: this is {kind} and no file. Name another file")
