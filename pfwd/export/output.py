"""Writing of files and folders in one step; an existing one is replaced only on request.

An export writes a draft in the same folder::

    NAME.3f9c0a52.tmp    the draft
    NAME.3f9c0a52.lock   locked by the writing process through the operating system
    NAME.3f9c0a52.old    the replaced folder, while the draft is renamed

A program that is killed leaves these files, and the next export to the same path removes them. It
recognises them by the lock, which the operating system releases when a process ends. The number of
the process would not do, because numbers are used again. A draft is never continued: writing takes
seconds, and the survey may have changed since.
"""

import contextlib
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

from filelock import FileLock, Timeout

from pfwd.errors import OptionError, refusal
from pfwd.files.output_path import (
    disk_errors,
    refuse_bad_place,
    refuse_special_file,
    require_writable,
    sync,
)
from pfwd_device.recording.storage import replace_file


@contextlib.contextmanager
def new_file(path: str | os.PathLike[str], *, force: bool) -> Iterator[Path]:
    """Yield the path of a draft, and rename it to `path` when the block ends without error.

    Parameters
    ----------
    path : path of the file to write
    force : bool
        True: an existing file may be replaced.

    Raises
    ------
    OptionError
        If the path is in use, or its folder does not exist.
    SurveyError
        If the file cannot be written.
    """
    target = Path(path)
    clear_leftovers(target)
    _check(target, force=force)
    if target.is_dir():
        raise OptionError(refusal(str(target), "the name of a file", "a folder"))
    with _locked_draft(target) as draft, disk_errors(target):
        yield draft
        sync(draft)
        replace_file(draft, target)


@contextlib.contextmanager
def new_text_file(
    path: str | os.PathLike[str], *, force: bool, newline: str = "\n"
) -> Iterator[TextIO]:
    """Yield a stream for the UTF-8 text of a new file; parameters and errors as for
    :func:`new_file`.
    """
    with (
        new_file(path, force=force) as draft,
        open(draft, "w", encoding="utf-8", newline=newline) as stream,
    ):
        yield stream


@contextlib.contextmanager
def new_folder(path: str | os.PathLike[str], suffix: str, *, force: bool) -> Iterator[Path]:
    """Yield the path of a draft folder, and rename it to `path` when the block ends without error.

    Parameters
    ----------
    path : path of the folder to write
    suffix : str
        Only a folder whose files all have this suffix may be replaced.
    force : bool
        True: an existing folder may be replaced.

    Raises
    ------
    OptionError, SurveyError
        As for :func:`new_file`.
    """
    target = Path(path)
    refuse_bad_place(target, "--output")
    clear_leftovers(target)
    if target.is_dir() and not any(target.iterdir()):
        target.rmdir()  # an empty folder may be replaced without `force`
    _check(target, force=force)
    existing = [path.name for path in target.iterdir()] if target.is_dir() else []
    if any(not name.endswith(suffix) for name in existing) or target.is_file():
        expected = f"a folder with nothing but *{suffix} files to replace"
        raise OptionError(refusal(str(target), expected, "other files", "name another folder"))
    with _locked_draft(target) as draft, disk_errors(target):
        draft.mkdir()
        yield draft
        for file in draft.iterdir():
            sync(file)
        old = draft.with_suffix(".old")
        if target.exists():
            replace_file(target, old)
        try:
            replace_file(draft, target)
        except OSError:
            if old.exists():
                os.replace(old, target)
            raise
        shutil.rmtree(old, ignore_errors=True)


def clear_leftovers(target: Path) -> None:
    """Remove the drafts that interrupted exports to a path have left.

    A folder whose replacement was interrupted is restored. Files of a running export stay, and so
    do those that cannot be removed.
    """
    if not target.name:
        return
    pattern = re.compile(re.escape(target.name) + r"\.[0-9a-f]{8}\.lock")
    try:
        names = os.listdir(target.parent)
    except OSError:
        return  # `new_file` reports the error
    for name in filter(pattern.fullmatch, names):
        path = target.with_name(name)
        # Locking opens the file for writing, and a link may lead to a user's file.
        if path.is_symlink() or not path.is_file():
            continue
        # Another process writes the draft; or the disk has no locks, and the owner is unknown: then
        # filelock reports the file as locked or, in earlier versions, raises NotImplementedError.
        # Either way the draft stays.
        with contextlib.suppress(Timeout, OSError, NotImplementedError):
            with FileLock(path, timeout=0):
                _remove(path.with_suffix(".tmp"))
                old = path.with_suffix(".old")
                if old.is_dir() and not old.is_symlink() and not target.exists():
                    os.replace(old, target)
                _remove(old)
            path.unlink(missing_ok=True)


@contextlib.contextmanager
def _locked_draft(target: Path) -> Iterator[Path]:
    """Yield a path for a draft and hold its lock; remove what is at this path after the block."""
    draft = target.with_name(f"{target.name}.{secrets.token_hex(4)}.tmp")
    path = draft.with_suffix(".lock")
    lock = FileLock(path)
    # On a disk without locks the draft has none (NotImplementedError in filelock 3, which is
    # allowed), and `clear_leftovers` does not remove it, because it cannot lock it either. A disk
    # that refuses every file (OSError) is reported for the draft itself.
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
    """Remove a file or a folder; a link is removed without its target."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def refuse_existing(path: str | os.PathLike[str], *, force: bool) -> None:
    """Raise OptionError if a path is in use or cannot be written.

    Parameters
    ----------
    path : path of the output
    force : bool
        True: an existing file may be replaced.
    """
    target = Path(path)
    refuse_bad_place(target, "--output")
    if target.is_dir() and not any(target.iterdir()):
        return  # `new_file` refuses it if the format is a file
    _check(target, force=force)
    if not target.is_dir():
        require_writable(target, "--output")


def _check(target: Path, *, force: bool) -> None:
    if not target.name:
        raise OptionError(refusal(str(target), "the name of a file or folder", "none"))
    refuse_bad_place(target, "--output")
    refuse_special_file(target, "--output")
    if not target.parent.is_dir():
        hint = "make it first"
        raise OptionError(refusal(str(target), f"the folder {target.parent}", "none", hint))
    if (target.exists() or target.is_symlink()) and not force:
        hint = "choose another one, or replace it with --force"
        raise OptionError(refusal(str(target), "a new name", "an existing one", hint))
