"""Fits drops anew, with other settings or for their curves, in a process of its own."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

from pfwd_survey.inverting.options import AnalysisOptions
from pfwd_survey.inverting.worker.tasks import Building, Urgency
from pfwd_survey.inverting.worker.worker import Answer, InversionWorker
from pfwd_survey.measuring.events import HandedOn, TableBuilding
from tui.screen.session.screen_events import Refitted


@dataclass(frozen=True, eq=False, slots=True)
class _Asked:
    one: HandedOn
    label: str


class Refits:
    """Takes drops, tells `Refitted`.

    Parameters
    ----------
    tell : callable
        Told what comes of it, in a thread of its own.
    """

    def __init__(self, tell: Callable[[Refitted | TableBuilding], None]) -> None:
        self._tell = tell
        self._worker: InversionWorker | None = None
        self._lock = threading.Lock()
        self._asked: dict[int, _Asked] = {}

    @property
    def busy(self) -> int:
        """How many are under way."""
        return len(self._asked)

    def ask(self, one: HandedOn, options: AnalysisOptions, label: str) -> None:
        """Fit a drop; an empty label: for its curves alone."""
        if self._worker is None:
            self._worker = InversionWorker(self._take)
        urgency = Urgency.FULL if label else Urgency.QUICK
        with self._lock:  # the answer must not come before its number is noted
            number = self._worker.analyse(
                urgency, one.drop, one.setup, one.screening, options, one.file
            )
            self._asked[number] = _Asked(one, label)

    def close(self) -> None:
        """End the process."""
        if self._worker is not None:
            self._worker.close()

    def _take(self, answer: Answer | Building) -> None:
        if isinstance(answer, Building):
            self._tell(TableBuilding(answer.what, answer.fraction))
            return
        with self._lock:
            asked = self._asked.pop(answer.task.number)
        label = asked.label
        result = answer.result
        if result is not None and label:
            result = replace(result, refit=label)
        fault = answer.fault or ""
        point, number = asked.one.point, asked.one.number
        self._tell(Refitted(point, number, label, result, answer.curves, fault))


def label_of(options: AnalysisOptions) -> str:
    """The settings that differ from the default, in words."""
    parts = []
    if options.published:
        parts.append("published method")
    if options.model:
        parts.append(options.model)
    if options.bedrock_depth is not None:
        depth = options.bedrock_depth
        parts.append(f"bedrock {depth}" if isinstance(depth, str) else f"bedrock {depth:g} m")
    parts += ["elastic"] if options.elastic else []
    parts += [f"{options.load} load"] if options.load else []
    parts += [f"{options.plate} plate"] if options.plate else []
    parts += [f"{options.sensors} sensors"] if options.sensors else []
    parts += [options.method] if options.method else []
    parts += [f"Poisson's ratio {options.poisson_ratio:g}"] if options.poisson_ratio else []
    return ", ".join(parts) or "as declared"
