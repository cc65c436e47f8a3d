"""A library in C that stands between a program and its system, and the fault it is told to make."""

import errno
import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

SOURCE = Path(__file__).with_name("shim.c")

# In the order of shim.c.
CALLS = (
    *("open", "create", "read", "write", "fsync", "fdatasync", "truncate", "rename", "link"),
    *("unlink", "mkdir", "stat", "fstat", "lock", "list", "close", "space"),
)
KINDS = (
    *("journal", "ledger", "drops", "results", "captures", "locks", "log", "reserve"),
    *("damaged", "folder", "other"),
)
MODES = ("error", "torn", "short", "done", "slow", "forget")
"""``error``: nothing is done. ``torn``: the first `amount` bytes are written, then the error.
``short``: `amount` bytes are written, and so it says. ``done``: all is done, and then the error,
as over a network that lost the answer. ``slow``: all is done `amount` ms later. ``forget``: a sync
that fails, and what was appended since the last one is zeros, as it is when the system drops the
pages that it could not write."""

FOR_EVER = 2**62
SHARE = 1_000_000
"""An amount of ``SHARE + n`` is n thousandths of what was to be written."""

VARIABLE = "PFWD_BELOW"
_COUNTERS = 2 + len(CALLS) * len(KINDS)

WRITING = ("create", "write", "fsync", "fdatasync", "truncate", "rename", "unlink", "mkdir")
"""Calls that a disk refuses which is full, read-only or gone."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault: the calls that may fail, which of them does, and how."""

    calls: tuple[str, ...] = CALLS
    kinds: tuple[str, ...] = KINDS
    at: int = 0
    """Number of the call, from 1, among those on such files; 0: none, they are counted."""
    times: int = 1
    """How many calls in a row, `FOR_EVER` for all that follow."""
    error: str = "EIO"
    mode: str = "error"
    amount: int = 0

    def text(self, roots: tuple[Path, ...], state: Path, log: Path) -> str:
        """What the library is told; `roots`: a survey, and folders of others to fail with it."""
        return (
            f"roots={':'.join(map(str, roots))}|state={state}|log={log}"
            f"|calls={_mask(self.calls, CALLS)}|kinds={_mask(self.kinds, KINDS)}"
            f"|at={self.at}|times={self.times}|error={getattr(errno, self.error)}"
            f"|mode={MODES.index(self.mode)}|amount={self.amount}"
        )

    def __str__(self) -> str:
        calls = "any call" if self.calls == CALLS else "/".join(self.calls)
        kinds = "any file" if self.kinds == KINDS else "/".join(self.kinds)
        often = {1: "once", FOR_EVER: "for ever"}.get(self.times, f"{self.times} times")
        amount = f" {self.amount}" if self.mode in ("torn", "short", "slow") else ""
        return f"{self.error} {self.mode}{amount} at {calls} {self.at} of {kinds}, {often}"


def _mask(chosen: tuple[str, ...], names: tuple[str, ...]) -> int:
    return sum(1 << names.index(name) for name in chosen)


def why_not() -> str | None:
    """Why no faults can be made below the code of this machine; None: they can."""
    if not sys.platform.startswith("linux"):
        return "expected Linux, where calls can be intercepted (LD_PRELOAD)"
    if shutil.which("cc") is None:
        return "expected a C compiler named cc, got none; install one"
    return None


def compile_shim(folder: Path) -> Path:
    """The library, compiled into a folder."""
    library = folder / "below.so"
    command = ["cc", "-O1", "-Wall", "-shared", "-fPIC", "-o", str(library), str(SOURCE), "-ldl"]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return library


def environment(library: Path, text: str) -> dict[str, str]:
    """The environment of a program that runs on the library."""
    return {**os.environ, "LD_PRELOAD": str(library), VARIABLE: text}


@dataclass(frozen=True, slots=True)
class Counted:
    """What the library counted over a run."""

    matched: int
    """Calls that might have failed."""
    fired: int
    """Calls that did."""
    counts: Mapping[tuple[str, str], int]
    """Calls on files of the folder, by call and kind; only those that came."""


def read_state(path: Path) -> Counted:
    """What was counted; nothing when no program was told of a fault."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        data = b""
    numbers = struct.unpack(f"={_COUNTERS}Q", data) if data else (0,) * _COUNTERS
    names = [(call, kind) for call in CALLS for kind in KINDS]
    counts = {name: count for name, count in zip(names, numbers[2:], strict=True) if count}
    return Counted(numbers[0], numbers[1], counts)
