"""What ``pfwd open`` costs on a survey of 5,000 points: first paint, and the answer to every key.

The screen runs in a pseudo-terminal as it does for a person. The answer to a key is there when the
last line of what it shows is on the terminal; the time to the last byte that it makes the program
write is given beside it, because the toolkit paints some of a page twice, and the second time
changes nothing that is seen. POSIX only: Windows has no such terminal that a program could stand
behind.
"""

import argparse
import dataclasses
import math
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.output import Reporter
from benchmarks.scale import PFWD, Template, UnsyncedStorage, recorded_drops
from benchmarks.screen import Terminal
from pfwd_device.recording import SurveyWriter

POINTS, DROPS = 5_000, 2
LATEST_PAINT, LATEST_ANSWER = 1.0, 0.050
"""s."""
QUIET = 0.15
"""s without a byte after which an answer is over."""
LONGEST = 120.0
"""s until everything is judged."""

KEYS: dict[str, tuple[str, bytes, str]] = {
    "down": ("\x1b[B", b"", ""),
    "page down": ("\x1b[6~", b"", ""),
    "next page": ("n", b"page 2 of", ""),
    "page before": ("b", b"page 1 of", ""),
    "sort": ("s", b"points", ""),
    "profile": ("p", b"left/right moves", ""),
    "profile, point after": ("\x1b[C", b"", ""),
    "profile, zoom in": ("+", b"", ""),
    "map": ("m", b"north up", ""),
    "job": ("j", b"target", ""),
    "points": ("1", b"verdict", ""),
    "drops of a point": ("\r", b"deflection as recorded", "1"),
}
"""What is typed in this order; the last of what it shows (empty: the last byte); what is typed to
come back, which is not counted."""


def run(arguments: list[str]) -> int:
    """``--points N`` (default 5000), ``--repeats N`` of every key (default 5)."""
    parser = argparse.ArgumentParser(prog="pfwd bench opened")
    parser.add_argument("--points", type=int, default=POINTS)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--columns", type=int, default=120)
    parser.add_argument("--rows", type=int, default=40)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    if os.name != "posix":
        print("pfwd bench opened: expected a POSIX system with pseudo-terminals", file=sys.stderr)
        return 2
    report = Reporter(arguments)
    size = args.columns, args.rows
    with tempfile.TemporaryDirectory(prefix="pfwd-opened-") as folder:
        os.environ["PFWD_CACHE"] = str(Path(folder) / "cache")
        survey = Path(folder) / "long road"
        build(survey, args.points, recorded_drops(Path(folder) / "demo"))
        report.title(f"pfwd open, {args.points} points of {DROPS} drops, {size[0]} x {size[1]}")
        good = True
        for name in ("never opened before", "opened before"):
            paint, points, judged = opening(survey, args.points, size)
            report.record(part=name, paint_s=paint, points_s=points, judged_s=judged)
            good &= paint <= LATEST_PAINT
        for name, answers in answers_to_keys(survey, size, args.repeats).items():
            middle = statistics.median(painted for painted, _ in answers)
            report.record(
                part=f"key: {name}",
                middle_s=middle,
                largest_s=max(painted for painted, _ in answers),
                last_byte_s=statistics.median(last for _, last in answers),
            )
            good &= middle <= LATEST_ANSWER
    return 0 if good else 1


def build(survey: Path, points: int, templates: list[Template]) -> None:
    """A survey of so many points along a line, with positions, results and some notes."""
    with SurveyWriter.open(survey, storage=UnsyncedStorage(), publish=False) as writer:
        writer.note_event("job", {"target": 45e6})
        for place in range(points):
            name = f"{place // 50}+{place % 50 * 20:03d}"
            for number in range(1, DROPS + 1):
                template = templates[(place + number) % len(templates)]
                record = dataclasses.replace(
                    template.record,
                    point=name,
                    drop=dataclasses.replace(template.record.drop, number=number),
                    metadata={**template.record.metadata, "key": f"bench/{place}/{number}"},
                )
                saved = writer.save_drop(record)
                result = {**template.results[-1], "drop": number, "record": saved}
                result["modulus_pa"] = 45e6 + 1e7 * ((place * 37) % 101 - 50) / 50
                writer.save_result(saved, result)
            north = 48.0 + 1.8e-4 * place
            writer.edit("position", {"latitude": north, "longitude": 11.5}, point=name)
        writer.close(600.0)


def opening(survey: Path, points: int, size: tuple[int, int]) -> tuple[float, float, float]:
    """Seconds until the frame, the first points, and all of them judged are on the terminal."""
    terminal = _opened(survey, size)
    seen: list[float] = []
    try:
        for text in (b"Profile", f"{points} points".encode(), b"page 1 of"):
            while text not in terminal.text:
                _in_time(terminal)
                terminal.read(0.01)
            seen.append(time.monotonic() - terminal.started)
        _until_quiet(terminal, 3.0)
        return seen[0], seen[1], time.monotonic() - terminal.started - 3.0
    finally:
        terminal.close()


def answers_to_keys(
    survey: Path, size: tuple[int, int], repeats: int
) -> dict[str, list[tuple[float, float]]]:
    """Seconds from a key to its page and to the last byte that it brings, by what the key does."""
    found: dict[str, list[tuple[float, float]]] = {name: [] for name in KEYS}
    terminal = _opened(survey, size)
    try:
        while b"page 1 of" not in terminal.text:
            _in_time(terminal)
            terminal.read(0.01)
        _until_quiet(terminal, 3.0)
        for _ in range(repeats):
            for name, (key, shown, back) in KEYS.items():
                found[name].append(_answer(terminal, key, shown))
                if back:
                    _answer(terminal, back, b"")
    finally:
        terminal.close()
    return found


def _opened(survey: Path, size: tuple[int, int]) -> Terminal:
    return Terminal([*PFWD, "open", str(survey)], size)


def _in_time(terminal: Terminal) -> None:
    if time.monotonic() - terminal.started > LONGEST:
        raise RuntimeError(f"pfwd open: not ready within {LONGEST:g} s")


def _until_quiet(terminal: Terminal, seconds: float) -> None:
    while terminal.read(seconds):
        _in_time(terminal)


def _answer(terminal: Terminal, key: str, shown: bytes) -> tuple[float, float]:
    """Seconds to ``shown``, and to the last byte."""
    terminal.text = b""
    begun = last = time.monotonic()
    painted = math.inf
    terminal.press(key)
    while terminal.read(QUIET if last > begun else 1.0):
        last = time.monotonic()
        if not shown or (painted == math.inf and shown in terminal.text):
            painted = last - begun
    return painted, last - begun


if __name__ == "__main__":
    sys.exit(run(sys.argv[1:]))
