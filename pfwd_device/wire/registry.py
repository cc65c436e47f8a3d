"""The dialects that instruments are spoken to in, by the name that a setup file says.

A new one is a module with a class like :class:`pfwd_device.wire.dialect.Dialect` and one entry in
``OWN``; in another package, an entry point of the group ``pfwd.dialects``. What a dialect needs,
and how it is recognised at a port, is said by its entry; nobody else asks for a name.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import pfwd_plugins
from pfwd_device.identity import Identity
from pfwd_device.wire.ascii_lines import AsciiDialect, looks_like_lines
from pfwd_device.wire.binary import BinaryDialect
from pfwd_device.wire.dialect import Dialect


@dataclass(frozen=True, slots=True)
class DeclaredLink:
    """What the setup file says that a dialect may need."""

    identity: Identity | None = None
    """What the instrument would say of itself; None: it says so itself."""
    columns: tuple[int, ...] = ()
    """For each channel its column, 0 is the first; empty unless the dialect needs columns."""
    resolution: tuple[float, ...] = ()
    """For each channel what one count stands for."""
    first_stream: int = 0
    """Number of the first run of a sampler that does not number its runs itself."""


@dataclass(frozen=True, slots=True)
class DialectEntry:
    """A dialect and what has to be known to speak it."""

    name: str
    """In setup files, scenarios and the header of captures; small letters."""
    title: str
    """For people; the model of an instrument that does not say one."""
    make: Callable[[DeclaredLink], Dialect]
    """A fresh one."""
    needs_identity: bool = False
    """Whether the instrument says nothing of itself, so that the setup file has to say it all."""
    needs_columns: bool = False
    """Whether each channel has to be declared with its column."""
    recognises: Callable[[bytes], bool] | None = None
    """Whether bytes that came unasked are of this dialect; None: an instrument answers when it is
    asked who it is."""


def _ascii(declared: DeclaredLink) -> Dialect:
    assert declared.identity is not None  # needs_identity
    return AsciiDialect(
        declared.identity,
        declared.columns,
        resolution=declared.resolution,
        first_stream=declared.first_stream,
    )


OWN: Mapping[str, DialectEntry] = MappingProxyType(
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
        )
    }
)
"""Those of this program; the first is what an instrument speaks when nothing is declared."""

DEFAULT = next(iter(OWN))


def find_dialect(name: str) -> DialectEntry | None:
    """The dialect of a name; None when there is none."""
    return OWN.get(name) or pfwd_plugins.load(pfwd_plugins.DIALECTS, name, DialectEntry)


def dialect_names() -> tuple[str, ...]:
    """Names of all dialects, those of other packages last."""
    others = pfwd_plugins.names(pfwd_plugins.DIALECTS)
    return tuple(dict.fromkeys((*OWN, *others)))


def all_dialects() -> Sequence[DialectEntry]:
    """All dialects that can be spoken, those of other packages last."""
    others = pfwd_plugins.load_all(pfwd_plugins.DIALECTS, DialectEntry, OWN)
    return (*OWN.values(), *(entry for _, entry in others))
