"""Which reader a file of another program needs, by its content and by the end of its name.

Another format joins with a module that has a function like ``read(file, request)`` and a line in
``FORMATS``. Readers are imported when they are needed.
"""

import os
import stat
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

from pfwd_survey.errors import TraceError, refusal
from pfwd_survey.files.foreign.common import Request
from pfwd_survey.files.traces import LARGEST_FILE, TracePoint

HEAD = 4096
"""Bytes that a file is recognised by."""


@dataclass(frozen=True, slots=True)
class Format:
    """A kind of files that another program writes."""

    name: str
    """For people."""
    suffixes: tuple[str, ...]
    """Ends of the names, in small letters."""
    module: str
    """Module of this package with the function ``read(file, request)``."""
    recognises: Callable[[bytes], bool]
    """Whether the first bytes are those of such a file."""


FORMATS = (
    Format(
        "Rincent Minidyn, Maxidyn, Heavydyn",
        (".dynz", ".prjz", ".mpvz"),
        "rincent",
        lambda head: head.startswith(b"PK\x03\x04"),
    ),
    Format("JILS time history", (".thy",), "jils", lambda head: b"Weight/spring:" in head),
)

TEXT = Format("delimited text with a column map", (), "delimited", lambda head: False)


def find_format(file: str) -> Format | None:
    """The format of a file; None when it is none of another program, or cannot be read."""
    try:
        if not stat.S_ISREG(os.stat(file).st_mode):
            return None  # a pipe may wait for ever
        with open(file, "rb") as stream:
            head = stream.read(HEAD)
    except OSError:
        return None
    for one in FORMATS:
        if one.recognises(head):
            return one
    suffix = Path(file).suffix.lower()
    return next((one for one in FORMATS if suffix in one.suffixes), None)


def read_foreign(one: Format, file: str, request: Request) -> list[TracePoint]:
    """The test points of another program's file.

    Raises
    ------
    TraceError
        If it is refused.
    """
    try:
        size = os.path.getsize(file)
        if size > LARGEST_FILE:
            expected = f"at most {LARGEST_FILE / 1e6:.0f} MB"
            raise TraceError(refusal(file, expected, f"{size / 1e6:.1f} MB"))
        read = import_module(f"pfwd_survey.files.foreign.{one.module}").read
        points: list[TracePoint] = read(file, request)
    except OSError as err:
        raise TraceError(refusal(file, "a readable file", err.strerror or str(err))) from err
    return points
