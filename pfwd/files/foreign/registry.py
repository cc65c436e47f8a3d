"""Formats of other programs' files, recognised by content, else by suffix.

A new format is a module with a function ``read(file, request)`` and one entry in
`FOREIGN_FORMATS`. In another package it is an entry point of the group ``pfwd.import_formats``
that names a `Format`. A reader is imported when it is used.
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
from pfwd.files.foreign.laboratory import laboratory_format
from pfwd.files.traces import MAX_FILE_BYTES, TracePoint, is_trace_file

RECOGNITION_BYTES = 4096
"""Number of bytes at the beginning of a file by which its format is recognised."""


@dataclass(frozen=True, slots=True)
class Format:
    """File format of another program, with the functions that recognise and read it."""

    name: str
    """Name for messages."""
    suffixes: tuple[str, ...]
    """Suffixes of file names in lower case, with the dot."""
    read: str | Callable[[str, Request], Sequence[TracePoint]]
    """Function that reads the test points of a file, or its name ``"module:function"``, which is
    imported when it is used."""
    recognises: Callable[[bytes], bool]
    """Function that returns whether the first bytes of a file are of this format."""

    def reader(self) -> Callable[[str, Request], Sequence[TracePoint]]:
        """Return the function ``read(file, request)``, imported if necessary."""
        if not isinstance(self.read, str):
            return self.read
        module, _, function = self.read.partition(":")
        reader: Callable[[str, Request], Sequence[TracePoint]]
        reader = getattr(import_module(module), function)
        return reader


_PACKAGE = __name__.rpartition(".")[0]

FOREIGN_FORMATS = (
    Format(
        "Rincent Minidyn, Maxidyn, Heavydyn",
        (".dynz", ".prjz", ".mpvz"),
        f"{_PACKAGE}.rincent:read",
        lambda head: head.startswith((b"PK\x03\x04", b"PK\x05\x06")),
    ),
    Format(
        "JILS time history",
        (".thy",),
        f"{_PACKAGE}.jils:read",
        lambda head: b"Weight/spring:" in head and b"Number_of_samples:" in head,
    ),
    Format(
        "JILS peaks",
        (".dat",),
        f"{_PACKAGE}.jils_peaks:read",
        lambda head: b"Weight/spring:" in head,
    ),
    Format(
        "Dynatest F25",
        (".f25",),
        f"{_PACKAGE}.f25:read",
        lambda head: head.startswith(b"5001,"),
    ),
    Format(
        "PDDX",
        (".pdx", ".pddx"),
        f"{_PACKAGE}.pddx:read",
        lambda head: b"[Pavement Deflection Data Exchange File]" in head,
    ),
    Format(
        "Sweco .fwd",
        (),
        f"{_PACKAGE}.sweco:read",
        lambda head: b"ROAD SYSTEM" in head or b"Load plate radius [mm]" in head,
    ),
    Format(
        "Dynatest .fwd", (".fwd",), f"{_PACKAGE}.dynatest:read", lambda head: head[:3] == b"R80"
    ),
)

LABORATORY_FILE = Format(
    "laboratory file with a column map",
    (),
    f"{_PACKAGE}.delimited:read",
    lambda head: laboratory_format(head) is not None,
)
DELIMITED_TEXT = Format(
    "delimited text with a column map", (), f"{_PACKAGE}.delimited:read", lambda head: False
)


def find_format(file: str) -> Format | None:
    """Return the format of another program's file.

    Parameters
    ----------
    file : str
        Path of the file.

    Returns
    -------
    Format or None
        None: the file has no known format, is a trace file of this program, or cannot be read.
    """
    try:
        if not stat.S_ISREG(os.stat(file).st_mode):
            return None  # a pipe may wait for ever
        with open(file, "rb") as stream:
            head = stream.read(RECOGNITION_BYTES)
    except OSError:
        return None
    built_in = _select((*FOREIGN_FORMATS, LABORATORY_FILE), file, head)
    # Trace files of this program are never offered to plug-ins.
    if built_in is not None or is_trace_file(file):
        return built_in
    return _select(_plugin_formats(), file, head)


def foreign_suffixes() -> tuple[str, ...]:
    """Return the suffixes of all formats, in lower case with the dot."""
    return tuple(
        suffix for form in (*FOREIGN_FORMATS, *_plugin_formats()) for suffix in form.suffixes
    )


def _select(formats: Iterable[Format], file: str, head: bytes) -> Format | None:
    """Return the format whose content matches, else whose suffix matches; None: no format does."""
    formats = tuple(formats)
    suffix = Path(file).suffix.lower()
    by_content = (form for form in formats if form.recognises(head))
    by_name = (form for form in formats if suffix in form.suffixes)
    return next(by_content, None) or next(by_name, None)


@cache
def _plugin_formats() -> tuple[Format, ...]:
    """Return the formats of installed plug-ins, whose exceptions are converted to messages."""
    formats = pfwd_plugins.load_all(pfwd_plugins.IMPORT_FORMATS, Format)
    return tuple(_guarded(name, form) for name, form in formats)


def _guarded(name: str, form: Format) -> Format:
    package = pfwd_plugins.package_of(pfwd_plugins.IMPORT_FORMATS, name)

    def recognises(head: bytes) -> bool:
        try:
            return bool(form.recognises(head))
        except Exception as err:
            actual = f"True or False from recognises(), got {type(err).__name__}: {err}"
            pfwd_plugins.remark(pfwd_plugins.IMPORT_FORMATS, name, actual)
            return False

    def read(file: str, request: Request) -> Sequence[TracePoint]:
        try:
            return form.reader()(file, request)
        except (SurveyError, OSError):
            raise
        except Exception as err:
            actual = f"{type(err).__name__}: {err}"
            raise TraceError(refusal(file, f"a file that {package} reads", actual)) from err

    return replace(form, recognises=recognises, read=read)


def read_foreign(form: Format, file: str, request: Request) -> list[TracePoint]:
    """Read the test points of another program's file.

    Parameters
    ----------
    form : Format
    file : str
        Path of the file.
    request : Request
        Options of the user.

    Raises
    ------
    TraceError
        If the file is refused.
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
