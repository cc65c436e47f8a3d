"""Cost of commands on surveys of 2,500 and 10,000 drops.

The survey is written by the project's writer from recorded drops of a simulated instrument, without
waiting for the disk; this time is not part of the figures. A figure is the smallest of several
runs. The processor time of a command and its children is reported too, as it depends less on other
programs. The limits are those of an idle computer. POSIX only: Windows does not report the
resources of child processes.
"""

import dataclasses
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from benchmarks.output import Reporter, parse_options
from benchmarks.screen import PFWD, first_paint
from pfwd_device.jobs import Jobs
from pfwd_device.recording import DropRecord, ReboundRecord, Storage, SurveyWriter, read_survey

DROPS = (2_500, 10_000)
SHORT = (250, 1_000)
DROPS_PER_POINT = 10_000 / 1_700
REPEATS = 3
DROPS_PER_NOTE = 50
"""Every drop of this number gets a note."""

MAX_RATIO = 1.3
"""Largest ratio of the cost per drop of the larger survey to that of the smaller one. The cost of a
survey with one drop is subtracted first."""

SPARE_BYTES = 2 * 10**9
"""Free space that must remain on the disk, bytes."""

BYTES_OF_A_DROP = 200_000
"""Space that one drop needs on the disk, bytes: record, file and result, and the same for
exports."""

TIMEOUT_S = 600.0
"""Time limit of one command, s."""


@dataclass(frozen=True, slots=True)
class ScaleCase:
    """Command to be measured, with its limits."""

    name: str
    arguments: Callable[[Path, Path], list[str]]
    """Returns the arguments from the path of the survey and a folder for exports."""
    seconds: float
    """Longest time for the larger survey, s."""
    megabytes: float | None = None
    """Largest memory of one process, MB; None: no limit."""
    repeats: int = REPEATS


CASES = (
    ScaleCase("edit, list", lambda survey, _: ["edit", str(survey)], 1.0),
    ScaleCase(
        "edit --note",
        lambda survey, _: ["edit", str(survey), "--point", "P 1", "--note", "wet"],
        1.5,
    ),
    ScaleCase("export table", lambda survey, out: _export(survey, out, "table"), 5.0),
    ScaleCase("check", lambda survey, _: ["check", str(survey)], 8.0),
    ScaleCase("export h5", lambda survey, out: _export(survey, out, "h5"), 60.0, 200.0, 1),
)

MAX_PAINT_S = 2.0
"""Longest time from ``pfwd live`` or ``pfwd replay --live`` to a readable page, s."""


def _export(survey: Path, out: Path, form: str) -> list[str]:
    return ["export", str(survey), "--format", form, "-o", str(out / f"x.{form}"), "--force"]


def run(arguments: list[str]) -> int:
    """Build the surveys, measure and compare; return the exit status: 0 if all limits are met."""
    options, report = parse_options(
        "scale",
        __doc__,
        arguments,
        repeats=(REPEATS, "of each command"),
        folder=(Path, "where the surveys are made, and deleted"),
        short=(False, "a tenth of the drops"),
    )
    if os.name != "posix":
        print("pfwd bench scale: expected a POSIX system", file=sys.stderr)
        return 2
    smaller, larger = SHORT if options.short else DROPS
    with tempfile.TemporaryDirectory(prefix="pfwd-bench-", dir=options.folder) as folder:
        free, required = shutil.disk_usage(folder).free, larger * BYTES_OF_A_DROP + SPARE_BYTES
        if free < required:
            print(
                f"pfwd bench scale: expected {required / 1e9:.1f} GB free in {folder}, got "
                f"{free / 1e9:.1f} GB; name another folder with --folder",
                file=sys.stderr,
            )
            return 1
        return _run(report, Path(folder), (1, smaller, larger), options.repeats)


def _run(report: Reporter, folder: Path, counts: tuple[int, ...], repeats: int) -> int:
    survey = folder / "survey"
    templates = recorded_drops(folder / "recorded")
    costs_by_name: dict[str, list[Cost]] = {}
    for before, drops in zip((0, *counts), counts, strict=False):
        start = time.monotonic()
        build(survey, before, drops, templates)
        if drops > 1:
            seconds = time.monotonic() - start
            report.title(f"{drops} drops at {point_number(drops)} points (s)")
            size = sum(path.stat().st_size for path in survey.rglob("*") if path.is_file())
            report.record(part="survey", drops=drops, megabytes=size / 1e6, made_in_s=seconds)
        for case in CASES:
            n_runs = min(case.repeats, repeats)
            costs = [measure(case.arguments(survey, folder)) for _ in range(n_runs)]
            best = Cost(
                min(cost.seconds for cost in costs),
                min(cost.processor for cost in costs),
                max(cost.megabytes for cost in costs),
            )
            costs_by_name.setdefault(case.name, []).append(best)
            if drops > 1:
                report.record(part=case.name, drops=drops, **dataclasses.asdict(best))
        if drops > 1:
            paints = {
                # No instrument is at this address; the time is that of reading the survey.
                "first paint of live": ["live", "socket://127.0.0.1:9", "-o", str(survey)],
                "first paint of replay --live": ["replay", str(survey), "--live"],
            }
            for name, command in paints.items():
                painted = [first_paint(command) for _ in range(repeats)]
                cost = Cost(min(painted), 0.0, 0.0)
                costs_by_name.setdefault(name, []).append(cost)
                report.record(part=name, drops=drops, seconds=cost.seconds, largest=max(painted))
    report.record(part="machine", cores=os.cpu_count(), load=psutil.getloadavg()[0])
    return _judge(report, costs_by_name, counts)


def _judge(
    report: Reporter, costs_by_name: Mapping[str, list["Cost"]], counts: tuple[int, ...]
) -> int:
    report.title("cost per drop, what one drop costs taken off, and the limits")
    good = True
    limits = {case.name: case for case in CASES}
    for name, costs in costs_by_name.items():
        case = limits.get(name)
        seconds = costs[-1].seconds
        is_full_size = counts[-1] == DROPS[-1]  # the limits are for this size
        fine = not is_full_size or seconds <= (case.seconds if case else MAX_PAINT_S)
        values: dict[str, Any] = {"part": f"{name}, flat", "seconds": seconds}
        if case is not None:
            first, *rest = costs
            each = [
                max(cost.processor - first.processor, 0.0) / (drops - 1)
                for cost, drops in zip(rest, counts[1:], strict=True)
            ]
            ratio = each[-1] / each[0] if each[0] > 0 else float("inf")
            values |= {"each_ms": each[-1] * 1e3, "ratio": ratio}
            fine &= ratio <= MAX_RATIO
            if case.megabytes is not None:
                values["megabytes"] = costs[-1].megabytes
                fine &= costs[-1].megabytes <= case.megabytes
        report.record(**values, fine=fine)
        good &= fine
    return 0 if good else 1


# Cost of a command.


@dataclass(frozen=True, slots=True)
class Cost:
    """Elapsed time, processor time and memory of a command."""

    seconds: float
    """Elapsed time, s."""
    processor: float
    """Processor time of the command and its children, user and system, s."""
    megabytes: float
    """Largest memory of one of its processes, MB."""


# A small process starts the command: the reported memory of a child is at least that of its parent.
_MEASURING = """
import json, os, subprocess, sys, time
begun = time.monotonic()
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, used = os.wait4(child.pid, 0)
child.returncode = os.waitstatus_to_exitcode(status)
seconds = time.monotonic() - begun
processor = used.ru_utime + used.ru_stime
print(json.dumps([child.returncode, seconds, processor, used.ru_maxrss]))
"""


def measure(arguments: list[str]) -> Cost:
    """Run ``pfwd`` with these arguments and return the cost; RuntimeError if it fails."""
    command = [sys.executable, "-I", "-S", "-c", _MEASURING, *PFWD, *arguments]
    completed = subprocess.run(
        command, capture_output=True, text=True, timeout=TIMEOUT_S, check=True
    )
    status, seconds, processor, largest = json.loads(completed.stdout)
    if status != 0:
        raise RuntimeError(
            f"pfwd {' '.join(arguments)}: status {status}: {completed.stderr[:1000]}"
        )
    unit = 1.0 if sys.platform == "darwin" else 1024.0  # bytes there, kB elsewhere
    return Cost(seconds, processor, largest * unit / 1e6)


# Survey.


@dataclass(frozen=True, slots=True)
class Template:
    """Recorded drop with its rebounds and results."""

    record: DropRecord
    rebounds: tuple[ReboundRecord, ...]
    results: tuple[Mapping[str, Any], ...]


def recorded_drops(folder: Path) -> list[Template]:
    """Return three drops of the scenario `default`, recorded and inverted by ``pfwd demo``."""
    options = ["--scenario", "default", "--drops", "3", "--lines", "-o", str(folder)]
    command = [*PFWD, "demo", *options]
    subprocess.run(command, check=True, capture_output=True, timeout=TIMEOUT_S)
    return [
        Template(dataclasses.replace(record, rebounds=()), record.rebounds, drop.read_results())
        for drop in read_survey(folder).drops
        for record in [drop.read()]
    ]


class UnsyncedStorage(Storage):
    """Storage that does not wait for the disk."""

    def sync(self, descriptor: int) -> None:
        """Return at once, without waiting for the disk."""

    def sync_directory(self, path: Path) -> None:
        """Return at once, without waiting for the disk."""


def point_number(number: int) -> int:
    """Return the number, from 1, of the point that a drop is at, by the number of the drop."""
    return int((number - 1) / DROPS_PER_POINT) + 1


def build(survey: Path, before: int, drops: int, templates: list[Template]) -> None:
    """Extend a survey of `before` drops to `drops` drops."""
    with SurveyWriter.open(survey, storage=UnsyncedStorage(), jobs=Jobs(0)) as writer:
        for number, template, record in _records(before, drops, templates):
            saved = writer.save_drop(record)
            assert saved == number
            for rebound in template.rebounds:
                writer.save_rebound(saved, rebound)
            writer.publish(saved)
            for result in template.results:
                writer.save_result(saved, {**result, "drop": record.drop.number})
            if number % DROPS_PER_NOTE == 0:
                writer.edit("note", f"said of drop {number}", number=saved)
        writer.close(TIMEOUT_S)


def _records(
    before: int, drops: int, templates: list[Template]
) -> Iterator[tuple[int, Template, DropRecord]]:
    for number in range(before + 1, drops + 1):
        template = templates[number % len(templates)]
        point = point_number(number)
        first = next(n for n in range(number, 0, -1) if n == 1 or point_number(n - 1) < point)
        yield (
            number,
            template,
            dataclasses.replace(
                template.record,
                point=f"P {point}",
                drop=dataclasses.replace(template.record.drop, number=number - first + 1),
                metadata={**template.record.metadata, "key": f"bench/{number}"},
            ),
        )
