"""Plots of a drop: load with half-sine, deflection with the fitted curve, residual."""

import math

import numpy as np
from numpy.typing import NDArray

from pfwd.analysis.results import DropResult, TimeHistories
from pfwd.analysis.screening.drops import (
    channels_outward,
    displacement_of,
    remove_offset,
)
from pfwd.analysis.sensor_fits import sensor_fits
from pfwd.digits import significant
from pfwd.session.events import SavedDrop
from pfwd.session.live_trace import Envelope
from pfwd.units import Units, percent
from tui.screen.drawing.lines import TextRole
from tui.screen.drawing.plot import Curve, Figure
from tui.screen.session.screen_drop import ScreenDrop
from tui.screen.session.screen_events import Refit

Array = NDArray[np.float64]
N_BOWL_POINTS = 400
"""Points of the modelled bowl; a terminal has fewer columns of dots."""
HALF_DASH_OVER_WIDTH = 0.02
"""Half the length of a sensor's dash, as a fraction of the width of the bowl."""


def drop_figures(
    drop: ScreenDrop,
    units: Units,
    span: tuple[float, float] | None = None,
    sensor: int = 0,
    refit: Refit | None = None,
) -> list[Figure]:
    """Return the plots of load, deflection and residual; without a fit the first two.

    Parameters
    ----------
    drop : ScreenDrop
    units : Units
    span : (start, end), optional
        Time axis, s; by default the window of the fit.
    sensor : int
        Index of the sensor, by offset.
    refit : Refitted, optional
        Fit to show in place of the result in force.
    """
    curves, result = curves_of(drop, refit)
    if curves is not None:
        return _fitted(drop, curves, result or DropResult(), units, span, sensor)
    if drop.saved is not None:
        return _raw(drop.saved, units, span, sensor)
    return []


def curves_of(
    drop: ScreenDrop, refit: Refit | None
) -> tuple[TimeHistories | None, DropResult | None]:
    """Return the curves of a drop, or of one of its refits, and the result they belong to."""
    if refit is None:
        return drop.drawn_curves, drop.curves_result
    return refit.curves, refit.result


def default_span(curves: TimeHistories) -> tuple[float, float]:
    """Return the time axis of the pulse and the settling after it, s."""
    end = float(curves.time[-1])
    contact = curves.contact_end if math.isfinite(curves.contact_end) else end
    return max(float(curves.time[0]), -2e-3), min(end, max(2.0 * contact, 25e-3))


def _fitted(
    drop: ScreenDrop,
    curves: TimeHistories,
    result: DropResult,
    units: Units,
    span: tuple[float, float] | None,
    sensor: int,
) -> list[Figure]:
    start, end = (1e3 * t for t in span or default_span(curves))
    time = 1e3 * curves.time
    sensor = min(sensor, len(curves.offsets) - 1)
    load_scale = units.of("load").scale
    scale = units.of("deflection").scale
    pulse = half_sine_of(result, curves)
    name = f"half-sine {significant(1e3 * pulse[1])} ms" if pulse else "half-sine"
    shape = pulse[0] if pulse else np.full_like(curves.time, np.nan)
    load = Figure(
        "load",
        units.unit("load"),
        (
            Curve(time, curves.load / load_scale, "load", "measured"),
            Curve(time, shape / load_scale, "fitted", name, True),
        ),
        start,
        end,
        note=f"peak {units.text('load', drop.peak_load)}",
        time_axis=False,
    )
    observed, predicted = curves.observed[sensor] / scale, curves.predicted[sensor] / scale
    fitted = np.where(curves.time <= curves.window_end, predicted, np.nan)
    before: tuple[Curve, ...] = ()
    if curves.before is not None:
        before = (Curve(time, curves.before[sensor] / scale, "dim", "without effects", True),)
    deflection = Figure(
        _place("deflection", curves.offsets, sensor, units),
        units.unit("deflection"),
        (
            *before,
            Curve(time, observed, "measured", "measured"),
            Curve(time, fitted, "fitted", "fitted", True),
        ),
        start,
        end,
        note=f"peak as recorded {significant(float(np.nanmax(observed)), 3)}",
    )
    return [load, deflection, _residual(result, time, fitted - observed, units, (start, end))]


def _residual(
    result: DropResult,
    time: Array,
    residual: Array,
    units: Units,
    span: tuple[float, float],
) -> Figure:
    part = percent(result.residual_rms_over_peak)
    noise = units.value("deflection", result.noise_rms_m) or 0.0
    return Figure(
        "residual",
        units.unit("deflection"),
        (Curve(time, residual, "residual", "fitted - measured"),),
        *span,
        note=f"{part} of the peak",
        # Noise fills a tenth of the plot, so that it looks like what it is.
        min_range=20 * noise,
    )


def half_sine_of(result: DropResult, curves: TimeHistories) -> tuple[Array, float] | None:
    """Return the half-sine fitted to the load, N, NaN outside of it, and its duration, s."""
    peak = result.half_sine_load_n
    duration = result.half_sine and result.half_sine.duration_s
    if peak is None or not duration:
        return None
    # The pulse is placed where the measured peak is: its start is no part of the result.
    centre = float(curves.time[int(np.nanargmax(curves.load))])
    phase = (curves.time - centre) / duration + 0.5
    inside = (phase >= 0.0) & (phase <= 1.0)
    return np.where(inside, peak * np.sin(np.pi * phase), np.nan), duration


def _place(title: str, offsets: Array, sensor: int, units: Units) -> str:
    if len(offsets) < 2:
        return title
    return f"{title} at {units.with_unit('length', float(offsets[sensor]))}"


def _raw(
    saved: SavedDrop, units: Units, span: tuple[float, float] | None, sensor: int
) -> list[Figure]:
    drop = saved.drop
    if not drop.time.size:
        return []  # peaks alone: nothing to draw
    time = 1e3 * drop.time
    start, end = (1e3 * t for t in span or (max(float(drop.time[0]), -5e-3), float(drop.time[-1])))
    load = remove_offset(drop.time, drop.load) / units.of("load").scale
    plots = [
        Figure(
            "load",
            units.unit("load"),
            (Curve(time, load, "load", "measured"),),
            start,
            end,
            note=f"peak {significant(float(np.nanmax(load)), 3)}",
            time_axis=False,
        )
    ]
    if drop.channels:
        # In the order of the fit, so that the sensor stays when the fit comes.
        channels = channels_outward(drop)
        sensor = min(sensor, len(channels) - 1)
        moved = displacement_of(channels[sensor], drop.time) / units.of("deflection").scale
        finite = moved[np.isfinite(moved)]
        peak = significant(float(finite.max()), 3) if len(finite) else "-"
        offsets = np.array([channel.offset for channel in channels])
        plots.append(
            Figure(
                _place("deflection", offsets, sensor, units),
                units.unit("deflection"),
                (Curve(time, moved, "measured", "measured"),),
                start,
                end,
                note=f"peak {peak}, not fitted",
            )
        )
    return plots


def spectrum_figure(
    drop: ScreenDrop, units: Units, sensor: int = 0, refit: Refit | None = None
) -> Figure | None:
    """Return the amplitude spectra of deflection and residual; None without a fit."""
    curves, _ = curves_of(drop, refit)
    if curves is None:
        return None
    sensor = min(sensor, len(curves.offsets) - 1)
    inside = (curves.time >= 0) & (curves.time <= curves.window_end)
    observed, predicted = curves.observed[sensor][inside], curves.predicted[sensor][inside]
    if len(observed) < 8:
        return None
    step = float(np.diff(curves.time[:2])[0])
    shape = np.hanning(len(observed))
    frequency = np.asarray(np.fft.rfftfreq(len(observed), step), np.float64)
    parts = []
    role: TextRole
    for values, role, name in (
        (observed, "measured", "measured"),
        (predicted - observed, "residual", "residual"),
    ):
        amplitude = 2 * np.abs(np.fft.rfft(values * shape)) / shape.sum()
        decibel = 20 * np.log10(np.maximum(amplitude, 1e-12) / units.of("deflection").scale)
        parts.append(
            Curve(frequency, np.asarray(decibel, np.float64), role, name, role == "residual")
        )
    highest = float(frequency[-1])
    values = np.concatenate([part.values for part in parts])
    return Figure(
        "spectrum",
        f"dB re 1 {units.unit('deflection')}",
        tuple(parts),
        0.0,
        min(1000.0, highest),
        time_unit="Hz",
        bottom=float(np.floor(values.min() / 20) * 20),
        top=float(np.ceil(values.max() / 20) * 20),
    )


def bowl_figure(drop: ScreenDrop, units: Units, refit: Refit | None = None) -> Figure | None:
    """Return measured and modelled peaks by offset; None for a single sensor."""
    curves, _ = curves_of(drop, refit)
    if curves is None or len(curves.offsets) < 2:
        return None
    fits = sorted(sensor_fits(curves), key=lambda fit: fit.offset)
    length, deflection = units.of("length").scale, units.of("deflection").scale
    places = np.array([fit.offset for fit in fits]) / length
    reach = float(places[-1] - places[0])
    across = np.linspace(places[0], places[-1], N_BOWL_POINTS)
    modelled = np.interp(across, places, [fit.modelled_peak / deflection for fit in fits])
    # A dash for each sensor: a single dot would be lost among those of the line.
    dash = np.abs(across[:, None] - places[None, :]) <= HALF_DASH_OVER_WIDTH * reach
    measured = np.array([fit.measured_peak for fit in fits]) / deflection
    nearest = np.abs(across[:, None] - places[None, :]).argmin(axis=1)
    dashes = np.where(dash.any(axis=1), measured[nearest], np.nan)
    return Figure(
        "bowl",
        units.unit("deflection"),
        (
            Curve(across, dashes, "measured", "measured"),
            Curve(across, modelled, "fitted", "modelled", True),
        ),
        float(places[0] - HALF_DASH_OVER_WIDTH * reach),
        float(places[-1] + HALF_DASH_OVER_WIDTH * reach),
        time_unit=units.unit("length"),
        bottom=min(0.0, 1.05 * float(measured.min())),
        note="peaks by distance from the centre",
    )


def live_figures(envelope: Envelope, units: Units, window: float) -> list[Figure]:
    """Return the plots of load and motion as they arrive; the time counts back from now."""
    count = len(envelope.load)
    times = -(np.arange(count)[::-1] + 0.5) * envelope.interval
    time = np.repeat(times, 2)
    load = envelope.load.reshape(-1) / units.of("load").scale
    moving = units.of(envelope.quantity)
    motion = envelope.velocity.reshape(-1) / moving.scale
    return [
        Figure(
            "live load",
            units.unit("load"),
            (Curve(time, load, "load", ""),),
            -window,
            0.0,
            "s",
            note=f"now {significant(float(load[-1]), 2) if count else '-'}",
            min_range=1.0,
        ),
        Figure(
            f"live {envelope.quantity}",
            moving.name,
            (Curve(time, motion, "measured", ""),),
            -window,
            0.0,
            "s",
            min_range=envelope.quantity.live_range,
        ),
    ]
