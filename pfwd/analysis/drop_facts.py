"""Facts of a drop that a measuring procedure judges, from its traces and its result."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from inversion.errors import RecordFormatError
from inversion.notices import Notice, invalidating
from pfwd.analysis.results import DropResult, MeasuredFacts, fit_fault
from pfwd.analysis.screening.drops import CENTRE, Screening, pulse_peak, unbroken_part
from pfwd.files.header import IMPORTED, PEAK_DEVIATIONS, PointSetup
from pfwd.peaks.stiffness import ground_velocity
from pfwd.procedures import Kind, PointDrop
from pfwd_device import Channel, Drop
from pfwd_device.drop import Peaks
from pfwd_device.signals import (
    displacement_of,
    integrated,
    quiet_samples,
    remove_offset,
    trace_peaks,
)

FACTS_VERSION = 1
"""Version of the stored facts: to be increased when :func:`point_drop` changes, so that facts of
other versions are ignored."""

FACTS_KEY = "facts"
"""Key of the facts in the metadata of a drop; imported drops have none."""

DURATION_EDGE = 0.03
"""The pulse lasts while the load is above this fraction of its peak."""

PEAK_WITHIN = 2.0
"""The peak of the deflection is searched within this number of pulse durations after the start of
the pulse. It lags the load by a fraction of one; later maxima are rebounds, or drift of an
integrated velocity."""

_LEAD_IN = 0.25
"""Time before the pulse that a picture shows, in pulse durations."""

END_PART = 0.05
"""Fraction of the record, at its end, over which the remaining deflection is averaged."""


def point_drop(
    drop: Drop,
    setup: PointSetup,
    screening: Screening,
    result: DropResult | None = None,
) -> PointDrop:
    """Return the facts of a drop that a procedure judges.

    Parameters
    ----------
    drop : Drop
    setup : PointSetup
        Its declared geophone response is removed from the peak: uncorrected, a geophone of 4.5 Hz
        lowers the peak of a 17 ms pulse by 18 %.
    screening : Screening
    result : DropResult, optional
        Supplies the fitted modulus.

    Returns
    -------
    PointDrop
    """
    if drop.only_peaks is not None and not setup.is_stiffness_test:
        return _of_peaks(drop.number, drop.only_peaks, setup)
    if screening.status == "rejected":
        return PointDrop(drop.number, Kind.REJECTED, reason=screening.reason)
    unbroken = unbroken_part(drop)[0]
    peak, start, duration = _pulse_of(unbroken)
    facts: dict[str, Any] = {"peak_load": peak, "pulse_duration": duration}
    centre = [channel for channel in unbroken.channels if abs(channel.offset) < CENTRE]
    if centre and duration:
        facts |= _deflection(unbroken, centre[0], setup, start, duration)
    fact = PointDrop(drop.number, Kind(screening.status), **facts)
    return with_modulus(fact, result, setup, screening.warnings)


@dataclasses.dataclass(frozen=True, eq=False, slots=True)
class JudgedDeflection:
    """Deflection in the centre over time; its largest value is `PointDrop.peak_deflection`."""

    time: NDArray[np.float64]
    """(n,), s after the trigger."""
    deflection: NDArray[np.float64]
    """(n,), m, from the start of the pulse, with the declared response of the geophone removed."""


def judged_deflection(drop: Drop, setup: PointSetup) -> JudgedDeflection | None:
    """Return the deflection that a procedure judges, for a picture.

    It begins a quarter of a pulse duration before the pulse. It ends one pulse duration after the
    end of the search for its peak, or earlier, where drift exceeds that peak.

    Parameters
    ----------
    drop : Drop
    setup : PointSetup
        Supplies the geophone response.

    Returns
    -------
    JudgedDeflection or None
        None: there are no traces, no pulse, no centre sensor, or no downward motion.
    """
    if drop.only_peaks is not None:
        return None
    unbroken = unbroken_part(drop)[0]
    centre = [channel for channel in unbroken.channels if abs(channel.offset) < CENTRE]
    if not centre or not unbroken.load.size:
        return None
    _, start, duration = _pulse_of(unbroken)
    if not duration:
        return None
    moved, _ = _centre_motion(unbroken, centre[0], setup)
    window = _judged_window(unbroken.time, start, duration)
    peak = moved[window].max()
    if peak <= moved[start]:
        return None
    pulse = unbroken.time[start]
    first = int(np.searchsorted(unbroken.time, pulse - _LEAD_IN * duration))
    last = int(np.searchsorted(unbroken.time, pulse + (PEAK_WITHIN + 1.0) * duration))
    beyond = np.flatnonzero(moved[window.stop : last] > peak)
    part = slice(first, window.stop + int(beyond[0]) if beyond.size else max(last, window.stop))
    return JudgedDeflection(unbroken.time[part], moved[part] - moved[start])


def _of_peaks(number: int, peaks: Peaks, setup: PointSetup) -> PointDrop:
    """Return the facts of a drop without traces.

    Procedures judge it, although it cannot be inverted.
    """
    kind = Kind.SEATING if number <= setup.seating_drops else Kind.MEASURED
    centre = peaks.centre
    return PointDrop(
        number,
        kind,
        peak_load=peaks.load,
        peak_deflection=centre if centre is not None and centre > 0 else None,
    )


def uncompared_facts(
    drop: Drop, setup: PointSetup, screening: Screening
) -> tuple[PointDrop, float]:
    """Return the facts from the record of a drop alone, and the peak for comparisons.

    Parameters
    ----------
    drop : Drop
    setup : PointSetup
    screening : Screening
        Screening by the record alone.

    Returns
    -------
    facts : PointDrop
    peak : float, N
        Result of `pulse_peak`; 0: the drop is not compared with others.
    """
    facts = point_drop(drop, setup, screening)
    if facts.kind is Kind.REJECTED:
        return facts, 0.0
    # Seating drops are recognised later, with all drops of the point.
    facts = dataclasses.replace(facts, kind=Kind.MEASURED)
    only_peaks = drop.only_peaks is not None and not setup.is_stiffness_test
    return facts, 0.0 if only_peaks else pulse_peak(drop)


def facts_to_store(facts: PointDrop, peak: float, setup: PointSetup) -> MeasuredFacts | None:
    """Return the facts that a survey stores; None for a drop without traces, or on a test rig.

    Parameters
    ----------
    facts : PointDrop
    peak : float, N
        Second result of `uncompared_facts`.
    setup : PointSetup
    """
    if setup.is_stiffness_test:
        return None
    response: dict[str, Any] = {
        "geophone_natural_frequency_hz": setup.geophone_natural_frequency,
        "geophone_damping": setup.geophone_damping,
    }
    if facts.kind is Kind.REJECTED:
        return MeasuredFacts(version=FACTS_VERSION, rejected=facts.reason, **response)
    if not peak:
        return None
    return MeasuredFacts(
        version=FACTS_VERSION,
        peak_load_n=facts.peak_load,
        pulse_peak_n=peak,
        deflection_m=facts.peak_deflection,
        velocity_m_per_s=facts.peak_velocity,
        duration_s=facts.pulse_duration,
        offset_over_peak=facts.offset_over_peak,
        return_over_peak=facts.return_over_peak,
        **response,
    )


def facts_from_stored(
    number: int, facts: MeasuredFacts | None, setup: PointSetup
) -> PointDrop | None:
    """Return a drop with its stored facts; None: they have to be computed from the traces.

    Parameters
    ----------
    number : int
        Number of the drop at its point.
    facts : MeasuredFacts or None
    setup : PointSetup
        Setup as declared now: facts with another response of the geophone are not valid.
    """
    if facts is None or facts.version != FACTS_VERSION or setup.is_stiffness_test:
        return None
    then = facts.geophone_natural_frequency_hz, facts.geophone_damping
    if then != (setup.geophone_natural_frequency, setup.geophone_damping):
        return None
    if facts.rejected is not None:
        return PointDrop(number, Kind.REJECTED, reason=facts.rejected)
    if facts.peak_load_n is None or facts.pulse_peak_n is None:
        return None
    return PointDrop(
        number,
        Kind.MEASURED,
        facts.peak_load_n,
        facts.deflection_m,
        facts.duration_s,
        facts.velocity_m_per_s,
        offset_over_peak=facts.offset_over_peak,
        return_over_peak=facts.return_over_peak,
    )


def stored_facts(
    number: int, setup: PointSetup, metadata: Mapping[str, Any], result: DropResult | None
) -> tuple[PointDrop, float] | None:
    """Return the facts stored with a drop or its result, and the result of `pulse_peak`, N.

    The result is None if they have to be computed from the traces.
    """
    stored = metadata.get(FACTS_KEY)
    try:
        recorded = None if stored is None else MeasuredFacts.from_json(stored)
    except RecordFormatError:  # they are computed from the traces
        recorded = None
    for facts in (recorded, None if result is None else result.facts):
        facts_in_force = facts_from_stored(number, facts, setup)
        if facts_in_force is not None and facts is not None:
            return facts_in_force, facts.pulse_peak_n or 0.0
    return None


def unbroken_peaks(drop: Drop) -> Peaks | None:
    """Return the peaks of a drop before its first missing samples.

    The result is None if samples around the trigger are missing.
    """
    if drop.only_peaks is not None:
        return drop.only_peaks
    unbroken, missing, _ = unbroken_part(drop)
    return trace_peaks(unbroken) if missing is None and unbroken.load.size else None


def corrected_deflection(drop: Drop, setup: PointSetup) -> float | None:
    """Return the peak deflection in the centre, m, without the geophone response.

    The result is None if samples around the trigger are missing, there is no pulse, or the drop was
    on a test rig.
    """
    if drop.only_peaks is not None:
        return drop.only_peaks.centre
    if setup.is_stiffness_test or unbroken_part(drop)[1] is not None:
        return None
    try:
        return point_drop(drop, setup, Screening("measured")).peak_deflection
    except (ValueError, IndexError):  # no pulse in it
        return None


MAX_PEAK_DEVIATION = 0.1
"""Largest relative difference between the peak of a trace and the peak stored in the same file, at
which both are of the same drop: the modulus would be wrong by as much. Filters of the makers'
software change peaks by up to 2 %."""


def _contradicts_its_file(number: int, setup: PointSetup | None) -> bool:
    noted = None if setup is None else setup.extra.get(IMPORTED)
    deviations = noted.get(PEAK_DEVIATIONS) if isinstance(noted, Mapping) else None
    deviation = deviations.get(str(number)) if isinstance(deviations, Mapping) else None
    return isinstance(deviation, int | float) and deviation > MAX_PEAK_DEVIATION


def with_modulus(
    facts: PointDrop,
    result: DropResult | None,
    setup: PointSetup | None = None,
    warnings: Sequence[Notice] = (),
) -> PointDrop:
    """Return the facts of a drop with the modulus of a result, or without a modulus.

    Parameters
    ----------
    facts : PointDrop
    result : DropResult or None
    setup : PointSetup, optional
        Setup of the drop; it holds the difference of its peaks from those stored in its file.
    warnings : sequence of Notice
        Warnings of the screening; those of the result are used as well.
    """
    warned = (*warnings, *(() if result is None else result.warnings))
    fault = invalidating(warned, "record")
    if _contradicts_its_file(facts.number, setup):
        fault = Notice("record-contradicts-file")
    if result is None or result.modulus_pa is None:
        return dataclasses.replace(
            facts,
            record_fault=fault,
            modulus=None,
            modulus_interval=None,
            equivalent_modulus=None,
            equivalent_interval=None,
            modulus_depth=None,
            residual=None,
            fit_fault=None,
            fit_fault_code=None,
        )
    of_fit = fault or fit_fault(result)
    return dataclasses.replace(
        facts,
        record_fault=fault,
        modulus=result.modulus_pa,
        modulus_interval=result.modulus_interval_pa,
        equivalent_modulus=result.equivalent_modulus_pa,
        equivalent_interval=result.equivalent_modulus_interval_pa,
        modulus_depth=result.modulus_depth_m,
        residual=result.contact_residual_rms_over_peak,
        fit_fault=of_fit,
        # Other reasons than warnings do not state what to do.
        fit_fault_code=of_fit.code if of_fit is not None and of_fit in warned else None,
    )


def _pulse_of(drop: Drop) -> tuple[float, int, float | None]:
    """Return the peak load, N, the first sample and the duration, s, of the pulse.

    The duration is that of a half-sine with the same peak and impulse; None: there is no pulse.
    """
    load = remove_offset(drop.time, drop.load)
    start, end = _pulse(load)
    peak = float(load.max())
    area = float(np.trapezoid(load[start:end], drop.time[start:end]))
    return peak, start, math.pi * area / (2 * peak) if peak > 0 else None


def _pulse(load: NDArray[np.float64]) -> tuple[int, int]:
    """Return the index of the first sample of the pulse, and the index after its last sample."""
    top = int(load.argmax())
    low = load < DURATION_EDGE * load[top]
    before, after = np.flatnonzero(low[:top]), np.flatnonzero(low[top:])
    start = int(before[-1]) + 1 if before.size else 0
    return start, top + int(after[0]) if after.size else load.size


def _centre_motion(
    drop: Drop, channel: Channel, setup: PointSetup
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return deflection, m, and velocity, m/s, without the geophone's declared response."""
    velocity = ground_velocity(channel, drop, setup)
    if not channel.quantity.integrations:
        return displacement_of(channel, drop.time), velocity
    return integrated(velocity, drop.time), velocity


def _judged_window(time: NDArray[np.float64], start: int, duration: float) -> slice:
    """Return the samples among which the peak of the deflection is searched."""
    until = time[start] + PEAK_WITHIN * duration
    return slice(start, max(start + 2, int(np.searchsorted(time, until))))


def _deflection(
    drop: Drop, channel: Channel, setup: PointSetup, start: int, duration: float
) -> dict[str, float]:
    moved, velocity = _centre_motion(drop, channel, setup)
    part = _judged_window(drop.time, start, duration)
    peak = float((moved[part] - moved[start]).max())
    if peak <= 0:
        return {}
    facts = {"peak_deflection": peak, "peak_velocity": float(velocity[part].max())}
    if not channel.quantity.integrations:
        # For an integrated velocity both values would be drift of the integration.
        quiet = quiet_samples(drop.time)
        if quiet:
            facts["offset_over_peak"] = abs(float(channel.values[:quiet].mean())) / peak
        last = max(1, int(END_PART * moved.size))
        facts["return_over_peak"] = abs(float(moved[-last:].mean())) / peak
    return facts
