"""Plots of inverted drops: load, displacement measured and fitted, residual (matplotlib)."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pfwd.analysis.results import DropResult, FileOutcome
from pfwd.display import COLOURS, draw_fit
from pfwd.errors import OptionError, refusal
from pfwd.files.output_path import require_writable
from pfwd.matplotlib_start import start_matplotlib
from pfwd.units import modulus_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_COLUMNS = 6
"""Largest number of drops side by side in a picture; further drops are in rows below."""

MAX_DROPS_IN_PICTURE = 24
"""Largest number of drops in a picture; further drops are in pictures NAME-2.png and so on. A
picture of 24 drops has 4000 by 4200 pixels, which viewers still open."""

_COLUMN_INCHES, _HEIGHT_INCHES = 5.2, 8.0
# In print the sensors are distinguished by their dashes.
_DASHES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1)), (0, (1, 1)))


def plot_outcomes(outcomes: Sequence[FileOutcome], path: str | os.PathLike[str]) -> list[Path]:
    """Draw all inverted drops, as pages of a PDF file or in pictures of 24 drops.

    Parameters
    ----------
    outcomes : sequence of FileOutcome
    path : path ending in .pdf, .png or .svg

    Returns
    -------
    list of Path
        The written files.

    Raises
    ------
    OptionError
        If there is no inverted drop, or a file cannot be written.
    """
    results = [
        result for outcome in outcomes for result in outcome.results if result.history is not None
    ]
    target = Path(path)
    if not results:
        raise OptionError(refusal("--plot", "at least one inverted drop", "none"))
    require_writable(target, "--plot")
    try:
        if target.suffix.lower() == ".pdf":
            _write_pages(results, target)
            return [target]
        written = []
        for number, begin in enumerate(range(0, len(results), MAX_DROPS_IN_PICTURE), 1):
            file = target if number == 1 else target.with_stem(f"{target.stem}-{number}")
            require_writable(file, "--plot")
            _figure(results[begin : begin + MAX_DROPS_IN_PICTURE]).savefig(file, dpi=130)
            written.append(file)
    except OSError as error:
        raise OptionError(refusal(f"--plot {target}", "a file to write", str(error))) from error
    return written


def _write_pages(results: Sequence[DropResult], target: Path) -> None:
    start_matplotlib()
    from matplotlib.backends.backend_pdf import PdfPages

    with PdfPages(target) as pages:
        for item in results:
            pages.savefig(_figure([item]))


def _figure(results: Sequence[DropResult]) -> Figure:
    # Without pyplot: it needs no window system, and figures are freed with their last reference.
    start_matplotlib()
    from matplotlib.figure import Figure

    columns = min(len(results), MAX_COLUMNS)
    rows = math.ceil(len(results) / columns)
    size = (_COLUMN_INCHES * columns, _HEIGHT_INCHES * rows)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(
        3 * rows, columns, squeeze=False, sharex=False, height_ratios=(1.0, 1.5, 0.8) * rows
    )
    for number, result in enumerate(results):
        row, column = divmod(number, columns)
        three = axes[3 * row : 3 * row + 3, column]
        for axis in three[:2]:
            axis.sharex(three[2])
            axis.tick_params(labelbottom=False)
        _draw(three, result)
    for number in range(len(results), rows * columns):
        row, column = divmod(number, columns)
        for axis in axes[3 * row : 3 * row + 3, column]:
            axis.set_axis_off()
    return figure


def _draw(axes: Any, result: DropResult) -> None:
    history, pulse = result.history, result.half_sine
    assert history is not None
    time = 1e3 * history.time
    load, deflection, residual = axes
    load.plot(time, 1e-3 * history.load, color=COLOURS[0], label="measured")
    if pulse is not None and pulse.duration_s is not None and pulse.start_s is not None:
        phase = np.clip((history.time - pulse.start_s) / pulse.duration_s, 0.0, 1.0)
        load.plot(
            time,
            1e-3 * (result.half_sine_load_n or 0.0) * np.sin(np.pi * phase),
            color=COLOURS[1],
            linestyle="--",
            label=f"half-sine {1e3 * pulse.duration_s:.1f} ms",
        )
    load.set_ylabel("load, kN")
    draw_fit(deflection, history)
    deflection.set(xlabel="", ylabel="deflection, µm")
    for row, values in enumerate(history.residual):
        style = {"color": COLOURS[row % len(COLOURS)], "linestyle": _DASHES[row % len(_DASHES)]}
        residual.plot(time, 1e6 * values, linewidth=1.0, **style)
    residual.set_ylabel("residual, µm")
    residual.set_xlabel("time after the trigger, ms")
    for axis in axes:
        axis.axhline(0.0, color="0.7", linewidth=0.6)
        axis.axvline(1e3 * history.window_end, color="0.5", linewidth=0.8, linestyle=":")
        axis.grid(alpha=0.25)
    load.legend(fontsize=8)
    # Text from a file must not be read as a formula.
    load.set_title(_title(result), fontsize=8, parse_math=False)


def _title(result: DropResult) -> str:
    depth = result.bedrock_depth_m
    base = "half-space" if depth is None else f"bedrock {depth:.3g} m"
    point = "" if result.point is None else f", point {result.point}"
    return (
        f"{Path(result.file).name}{point}, drop {result.drop}\n"
        f"E {modulus_text(result.modulus_pa, result.modulus_interval_pa)}; {base}; "
        f"η {1e-3 * (result.viscosity_pa_s or 0.0):.3g} kPa s\n"
        f"{result.plate} plate {result.plate_radius_m:g} m, ν {result.poisson_ratio:g}; residual "
        f"{100 * (result.window_residual_rms_over_peak or 0.0):.2g} % of peak up to the dotted line"
    )
