"""Whether a file can be written, asked before the work and not after it."""

import os
import tempfile
from pathlib import Path

from pfwd_survey.errors import OptionError, refusal


def require_writable(path: str | os.PathLike[str], option: str) -> Path:
    """Refuse a place for a file that cannot be written; nothing is left there.

    Parameters
    ----------
    path : of the file that is wanted
    option : str
        That named it, for the message.

    Returns
    -------
    Path

    Raises
    ------
    OptionError
        If it is a folder, its folder is not there, or takes no file.
    """
    target = Path(path)
    where = f"{option} {target}"
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
