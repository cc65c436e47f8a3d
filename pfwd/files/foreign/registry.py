"""Which reader a file of another program needs, by its content and by the end of its name.

A new one is a module with a function ``read(file, request)`` and one entry in ``OWN``; in another
package, an entry point of the group ``pfwd.import_formats``. Readers are imported when they are
needed.
"""

import os
import stat
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from pathlib import Path

import pfwd_plugins
from pfwd.errors import SurveyError, TraceError, refusal
from pfwd.files.foreign.common import Request
from pfwd.files.traces import MAX_FILE_BYTES, TracePoint, is_trace_file

HEAD = 4096
"""Bytes that a file is recognised by."""


@dataclass(frozen=True, slots=True)
class Format:
    """A kind of files that another program writes."""

    name: str
    """For people."""
    suffixes: tuple[str, ...]
    """Ends of the names, in small letters."""
    read: str | Callable[[str, Request], Sequence[TracePoint]]
    """Reads the test points of a file; or where that function is, as ``"module:function"``:
    imported when it is used."""
    recognises: Callable[[bytes], bool]
    """Whether the first bytes are those of such a file."""

    def reader(self) -> Callable[[str, Request], Sequence[TracePoint]]:
        """The function ``read(file, request)``."""
        if not isinstance(self.read, str):
            return self.read
        module, _, function = self.read.partition(":")
        found: Callable[[str, Request], Sequence[TracePoint]]
        found = getattr(import_module(module), function)
        return found


_HERE = __name__.rpartition(".")[0]

OWN = (
    Format(
        "Rincent Minidyn, Maxidyn, Heavydyn",
        (".dynz", ".prjz", ".mpvz"),
        f"{_HERE}.rincent:read",
        lambda head: head.startswith(b"PK\x03\x04"),
    ),
    Format(
        "JILS time history",
        (".thy",),
        f"{_HERE}.jils:read",
        lambda head: b"Weight/spring:" in head and b"Number_of_samples:" in head,
    ),
    Format(
        "JILS peaks", (".dat",), f"{_HERE}.jils_peaks:read", lambda head: b"Weight/spring:" in head
    ),
    Format(
        "Dynatest F25",
        (".f25",),
        f"{_HERE}.f25:read",
        lambda head: head.startswith(b"5001,"),
    ),
    Format(
        "PDDX",
        (".pdx", ".pddx"),
        f"{_HERE}.pddx:read",
        lambda head: b"[Pavement Deflection Data Exchange File]" in head,
    ),
    Format("Sweco .fwd", (), f"{_HERE}.sweco:read", lambda head: b"ROAD SYSTEM" in head),
    Format("Dynatest .fwd", (".fwd",), f"{_HERE}.dynatest:read", lambda head: head[:3] == b"R80"),
)

TEXT = Format("delimited text with a column map", (), f"{_HERE}.delimited:read", lambda head: False)


def find_format(file: str) -> Format | None:
    """The format of a file; None when it is none of another program, or cannot be read."""
    try:
        if not stat.S_ISREG(os.stat(file).st_mode):
            return None  # a pipe may wait for ever
        with open(file, "rb") as stream:
            head = stream.read(HEAD)
    except OSError:
        return None
    found = _of(OWN, file, head)
    # What this program writes itself is nobody else's.
    return found if found is not None or is_trace_file(file) else _of(_others(), file, head)


def foreign_suffixes() -> tuple[str, ...]:
    """Ends of the names of all formats, in small letters."""
    return tuple(suffix for form in (*OWN, *_others()) for suffix in form.suffixes)


def _of(formats: Iterable[Format], file: str, head: bytes) -> Format | None:
    """By the content, else by the end of the name."""
    formats = tuple(formats)
    suffix = Path(file).suffix.lower()
    by_content = (form for form in formats if form.recognises(head))
    by_name = (form for form in formats if suffix in form.suffixes)
    return next(by_content, None) or next(by_name, None)


@cache
def _others() -> tuple[Format, ...]:
    """Of other packages; whatever goes wrong in them is an answer."""
    found = pfwd_plugins.load_all(pfwd_plugins.IMPORT_FORMATS, Format)
    return tuple(_guarded(name, form) for name, form in found)


def _guarded(name: str, form: Format) -> Format:
    package = pfwd_plugins.package_of(pfwd_plugins.IMPORT_FORMATS, name)

    def recognises(head: bytes) -> bool:
        try:
            return bool(form.recognises(head))
        except Exception as err:
            came = f"an answer to whether a file is one of it, got {type(err).__name__}: {err}"
            pfwd_plugins.remark(pfwd_plugins.IMPORT_FORMATS, name, came)
            return False

    def read(file: str, request: Request) -> Sequence[TracePoint]:
        try:
            return form.reader()(file, request)
        except (SurveyError, OSError):
            raise
        except Exception as err:
            came = f"{type(err).__name__}: {err}"
            raise TraceError(refusal(file, f"a file that {package} reads", came)) from err

    return replace(form, recognises=recognises, read=read)


def read_foreign(form: Format, file: str, request: Request) -> list[TracePoint]:
    """The test points of another program's file.

    Raises
    ------
    TraceError
        If it is refused.
    """
    try:
        size = os.path.getsize(file)
        if size > MAX_FILE_BYTES:
            expected = f"at most {MAX_FILE_BYTES / 1e6:.0f} MB"
            raise TraceError(refusal(file, expected, f"{size / 1e6:.1f} MB"))
        points = list(form.reader()(file, request))
    except OSError as err:
        raise TraceError(refusal(file, "a readable file", err.strerror or str(err))) from err
    return points
