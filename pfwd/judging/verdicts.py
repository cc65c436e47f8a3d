"""A test point with its drops, and its value, interval, target and verdict by the job."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

from inversion.notices import Notice, invalidating
from pfwd.analysis.result_store import holds
from pfwd.analysis.results import DiagnosisResult, FittedState
from pfwd.files.header import PointSetup
from pfwd.judging.drops import DropView, classify_drops
from pfwd.judging.job import Job
from pfwd.judging.places import place_in
from pfwd.procedures import (
    DiagnosedModulus,
    Kind,
    PointDrop,
    PointModulus,
    PointProgress,
    PointValue,
    Verdict,
    judge,
)
from pfwd.procedures.judging import is_target_for
from pfwd.procedures.point import ModulusSource, in_force_as_dict
from pfwd.procedures.profile import OUR_TOLERANCES
from pfwd.procedures.values import (
    moduli_of,
    modulus_to_use,
    residual_fault,
    unsupported_records,
    value_of,
)
from pfwd_device.recording.survey_reader import SurveyPoint

DEFAULT_RADIUS = 0.15
"""Plate radius, m, where no drop declares one; a placeholder with which nothing is computed."""

SAME_PLATE = 1e-9
"""Largest relative difference of two declared radii that are taken for the same plate."""


@dataclass(frozen=True, eq=False)
class PointView:
    """One test point of a survey: its drops, what was declared for it, and its judgement."""

    name: str
    """Name under which its drops are stored."""
    drops: Sequence[DropView] = ()
    """All drops, in the order they fell."""
    target: float | None = None
    """Target declared for this point, Pa, or m for a deflection; None: not declared."""
    discarded: bool = False
    diagnosis: DiagnosisResult | None = None
    """Last diagnosis, even if the point has changed since; None: there is none."""
    awaits_diagnosis: bool = False
    """True: a diagnosis of its present drops is under way."""
    title: str = ""
    """Name that the operator gave it later; empty: it has its first name."""
    job: Job = field(default_factory=Job)
    """Job by which the point is judged."""
    fallback_target: tuple[float, Notice] | None = None
    """Target that is used if the survey declares none, and its source; None: the procedure's is
    used."""
    notes: tuple[str, ...] = ()
    place: Mapping[str, Any] | None = None
    """``latitude``, ``longitude`` (degrees) and ``source``: edited, declared, or of a receiver,
    with the quality of its fix; None: unknown."""
    replayed: Sequence[DropView] = ()
    """Stored drops of a survey that is replayed; each counts from the time at which it is
    replayed."""
    source: SurveyPoint | None = None
    """Stored point; None: it is being measured, or this object came from another process."""
    whole: "PointView | None" = None
    """Point that is judged, if this object holds only some of its drops; None: it holds all of
    them."""
    warnings: tuple[Notice, ...] = ()
    """Warnings about its setup, for a report."""

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "source": None}

    @property
    def position(self) -> tuple[float, float] | None:
        """Latitude and longitude, degrees; None: unknown."""
        place = place_in(self.place)
        return None if place is None else (place.latitude, place.longitude)

    @property
    def setup(self) -> PointSetup:
        """Setup of its first drop."""
        return self.drops[0].setup

    @property
    def shown_name(self) -> str:
        """Name to show: the later one if there is one."""
        return self.title or self.name

    @cached_property
    def facts(self) -> Sequence[PointDrop]:
        """Facts of its drops, with rebounds and seating drops recognised; see `classify_drops`."""
        if self.whole is not None:
            fact_by_number = {fact.number: fact for fact in self.whole.facts}
            return tuple(fact_by_number[drop.number] for drop in self.drops)
        return tuple(classify_drops(self.drops))

    @cached_property
    def plate(self) -> "PointPlate":
        """Plate and Poisson's ratio declared for its drops."""
        return _plate_of(self)

    @cached_property
    def diagnosis_in_force(self) -> DiagnosisResult | None:
        """Last diagnosis, if it is of the present drops and setup; None: there is none."""
        if self.whole is not None:
            return self.whole.diagnosis_in_force
        if self.diagnosis is None or not self.drops:
            return None
        numbers = [fact.number for fact in self.facts if fact.kind not in _TAKING_NO_PART]
        return self.diagnosis if holds(self.diagnosis, self.drops[-1].setup, numbers) else None

    @property
    def is_verdict_pending(self) -> bool:
        """True if its verdict is on a fitted modulus and waits for its diagnosis."""
        return self.awaits_diagnosis and self.job.quantity.is_fitted

    @cached_property
    def progress(self) -> PointProgress:
        """Judgement by the procedure of the job: value, target and verdict."""
        return _judge(self) if self.whole is None else self.whole.progress

    @cached_property
    def counting_diagnosis(self) -> DiagnosisResult | None:
        """Diagnosis whose modulus is that of the point; None: the modulus is fitted, or none."""
        modulus = self.progress.modulus
        is_diagnosed = modulus is not None and modulus.source == "diagnosed"
        return self.diagnosis_in_force if is_diagnosed else None

    @cached_property
    def shown(self) -> "PointView":
        """Point for readers: if its modulus is withheld, its drops have none either."""
        if self.progress.withheld is None:
            return self
        drops = tuple(drop.without_modulus() for drop in self.drops)
        return dataclasses.replace(self, drops=drops, whole=self.whole and self.whole.shown)

    @cached_property
    def as_diagnosed(self) -> "PointView":
        """Point whose drops have curves and residuals of its diagnosis, if that counts.

        They replace the fit of each drop alone, except fits with layers.
        """
        diagnosis = self.counting_diagnosis
        if diagnosis is None:
            return self
        drops = tuple(
            drop if drop.has_layers else drop.in_diagnosis(diagnosis.fit_of(drop.number))
            for drop in self.drops
        )
        return dataclasses.replace(self, drops=drops, whole=self.whole or self)

    def drop(self, number: int) -> DropView | None:
        """Return the drop with this number; None: there is none."""
        return next((drop for drop in self.drops if drop.number == number), None)

    def as_json(self) -> dict[str, Any]:
        """Return the judgement as values that JSON can hold, in SI units.

        It is a line of the log of a session.
        """
        progress = self.progress
        values: Mapping[str, Any] = progress.as_dict()
        return {
            "point": self.shown_name,
            "complete": progress.complete,
            "value": values["value"],
            "target": progress.target,
            "verdict": progress.verdict.value,
            "verdict_reason": values["verdict_reason"],
            "verdict_reason_code": values["verdict_reason_code"],
            **in_force_as_dict(progress.modulus_in_force),
            "used": list(progress.used),
            "compaction": values["compaction"],
        }


_TAKING_NO_PART = (Kind.DISCARDED, Kind.REJECTED)


def _diagnosed(diagnosis: DiagnosisResult | None) -> DiagnosedModulus | None:
    if diagnosis is None or diagnosis.after is None:
        return None
    modulus = _modulus_of(diagnosis.after, "diagnosed")
    if diagnosis.equivalent_use == "do-not-use":
        modulus = dataclasses.replace(modulus, equivalent=None, equivalent_interval=None)
    is_open = modulus.value is None and modulus.equivalent is None
    return DiagnosedModulus(
        None if is_open else modulus,
        diagnosis.use,
        diagnosis.use_reason,
        diagnosis.equivalent_use,
    )


def _modulus_of(state: FittedState, source: ModulusSource) -> PointModulus:
    return PointModulus(
        state.modulus_pa,
        state.modulus_interval_pa,
        source,
        equivalent=state.equivalent_modulus_pa,
        equivalent_interval=state.equivalent_modulus_interval_pa,
        depth=state.modulus_depth_m,
    )


def fit_before_diagnosis(diagnosis: DiagnosisResult) -> PointModulus | None:
    """Return the modulus that was fitted without effects, before the diagnosis.

    The result is None if nothing was fitted.
    """
    before = diagnosis.before
    if before is None or before.modulus_pa is None:
        return None
    fault = invalidating(diagnosis.warnings, "fit") or residual_fault(
        before.contact_residual_rms_over_peak, OUR_TOLERANCES["most_residual"]
    )
    return dataclasses.replace(_modulus_of(before, "fitted"), not_supported=fault)


def modulus_in_force(
    diagnosis: DiagnosisResult, point: PointView | None = None
) -> PointModulus | None:
    """Return the modulus of a point that may be used after a diagnosis.

    The result is None if the data support no modulus.

    Parameters
    ----------
    diagnosis : DiagnosisResult
    point : PointView, optional
        The point in its survey, with the fits of its drops. Without it the fitted modulus is the
        one that the diagnosis computed without effects.

    Returns
    -------
    PointModulus or None
        `not_supported` holds the reason if the records of the point support no value.
    """
    fitted, fault = fit_before_diagnosis(diagnosis), None
    if point is not None:
        fitted = dataclasses.replace(point, diagnosis=diagnosis).progress.fitted_modulus
        drops = set(diagnosis.drops)
        fault = unsupported_records([fact for fact in point.facts if fact.number in drops])
    in_force, _ = modulus_to_use(fitted, _diagnosed(diagnosis))
    if in_force is None and fault is not None:
        in_force = fitted
    return in_force and dataclasses.replace(in_force, not_supported=fault)


def _judge(point: PointView) -> PointProgress:
    """Return the judgement of a point by the procedure of its job.

    The target is the first of these that is declared: of the point, of its station, of the job, the
    fallback, that of the procedure.
    """
    radius, ratio, faults = point.plate
    target, source = _target_of(point)
    setup = point.drops[-1].setup if point.drops else None
    progress = judge(
        point.job.procedure_in_force,
        point.facts,
        plate_radius=radius,
        poisson_ratio=ratio,
        target=target,
        moisture=None if setup is None else setup.moisture,
        material=None if setup is None or setup.material is None else str(setup.material),
        diagnosed=_diagnosed(point.diagnosis_in_force),
        centre_sensor=None if setup is None else setup.centre_sensor,
        earlier_violations=faults,
    )
    if progress.target is not None and progress.target == target:
        progress = dataclasses.replace(progress, target_source=source)
    reason = Notice("point-discarded") if point.discarded else None
    if reason is None and point.is_verdict_pending and progress.verdict is not Verdict.NONE:
        reason = Notice("verdict-pending")
    if reason is None:
        return progress
    return dataclasses.replace(
        progress, verdict=Verdict.NONE, verdict_reason=reason, verdict_reason_code=None
    )


def _target_of(point: PointView) -> tuple[float | None, Notice | None]:
    """Return the target of a point, Pa or m, and its source.

    Targets of the judged quantity come first.
    """
    job = point.job
    station = job.station(point.shown_name)
    candidates = (
        (point.target, Notice("target-of-point")),
        (None if station is None else station.target, Notice("target-of-station")),
        (job.target, Notice("target-of-survey")),
        point.fallback_target or (None, None),
    )
    declared = [(value, source) for value, source in candidates if value is not None]
    if not declared:
        return None, None
    fitting = [pair for pair in declared if is_target_for(job.procedure_in_force, pair[0])]
    # A target of another quantity is passed on, because the judgement reports that it is ignored.
    return (fitting or declared)[0]


class PointPlate(NamedTuple):
    """Plate of a point, and Poisson's ratio of its ground."""

    radius: float
    """Radius, m; 0: there was no plate."""
    poisson_ratio: float | None
    """Declared Poisson's ratio; None: not declared."""
    faults: list[Notice]
    """One message if the drops were measured with different plates; else empty."""


def _plate_of(point: PointView) -> PointPlate:
    loaded = [
        drop
        for drop, fact in zip(point.drops, point.facts, strict=True)
        if fact.kind not in _TAKING_NO_PART
    ]
    if not loaded:
        if not point.drops:
            return PointPlate(DEFAULT_RADIUS, None, [])
        setup = point.drops[-1].setup
        return PointPlate(setup.plate_radius or DEFAULT_RADIUS, setup.poisson_ratio, [])
    last = loaded[-1].setup
    radii = sorted({drop.setup.plate_radius for drop in loaded})
    faults = []
    if radii[-1] - radii[0] > SAME_PLATE * radii[-1]:
        ends = {"smallest_m": radii[0], "largest_m": radii[-1]}
        faults.append(Notice("plates-differ", ends))
    return PointPlate(last.plate_radius, last.poisson_ratio, faults)


def value_of_drop(job: Job, drop: DropView) -> PointValue | None:
    """Return the value of a single drop in the judged quantity; None: the drop lacks it.

    One drop has no scatter: only a fitted modulus has an interval, which is that of its model.
    """
    if drop.facts.kind is Kind.REJECTED:
        return None
    setup, procedure, drops = drop.setup, job.procedure_in_force, [drop.facts]
    modulus, _ = moduli_of(procedure, drops, None)
    return value_of(procedure, drops, setup.plate_radius, setup.poisson_ratio, [], modulus)
