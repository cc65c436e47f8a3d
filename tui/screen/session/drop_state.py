"""State of a drop on the screen, and its changes by events."""

import math
from dataclasses import dataclass, field

from pfwd.analysis.diagnosed_drop import DiagnosedDrop
from pfwd.analysis.results import DiagnosisResult, DropResult, FittedState, TimeHistories
from pfwd.analysis.sensor_fits import sensor_fits
from pfwd.judging import DropView
from pfwd.procedures import Quantity
from pfwd.session.events import DropAnalysed, DropSaved, SavedDrop
from tui.screen.session.screen_events import DropRead, Refit


@dataclass(slots=True)
class DropState:
    """Drop on the screen: its view, traces, results and further fits."""

    point: str
    number: int
    view: DropView | None = None
    """Drop as all readers have it; None: it is not on the disk yet."""
    status: str = "measured"
    reason: str = ""
    safe: bool = True
    saved: SavedDrop | None = None
    """Drop with its traces; None: they are read when the drop is opened."""
    curves: TimeHistories | None = None
    """Measured and fitted curves; None: they are computed when the drop is opened."""
    results: list[DropResult] = field(default_factory=list)
    """All results, in order."""
    refits: list[Refit] = field(default_factory=list)
    """Fits with other settings; the mean of the point ignores them."""
    final: bool = False
    """True once the last result has come."""
    rebounds: list[float] = field(default_factory=list)
    """Peak loads of the bounces, N."""
    fault: str = ""
    """Reason why there is no modulus; empty: there is one, or it is being computed."""
    withheld: str | None = None
    """Reason why neither fit nor diagnosis of the point permits a modulus; None: one does."""
    diagnosed: DiagnosisResult | None = None
    """Diagnosis whose modulus is that of the point; None: there is none."""
    identical: bool | None = None
    saved_at: float = 0.0
    """Monotonic clock when the drop was stored, s; 0: read from the survey."""
    delay: float | None = None
    """Time from the last sample to the first modulus, s."""

    @property
    def record(self) -> int | None:
        """Number within the survey; None: the drop is not stored."""
        return None if self.view is None else self.view.record

    @property
    def discarded(self) -> bool:
        """True if the operator discarded or moved the drop."""
        return self.view is not None and self.view.discarded is not None

    @property
    def moved_to(self) -> str:
        """New place of a moved drop in words; empty: it was not moved."""
        return "" if self.view is None else self.view.moved_to or ""

    @property
    def edited_word(self) -> str:
        """Word for a drop that the operator excluded, MOVED or DISCARDED; empty: not excluded."""
        return "MOVED" if self.moved_to else "DISCARDED" if self.discarded else ""

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes of the operator on the drop, in the order of writing."""
        return () if self.view is None else self.view.notes

    @property
    def marks(self) -> tuple[str, ...]:
        """Irregularities of the record in words, as gaps or a saturated channel."""
        return () if self.view is None else self.view.marks

    @property
    def peak_load(self) -> float:
        """Peak load, N; NaN: unknown. Of a rejected drop it is the peak as recorded."""
        peaks = None if self.view is None else self.view.peaks
        candidates = (
            None if self.view is None else self.view.own.peak_load,
            None if peaks is None else peaks.load,
            None if self.result is None else self.result.peak_load_n,
        )
        return next((peak for peak in candidates if peak is not None), math.nan)

    @property
    def peak_deflection(self) -> float:
        """Peak deflection of the centre, m; NaN: unknown.

        The declared response of the geophone is removed, except for a rejected drop.
        """
        peaks = None if self.view is None else self.view.peaks
        candidates = (
            None if self.view is None else self.view.own.peak_deflection,
            None if peaks is None else peaks.centre,
        )
        return next((peak for peak in candidates if peak is not None), math.nan)

    @property
    def result(self) -> DropResult | None:
        """Last result of the inversion of this drop, without the ground if it is withheld."""
        last = self.results[-1] if self.results else None
        return last if last is None or self.withheld is None else last.without_ground()

    @property
    def shown_result(self) -> DropResult | None:
        """Result that belongs to the curves: the last one, or that of a diagnosis that counts."""
        if self.result is None or not self._is_diagnosed:
            return self.result
        return self.result.in_diagnosis(self._diagnosed_fit)

    @property
    def shown_curves(self) -> TimeHistories | None:
        """Measured and fitted curves, those of a diagnosis if it counts."""
        if self.curves is None or not self._is_diagnosed:
            return self.curves
        fit = self._diagnosed_fit
        return None if fit is None else fit.drawn_on(self.curves)

    @property
    def _is_diagnosed(self) -> bool:
        """True if a diagnosis counts, and not the fit of the drop or its layers."""
        has_layers = self.result is not None and len(self.result.layers or ()) > 1
        return self.diagnosed is not None and not has_layers

    @property
    def _diagnosed_fit(self) -> DiagnosedDrop | None:
        """Fit of the drop by the diagnosis; None: it was not fitted."""
        return None if self.diagnosed is None else self.diagnosed.fit_of(self.number)

    @property
    def modulus(self) -> float | None:
        """Modulus of the last result, Pa; None: there is none."""
        value = self.result.modulus_pa if self.result else None
        return value if value is not None and math.isfinite(value) else None

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
    def is_diagnosed(self) -> bool:
        """True if a diagnosis of the point replaces the fit of this drop."""
        return self._diagnosed_fit is not None

    @property
    def saturated(self) -> bool:
        """True if a channel reached the end of the converter's range."""
        return self.view is not None and self.view.saturation is not None

    @property
    def awaits_modulus(self) -> bool:
        """True while the first modulus is being computed."""
        return self.safe and not self.results and self.status != "rejected"


def saved_drop(event: DropSaved, saved_at: float) -> DropState:
    """Return the state of a drop that was stored at `saved_at` by the monotonic clock, s."""
    saved = event.saved
    return DropState(
        saved.point,
        saved.number,
        saved.view,
        status=saved.screening.status,
        reason=saved.screening.reason or "",
        saved=saved,
        identical=event.identical,
        saved_at=saved_at,
    )


def add_result(drop: DropState, event: DropAnalysed) -> None:
    """Add the result of an analysis that ended while measuring to its drop."""
    failed = event.result.modulus_pa is None and not event.result.layers
    if failed and drop.results:
        # The quick result stays in force when the full search has failed.
        drop.final = drop.final or event.final
        return
    drop.results.append(event.result)
    drop.final = drop.final or event.final
    if drop.delay is None:
        drop.delay = event.delay
    if failed:
        drop.fault = event.result.reason or "the analysis failed"
    if event.curves is not None:
        drop.curves = event.curves


def add_read(drop: DropState, event: DropRead) -> None:
    """Add traces and results that were read from the survey to their drop."""
    saved = event.saved
    drop.saved, drop.view = saved, drop.view or saved.view
    main = [result for result in event.results if not result.is_trial]
    if not drop.results:
        drop.status, drop.reason = saved.screening.status, saved.screening.reason or ""
        drop.results = main
    labels = {refit.label for refit in drop.refits}
    for result in event.results:
        label = result.refit or ""
        if label and label not in labels:
            drop.refits.append(Refit(saved.point, saved.number, label, result, None))


def add_refit(drop: DropState, event: Refit) -> None:
    """Add a fit with other settings to its drop, or the curves of the result in force."""
    if event.label:
        drop.refits = [refit for refit in drop.refits if refit.label != event.label]
        drop.refits.append(event)
    elif event.curves is not None:
        drop.curves = event.curves
        if not drop.results and event.result is not None:
            drop.results.append(event.result)


def add_stored(drop: DropState, stored: DropView) -> None:
    """Set the stored result of a drop that has no result yet, with status and reason."""
    result = stored.last_result
    if result is not None and not result.has_ground:
        result = None
    if result is not None and not drop.results:
        drop.results = [result]
        drop.status = result.status
        drop.reason = result.reason or ""
    elif result is None and drop.saved is None:
        drop.status, drop.reason = "rejected", "no result; open it to see why"


def excluded_sensor_numbers(drop: DropState) -> tuple[int, ...]:
    """Return the numbers, from 1, of the sensors excluded from the fit.

    Dead sensors are known from the record, others once the drop is fitted.
    """
    if drop.saved is None:
        return ()
    channels = drop.saved.drop.channels
    excluded = set(drop.saved.screening.left_out)
    if drop.curves is not None and len(drop.curves.offsets) > 1:
        excluded |= {channel.offset for channel in channels} - set(map(float, drop.curves.offsets))
    return tuple(number for number, channel in enumerate(channels, 1) if channel.offset in excluded)


def sensor_residuals(drop: DropState) -> dict[int, float]:
    """Return the residual of every sensor during contact over its peak, by number from 1."""
    if drop.saved is None or drop.curves is None:
        return {}
    numbers = {channel.offset: n for n, channel in enumerate(drop.saved.drop.channels, 1)}
    return {
        numbers[fit.offset]: fit.contact
        for fit in sensor_fits(drop.curves)
        if fit.offset in numbers
    }
