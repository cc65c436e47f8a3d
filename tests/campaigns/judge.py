"""Comparison of the acknowledged drops with those that are recovered.

A program prints, in this order, which drops it has acknowledged and that drops are not safe. Then
the survey is recovered, with the fallback records of unsafe drops. If an acknowledged drop is
missing, NOT SAFE must have been printed before the next drop was acknowledged, and `check` must not
call the survey complete.
"""

from collections import Counter
from dataclasses import dataclass, field

DOCUMENTED_STATUSES = (0, 1, 2, 3)
"""Exit statuses of the command line."""

UNEXPECTED_ERRORS = ("Traceback (most recent call last)", "nobody foresaw")
"""Marks of unexpected errors."""

MAX_DROPS_BEFORE_WARNING = 1
"""Drops that may be acknowledged between a replacement and the warning: the files of this drop were
compared just before they were replaced."""

ACKNOWLEDGED, WARNED, REPLACED = "acknowledged", "not safe", "replaced"


@dataclass(frozen=True, slots=True)
class Event:
    """Message of the program, or the replacement of its files by the campaign."""

    kind: str
    """`ACKNOWLEDGED`, `WARNED` or `REPLACED`."""
    name: str
    """Name of the drop (``drop 1/3``), or the text of a warning."""


@dataclass(slots=True)
class Outcome:
    """Observations of a run."""

    events: list[Event] = field(default_factory=list)
    status: int | None = 0
    """Exit status of the program; None: it hung and was ended."""
    killed: bool = False
    """True if the campaign killed the program, so that it could not warn."""
    output: str = ""
    """Text of the program, and of the programs that recovered and checked."""
    recovered: list[str] = field(default_factory=list)
    """Names of the drops in the survey and among the fallback records."""
    complete: bool | None = None
    """Result of the check after recovery; None: there is no survey to check."""
    refusal: str = ""
    """Reason why the survey could not be recovered or read."""
    removed: bool = False
    """True if the survey was moved or deleted, so that a refusal is right."""
    harmless: bool = False
    """True if no drop was endangered, so that a warning is wrong."""
    later_statuses: tuple[int, ...] = ()
    """Exit statuses of the programs that recovered and checked, -1: it hung."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Broken promises of a run."""

    faults: tuple[str, ...]
    """Words: `lost`, `called complete`, `twice`, `unreadable`, `incomplete`, `traceback`,
    `hang`, `status`, `warned without need`."""
    details: tuple[str, ...]

    @property
    def good(self) -> bool:
        """True without faults."""
        return not self.faults


def judge(outcome: Outcome) -> Verdict:
    """Return the promises that the outcome of a run breaks."""
    faults: dict[str, str] = {}
    counts = Counter(outcome.recovered)
    acknowledged = list(
        dict.fromkeys(event.name for event in outcome.events if event.kind == ACKNOWLEDGED)
    )
    lost = tuple(name for name in acknowledged if name not in counts)
    silent = [name for name in lost if not _is_warned_in_time(outcome, name)]
    if silent:
        faults["lost"] = f"lost without a warning: {', '.join(silent)}"
    if lost and outcome.complete:
        faults["called complete"] = f"called complete without {', '.join(lost)}"
    twice = [name for name, count in counts.items() if count > 1]
    if twice:
        faults["twice"] = f"recorded twice: {', '.join(twice)}"
    if outcome.refusal and acknowledged and not outcome.removed:
        faults["unreadable"] = outcome.refusal
    if outcome.complete is False and not lost and not outcome.removed:
        faults["incomplete"] = "incomplete after recovery, although no drop is missing"
    warnings = [event.name for event in outcome.events if event.kind == WARNED]
    if outcome.harmless and warnings:
        faults["warned without need"] = warnings[0]
    if any(mark in outcome.output for mark in UNEXPECTED_ERRORS):
        faults["traceback"] = _last_of_traceback(outcome.output)
    if outcome.status is None or -1 in outcome.later_statuses:
        faults["hang"] = "did not end"
    statuses = [status for status in (outcome.status, *outcome.later_statuses) if status != -1]
    if not outcome.killed:
        wrong = [status for status in statuses if status not in (None, *DOCUMENTED_STATUSES)]
        if wrong:
            faults["status"] = f"ended with {wrong[0]}"
    return Verdict(tuple(faults), tuple(faults.values()))


def _is_warned_in_time(outcome: Outcome, name: str) -> bool:
    """Return True if a warning follows the danger to a drop before the next drop is acknowledged.

    The danger begins with its acknowledgement or with a later replacement. A killed program needs
    no warning before it has another drop to acknowledge.
    """
    first = outcome.events.index(Event(ACKNOWLEDGED, name)) + 1
    replacements = [
        place
        for place, event in enumerate(outcome.events)
        if event.kind == REPLACED and place >= first
    ]
    starts = [(place + 1, MAX_DROPS_BEFORE_WARNING) for place in replacements] or [(first, 0)]
    return any(_is_warned(outcome.events[at:], drops, outcome.killed) for at, drops in starts)


def _is_warned(events: list[Event], max_drops: int, killed: bool) -> bool:
    for event in events:
        if event.kind == WARNED:
            return True
        if event.kind == ACKNOWLEDGED:
            if max_drops == 0:
                return False
            max_drops -= 1
    return killed


def is_warning(line: str) -> bool:
    """Return True if a line warns of an acknowledged drop; `NOT SAFE yet` precedes its safety."""
    return "NOT SAFE" in line and "NOT SAFE yet" not in line


def _last_of_traceback(text: str) -> str:
    """Return the error of the last traceback in a text and its places in the project."""
    lines = text.splitlines()
    places = [line.strip() for line in lines if line.startswith("  File ") and "/pfwd_" in line]
    errors = [line for line in lines if "Error" in line and not line.startswith(" ")]
    return " <- ".join([*errors[-1:], *reversed(places[-3:])]) or text[-300:]
