"""Response time of ``pfwd open`` on a survey of 5,000 points: first paint, and every key.

The screen runs in a pseudo-terminal. The response to a key ends when the last line of the new page
is on the terminal. The time to the last byte is reported too, because the toolkit paints part of a
page twice without a visible change. POSIX only: Windows has no pseudo-terminals of this kind.
"""

import dataclasses
import math
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.output import parse_options
from benchmarks.scale import Template, UnsyncedStorage, recorded_drops
from benchmarks.screen import PFWD, SIZE, Terminal
from pfwd_device.recording import SurveyWriter

POINTS, DROPS = 5_000, 2
MAX_PAINT_S, MAX_RESPONSE_S = 1.0, 0.050
"""Limits of the first paint and of the response to a key, s."""
QUIET_S = 0.15
"""Time without a byte after which a response has ended, s."""
READY_TIMEOUT_S = 120.0
"""Time within which all points must have a verdict, s."""

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
"""Keys in the order of use, by name: the key, the last text of its page (empty: the last byte), and
the key to return, which is not measured."""


def run(arguments: list[str]) -> int:
    """Measure ``--points N`` (5000) with ``--repeats N`` of every key (5).

    Return the exit status.
    """
    options, report = parse_options(
        "opened",
        __doc__,
        arguments,
        points=(POINTS, "number of points"),
        repeats=(5, "of each key"),
    )
    if os.name != "posix":
        print("pfwd bench opened: expected a POSIX system with pseudo-terminals", file=sys.stderr)
        return 2
    with tempfile.TemporaryDirectory(prefix="pfwd-opened-") as folder:
        os.environ["PFWD_CACHE"] = str(Path(folder) / "cache")
        survey = Path(folder) / "long road"
        build(survey, options.points, recorded_drops(Path(folder) / "demo"))
        report.title(f"pfwd open, {options.points} points of {DROPS} drops, {SIZE[0]} x {SIZE[1]}")
        good = True
        for name in ("never opened before", "opened before"):
            paint, points, judged = opening(survey, options.points)
            report.record(part=name, paint_s=paint, points_s=points, judged_s=judged)
            good &= paint <= MAX_PAINT_S
        for name, responses in response_times(survey, options.repeats).items():
            median = statistics.median(painted for painted, _ in responses)
            report.record(
                part=f"key: {name}",
                middle_s=median,
                largest_s=max(painted for painted, _ in responses),
                last_byte_s=statistics.median(last for _, last in responses),
            )
            good &= median <= MAX_RESPONSE_S
    return 0 if good else 1


def build(survey: Path, points: int, templates: list[Template]) -> None:
    """Write a survey of points along a line, with positions and results."""
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
                result = {**template.results[-1], "drop": number}
                result["modulus_pa"] = 45e6 + 1e7 * ((place * 37) % 101 - 50) / 50
                writer.save_result(saved, result)
            north = 48.0 + 1.8e-4 * place
            writer.edit("position", {"latitude": north, "longitude": 11.5}, point=name)
        writer.close(600.0)


def opening(survey: Path, points: int) -> tuple[float, float, float]:
    """Return the times until the frame, the first points, and all verdicts are on the screen, s."""
    terminal = _opened(survey)
    times: list[float] = []
    try:
        for text in (b"Profile", f"{points} points".encode(), b"page 1 of"):
            while text not in terminal.text:
                _in_time(terminal)
                terminal.read(0.01)
            times.append(time.monotonic() - terminal.started)
        _until_quiet(terminal, 3.0)
        return times[0], times[1], time.monotonic() - terminal.started - 3.0
    finally:
        terminal.close()


def response_times(survey: Path, repeats: int) -> dict[str, list[tuple[float, float]]]:
    """Return, by name of the key, the times from the key to its page and to the last byte, s."""
    responses: dict[str, list[tuple[float, float]]] = {name: [] for name in KEYS}
    terminal = _opened(survey)
    try:
        while b"page 1 of" not in terminal.text:
            _in_time(terminal)
            terminal.read(0.01)
        _until_quiet(terminal, 3.0)
        for _ in range(repeats):
            for name, (key, awaited, back) in KEYS.items():
                responses[name].append(_respond(terminal, key, awaited))
                if back:
                    _respond(terminal, back, b"")
    finally:
        terminal.close()
    return responses


def _opened(survey: Path) -> Terminal:
    return Terminal([*PFWD, "open", str(survey)])


def _in_time(terminal: Terminal) -> None:
    if time.monotonic() - terminal.started > READY_TIMEOUT_S:
        raise RuntimeError(f"pfwd open: not ready within {READY_TIMEOUT_S:g} s")


def _until_quiet(terminal: Terminal, seconds: float) -> None:
    while terminal.read(seconds):
        _in_time(terminal)


def _respond(terminal: Terminal, key: str, awaited: bytes) -> tuple[float, float]:
    """Press a key; return the times to the awaited text and to the last byte, s."""
    terminal.text = b""
    start = last = time.monotonic()
    painted = math.inf
    terminal.press(key)
    while terminal.read(QUIET_S if last > start else 1.0):
        last = time.monotonic()
        if not awaited or (painted == math.inf and awaited in terminal.text):
            painted = last - start
    return painted, last - start
