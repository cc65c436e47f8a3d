"""Comparison of the acknowledged records with those that are found again.

A program says, in this order, what it has acknowledged and that something is not safe. Afterwards
the survey is recovered, with what is in the second place for unsafe drops. When an acknowledged
record is in neither, NOT SAFE must have been said before the next drop was acknowledged, and nobody
may call a survey whole that lacks one.
"""

from collections import Counter
from dataclasses import dataclass, field

DOCUMENTED = (0, 1, 2, 3)
"""Exit statuses of the command line."""

NOT_SAFE = "NOT SAFE"
"""Said when something acknowledged may be lost."""

NOT_SAVED = "NOT SAFE yet"
"""Said of a drop that has not been acknowledged: nobody was promised anything."""

UNFORESEEN = {
    "traceback": ("Traceback (most recent call last)", "nobody foresaw"),
    "escaped": ("escaped: ",),
}
"""Marks of errors that nobody had foreseen: of the command, and of the library, whose callers know
its own errors only."""

IN_FLIGHT = 1
"""Drops that may be acknowledged between a replacement and the warning: the one whose files had
been compared already when they were replaced."""

ACKNOWLEDGED, WARNED, REPLACED = "acknowledged", "not safe", "replaced"


@dataclass(frozen=True, slots=True)
class Said:
    """One thing that the program said."""

    what: str
    """`ACKNOWLEDGED`, `WARNED`, or `REPLACED`: the campaign put other files in place."""
    name: str
    """Of the record (``drop 1/3``, ``note ...``), or a text."""


@dataclass(slots=True)
class Outcome:
    """All that is known after a run."""

    said: list[Said] = field(default_factory=list)
    status: int | None = 0
    """Exit status of the program; None: it hung and was ended."""
    killed: bool = False
    """Ended by the campaign, without a chance to say anything."""
    output: str = ""
    """All text of the program, and of the programs that recovered and checked."""
    found: list[str] = field(default_factory=list)
    """Names of the records found again, in the survey and in the second place."""
    whole: bool | None = None
    """What the check says after recovery; None: there is no survey to check."""
    refusal: str = ""
    """Why the survey could not be recovered or read; it may have been taken away."""
    gone: bool = False
    """The survey was taken away from where it was, so that a refusal is right."""
    harmless: bool = False
    """Nothing was done that endangers a record, so that a warning is wrong."""
    later_statuses: tuple[int, ...] = ()
    """Exit statuses of the programs that recovered and checked, -1: it hung."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is wrong; nothing when the outcome is as promised."""

    faults: tuple[str, ...]
    """Words: `lost`, `called whole`, `twice`, `unreadable`, `not whole`, `traceback`,
    `escaped`, `hang`, `status`, `warned without need`."""
    details: tuple[str, ...]
    lost: tuple[str, ...] = ()
    """Acknowledged records that are nowhere, warned of or not."""

    @property
    def good(self) -> bool:
        """Everything is as promised."""
        return not self.faults


def judge(outcome: Outcome) -> Verdict:
    """What of the outcome breaks the promise."""
    faults: dict[str, str] = {}
    found = Counter(outcome.found)
    acknowledged = list(
        dict.fromkeys(said.name for said in outcome.said if said.what == ACKNOWLEDGED)
    )
    lost = tuple(name for name in acknowledged if name not in found)
    silent = [name for name in lost if not _warned_in_time(outcome, name)]
    if silent:
        faults["lost"] = f"lost without a word: {', '.join(silent)}"
    if lost and outcome.whole:
        faults["called whole"] = f"called whole without {', '.join(lost)}"
    twice = [name for name, count in found.items() if count > 1 and name.startswith("drop ")]
    if twice:
        faults["twice"] = f"recorded twice: {', '.join(twice)}"
    if outcome.refusal and acknowledged and not outcome.gone:
        faults["unreadable"] = outcome.refusal
    if outcome.whole is False and not lost and not outcome.gone:
        faults["not whole"] = "not whole after recovery, although nothing is missing"
    warned = [said.name for said in outcome.said if said.what == WARNED]
    if outcome.harmless and warned:
        faults["warned without need"] = warned[0]
    for word, marks in UNFORESEEN.items():
        if any(mark in outcome.output for mark in marks):
            faults[word] = _last_of_traceback(outcome.output)
    if outcome.status is None or -1 in outcome.later_statuses:
        faults["hang"] = "did not end"
    statuses = [status for status in (outcome.status, *outcome.later_statuses) if status != -1]
    if not outcome.killed:
        wrong = [status for status in statuses if status not in (None, *DOCUMENTED)]
        if wrong:
            faults["status"] = f"ended with {wrong[0]}"
    return Verdict(tuple(faults), tuple(faults.values()), lost)


def _warned_in_time(outcome: Outcome, name: str) -> bool:
    """Whether NOT SAFE was said after the record was in danger and before the next drop was saved.

    It is in danger from its acknowledgement on, or, when files were replaced after that, from then
    on. Of a program that was killed before it had another drop to save, no warning is asked.
    """
    begins = outcome.said.index(Said(ACKNOWLEDGED, name)) + 1
    replaced = [
        place
        for place, said in enumerate(outcome.said)
        if said.what == REPLACED and place >= begins
    ]
    starts = [(place + 1, IN_FLIGHT) for place in replaced] or [(begins, 0)]
    return any(_warned(outcome.said[start:], left, outcome.killed) for start, left in starts)


def _warned(said: list[Said], left: int, killed: bool) -> bool:
    for word in said:
        if word.what == WARNED:
            return True
        if word.what == ACKNOWLEDGED and word.name.startswith("drop "):
            if left == 0:
                return False
            left -= 1
    return killed


def is_warning(line: str) -> bool:
    """Whether a line says of something acknowledged that it is not safe."""
    return NOT_SAFE in line and NOT_SAVED not in line


def _last_of_traceback(text: str) -> str:
    """The error and where in the project it came from, of the last traceback in a text."""
    lines = text.splitlines()
    places = [line.strip() for line in lines if line.startswith("  File ") and "/pfwd_" in line]
    errors = [line for line in lines if "Error" in line and not line.startswith(" ")]
    return " <- ".join([*errors[-1:], *reversed(places[-3:])]) or text[-300:]
