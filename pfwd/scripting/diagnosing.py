"""Function `pfwd.diagnose`, which explains the residual of points by effects of ground and device.

"Before" is the fit of the base model alone, "after" the fit of the same model with the effects.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from inversion import notices
from inversion.notices import Notice
from pfwd.digits import modulus_text
from pfwd.errors import OptionError, SurveyError, refusal
from pfwd.export.json_text import without_nan
from pfwd.judging.view import moduli_in_force
from pfwd.scripting.display import (
    ScriptObject,
    axes_or_new,
    count,
    data_frame,
    html_table,
    text_of,
)
from pfwd.scripting.inverting import Header, drop_of_arrays, is_array
from pfwd.scripting.measured import Drop, Point, points_of, time_and_load
from pfwd.scripting.options import DIAGNOSE_OPTIONS, DiagnoseOptions, analysis_options

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from pandas import DataFrame

    from inversion.diagnosis import PointDiagnosis, PointRecords
    from inversion.inference.instrument import Instrument
    from pfwd.analysis.diagnosis.entries import DiagnosisPoint
    from pfwd.analysis.diagnosis.points import DeviceValues
    from pfwd.analysis.results import DiagnosisResult
    from pfwd.procedures import PointModulus
    from pfwd.scripting.measured import Points
    from pfwd.scripting.surveys import Survey


class Diagnosis(ScriptObject):
    """Effects that explain the residual of a point, and their influence on the modulus.

    Each key of ``pfwd diagnose --json`` can be used as an index: ``diagnosis["held_out"]``.
    """

    __slots__ = ("_diagnosis", "_fault", "_modulus", "_place", "_record")

    def __init__(
        self,
        result: DiagnosisResult,
        modulus: PointModulus | None,
        diagnosis: PointDiagnosis | None = None,
        place: tuple[Instrument, int] | None = None,
    ) -> None:
        self._record: dict[str, Any] = without_nan(result.to_json())
        self._fault = None if modulus is None else modulus.not_supported
        self._modulus = None if self._fault is not None else modulus
        self._diagnosis = diagnosis
        self._place = place

    @property
    def file(self) -> str:
        """Path from which the point was read."""
        return str(self._record["file"])

    @property
    def verdict(self) -> str:
        """``clean`` (no residual to explain), ``explained`` by effects, or ``unexplained``."""
        return str(self._record["verdict"])

    @property
    def corrected(self) -> bool:
        """True if effects explain the residual so well that the modulus fitted with them counts as
        corrected.
        """
        return bool(self._record["corrected"])

    @property
    def modulus(self) -> float | None:
        """Modulus to use, Pa: fitted with the effects, or without them if `use` is ``do-not-use``;
        None: none.
        """
        return None if self._modulus is None else self._modulus.value

    @property
    def modulus_interval(self) -> tuple[float, float] | None:
        """95 % interval of `modulus`, Pa; None: there is no modulus."""
        return None if self._modulus is None else self._modulus.interval

    @property
    def use(self) -> str:
        """Use of the modulus fitted with effects: ``design``, ``with-care`` or ``do-not-use``."""
        return "do-not-use" if self._fault is not None else str(self._record["use"])

    @property
    def use_reason(self) -> str:
        """Reason for `use`, one sentence."""
        return self._fault or str(self._record["use_reason"])

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects, the strongest first; ``diagnosis["effects"]`` has their values."""
        return tuple(str(effect["name"]) for effect in self._record["effects"])

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

    @property
    def warnings(self) -> tuple[Notice, ...]:
        """Warnings about the data and the limits of the diagnosis."""
        return notices.from_json(self._record["warnings"], self._record["warning_codes"])

    def __getitem__(self, key: str) -> Any:
        if key not in self._record:
            raise KeyError(f"diagnosis: expected one of {', '.join(self._record)}, got {key!r}")
        return self._record[key]

    def __repr__(self) -> str:
        name = text_of(os.path.basename(self.file))
        drops = count(len(self._record["drops"]), "drop")
        verdict = self.verdict
        if self.effects:
            joint = " by" if self.verdict == "explained" or self.corrected else ", found"
            verdict += f"{joint} {', '.join(self.effects)}"
        warned = count(len(self.warnings), "warning") if self.warnings else "no warnings"
        if self.before is None or self.after is None:
            return f"Diagnosis({name}, {drops}: {verdict}; {warned})"
        record = self._record
        moduli = f"E {_modulus(self.before)}"
        if self.effects:
            moduli += f" before, {_modulus(self.after)} after: {self._use_words()}"
        return (
            f"Diagnosis({name}, {drops}: {verdict}; {moduli}; {self.after['model']}, "
            f"{record['plate']} plate of radius {record['plate_radius_m']:g} m, "
            f"Poisson's ratio {record['poisson_ratio']:g}; {warned})"
        )

    def _counts(self, state: str) -> bool:
        """Return whether the modulus ``before`` or ``after`` is the one to use."""
        source = "diagnosed" if state == "after" else "fitted"
        return self._modulus is not None and self._modulus.source == source

    def _use_words(self) -> str:
        """Return a phrase on the use of the modulus fitted with effects, and on what to use
        instead.
        """
        words = {"design": "design value", "with-care": "use with care"}
        if self.use in words:
            return words[self.use]
        instead = "use none" if self._modulus is None else "use the one before"
        return f"do not use ({self.use_reason}), {instead}"

    def __str__(self) -> str:
        lines = [repr(self)]
        for effect in self._record["effects"]:
            lines.append(f"  {effect['name']}: {_value(effect)}; {effect.get('advice') or ''}")
        lines += [f"  warning: {text_of(text)}" for text in self.warnings]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        rows = [
            (
                label,
                "" if state is None else _modulus(state),
                "" if state is None else state["model"],
                "" if state is None else f"{100 * state['residual_rms_over_peak']:.2g}",
                "" if state is None else f"{state['residual_over_noise']:.2g}",
            )
            for label, state in (("before", self.before), ("after", self.after))
        ]
        return html_table(repr(self), _STATE_COLUMNS, rows)

    def to_dict(self) -> dict[str, Any]:
        """Return all values of the diagnosis, with the keys of ``pfwd diagnose --json``."""
        return dict(self._record)

    def to_dataframe(self) -> DataFrame:
        """Return a table with a row for the fit before and one for the fit after; needs pandas."""
        return data_frame(_rows(self))

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
            If the point has no measured drop.
        """
        if self._diagnosis is None:
            raise SurveyError(refusal(self.file, "a diagnosed drop to draw", "none"))
        ax = axes_or_new(ax)
        for curves in self._diagnosis.curves:
            time = 1e3 * curves.time
            for row, offset in enumerate(curves.offsets.tolist()):
                observed = curves.observed[row]
                peak = abs(observed).max()
                name = f"drop {curves.number}, {offset:g} m"
                before = 100 * (curves.before[row] - observed) / peak
                after = 100 * (curves.after[row] - observed) / peak
                ax.plot(time, before, "--", linewidth=1, label=f"before, {name}")
                ax.plot(time, after, linewidth=1, label=f"after, {name}")
            ax.axvline(1e3 * curves.contact_end, color="0.7", linewidth=0.8)
        ax.set_xlabel("time, ms; the grey line ends the contact")
        ax.set_ylabel("fitted - measured, % of the peak")
        ax.set_title(repr(self), fontsize="small", parse_math=False, wrap=True)
        ax.legend(fontsize="small")
        return ax


class Diagnoses(ScriptObject, Sequence[Diagnosis]):
    """Diagnoses of several points, in the order of the points."""

    __slots__ = ("_diagnoses",)

    def __init__(self, diagnoses: Sequence[Diagnosis]) -> None:
        self._diagnoses = tuple(diagnoses)

    def __len__(self) -> int:
        return len(self._diagnoses)

    def __iter__(self) -> Iterator[Diagnosis]:
        return iter(self._diagnoses)

    @overload
    def __getitem__(self, index: int) -> Diagnosis: ...
    @overload
    def __getitem__(self, index: slice) -> Diagnoses: ...
    def __getitem__(self, index: int | slice) -> Diagnosis | Diagnoses:
        if isinstance(index, slice):
            return Diagnoses(self._diagnoses[index])
        return self._diagnoses[index]

    def __repr__(self) -> str:
        if len(self) == 1:
            return f"Diagnoses({self[0]!r})"
        verdicts = [diagnosis.verdict for diagnosis in self]
        counts = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
        return f"Diagnoses({count(len(self), 'point')}: {counts or 'none'})"

    def __str__(self) -> str:
        return "\n".join(map(str, self))

    def _repr_html_(self) -> str:
        rows = [
            (repr(diagnosis), ", ".join(diagnosis.effects) or "none", diagnosis.verdict)
            for diagnosis in self
        ]
        return html_table(repr(self), ("point", "effects", "verdict"), rows)

    def to_dict(self) -> dict[str, Any]:
        """Return a dict with the key ``diagnoses``: one record of ``pfwd diagnose --json`` for each
        point.
        """
        return {"diagnoses": [diagnosis.to_dict() for diagnosis in self]}

    def to_dataframe(self) -> DataFrame:
        """Return a table with two rows for each point, fit before and fit after; needs pandas."""
        return data_frame(row for diagnosis in self for row in _rows(diagnosis))


_STATE_COLUMNS = (
    "",
    "E with its 95 % interval",
    "model",
    "residual, % of the peak",
    "over the noise",
)


@overload
def diagnose(  # type: ignore[overload-overlap]  # a point is a sequence of drops: the first counts
    data: Drop | Point,
    /,
    *,
    header: Header = None,
    device: str | os.PathLike[str] | None = None,
    **options: Unpack[DiagnoseOptions],
) -> Diagnosis: ...
@overload
def diagnose(
    data: str | os.PathLike[str] | Survey | Points | Sequence[Drop | Point],
    /,
    *,
    header: Header = None,
    device: str | os.PathLike[str] | None = None,
    jobs: int = 1,
    **options: Unpack[DiagnoseOptions],
) -> Diagnoses: ...
@overload
def diagnose(
    time: ArrayLike,
    load: ArrayLike,
    values: ArrayLike,
    /,
    *,
    quantity: Literal["displacement", "velocity"] = "displacement",
    offsets: float | Sequence[float] | None = None,
    device: str | os.PathLike[str] | None = None,
    **options: Unpack[DiagnoseOptions],
) -> Diagnosis: ...
def diagnose(
    data: Any,
    /,
    *arrays: Any,
    quantity: Literal["displacement", "velocity"] = "displacement",
    offsets: float | Sequence[float] | None = None,
    header: Header = None,
    device: str | os.PathLike[str] | None = None,
    jobs: int = 1,
    **options: Any,
) -> Diagnosis | Diagnoses:
    """Find the effects that explain the residual of points, and their influence on the modulus.

    A drop, a point or arrays return one `Diagnosis`; a path, a survey or points return `Diagnoses`,
    one for each point. Points with the same declared ``device`` share the effects of their device.

    Parameters
    ----------
    data : a drop, a point, points, a survey, several of these, or a path; or ``time, load, values``
    quantity, offsets, header : as for `pfwd.invert`
    device : path of a TOML file that ``pfwd diagnose --write-device`` wrote, optional
        Known device effects, which are not fitted.
    jobs : int
        Number of processes; a script with more than one needs ``if __name__ == "__main__":``.

    Other Parameters
    ----------------
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

    settings = analysis_options(DIAGNOSE_OPTIONS, options)
    if isinstance(jobs, bool) or not isinstance(jobs, int) or jobs < 1:
        raise OptionError(refusal("jobs", "a whole number >= 1", repr(jobs)))
    if arrays or is_array(data):
        data = drop_of_arrays(data, arrays, quantity, offsets, settings, header)
    elif offsets is not None or quantity != "displacement":
        name = "offsets" if offsets is not None else "quantity"
        raise OptionError(refusal(name, "none unless arrays are given", "one"))
    points = points_of(data, header, settings.overrides())
    device_values, spread = (None, None) if device is None else read_device(device)
    entries = [entry_of(point.file, point, settings) for point in points]
    places = _places(entries, device_values)
    outcomes = list(diagnose_entries(entries, device_values, jobs, spread=spread))
    results = []
    for outcome in outcomes:
        if outcome.result is None:
            raise SurveyError(outcome.error or refusal(outcome.file, "a diagnosis", "none"))
        results.append(outcome.result)
    diagnoses = [
        Diagnosis(result, modulus, outcome.diagnosis, place)
        for result, modulus, outcome, place in zip(
            results, moduli_in_force(results), outcomes, places, strict=True
        )
    ]
    return diagnoses[0] if isinstance(data, Drop | Point) else Diagnoses(diagnoses)


def _places(
    entries: Sequence[DiagnosisPoint], device_values: DeviceValues | None
) -> list[tuple[Instrument, int] | None]:
    """Return for each point the model of its instrument and its index there; None: no measured
    drop.
    """
    from inversion.inference.instrument import Instrument
    from pfwd.analysis.diagnosis.entries import instrument_of

    records: dict[tuple[object, ...], list[PointRecords]] = {}
    for entry in entries:
        if entry.records is not None:
            records.setdefault(instrument_of(entry), []).append(entry.records)
    instruments = {key: Instrument(points, device_values) for key, points in records.items()}
    counts = dict.fromkeys(records, 0)
    places: list[tuple[Instrument, int] | None] = []
    for entry in entries:
        if entry.records is None:
            places.append(None)
            continue
        key = instrument_of(entry)
        places.append((instruments[key], counts[key]))
        counts[key] += 1
    return places


def _modulus(state: Mapping[str, Any]) -> str:
    modulus, interval = state["modulus_pa"], state["modulus_interval_pa"]
    if modulus is None or interval is None or None in interval:
        return "none"
    return modulus_text(modulus, interval)


def _value(effect: Mapping[str, Any]) -> str:
    if effect["value"] is None:
        return "no value"
    unit = "" if effect["unit"] == "-" else f" {effect['unit']}"
    spread = "" if effect["sd"] is None else f" ± {effect['sd']:.2g}"
    return f"{effect['value']:.4g}{spread}{unit}"


def _rows(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    rows = []
    for label, state in (("before", diagnosis.before), ("after", diagnosis.after)):
        if state is None:
            continue
        low, high = state["modulus_interval_pa"]
        rows.append(
            {
                "file": diagnosis.file,
                "verdict": diagnosis.verdict,
                "state": label,
                "effects": "; ".join(diagnosis.effects) if label == "after" else "",
                **{key: value for key, value in state.items() if key != "modulus_interval_pa"},
                "modulus_interval_low_pa": low,
                "modulus_interval_high_pa": high,
                "in_force": diagnosis._counts(label),
                "use": diagnosis.use,
                "use_reason": diagnosis.use_reason,
                "plate": diagnosis["plate"],
                "plate_radius_m": diagnosis["plate_radius_m"],
                "poisson_ratio": diagnosis["poisson_ratio"],
                "warnings": "; ".join(diagnosis.warnings),
            }
        )
    return rows
