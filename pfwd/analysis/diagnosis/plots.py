"""Pictures of diagnoses: traces, residuals and their spectrum, evidence of the effects."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from inversion.diagnosis.findings import FittedState
from pfwd.analysis.results import DiagnosisResult
from pfwd.display import AFTER_COLOUR, BEFORE_COLOUR, draw_residual
from pfwd.errors import SurveyError, refusal
from pfwd.facts import facts_of_state
from pfwd.matplotlib_start import start_matplotlib
from pfwd.units import SI, percent

_DATA = "#222222"


def plot_diagnoses(results: Sequence[DiagnosisResult], path: str | os.PathLike[str]) -> None:
    """Write a picture of diagnoses, one row of four diagrams for each point.

    Parameters
    ----------
    results : sequence of DiagnosisResult
        Results without traces are skipped.
    path : path ending in .png, .svg or .pdf

    Raises
    ------
    SurveyError
        If no result has traces.
    """
    start_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows = [result for result in results if result.curves]
    if not rows:
        raise SurveyError(refusal("--plot", "at least one diagnosed point", "none"))
    figure = Figure(figsize=(15, 3.4 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(rows), 4, squeeze=False)
    for row, result in zip(axes, rows, strict=True):
        _draw_traces(row[0], result)
        title = "residual: base model (grey), with all effects (blue)"
        draw_residual(row[1], result.curves, title)
        _draw_spectrum(row[2], result)
        _draw_ladder(row[3], result)
    figure.savefig(path, dpi=110)


def _draw_traces(axis: Any, result: DiagnosisResult) -> None:
    for curves in result.curves:
        time = curves.time * 1e3
        for observed, before, after in zip(
            curves.observed, curves.before, curves.after, strict=True
        ):
            axis.plot(time, before * 1e6, color=BEFORE_COLOUR, lw=0.8, ls="--")
            axis.plot(time, observed * 1e6, color=_DATA, lw=1.2)
            axis.plot(time, after * 1e6, color=AFTER_COLOUR, lw=0.9)
    axis.set_title(f"{_name(result)}: {result.verdict}", fontsize=9)
    axis.set_ylabel("displacement, µm (down +)", fontsize=8)
    if axis.lines:
        names = ("base model", "recorded", "with all effects")
        axis.legend(axis.lines[: len(names)], names, fontsize=7)
    axis.set_xlabel("ms", fontsize=8)


def _draw_spectrum(axis: Any, result: DiagnosisResult) -> None:
    for curves in result.curves:
        step = curves.time[1] - curves.time[0]
        taper = np.hanning(curves.time.size)
        for values, colour in ((curves.before, BEFORE_COLOUR), (curves.after, AFTER_COLOUR)):
            residual = (values[0] - curves.observed[0]) * taper
            spectrum = np.abs(np.fft.rfft(residual, 4 * residual.size)) * step
            frequency = np.fft.rfftfreq(4 * residual.size, step)
            part = (frequency > 2) & (frequency < 600)
            axis.loglog(frequency[part], spectrum[part], color=colour, lw=0.8)
    axis.set_title("spectrum of the residual, first sensor", fontsize=9)
    axis.set_xlabel("Hz", fontsize=8)
    axis.set_ylabel("m s", fontsize=8)


def _draw_ladder(axis: Any, result: DiagnosisResult) -> None:
    effects = result.effects
    # Effects shared by the points of a device have no evidence at a single point.
    names = [
        effect.name.replace("_", " ")
        + ("" if np.isfinite(effect.evidence) else " (shared by the points)")
        for effect in effects
    ] or ["no effect"]
    evidence = [float(np.nan_to_num(effect.evidence)) for effect in effects]
    places = np.arange(len(names))
    axis.barh(places, evidence or [0.0], color=AFTER_COLOUR)
    axis.set_yticks(places, names, fontsize=8)
    axis.invert_yaxis()
    axis.set_xlabel("evidence (log Bayes factor)", fontsize=8)
    axis.set_title(
        "\n".join(
            f"{when} {_modulus(state)}, residual {percent(state.residual_rms_over_peak)}"
            for when, state in (("base model", result.before), ("all effects", result.after))
            if state is not None
        ),
        fontsize=9,
    )


def _name(result: DiagnosisResult) -> str:
    """Return the name of a point, or of its file if the point has no name."""
    return Path(result.file).name if result.point is None else result.point


def _modulus(state: FittedState) -> str:
    """Return the modulus with its interval as text."""
    return f"E {SI.show(facts_of_state(state)['modulus'])}"
