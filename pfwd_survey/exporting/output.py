"""Files that are there whole or not at all, and never in place of another one by mistake."""

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from pfwd_survey.errors import OptionError, refusal
from pfwd_survey.files.disk import disk_errors, sync


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
    _check(target, force=force)
    if target.is_dir():
        raise OptionError(refusal(str(target), "the name of a file", "a folder"))
    draft = _draft(target)
    try:
        with disk_errors(target):
            yield draft
            sync(draft)
            os.replace(draft, target)
    finally:
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)


@contextlib.contextmanager
def new_folder(path: str | os.PathLike[str], suffix: str, *, force: bool) -> Iterator[Path]:
    """As :func:`new_file`, for a folder; a replaced one may only hold files of this suffix."""
    target = Path(path)
    if target.is_dir() and not any(target.iterdir()):
        target.rmdir()  # nothing is replaced
    _check(target, force=force)
    others = [one.name for one in target.iterdir()] if target.is_dir() else []
    if any(not name.endswith(suffix) for name in others) or target.is_file():
        expected = f"a folder with nothing but *{suffix} files to replace"
        raise OptionError(refusal(str(target), expected, "something else", "name another one"))
    draft, old = _draft(target), target.with_name(f"{target.name}.{os.getpid()}.old")
    try:
        with disk_errors(target):
            draft.mkdir()
            yield draft
            for one in draft.iterdir():
                sync(one)
            if target.exists():
                os.replace(target, old)
            try:
                os.replace(draft, target)
            except OSError:
                if old.exists():
                    os.replace(old, target)
                raise
    finally:
        shutil.rmtree(draft, ignore_errors=True)
        if target.exists():
            shutil.rmtree(old, ignore_errors=True)


def _check(target: Path, *, force: bool) -> None:
    if not target.name:
        raise OptionError(refusal(str(target), "the name of a file or folder", "none"))
    if not target.parent.is_dir():
        hint = "make it first"
        raise OptionError(refusal(str(target), f"the folder {target.parent}", "none", hint))
    if (target.exists() or target.is_symlink()) and not force:
        hint = "--force writes over it"
        raise OptionError(refusal(str(target), "a name that is free", "one that is taken", hint))


def _draft(target: Path) -> Path:
    return target.with_name(f"{target.name}.{os.getpid()}.tmp")
