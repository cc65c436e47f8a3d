"""Drop of the survey with its point, and the traces and fits of it that are in memory."""

import math
from dataclasses import dataclass

from pfwd.analysis.diagnosed_drop import DiagnosedDrop
from pfwd.analysis.results import DiagnosisResult, DropResult, FittedState, TimeHistories
from pfwd.analysis.sensor_fits import sensor_fits
from pfwd.judging import DropView, PointView, value_of_drop
from pfwd.message_groups import Notice, text_of
from pfwd.procedures import Kind, PointValue, Quantity
from pfwd.session.events import SavedDrop
from tui.screen.session.screen_events import Refit


@dataclass(frozen=True, eq=False, slots=True)
class DropInMemory:
    """Traces, curves and fits of a drop; they are read again when the drop is opened."""

    saved: SavedDrop | None = None
    """Drop with its traces; None: they were not read."""
    curves: TimeHistories | None = None
    """Measured and fitted curves; None: they are computed when the drop is opened."""
    results: tuple[DropResult, ...] = ()
    """Results in the order in which they were computed."""
    refits: tuple[Refit, ...] = ()
    """Fits with other settings; the mean of the point ignores them."""
    delay: float | None = None
    """Time from the last sample to the first modulus, s."""


EMPTY_MEMORY = DropInMemory()
"""Drop of which nothing is in memory."""


@dataclass(frozen=True, eq=False, slots=True)
class ScreenDrop:
    """Drop of the survey as the pages show it."""

    owner: PointView
    view: DropView
    memory: DropInMemory = EMPTY_MEMORY
    unsafe: str | None = None
    """Reason why it is not on the disk; None: it is."""

    @property
    def point(self) -> str:
        """Name under which the drops of its point are stored."""
        return self.owner.name

    @property
    def number(self) -> int:
        """Number within its point."""
        return self.view.number

    @property
    def record(self) -> int | None:
        """Number within the survey; None: the drop is not stored."""
        return self.view.record

    @property
    def saved(self) -> SavedDrop | None:
        """Drop with its traces; None: they are not in memory."""
        return self.memory.saved

    @property
    def safe(self) -> bool:
        """True if it is on the disk."""
        return self.unsafe is None

    @property
    def status(self) -> str:
        """Measured, seating or rejected, by the procedure of the point."""
        kind = dict(self.owner.progress.kinds).get(self.number, Kind.MEASURED)
        return (Kind.MEASURED if kind is Kind.DISCARDED else kind).value

    @property
    def reason(self) -> str:
        """Reason why it is rejected or not on the disk; empty: neither, or no reason is known."""
        if self.unsafe is not None:
            return self.unsafe
        number = self.number
        facts = next((fact for fact in self.owner.facts if fact.number == number), None)
        if facts is None or facts.kind is not Kind.REJECTED:
            return ""
        return text_of(facts.reason)

    @property
    def exclusion_reason(self) -> str:
        """Reason why a measured drop is excluded from the mean of its point; empty: it is not."""
        if self.status != Kind.MEASURED.value or self.discarded:
            return ""
        number, excluded = self.number, self.owner.progress.excluded
        return text_of(next((e.reason for e in excluded if e.number == number), None))

    @property
    def discarded(self) -> bool:
        """True if the operator discarded or moved the drop."""
        return self.view.discarded is not None

    @property
    def moved_to(self) -> str:
        """New place of a moved drop in words; empty: it was not moved."""
        return text_of(self.view.moved_to)

    @property
    def edited_word(self) -> str:
        """Word for a drop that the operator excluded, MOVED or DISCARDED; empty: not excluded."""
        return "MOVED" if self.moved_to else "DISCARDED" if self.discarded else ""

    @property
    def peak_load(self) -> float:
        """Peak load, N; NaN: unknown. Of a rejected drop it is the peak as recorded."""
        peaks, result = self.view.peaks, self.result
        candidates = (
            self.view.own.peak_load,
            None if peaks is None else peaks.load,
            None if result is None else result.peak_load_n,
        )
        return next((peak for peak in candidates if peak is not None), math.nan)

    @property
    def peak_deflection(self) -> float:
        """Peak deflection of the centre, m; NaN: unknown.

        The declared response of the geophone is removed, except for a rejected drop.
        """
        peaks = self.view.peaks
        candidates = (self.view.own.peak_deflection, None if peaks is None else peaks.centre)
        return next((peak for peak in candidates if peak is not None), math.nan)

    @property
    def withheld(self) -> Notice | None:
        """Reason why neither fit nor diagnosis of the point permits a modulus; None: one does."""
        return self.owner.progress.withheld

    @property
    def diagnosed(self) -> DiagnosisResult | None:
        """Diagnosis whose modulus is that of the point; None: there is none."""
        return self.owner.counting_diagnosis

    @property
    def result(self) -> DropResult | None:
        """Last result of the inversion of this drop, without the ground if it is withheld."""
        last = self.view.result
        if last is None and self.memory.results:
            last = self.memory.results[-1]
        return last if last is None or self.withheld is None else last.without_ground()

    @property
    def curves_result(self) -> DropResult | None:
        """Result that belongs to the curves: the last one, or that of a diagnosis that counts."""
        result = self.result
        return result.in_diagnosis(self._diagnosed_fit) if result and self.is_diagnosed else result

    @property
    def drawn_curves(self) -> TimeHistories | None:
        """Measured and fitted curves, those of a diagnosis if it counts."""
        curves = self.memory.curves
        if curves is None or not self.is_diagnosed:
            return curves
        fit = self._diagnosed_fit
        return None if fit is None else fit.drawn_on(curves)

    @property
    def is_diagnosed(self) -> bool:
        """True if a diagnosis of the point counts, and not the fit of the drop or its layers."""
        result = self.result
        has_layers = result is not None and len(result.layers or ()) > 1
        return self.diagnosed is not None and not has_layers

    @property
    def _diagnosed_fit(self) -> DiagnosedDrop | None:
        """Fit of the drop by the diagnosis; None: it was not fitted."""
        return None if self.diagnosed is None else self.diagnosed.fit_of(self.number)

    @property
    def modulus(self) -> float | None:
        """Modulus of the last result, Pa; None: there is none."""
        result = self.result
        value = None if result is None else result.modulus_pa
        return value if value is not None and math.isfinite(value) else None

    def value(self) -> PointValue | None:
        """Return the quantity that the procedure judges, for this drop; None: not known."""
        return value_of_drop(self.owner.job, self.view)

    def fitted(self, quantity: Quantity) -> tuple[float | None, tuple[float, float] | None]:
        """Return the fitted or the equivalent modulus, Pa, with its interval.

        It is that of a diagnosis of the point if it counts, else that of the last result.
        """
        after = None if self.diagnosed is None or not self.is_diagnosed else self.diagnosed.after
        fit: DropResult | FittedState | None = self.result if after is None else after
        if fit is None or self.modulus is None:
            return None, None
        if quantity is Quantity.EQUIVALENT_MODULUS:
            return fit.equivalent_modulus_pa, fit.equivalent_modulus_interval_pa
        return fit.modulus_pa, fit.modulus_interval_pa

    @property
    def fault(self) -> str:
        """Reason why there is no modulus; empty: there is one, or it is being computed."""
        last = self.view.last_result
        if last is None or last.has_ground or self.result is not None:
            return ""
        return text_of(last.reason) or "the analysis failed"

    @property
    def saturated(self) -> bool:
        """True if a channel reached the end of the converter's range."""
        return self.view.saturation is not None

    @property
    def awaits_modulus(self) -> bool:
        """True while the first modulus is being computed."""
        return self.view.awaits_result and self.view.last_result is None

    @property
    def is_refined(self) -> bool:
        """True while a better modulus than the first one is being computed."""
        return self.view.awaits_result and self.view.last_result is not None


def excluded_sensor_numbers(drop: ScreenDrop) -> tuple[int, ...]:
    """Return the numbers, from 1, of the sensors excluded from the fit.

    Dead sensors are known from the record, others once the drop is fitted.
    """
    saved, curves = drop.saved, drop.memory.curves
    if saved is None:
        return ()
    channels = saved.drop.channels
    excluded = set(saved.screening.left_out)
    if curves is not None and len(curves.offsets) > 1:
        excluded |= {channel.offset for channel in channels} - set(map(float, curves.offsets))
    return tuple(number for number, channel in enumerate(channels, 1) if channel.offset in excluded)


def sensor_residuals(drop: ScreenDrop) -> dict[int, float]:
    """Return the residual of every sensor during contact over its peak, by number from 1."""
    saved, curves = drop.saved, drop.memory.curves
    if saved is None or curves is None:
        return {}
    numbers = {channel.offset: n for n, channel in enumerate(saved.drop.channels, 1)}
    return {
        numbers[fit.offset]: fit.contact for fit in sensor_fits(curves) if fit.offset in numbers
    }
