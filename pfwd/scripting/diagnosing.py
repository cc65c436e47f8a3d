"""Function `pfwd.diagnose`, which explains the residual of points by effects of ground and device.

"Before" is the fit of the base model alone, "after" the fit of the same model with the effects.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inversion.notices import Notice
from pfwd.analysis.results import DiagnosisResult, EffectResult
from pfwd.digits import modulus_text
from pfwd.errors import OptionError, SurveyError, refusal
from pfwd.export.json_text import without_nan
from pfwd.judging.view import moduli_in_force
from pfwd.scripting import display
from pfwd.scripting.measured import Drop, HasPoints, Point, points_of, requested, time_and_load
from pfwd.scripting.options import DIAGNOSE_OPTIONS, DiagnoseOptions

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from inversion.diagnosis import PointDiagnosis
    from inversion.inference.instrument import Instrument
    from pfwd.analysis.diagnosis.entries import DiagnosisPoint
    from pfwd.analysis.diagnosis.points import DeviceValues
    from pfwd.procedures import PointModulus


class Diagnosis(display.Displayable):
    """Effects that explain the residual of a point, and their influence on the modulus.

    Each key of ``pfwd diagnose --json`` can be used as an index: ``diagnosis["held_out"]``.
    """

    __slots__ = ("_diagnosis", "_fault", "_modulus", "_place", "_record", "_result")

    def __init__(
        self,
        result: DiagnosisResult,
        modulus: PointModulus | None,
        diagnosis: PointDiagnosis | None = None,
        place: tuple[Instrument, int] | None = None,
    ) -> None:
        self._result, self._diagnosis, self._place = result, diagnosis, place
        self._record: dict[str, Any] = without_nan(result.to_json())
        self._fault = None if modulus is None else modulus.not_supported
        self._modulus = None if self._fault is not None else modulus

    file: str = display.alias("_result.file")
    """Path from which the point was read."""
    point: str | None = display.alias("_result.point")
    """Name of the test point; None: not declared."""
    verdict: str = display.alias("_result.verdict")
    """``clean`` (no residual to explain), ``explained`` by effects, or ``unexplained``."""
    corrected: bool = display.alias("_result.corrected")
    """True if effects explain the residual so well that the modulus fitted with them counts as
    corrected."""
    stored: bool | None = display.alias("_result.stored")
    """True: the diagnosis was stored with the survey; None: it was computed now."""
    warnings: tuple[Notice, ...] = display.alias("_result.warnings")
    """Warnings about the data and the limits of the diagnosis."""
    modulus: float | None = display.alias("_modulus.value")
    """Modulus to use, Pa: fitted with the effects, or without them if `use` is ``do-not-use``;
    None: none."""
    modulus_interval: tuple[float, float] | None = display.alias("_modulus.interval")
    """95 % interval of `modulus`, Pa; None: there is no modulus."""
    equivalent_modulus: float | None = display.alias("_modulus.equivalent")
    """Modulus of the half-space that deflects as much under the plate, Pa, from the source of
    `modulus`; None: none."""
    equivalent_modulus_interval: tuple[float, float] | None = display.alias(
        "_modulus.equivalent_interval"
    )
    """95 % interval of `equivalent_modulus`, Pa."""
    modulus_source: str | None = display.alias("_modulus.source")
    """Source of `modulus`: ``diagnosed`` (with the effects) or ``fitted``; None: none."""

    @property
    def in_force(self) -> bool:
        """True: the modulus fitted with the effects is the one to use."""
        return self.modulus_source == "diagnosed"

    @property
    def use(self) -> str:
        """Use of the modulus fitted with effects: ``design``, ``with-care`` or ``do-not-use``."""
        return "do-not-use" if self._fault is not None else self._result.use

    @property
    def use_reason(self) -> str:
        """Reason for `use`, one sentence."""
        return self._fault or self._result.use_reason

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects, the strongest first; ``diagnosis["effects"]`` has their values."""
        return tuple(effect.key for effect in self._result.effects or ())

    @property
    def before(self) -> dict[str, Any] | None:
        """Fit of the base model: modulus with interval, and residual; None: no measured drop."""
        state: dict[str, Any] | None = self._record["before"]
        return state

    @property
    def after(self) -> dict[str, Any] | None:
        """Fit of the base model with the effects, with the keys of `before`; None: no measured
        drop.
        """
        state: dict[str, Any] | None = self._record["after"]
        return state

    def __getitem__(self, key: str) -> Any:
        if key not in self._record:
            raise KeyError(f"diagnosis: expected one of {', '.join(self._record)}, got {key!r}")
        return self._record[key]

    def __repr__(self) -> str:
        result, verdict = self._result, self.verdict
        if self.effects:
            joint = " by" if verdict == "explained" or self.corrected else ", found"
            verdict += f"{joint} {', '.join(self.effects)}"
        drops = display.count(len(result.drops or ()), "drop")
        parts = [f"{display.text_of(os.path.basename(self.file))}, {drops}: {verdict}"]
        before, after = result.before, result.after
        if before is not None and after is not None:
            moduli = [
                modulus_text(state.modulus_pa, state.modulus_interval_pa) or "none"
                for state in (before, after)
            ]
            use = f" before, {moduli[1]} after: {self._use_words()}" if self.effects else ""
            plate = (result.plate, result.plate_radius_m, result.poisson_ratio)
            parts += [f"E {moduli[0]}{use}", display.conditions(after.model, *plate)]
        return f"Diagnosis({'; '.join([*parts, display.warning_count(self.warnings)])})"

    def _use_words(self) -> str:
        """Return a phrase on the use of the modulus fitted with effects, and on what to use
        instead.
        """
        words = {"design": "design value", "with-care": "use with care"}
        instead = "use none" if self._modulus is None else "use the one before"
        return words.get(self.use, f"do not use ({self.use_reason}), {instead}")

    def __str__(self) -> str:
        line, *warnings = super().__str__().splitlines()
        return "\n".join([line, *map(_effect_line, self._result.effects or ()), *warnings])

    def _rows(self) -> Sequence[Mapping[str, Any]]:
        states = {"before": self.before, "after": self.after}
        return [
            {
                "file": self.file,
                "point": self.point,
                "verdict": self.verdict,
                "state": label,
                "effects": self.effects if label == "after" else (),
                **state,
                "in_force": self.modulus is not None and self.in_force == (label == "after"),
                "use": self.use,
                "use_reason": self.use_reason,
                **{key: self._record[key] for key in ("plate", "plate_radius_m", "poisson_ratio")},
                "warnings": self.warnings,
            }
            for label, state in states.items()
            if state is not None
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return all values of the diagnosis, with the keys of ``pfwd diagnose --json``."""
        return dict(self._record)

    def predict(self, time: ArrayLike, load: ArrayLike) -> NDArray[np.float64]:
        """Return the displacement that the instrument would record in the next drop.

        The prediction uses the drops of the point, and all points of the same instrument that were
        diagnosed in the same call: the hardening of the ground from drop to drop, and the effects
        that the fits have in common. Mains hum is not predicted. The first call fits all these
        points.

        Parameters
        ----------
        time : (n,) s, uniform steps; 0 is the trigger, with some rest before it
        load : (n,) N, downward positive

        Returns
        -------
        (n_sensors, n) m, downward positive, 0 before the pulse
            Displacement of the diagnosed sensors, in the order of the drop.

        Raises
        ------
        SurveyError, InversionError
            If no drop was diagnosed, or the arrays are not the load of a drop.

        Examples
        --------
        >>> drop = pfwd.example("half-space").drops[0]
        >>> pfwd.diagnose(drop).predict(drop.time, drop.load).shape == (1, drop.time.size)
        True
        """
        if self._place is None:
            raise SurveyError(refusal(self.file, "a diagnosed drop to predict from", "none"))
        instrument, place = self._place
        axis, force = time_and_load(time, load)
        return np.asarray(instrument.predict_next(place, axis, force), np.float64)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the residual before and after, in % of the peak over ms.

        Parameters
        ----------
        ax : Axes of matplotlib, optional
            None: a new figure is made.

        Returns
        -------
        Axes

        Raises
        ------
        SurveyError
            If the point has no measured drop, or the diagnosis is a stored one, without traces.
        """
        if self._diagnosis is None:
            hint = "diagnose with refit=True" if self.stored else ""
            raise SurveyError(refusal(self.file, "a diagnosed drop to draw", "none", hint))
        from pfwd.analysis.diagnosis.plots import draw_residual

        ax = display.axes_or_new(ax)
        draw_residual(ax, self._diagnosis)
        x = "time, ms; the grey line ends the contact"
        return display.label_axes(ax, x, "fitted - measured, % of the peak", repr(self))


class Diagnoses(display.ObjectSequence[Diagnosis]):
    """Diagnoses of several points, in the order of the points."""

    KEY = "diagnoses"

    def __repr__(self) -> str:
        if len(self) == 1:
            return f"Diagnoses({self[0]!r})"
        verdicts = [diagnosis.verdict for diagnosis in self]
        counts = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
        return f"Diagnoses({display.count(len(self), 'point')}: {counts or 'none'})"

    def __str__(self) -> str:
        return "\n".join(map(str, self))


@overload
def diagnose(  # type: ignore[overload-overlap]  # a point is a sequence of drops: the first counts
    data: Drop | Point, /, **options: Unpack[DiagnoseOptions]
) -> Diagnosis: ...
@overload
def diagnose(
    time: ArrayLike, load: ArrayLike, values: ArrayLike, /, **options: Unpack[DiagnoseOptions]
) -> Diagnosis: ...
@overload
def diagnose(
    data: str | os.PathLike[str] | HasPoints | Sequence[Drop | Point],
    /,
    **options: Unpack[DiagnoseOptions],
) -> Diagnoses: ...
def diagnose(
    data: Any,
    /,
    *arrays: Any,
    device: str | os.PathLike[str] | None = None,
    jobs: int = 1,
    refit: bool = False,
    **options: Any,
) -> Diagnosis | Diagnoses:
    """Find the effects that explain the residual of points, and their influence on the modulus.

    A drop, a point or arrays return one `Diagnosis`; a path, a survey or points return `Diagnoses`,
    one for each point. Points with the same declared ``device`` share the effects of their device.

    Parameters
    ----------
    data : a drop, a point, points, a survey, several of these, or a path; or ``time, load, values``
    device : path of a TOML file that ``pfwd diagnose --write-device`` wrote, optional
        Known device effects, which are not fitted.
    jobs : int
        Number of processes; a script with more than one needs ``if __name__ == "__main__":``.
    refit : bool
        False: a diagnosis that the survey stores for the same request is returned, as by
        ``pfwd diagnose``. True: all are computed again.

    Other Parameters
    ----------------
    quantity, offsets, header : as for `pfwd.invert`
    elastic : True: a base model without dashpot, so that viscosity is an effect
    load : "measured" or "half-sine"
    plate_radius, plate_mass, poisson_ratio, density : declared values, m, kg, -, kg/m3

    Returns
    -------
    Diagnosis or Diagnoses

    Raises
    ------
    SurveyError, InversionError
        If a file is refused, a drop cannot be diagnosed, or an option is unknown or wrong.
    """
    from pfwd.analysis.diagnosis.device_file import read_device
    from pfwd.analysis.diagnosis.diagnose import diagnose_entries
    from pfwd.analysis.diagnosis.entries import entry_of

    if isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1:
        raise OptionError(refusal("jobs", "a whole number >= 1", repr(jobs)))
    data, settings, header = requested(DIAGNOSE_OPTIONS, data, arrays, options)
    points = points_of(data, header, settings.overrides())
    device_values, spread = (None, None) if device is None else read_device(device)
    entries = [entry_of(point.file, point, settings) for point in points]
    outcomes = diagnose_entries(entries, device_values, jobs, use_stored=not refit, spread=spread)
    diagnosed, results = [], []
    for outcome in outcomes:
        if outcome.result is None:
            raise SurveyError(outcome.error or refusal(outcome.file, "a diagnosis", "none"))
        results.append(outcome.result)
        diagnosed.append(outcome.diagnosis)
    places = _places(entries, device_values)
    diagnoses = Diagnoses(map(Diagnosis, results, moduli_in_force(results), diagnosed, places))
    return diagnoses[0] if isinstance(data, Drop | Point) else diagnoses


def _places(
    entries: Sequence[DiagnosisPoint], device_values: DeviceValues | None
) -> list[tuple[Instrument, int] | None]:
    """Return for each point the model of its instrument and its index there; None: no measured
    drop.
    """
    from inversion.inference.instrument import Instrument
    from pfwd.analysis.diagnosis.entries import instrument_of

    groups: dict[object, list[DiagnosisPoint]] = {}
    for entry in entries:
        groups.setdefault(instrument_of(entry), []).append(entry)
    places: dict[DiagnosisPoint, tuple[Instrument, int]] = {}
    for group in groups.values():
        measured = {entry: entry.records for entry in group if entry.records is not None}
        instrument = Instrument(list(measured.values()), device_values)
        places |= {entry: (instrument, index) for index, entry in enumerate(measured)}
    return [places.get(entry) for entry in entries]


def _effect_line(effect: EffectResult) -> str:
    value = "no value"
    if effect.value is not None:
        spread = "" if effect.sd is None else f" ± {effect.sd:.2g}"
        value = f"{effect.value:.4g}{spread} {effect.unit}".removesuffix(" -")
    return f"  {effect.name}: {value}; {effect.advice or ''}"
