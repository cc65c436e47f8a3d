"""Drop in a diagnosis: residuals and curves that replace those of the fit of the drop alone."""

from __future__ import annotations

import base64
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from inversion.records import JsonRecord
from inversion.result import TimeHistories

if TYPE_CHECKING:
    from inversion.diagnosis.findings import DropCurves

    FloatArray = NDArray[np.floating[Any]]

_FOUR_BYTE_FLOAT = np.dtype("<f4")


@dataclass(frozen=True, slots=True, kw_only=True)
class DiagnosedDrop(JsonRecord):
    """One drop in the fits of its point without and with effects.

    Rows of numbers are 4-byte floats, least significant byte first, in base 64.
    """

    drop: int
    """Number of the drop at its point."""
    start_s: float
    """Time of the first sample, s after the trigger."""
    step_s: float
    """Time between two samples, s."""
    offsets_m: str
    """Distance of each sensor from the plate centre, m."""
    before: tuple[str, ...]
    """Displacement of each sensor by the fit without effects, m."""
    after: tuple[str, ...]
    """The same by the fit with effects."""
    residual_rms_over_peak: float
    """Residual of that fit over the peak, from the trigger to the end of the record."""
    contact_residual_rms_over_peak: float
    """The same to the end of the contact."""

    @classmethod
    def of(cls, curves: DropCurves) -> DiagnosedDrop:
        """Return a drop in the form that is stored."""
        return cls(
            drop=curves.number,
            start_s=float(curves.time[0]),
            step_s=float(curves.time[1] - curves.time[0]),
            offsets_m=_packed(curves.offsets),
            before=tuple(map(_packed, curves.before)),
            after=tuple(map(_packed, curves.after)),
            residual_rms_over_peak=curves.residual_rms_over_peak,
            contact_residual_rms_over_peak=curves.contact_residual_rms_over_peak,
        )

    def drawn_on(self, fit: TimeHistories) -> TimeHistories:
        """Return the histories of a drop with these fits in place of the fit of the drop alone.

        They end with the diagnosis, and have the sensors that were diagnosed.

        Parameters
        ----------
        fit : TimeHistories
        """
        from scipy.interpolate import CubicSpline

        diagnosed = _unpacked(self.offsets_m).tolist()
        offsets = fit.offsets.astype(_FOUR_BYTE_FLOAT).tolist()
        places = [place for place, offset in enumerate(offsets) if offset in diagnosed]
        rows = [diagnosed.index(offsets[place]) for place in places]
        before, after = (
            np.array([_unpacked(texts[row]) for row in rows], np.float64)
            for texts in (self.before, self.after)
        )
        time = self.start_s + self.step_s * np.arange(after.shape[1])
        count = int(np.searchsorted(fit.time, time[-1] + 0.5 * (fit.time[1] - fit.time[0])))
        return replace(
            fit,
            time=fit.time[:count],
            load=fit.load[:count],
            model_load=fit.model_load[:count],
            observed=fit.observed[places, :count],
            predicted=CubicSpline(time, after, axis=1)(fit.time[:count]),
            before=CubicSpline(time, before, axis=1)(fit.time[:count]),
            offsets=fit.offsets[places],
            peaks=fit.peaks[places],
            window_end=float(fit.time[count - 1]),
        )


def _packed(values: FloatArray) -> str:
    return base64.b64encode(values.astype(_FOUR_BYTE_FLOAT).tobytes()).decode("ascii")


def _unpacked(text: str) -> NDArray[np.float32]:
    return np.frombuffer(base64.b64decode(text), _FOUR_BYTE_FLOAT)
