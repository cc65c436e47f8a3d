"""Output files: checks before the work begins, and replacement in one step."""

import contextlib
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path, PureWindowsPath

from pfwd.errors import OptionError, SurveyError, refusal
from pfwd.files.folders import is_survey
from pfwd_device.recording.storage import IN_USE as IN_USE
from pfwd_device.recording.storage import flush_to_disk, replace_file

_ILLEGAL_LETTERS = '<>:"|?*'
_DEVICES = frozenset(
    ("CON", "PRN", "AUX", "NUL", *(f"{name}{n}" for name in ("COM", "LPT") for n in range(1, 10)))
)
"""Names of devices of Windows, with any ending."""

STANDARD_STREAMS = ("/dev/stdout", "/dev/stderr", "/dev/fd/1", "/dev/fd/2")
"""Paths of standard output and standard error, accepted for outputs that are written piece by
piece."""


def require_writable(path: str | os.PathLike[str], option: str, *, streams: bool = False) -> Path:
    """Return the path of an output after checking that it can be written; no file is left there.

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
        If the path is illegal on Windows, is inside a survey, is something other than a regular
        file, is in a folder that does not exist, or cannot be written.
    """
    target = Path(path)
    if streams and str(target) in STANDARD_STREAMS:
        return target
    where = f"{option} {target}"
    refuse_bad_place(target, option)
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
        if os.name == "nt" and target.exists():
            _refuse_open_elsewhere(target)
    except OSError as err:
        reason = err.strerror or str(err)
        hint = "" if reason == IN_USE else "name another one"
        raise OptionError(refusal(where, "a file to write", reason, hint)) from err
    return target


def _refuse_open_elsewhere(target: Path) -> None:
    """Raise PermissionError if another program keeps this one from writing to a file."""
    try:
        with open(target, "rb+"):
            pass
    except PermissionError as err:
        raise PermissionError(err.errno, IN_USE, os.fspath(target)) from err


def refuse_bad_place(path: str | os.PathLike[str], option: str) -> None:
    """Raise OptionError if a path cannot be that of an output: its name is illegal on Windows, it
    is inside the folder of a survey, or it is a link that leads into one.

    The folder of a survey itself is accepted, because some commands continue surveys.
    """
    if os.name == "nt" and (problem := illegal_name(path)):
        raise OptionError(
            refusal(f"{option} {path}", "a name that Windows permits", problem, "leave it out")
        )
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


def illegal_name(path: str | os.PathLike[str]) -> str:
    """Return what Windows does not permit in a path; empty: it permits all of it.

    Examples
    --------
    >>> illegal_name("C:/T/Ring road: km 12?"), illegal_name("C:/T/aux.csv"), illegal_name("../a.b")
    (': ?', 'aux.csv, which means a device', '')
    """
    whole = PureWindowsPath(path)
    for name in whole.parts[bool(whole.anchor) :]:
        letters = [letter for letter in name if letter in _ILLEGAL_LETTERS or letter < " "]
        if letters:
            return " ".join(letter if letter >= " " else ascii(letter) for letter in letters)
        if name.partition(".")[0].rstrip().upper() in _DEVICES:
            return f"{name}, which means a device"
    return ""


def refuse_special_file(path: str | os.PathLike[str], option: str) -> None:
    """Raise OptionError if a path is a device, socket or named pipe.

    Output would replace a pipe by a file, or be lost in a device.
    """
    try:
        mode = os.stat(path).st_mode
    except OSError:  # it does not exist, or writing it fails with the reason
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        kinds = ((stat.S_ISFIFO, "a named pipe"), (stat.S_ISSOCK, "a socket"))
        kind = next((name for is_kind, name in kinds if is_kind(mode)), "a device")
        raise OptionError(f"{option} {path}: this is {kind} and no file. Name another file")


@contextlib.contextmanager
def disk_errors(target: Path) -> Iterator[None]:
    """Convert an OSError within the block into a SurveyError that names the output file."""
    try:
        yield
    except OSError as err:
        reason = err.strerror or str(err)
        expected = "a file to write" if reason == IN_USE else "a writable disk"
        raise SurveyError(refusal(str(target), expected, reason)) from err


@contextlib.contextmanager
def replaced_at_once(target: Path) -> Iterator[Path]:
    """Yield the path of a temporary file that replaces the target when the block ends without
    error.

    Other programs see the former file or the new one, never a part of it. After an error the former
    file stays and the temporary file is deleted. A power cut may lose both files, unless the block
    calls :func:`sync`; see :func:`replaced_durably`.
    """
    draft = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        yield draft
        replace_file(draft, target)
    except BaseException:
        # The first error is the one to report.
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)
        raise


@contextlib.contextmanager
def replaced_durably(target: Path) -> Iterator[Path]:
    """Replace a file as :func:`replaced_at_once` does and wait until the new one is on the disk."""
    with replaced_at_once(target) as draft:
        yield draft
        sync(draft)
    if os.name != "nt":  # Windows cannot open a folder, and needs no fsync of it
        handle = os.open(target.parent, os.O_RDONLY)
        try:
            flush_to_disk(handle)
        finally:
            os.close(handle)


def sync(path: Path) -> None:
    """Wait until the content of a file has reached the disk."""
    with open(path, "rb+") as stream:
        flush_to_disk(stream.fileno())
