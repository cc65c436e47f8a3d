"""Checks of output paths, made before the work and not after it."""

import os
import stat
import tempfile
from pathlib import Path

from pfwd.errors import OptionError, refusal
from pfwd.files.folders import is_survey

STANDARD_STREAMS = ("/dev/stdout", "/dev/stderr", "/dev/fd/1", "/dev/fd/2")
"""Paths of the streams of this process, for outputs that are written piece by piece."""


def require_writable(path: str | os.PathLike[str], option: str, *, streams: bool = False) -> Path:
    """Refuse the path of an output that cannot or must not be written; leaves nothing there.

    Parameters
    ----------
    path : path of the output
    option : str
        Option with this path, for the message.
    streams : bool
        True accepts `STANDARD_STREAMS`.

    Returns
    -------
    Path

    Raises
    ------
    OptionError
        If it is inside a survey, exists and is no regular file, its folder does not exist, or no
        file can be written there.
    """
    target = Path(path)
    if streams and str(target) in STANDARD_STREAMS:
        return target
    where = f"{option} {target}"
    refuse_inside_survey(target, option)
    refuse_special_file(target, option)
    if target.is_dir() or not target.name:
        raise OptionError(refusal(where, "the name of a file", "a folder"))
    if not target.parent.is_dir():
        actual = "a file" if target.parent.exists() else "none"
        raise OptionError(refusal(where, f"the folder {target.parent}", actual, "make it first"))
    try:
        # Permissions are not enough: the disk may be full or read-only.
        with tempfile.TemporaryFile(dir=target.parent, prefix=".pfwd-"):
            pass
        if target.exists() and not os.access(target, os.W_OK):
            raise PermissionError(None, "no right to write over it")
    except OSError as err:
        reason = err.strerror or str(err)
        raise OptionError(refusal(where, "a file to write", reason, "name another one")) from err
    return target


def refuse_inside_survey(path: str | os.PathLike[str], option: str) -> None:
    """Refuse a path inside the folder of a survey, or a link that leads into one.

    The folder of a survey itself is accepted: some commands continue surveys.

    Raises
    ------
    OptionError
    """
    target = Path(path)
    # Some commands replace a link, others write through it: both paths count.
    named = Path(os.path.realpath(target.parent)) / target.name
    for place in (named, Path(os.path.realpath(target))):
        survey = next((folder for folder in place.parents if is_survey(folder)), None)
        if survey is not None:
            raise OptionError(
                f"{option} {path}: this place is inside the survey {survey}, which holds recorded "
                "drops and nothing else. Name a place outside of it"
            )


def refuse_special_file(path: str | os.PathLike[str], option: str) -> None:
    """Refuse a device or a named pipe, which a file would replace or be lost in.

    Raises
    ------
    OptionError
    """
    try:
        mode = os.stat(path).st_mode
    except OSError:  # it does not exist, or writing it fails with the reason
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        kinds = ((stat.S_ISFIFO, "a named pipe"), (stat.S_ISSOCK, "a socket"))
        kind = next((name for is_kind, name in kinds if is_kind(mode)), "a device")
        raise OptionError(f"{option} {path}: this is {kind} and no file. Name another file")
