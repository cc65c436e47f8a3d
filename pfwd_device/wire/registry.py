"""Registry of the dialects, the protocols of instruments, by their names in setup files.

A new dialect is a module with a class like :class:`pfwd_device.wire.dialect.Dialect` and an entry
in ``BUILT_IN``; in another package, an entry point of the group ``pfwd.dialects``. The entry states
which declarations a dialect needs and how it is recognised at a port.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import pfwd_plugins
from pfwd_device.identity import Identity
from pfwd_device.wire.ascii_lines import AsciiDialect, LineLayout, looks_like_lines
from pfwd_device.wire.binary import BinaryDialect
from pfwd_device.wire.dataq import DataqDialect, looks_like_dataq, usb_model
from pfwd_device.wire.dialect import Dialect
from pfwd_device.wire.fixed_frames import FrameDialect, FrameLayout
from pfwd_device.wire.labjack import PRODUCT_QUESTION, LabjackDialect, looks_like_labjack


@dataclass(frozen=True, slots=True)
class DeclaredLink:
    """Values of the setup file that a dialect may need to decode the data of its instrument."""

    identity: Identity | None = None
    """Declared identity of the instrument; None if the instrument reports it."""
    columns: tuple[int, ...] = ()
    """Column of each channel, 0 is the first; empty unless the dialect needs columns."""
    inputs: tuple[int, ...] = ()
    """Number of the input of each channel as printed on a logger; empty unless the dialect needs
    it."""
    resolution: tuple[float, ...] = ()
    """Printed value of one count, for each channel."""
    line_layout: LineLayout | None = None
    """Layout of lines; None: that of docs/protocol.md."""
    frame_layout: FrameLayout | None = None
    """Layout of frames of fixed length; None unless the dialect needs it."""
    numbers: tuple[tuple[int, str], ...] = ()
    """Place in the frame and type of each channel; empty unless the dialect needs them."""
    first_stream: int = 0
    """Number of the first stream (run of samples) of an instrument that does not number them."""


@dataclass(frozen=True, slots=True)
class DialectEntry:
    """Entry of the registry: a dialect, the declarations it needs and its recognition."""

    name: str
    """Name in setup files, scenarios and the header of captures; small letters."""
    title: str
    """Title on screen; the model of an instrument that does not report one."""
    make: Callable[[DeclaredLink], Dialect]
    """Function that returns a new decoder and encoder of the dialect."""
    needs_identity: bool = False
    """True if the instrument reports no identity, so that the setup file has to declare it."""
    needs_columns: bool = False
    """True if each channel has to be declared with its column."""
    needs_inputs: bool = False
    """True for a logger, which reports its converter, but each of whose channels has to be declared
    with the number of its input."""
    needs_frames: bool = False
    """True if frames and the place of each channel in them have to be declared."""
    recognises: Callable[[bytes], bool] | None = None
    """Function that returns True if received bytes belong to this dialect; None if an instrument of
    this dialect replies to a request for its identity."""
    question: bytes = b""
    """Bytes to which an instrument of this dialect answers; empty: it sends without a request."""
    usb_model: Callable[[int, int], str | None] = lambda vendor, product: None
    """Function that returns the model of the instrument with a USB vendor number and product
    number; None if no instrument of this dialect has them."""
    scheme: str = ""
    """Beginning of the URLs of its ports, to which alone the question is sent; empty: any port."""


def _ascii(declared: DeclaredLink) -> Dialect:
    assert declared.identity is not None  # needs_identity
    return AsciiDialect(
        declared.identity,
        declared.columns,
        resolution=declared.resolution,
        first_stream=declared.first_stream,
        layout=declared.line_layout,
    )


def _frames(declared: DeclaredLink) -> Dialect:
    assert declared.identity is not None  # needs_identity
    assert declared.frame_layout is not None  # needs_frames
    return FrameDialect(
        declared.identity, declared.frame_layout, declared.numbers, declared.first_stream
    )


def _labjack(declared: DeclaredLink) -> Dialect:
    assert declared.identity is not None  # needs_identity
    return LabjackDialect(declared.identity, declared.inputs, declared.first_stream)


def _dataq(declared: DeclaredLink) -> Dialect:
    assert declared.identity is not None  # needs_identity
    return DataqDialect(declared.identity, declared.inputs, declared.first_stream)


BUILT_IN: Mapping[str, DialectEntry] = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            DialectEntry("pfwd", "binary protocol", lambda declared: BinaryDialect()),
            DialectEntry(
                "ascii",
                "ASCII lines",
                _ascii,
                needs_identity=True,
                needs_columns=True,
                recognises=looks_like_lines,
            ),
            DialectEntry("frames", "fixed frames", _frames, needs_identity=True, needs_frames=True),
            DialectEntry(
                "dataq",
                "DATAQ logger",
                _dataq,
                needs_identity=True,
                needs_inputs=True,
                recognises=looks_like_dataq,
                question=b"info 0\r",
                usb_model=usb_model,
            ),
            DialectEntry(
                "labjack",
                "LabJack logger",
                _labjack,
                needs_identity=True,
                needs_inputs=True,
                recognises=looks_like_labjack,
                question=PRODUCT_QUESTION,
                scheme="labjack",
            ),
        )
    }
)
"""Dialects of this program by name; the first is the default."""

DEFAULT = next(iter(BUILT_IN))


def find_dialect(name: str) -> DialectEntry | None:
    """Return the entry of the dialect with a name; None if no dialect has it."""
    return BUILT_IN.get(name) or pfwd_plugins.load(pfwd_plugins.DIALECTS, name, DialectEntry)


def dialect_names() -> tuple[str, ...]:
    """Return the names of all dialects, those from installed plugins last."""
    plugin_names = pfwd_plugins.names(pfwd_plugins.DIALECTS)
    return tuple(dict.fromkeys((*BUILT_IN, *plugin_names)))


def all_dialects() -> Sequence[DialectEntry]:
    """Return the entries of all dialects that can be loaded, those from installed plugins last."""
    plugin_names = pfwd_plugins.load_all(pfwd_plugins.DIALECTS, DialectEntry, BUILT_IN)
    return (*BUILT_IN.values(), *(entry for _, entry in plugin_names))
