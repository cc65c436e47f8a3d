"""Files that are there whole or not at all, and never in place of another one by mistake.

What is written is a draft beside its place, with a name of its own::

    NAME.3f9c0a52.tmp    the draft
    NAME.3f9c0a52.lock   held by the operating system for whoever writes it
    NAME.3f9c0a52.old    for a moment: the folder that is replaced

A program that is killed leaves them. The next export to the same place takes them away: a lock that
nobody holds is that of a program that has ended, on every system and wherever it ran, while the
number of a process may be another one's by then. Going on with a draft was considered; a folder is
written in seconds, and the survey may have changed since.
"""

import contextlib
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from pfwd.errors import OptionError, refusal
from pfwd.files.disk import disk_errors, sync
from pfwd.files.output_path import (
    refuse_inside_survey,
    refuse_special_file,
    require_writable,
)


@contextlib.contextmanager
def new_file(path: str | os.PathLike[str], *, force: bool) -> Iterator[Path]:
    """A draft beside `path` that takes its name when the block ends well.

    Parameters
    ----------
    path : of the file that is wanted
    force : bool
        Whether a file that is there may be replaced.

    Raises
    ------
    OptionError
        If there is something already, or no folder to write into.
    SurveyError
        If the disk does not take it.
    """
    target = Path(path)
    clear_leftovers(target)
    _check(target, force=force)
    if target.is_dir():
        raise OptionError(refusal(str(target), "the name of a file", "a folder"))
    with _own_draft(target) as draft, disk_errors(target):
        yield draft
        sync(draft)
        os.replace(draft, target)


@contextlib.contextmanager
def new_folder(path: str | os.PathLike[str], suffix: str, *, force: bool) -> Iterator[Path]:
    """As :func:`new_file`, for a folder; a replaced one may only hold files of this suffix."""
    target = Path(path)
    refuse_inside_survey(target, "--output")
    clear_leftovers(target)
    if target.is_dir() and not any(target.iterdir()):
        target.rmdir()  # nothing is replaced
    _check(target, force=force)
    others = [path.name for path in target.iterdir()] if target.is_dir() else []
    if any(not name.endswith(suffix) for name in others) or target.is_file():
        expected = f"a folder with nothing but *{suffix} files to replace"
        raise OptionError(refusal(str(target), expected, "something else", "name another one"))
    with _own_draft(target) as draft, disk_errors(target):
        draft.mkdir()
        yield draft
        for file in draft.iterdir():
            sync(file)
        old = draft.with_suffix(".old")
        if target.exists():
            os.replace(target, old)
        try:
            os.replace(draft, target)
        except OSError:
            if old.exists():
                os.replace(old, target)
            raise
        shutil.rmtree(old, ignore_errors=True)


def clear_leftovers(target: Path) -> None:
    """Take away what programs that were killed have left of exports to this place.

    A folder that was about to be replaced is put back. What somebody is writing stays, and so does
    what cannot be removed: it is in nobody's way.
    """
    if not target.name:
        return
    pattern = re.compile(re.escape(target.name) + r"\.[0-9a-f]{8}\.lock")
    try:
        names = os.listdir(target.parent)
    except OSError:
        return  # said when it is written
    for name in filter(pattern.fullmatch, names):
        path = target.with_name(name)
        # A link might lead the lock, which is opened for writing, to a file of somebody's.
        if path.is_symlink() or not path.is_file():
            continue
        # Somebody is at it; or the disk has no locks, and nobody can tell whose it is: then
        # filelock takes the file itself for one that is held, or, in earlier versions, says
        # NotImplementedError. Either way it stays, in nobody's way.
        with contextlib.suppress(Timeout, OSError, NotImplementedError):
            with FileLock(path, timeout=0):
                _remove(path.with_suffix(".tmp"))
                old = path.with_suffix(".old")
                if old.is_dir() and not old.is_symlink() and not target.exists():
                    os.replace(old, target)
                _remove(old)
            path.unlink(missing_ok=True)


@contextlib.contextmanager
def _own_draft(target: Path) -> Iterator[Path]:
    """The name of a draft that nobody else takes away; whatever has it goes with the block."""
    draft = target.with_name(f"{target.name}.{secrets.token_hex(4)}.tmp")
    path = draft.with_suffix(".lock")
    lock = FileLock(path)
    # On a disk without locks the draft goes without one: nobody takes it away while it is written,
    # see `clear_leftovers`, for nobody else can hold its lock either. A disk that takes no file at
    # all is said with the draft, which follows.
    with contextlib.suppress(OSError, NotImplementedError):
        lock.acquire()
    try:
        yield draft
    finally:
        with contextlib.suppress(OSError):
            _remove(draft)
        lock.release()
        with contextlib.suppress(OSError):
            path.unlink(missing_ok=True)


def _remove(path: Path) -> None:
    """A file or a folder; a link goes itself, not what it leads to."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def refuse_taken(path: str | os.PathLike[str], *, force: bool) -> None:
    """Refuse a name that is taken, or whose folder takes nothing.

    Raises
    ------
    OptionError
    """
    target = Path(path)
    refuse_inside_survey(target, "--output")
    if target.is_dir() and not any(target.iterdir()):
        return  # for a format that makes a folder; for others said when it is written
    _check(target, force=force)
    if not target.is_dir():
        require_writable(target, "--output")


def _check(target: Path, *, force: bool) -> None:
    if not target.name:
        raise OptionError(refusal(str(target), "the name of a file or folder", "none"))
    refuse_inside_survey(target, "--output")
    refuse_special_file(target, "--output")
    if not target.parent.is_dir():
        hint = "make it first"
        raise OptionError(refusal(str(target), f"the folder {target.parent}", "none", hint))
    if (target.exists() or target.is_symlink()) and not force:
        hint = "--force writes over it"
        raise OptionError(refusal(str(target), "a name that is free", "one that is taken", hint))
