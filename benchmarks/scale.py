"""What a survey of many drops costs: every command as users run it, on 2,500 and on 10,000 drops.

The survey is made by the project's own writer, from drops that a simulated instrument recorded,
without waiting for the disk. Making it is no part of the figures. A figure is the smallest of
several runs; the processor time of a command, its children with it, stands beside it, because
other programs may use the machine meanwhile. The limits are those of an idle machine. POSIX only:
elsewhere a program is not told what its children used.
"""

import argparse
import dataclasses
import hashlib
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

from benchmarks.output import Reporter
from pfwd_device.recording import DropRecord, Rebound, Storage, SurveyWriter
from pfwd_device.recording.drop_file import drop_file_bytes
from pfwd_device.recording.layout import Layout

DROPS = (2_500, 10_000)
SHORT = (250, 1_000)
DROPS_PER_POINT = 10_000 / 1_700
REPEATS = 3
NOTES = 50
"""A note on every so many drops."""

LARGEST_RATIO = 1.3
"""Of the cost per drop between the surveys; what a command costs with one drop is taken off."""

SPARE_BYTES = 2 * 10**9
"""Left free on the disk."""

BYTES_OF_A_DROP = 200_000
"""On the disk: record, file and result, and as much again for what is exported."""

TIMEOUT = 600.0
"""s for one command."""


@dataclass(frozen=True, slots=True)
class Case:
    """A command that is measured."""

    name: str
    arguments: Callable[[Path, Path], list[str]]
    """From the survey and a folder for what is exported."""
    seconds: float
    """At most, for the larger survey."""
    megabytes: float | None = None
    """At most, of the largest process; None: not said."""
    repeats: int = REPEATS


CASES = (
    Case("edit, list", lambda survey, _: ["edit", str(survey)], 1.0),
    Case(
        "edit --note",
        lambda survey, _: ["edit", str(survey), "--point", "P 1", "--note", "wet"],
        1.5,
    ),
    Case("export table", lambda survey, out: _export(survey, out, "table"), 3.0),
    Case("check", lambda survey, _: ["check", str(survey)], 8.0),
    Case("export h5", lambda survey, out: _export(survey, out, "h5"), 60.0, 200.0, 1),
)

LATEST_PAINT = 2.0
"""s from ``pfwd live`` or ``pfwd replay --live`` to a page that can be read."""


def _export(survey: Path, out: Path, form: str) -> list[str]:
    return ["export", str(survey), "--format", form, "-o", str(out / f"x.{form}"), "--force"]


def run(arguments: list[str]) -> int:
    """Build, measure, compare; 0 when everything is as it should be."""
    parser = argparse.ArgumentParser(prog="pfwd bench scale")
    parser.add_argument("--drops", type=int, nargs=2, metavar="N", help="of the two surveys")
    parser.add_argument("--repeats", type=int, default=REPEATS, help="of each command")
    parser.add_argument("--only", metavar="TEXT", help="commands whose name begins so")
    parser.add_argument("--folder", type=Path, help="where the surveys are made, and deleted")
    parser.add_argument("--short", action="store_true", help="a tenth of the drops")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(arguments)
    if os.name != "posix":
        print("pfwd bench scale: expected a POSIX system", file=sys.stderr)
        return 2
    smaller, larger = args.drops or (SHORT if args.short else DROPS)
    if not 0 < smaller < larger:
        print("pfwd bench scale: expected two numbers, the larger one last", file=sys.stderr)
        return 2
    report = Reporter(arguments)
    with tempfile.TemporaryDirectory(prefix="pfwd-bench-", dir=args.folder) as folder:
        free, wanted = shutil.disk_usage(folder).free, larger * BYTES_OF_A_DROP + SPARE_BYTES
        if free < wanted:
            print(
                f"pfwd bench scale: expected {wanted / 1e9:.1f} GB free in {folder}, got "
                f"{free / 1e9:.1f} GB; name another folder with --folder",
                file=sys.stderr,
            )
            return 1
        return _run(report, Path(folder), (1, smaller, larger), args)


def _run(report: Reporter, folder: Path, counts: tuple[int, ...], args: argparse.Namespace) -> int:
    survey = folder / "survey"
    templates = recorded_drops(folder / "recorded")
    found: dict[str, list[Cost]] = {}
    for before, drops in zip((0, *counts), counts, strict=False):
        begun = time.monotonic()
        build(survey, before, drops, templates)
        if drops > 1:
            seconds = time.monotonic() - begun
            report.title(f"{drops} drops at {point_number(drops)} points (s)")
            size = sum(path.stat().st_size for path in survey.rglob("*") if path.is_file())
            report.record(part="survey", drops=drops, megabytes=size / 1e6, made_in_s=seconds)
        for case in CASES:
            if args.only and not case.name.startswith(args.only):
                continue
            repeats = min(case.repeats, args.repeats)
            costs = [measure(case.arguments(survey, folder)) for _ in range(repeats)]
            found.setdefault(case.name, []).append(best := _best(costs))
            if drops > 1:
                report.record(part=case.name, drops=drops, **dataclasses.asdict(best))
        if drops > 1:
            for name, command in paints(survey).items():
                if args.only and not name.startswith(args.only):
                    continue
                painted = [first_paint(command) for _ in range(args.repeats)]
                cost = Cost(min(painted), 0.0, 0.0)
                found.setdefault(name, []).append(cost)
                report.record(part=name, drops=drops, seconds=cost.seconds, largest=max(painted))
    report.record(part="machine", cores=os.cpu_count(), load=os.getloadavg()[0])
    return _judge(report, found, counts)


def _judge(report: Reporter, found: Mapping[str, list["Cost"]], counts: tuple[int, ...]) -> int:
    report.title("cost per drop, what one drop costs taken off, and the limits")
    good = True
    limits = {case.name: case for case in CASES}
    for name, costs in found.items():
        case = limits.get(name)
        seconds = costs[-1].seconds
        whole = counts[-1] == DROPS[-1]  # the limits are said for these
        fine = not whole or seconds <= (case.seconds if case else LATEST_PAINT)
        values: dict[str, Any] = {"part": f"{name}, flat", "seconds": seconds}
        if case is not None:
            first, *rest = costs
            each = [
                max(cost.processor - first.processor, 0.0) / (drops - 1)
                for cost, drops in zip(rest, counts[1:], strict=True)
            ]
            ratio = each[-1] / each[0] if each[0] > 0 else float("inf")
            values |= {"each_ms": each[-1] * 1e3, "ratio": ratio}
            fine &= ratio <= LARGEST_RATIO
            if case.megabytes is not None:
                values["megabytes"] = costs[-1].megabytes
                fine &= costs[-1].megabytes <= case.megabytes
        report.record(**values, fine=fine)
        good &= fine
    return 0 if good else 1


# What a command costs.


@dataclass(frozen=True, slots=True)
class Cost:
    """Of a command."""

    seconds: float
    """From its start to its end."""
    processor: float
    """s, user and system, its children with it."""
    megabytes: float
    """The most that one of its processes had in memory at a time."""


def _best(costs: list[Cost]) -> Cost:
    return Cost(
        min(cost.seconds for cost in costs),
        min(cost.processor for cost in costs),
        max(cost.megabytes for cost in costs),
    )


PFWD = [sys.executable, "-P", "-c", "from tui.cli import main; raise SystemExit(main())"]


# A process of its own, and a small one: what the system says of a child's memory is at least what
# whoever started it had.
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
    """Run ``pfwd`` with these arguments; RuntimeError when it fails."""
    command = [sys.executable, "-I", "-S", "-c", _MEASURING, *PFWD, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT, check=True)
    status, seconds, processor, largest = json.loads(done.stdout)
    if status != 0:
        raise RuntimeError(f"pfwd {' '.join(arguments)}: status {status}: {done.stderr[:1000]}")
    unit = 1.0 if sys.platform == "darwin" else 1024.0  # bytes there, kB elsewhere
    return Cost(seconds, processor, largest * unit / 1e6)


def paints(survey: Path) -> dict[str, list[str]]:
    """The commands with a screen, by name."""
    return {
        # Nobody answers there: what is measured is how long the survey takes to be ready.
        "first paint of live": ["live", "socket://127.0.0.1:9", "-o", str(survey)],
        "first paint of replay --live": ["replay", str(survey), "--live"],
    }


def first_paint(arguments: list[str]) -> float:
    """Seconds from the command to a page that can be read."""
    from benchmarks.screen import PAINTED, Terminal

    terminal = Terminal([*PFWD, *arguments], (120, 40))
    try:
        while not PAINTED.search(terminal.text):
            if time.monotonic() - terminal.started > 60:
                raise RuntimeError(f"pfwd {' '.join(arguments)}: not painted within 60 s")
            terminal.read(0.01)
        return time.monotonic() - terminal.started
    finally:
        terminal.close()


# The survey.


@dataclass(frozen=True, slots=True)
class Template:
    """A recorded drop."""

    record: DropRecord
    rebounds: tuple[Rebound, ...]
    results: tuple[Mapping[str, Any], ...]


def recorded_drops(folder: Path) -> list[Template]:
    """Three drops of the scenario `default`, as ``pfwd demo`` records and inverts them."""
    from pfwd_device.recording import read_survey

    options = ["--scenario", "default", "--drops", "3", "--lines", "-o", str(folder)]
    command = [*PFWD, "demo", *options]
    subprocess.run(command, check=True, capture_output=True, timeout=TIMEOUT)
    return [
        Template(dataclasses.replace(record, rebounds=()), record.rebounds, drop.read_results())
        for drop in read_survey(folder).drops
        for record in [drop.read()]
    ]


class UnsyncedStorage(Storage):
    """Does not wait for the disk: what is lost with the power is made anew."""

    def sync(self, descriptor: int) -> None:
        """Nothing."""

    def sync_directory(self, path: Path) -> None:
        """Nothing."""


class QuickPublisher:
    """Writes the files of drops without reading them back."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.records: dict[int, DropRecord] = {}
        """By survey-wide number, those whose file is still to be made."""
        self.survey = b""

    def ask(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Make the file of a drop."""
        number = int(request["number"])
        layout = Layout(self._folder)
        path = layout.drop_file(number)
        data = drop_file_bytes(self.records.pop(number), number, self.survey)
        path.write_bytes(data)
        digest = hashlib.sha256(data).hexdigest()
        facts = {"path": layout.relative(path), "size": len(data), "sha256": digest}
        return {**facts, "number": number}

    def close(self) -> None:
        """Nothing runs."""


def point_number(number: int) -> int:
    """The point that the drop with this number within the survey belongs to, from 1."""
    return int((number - 1) / DROPS_PER_POINT) + 1


def build(survey: Path, before: int, drops: int, templates: list[Template]) -> None:
    """Go on with a survey of `before` drops until it has `drops`."""
    publisher = QuickPublisher(survey)
    with SurveyWriter.open(survey, storage=UnsyncedStorage(), publisher=publisher) as writer:
        publisher.survey = bytes.fromhex(writer.survey_id)
        for number, template, record in _records(before, drops, templates):
            saved = writer.save_drop(record)
            assert saved == number
            for rebound in template.rebounds:
                writer.save_rebound(saved, rebound)
            publisher.records[saved] = dataclasses.replace(record, rebounds=template.rebounds)
            writer.publish(saved)
            for result in template.results:
                writer.save_result(saved, {**result, "drop": record.drop.number, "record": saved})
            if number % NOTES == 0:
                writer.edit("note", f"said of drop {number}", number=saved)
        writer.close(TIMEOUT)


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
