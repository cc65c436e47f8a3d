"""Prediction of a drop from its load, by the fit of its point and the instrument's laws of drops.

The laws say how stiffness and take-off speed change from one drop to the next, see `NextDropLaw`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import PointSummary
from inversion.diagnosis.model import DropModel
from inversion.diagnosis.problem import response_of, surrogate_of
from inversion.diagnosis.rest import PreTriggerNoise
from inversion.effects.base import Ground
from inversion.effects.rebound import Rebound
from inversion.forward.library import SurrogateLibrary
from inversion.inference.point_model import ActiveEffects, take_off_speed
from inversion.inference.population import NextDropLaw, learn_next_drop, pulse_width, summarise
from inversion.inference.posterior import Posterior
from inversion.measured.record import Record, prepare


@dataclass(frozen=True, eq=False)
class DropPredictor:
    """Predictor of further drops of a point. Of a predicted drop only the load is used.

    Parameters
    ----------
    posterior : Posterior, fit of the point
    peer_points : summaries of the other points of the instrument
    """

    posterior: Posterior = field(repr=False)
    peer_points: Sequence[PointSummary] = field(repr=False)

    def predict(self, record: Record, library: SurrogateLibrary) -> FloatArray:
        """Return the displacements of the drop that follows the last one, (n_sensors, n), m.

        Parameters
        ----------
        record : Record, of the drop: its time, load, sensors and declarations
        library : SurrogateLibrary
        """
        last = self.posterior.model.last
        stiffening = self.stiffening_after(last, self.model_of(record, library))
        return self.next_drop(record, library, stiffening)

    def stiffening_after(
        self, place: int, model: DropModel, without_peer: int | None = None
    ) -> float:
        """Return the logarithm of a drop's stiffness over that of the last fitted drop.

        Parameters
        ----------
        place : int, index of the fitted drop that it follows
        model : DropModel, of the predicted drop
        without_peer : int or None, index of a peer point that is not used in the law
        """
        stiffness, load, width = self._fitted(place)
        law, drop = self._law(place, without_peer), model.drop
        return stiffness + law.stiffening(drop.peak_load / load, pulse_width(drop) / width)

    def stiffening_before(self, place: int, model: DropModel) -> float:
        """Return the same logarithm for a drop that precedes the fitted drop ``place``."""
        stiffness, load, width = self._fitted(place)
        law, drop = self._law(0), model.drop
        return stiffness - law.stiffening(load / drop.peak_load, width / pulse_width(drop))

    @cached_property
    def _summary(self) -> PointSummary:
        return summarise(self.posterior)

    def _law(self, place: int, without_peer: int | None = None) -> NextDropLaw:
        """Return the law for the drop after the fitted drop ``place``."""
        peers = [p for index, p in enumerate(self.peer_points) if index != without_peer]
        return learn_next_drop([*peers, self._summary], first=place == 0)

    def _fitted(self, place: int) -> tuple[float, float, float]:
        """Return a fitted drop's log stiffness over that of the last one, peak load and width."""
        summary = self._summary
        return summary.stiffness[place], summary.peak_loads[place], summary.pulse_widths[place]

    def next_drop(self, record: Record, library: SurrogateLibrary, stiffening: float) -> FloatArray:
        """Return the displacements of a drop with a given stiffness, (n_sensors, n), m.

        Parameters
        ----------
        record : Record, of the drop
        library : SurrogateLibrary
        stiffening : float, logarithm of its stiffness over that of the last fitted drop
        """
        model = self.posterior.model
        drop_model = self.model_of(record, library)
        ground, active = model.ground_and_effects(self.posterior.values, None, stiffening)
        self._set_take_off(drop_model, ground, active)
        return _as_recorded(record, drop_model, drop_model.predict(ground, active))

    def fitted_drop(self, record: Record, place: int, library: SurrogateLibrary) -> FloatArray:
        """Return the displacements of a fitted drop at all sensors, (n_sensors, n), m."""
        drop_model = self.model_of(record, library)
        ground, active = self.posterior.model.ground_and_effects(self.posterior.values, place)
        return _as_recorded(record, drop_model, drop_model.predict(ground, active))

    def _set_take_off(self, model: DropModel, ground: Ground, active: ActiveEffects) -> None:
        """Set the take-off speed of a predicted drop by the law of the instrument."""
        of_point = self.posterior.model
        last = of_point.last
        fitted = of_point.point.drops[last]
        last_ground, last_active = of_point.ground_and_effects(self.posterior.values, last)
        speed = take_off_speed(fitted, last_ground, last_active)
        if speed is None:
            return
        speed *= math.exp(self._law(last).speed_step)
        for effect, values in active:
            if isinstance(effect, Rebound):
                motion = model.ground_motion(ground, active)
                values["kick"] = effect.kick_for(speed, motion, values, model.context)

    def model_of(self, record: Record, library: SurrogateLibrary) -> DropModel:
        """Return the model of a drop, up to the end of its record."""
        of_point = self.posterior.model
        fitted, records = of_point.point.drops[of_point.last], of_point.point.records
        silent = tuple(replace(s, values=np.zeros_like(record.load)) for s in record.sensors)
        record = replace(record, sensors=silent)
        drop = prepare(record.nearest_first())
        # The load is known at a second contact too, so the model extends to the end of the record.
        drop = replace(drop, tail_end=float(drop.time[-1])).with_tail()
        model = DropModel(
            record,
            fitted.context.largest_load,
            fitted.context.index,
            records,
            response_of(record, surrogate_of(record, library), library),
            max(drop.tail_end, float(fitted.drop.tail_end)),
            PreTriggerNoise(drop, (), (), 0.0),
        )
        flat = dict(zip(fitted.drop.positions.tolist(), fitted.context.flat, strict=True))
        return model.with_flat_tops(tuple(flat.get(p) for p in drop.positions.tolist()))


def _as_recorded(record: Record, model: DropModel, predicted: FloatArray) -> FloatArray:
    """Return a prediction at the samples of the record, with the sensors in the record's order."""
    time = model.recorded_time
    spline = CubicSpline(time, predicted, axis=1)
    traces = spline(np.minimum(record.time, time[-1]))
    traces[:, record.time < time[0]] = 0.0
    places = model.drop.positions.tolist()
    return np.stack([traces[places.index(s.offset)] for s in record.sensors])
