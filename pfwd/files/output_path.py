"""Output files: checks before the work begins, and replacement in one step."""

import contextlib
import os
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path

from pfwd.errors import OptionError, SurveyError, refusal
from pfwd.files.folders import is_survey

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
        If the path is inside a survey, is something other than a regular file, is in a folder that
        does not exist, or cannot be written.
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
    """Raise OptionError if a path is inside the folder of a survey, or is a link that leads into
    one.

    The folder of a survey itself is accepted, because some commands continue surveys.
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
        raise SurveyError(refusal(str(target), "a writable disk", reason)) from err


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
        os.replace(draft, target)
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
            os.fsync(handle)
        finally:
            os.close(handle)


def sync(path: Path) -> None:
    """Wait until the content of a file has reached the disk."""
    with open(path, "rb+") as stream:
        os.fsync(stream.fileno())
