"""Prediction of a drop that was not fitted, from its load and the fit of its point.

The drop meets the ground of the point, with the effects of the point and of the device. Effects of
single drops have the values that they have in one fitted drop, the one before it. Mains hum is not
predicted: its phase is random.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from inversion.arrays import FloatArray
from inversion.diagnosis.findings import FittedPoint
from inversion.diagnosis.model import DropModel
from inversion.diagnosis.problem import Active, Point, response_of, surrogate_of
from inversion.diagnosis.rest import DropAtRest
from inversion.effects.base import Effect, Ground
from inversion.effects.catalogue import BY_NAME
from inversion.forward.library import SurrogateLibrary
from inversion.measured.record import Record, prepare
from inversion.threads import single_threaded_blas


def predict_next(
    fitted: FittedPoint, time: FloatArray, load: FloatArray, library: SurrogateLibrary
) -> FloatArray:
    """Return the displacements of a drop that follows the fitted ones, (n_sensors, n), m.

    Parameters
    ----------
    fitted : FittedPoint
    time, load : (n,) ndarray of float, s and N; time 0 is the trigger
    library : SurrogateLibrary
    """
    last = fitted.records.records[-1]
    silent = tuple(replace(sensor, values=np.zeros_like(load)) for sensor in last.sensors)
    record = replace(last, time=time, load=load, sensors=silent)
    with single_threaded_blas():
        return DropPredictor(fitted, record, len(fitted.records.records) - 1, library).trace()


class DropPredictor:
    """Predicts the deflections of a drop; those of its record are not read.

    Parameters
    ----------
    fitted : FittedPoint
    record : Record, of the drop: its time, load, sensors and declarations
    like : int, place of the fitted drop from which the effects of single drops take their values
    library : SurrogateLibrary
    """

    def __init__(
        self, fitted: FittedPoint, record: Record, like: int, library: SurrogateLibrary
    ) -> None:
        silent = tuple(replace(s, values=np.zeros_like(record.load)) for s in record.sensors)
        self._record = replace(record, sensors=silent)
        self._fitted, self._like = fitted, like
        self._point = Point(fitted.records, library)
        self._model = self._made(library)

    def _made(self, library: SurrogateLibrary) -> DropModel:
        """Return the model of the drop, to the end of its record."""
        fitted_drop = self._point.drops[self._like]
        drop = prepare(self._record.nearest_first())
        # The load of a second contact is known, so the model goes on.
        drop = replace(drop, tail_end=float(drop.time[-1])).with_tail()
        surrogate = surrogate_of(self._record, library)
        model = DropModel(
            self._record,
            surrogate,
            fitted_drop.context.largest_load,
            self._like,
            self._fitted.records,
            fitted_drop.context.layers,
            response_of(self._record, surrogate),
            max(drop.tail_end, *(float(model.drop.tail_end) for model in self._point.drops)),
            DropAtRest(drop, (), (), 0.0),
        )
        flat = dict(zip(fitted_drop.drop.positions.tolist(), fitted_drop.context.flat, strict=True))
        return model.with_flat_tops(tuple(flat.get(p) for p in drop.positions.tolist()))

    def trace(self, *, with_effects: bool = True, stiffness: float = 1.0) -> FloatArray:
        """Return the displacement as the instrument records it, (n_sensors, n), m.

        Parameters
        ----------
        with_effects : bool, whether the effects act; False: the base model
        stiffness : float, factor on the stiffness of the ground or of the rig
        """
        model = self._model
        effects: Sequence[Effect] = ()
        if with_effects:
            effects = [BY_NAME[name] for name in self._fitted.effects]
            coarse = self._point.coarse()
            if self._fitted.plain and coarse is not self._point:
                model = model.in_band(max(drop.least_band for drop in self._point.drops))
        ground = self._ground(effects, with_effects=with_effects)
        ground = replace(
            ground, modulus=stiffness * ground.modulus, viscosity=stiffness * ground.viscosity
        )
        active = self._active(effects)
        for effect, values in active:
            if effect.replaces_ground:
                values["stiffness"] *= stiffness
        return self._as_recorded(model, model.predict(ground, active))

    def _ground(self, effects: Sequence[Effect], *, with_effects: bool) -> Ground:
        """Return the ground of the point."""
        values = self._fitted.values if with_effects else self._fitted.base_values
        soil = self._point.soil(any(effect.ground_is_below for effect in effects))
        own = [u for u in soil if (0, "", u.parameter.name, None) in values]
        unit_values = [u.parameter.unit_value(values[0, "", u.parameter.name, None]) for u in own]
        return self._point.ground(own, np.array(unit_values))

    def _active(self, effects: Sequence[Effect]) -> Active:
        """Return the effects that act on the drop, with their values."""
        fitted, context = self._fitted, self._model.context
        active: Active = []
        for effect in effects:
            if effect.looks_like_noise or not effect.acts_on(context):
                continue
            values = dict(fitted.given.get(effect.name, {}))
            for (_, name, key, drop), value in fitted.values.items():
                if name == effect.name and drop in (None, self._like):
                    values[key] = value
            # What the load of the drop alone decides, as the cap of a load that is cut off.
            for parameter in effect.parameters_for(context):
                values.setdefault(parameter.name, parameter.starts[0])
            active.append((effect, values))
        return active

    def _as_recorded(self, model: DropModel, predicted: FloatArray) -> FloatArray:
        """Return a prediction at the samples of the record, with its sensors in their order."""
        time = model.recorded_time
        spline = CubicSpline(time, predicted, axis=1)
        traces = spline(np.minimum(self._record.time, time[-1]))
        traces[:, self._record.time < time[0]] = 0.0
        places = model.drop.positions.tolist()
        return np.stack([traces[places.index(s.offset)] for s in self._record.sensors])
