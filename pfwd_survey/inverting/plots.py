"""Plots of inverted drops: load, displacement measured and fitted, residual (matplotlib)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pfwd_survey.errors import OptionError, refusal
from pfwd_survey.inverting.outcome import FileOutcome
from pfwd_survey.inverting.results import DropResult
from pfwd_survey.matplotlib_start import start_matplotlib

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from inversion import InversionResult

MOST_COLUMNS = 12
"""Drops side by side in one picture; more are pages of a PDF."""

_COLUMN_INCHES, _HEIGHT_INCHES = 5.2, 8.0
# Distinguishable without colour vision and, by their dashes, in print.
_COLOURS = ("#0b3c5d", "#b8500f", "#3d7a2a", "#7b3f8c", "#8a6d00", "#444444")
_DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1)), (0, (1, 1)))


def plot_outcomes(outcomes: Sequence[FileOutcome], path: str | os.PathLike[str]) -> Path:
    """Draw every inverted drop and write the picture, or a PDF with a page a drop.

    Raises
    ------
    OptionError
        If nothing was inverted, there are too many drops for one picture, or the file cannot be
        written.
    """
    shown = [
        (record, result)
        for outcome in outcomes
        for record, result in zip(outcome.results, outcome.inversions, strict=True)
        if result is not None
    ]
    target = Path(path)
    if not shown:
        raise OptionError(refusal("--plot", "at least one inverted drop", "none"))
    try:
        if target.suffix.lower() == ".pdf":
            _write_pages(shown, target)
        elif len(shown) > MOST_COLUMNS:
            hint = "name a .pdf file for a page a drop"
            raise OptionError(refusal("--plot", f"{MOST_COLUMNS} drops", f"{len(shown)}", hint))
        else:
            _figure(shown).savefig(target, dpi=130)
    except OSError as error:
        raise OptionError(refusal(f"--plot {target}", "a file to write", str(error))) from error
    return target


def _write_pages(shown: Sequence[tuple[DropResult, InversionResult]], target: Path) -> None:
    start_matplotlib()
    from matplotlib.backends.backend_pdf import PdfPages

    with PdfPages(target) as pages:
        for item in shown:
            pages.savefig(_figure([item]))


def _figure(shown: Sequence[tuple[DropResult, InversionResult]]) -> Figure:
    # Without pyplot: no window system is asked for, and figures go when they are dropped.
    start_matplotlib()
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_COLUMN_INCHES * len(shown), _HEIGHT_INCHES), layout="constrained")
    axes = figure.subplots(
        3, len(shown), squeeze=False, sharex="col", height_ratios=(1.0, 1.5, 0.8)
    )
    for column, (record, result) in enumerate(shown):
        _draw(axes[:, column], record, result)
    return figure


def _draw(axes: Any, record: DropResult, result: InversionResult) -> None:
    history = result.history
    time = 1e3 * history.time
    load, deflection, residual = axes
    load.plot(time, 1e-3 * history.load, color=_COLOURS[0], label="measured")
    fit = result.half_sine
    start = history.time[0]
    load.plot(
        time,
        1e-3 * fit.load(history.time - start),
        color=_COLOURS[1],
        linestyle="--",
        label=f"half-sine {1e3 * fit.duration:.1f} ms",
    )
    load.set_ylabel("load, kN")
    for row, offset in enumerate(history.offsets):
        colour = _COLOURS[row % len(_COLOURS)]
        name = "centre" if offset == 0.0 else f"{offset:g} m"
        deflection.plot(
            time, 1e6 * history.observed[row], ".", markersize=3, color=colour, label=name
        )
        deflection.plot(time, 1e6 * history.predicted[row], color=colour, linewidth=1.2)
        residual.plot(
            time,
            1e6 * history.residual[row],
            color=colour,
            linestyle=_DASHES[row % len(_DASHES)],
            linewidth=1.0,
        )
    deflection.set_ylabel("displacement, µm (dots measured, line fitted)")
    residual.set_ylabel("fitted - measured, µm")
    residual.set_xlabel("time after the trigger, ms")
    for axis in axes:
        axis.axhline(0.0, color="0.7", linewidth=0.6)
        axis.axvline(1e3 * history.window_end, color="0.5", linewidth=0.8, linestyle=":")
        axis.grid(alpha=0.25)
    load.legend(fontsize=8)
    deflection.legend(fontsize=8)
    # Text from a file must not be read as a formula.
    load.set_title(_title(record, result), fontsize=8, parse_math=False)


def _title(record: DropResult, result: InversionResult) -> str:
    ground = result.subgrade
    low, high = (1e-6 * value for value in result.modulus_interval)
    depth = ground.bedrock_depth.value
    base = "half-space" if record.model == "half-space" else f"bedrock {depth:.3g} m"
    return (
        f"{Path(record.file or '').name}, drop {record.drop}\n"
        f"E {1e-6 * ground.modulus.value:.4g} MPa, 95 % {low:.4g} to {high:.4g}; {base}; "
        f"η {1e-3 * ground.viscosity.value:.3g} kPa s\n"
        f"{result.plate} plate {result.plate_radius:g} m, ν {result.poisson_ratio:g}; residual "
        f"{100 * result.window_residual_rms_over_peak:.2g} % of peak up to the dotted line"
    )
