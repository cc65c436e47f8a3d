"""An effect whose parameters are absent leaves the record of a model as it was, or nearly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from inversion import SurrogateLibrary
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.problem import Point
from inversion.effects import CATALOGUE, DropContext, Effect
from pfwd_plugins.quantities import MotionName
from tests.inversion import synthetic
from tests.inversion.synthetic import Array, Scene, record

GROUND = replace(synthetic.GROUND, inverse_depth=0.0)
# Standard deviation over the peak.
LITTLE = 1e-3
# Effects whose bounds end where they still change something: the deepest rock that the tables
# cover, the slowest geophone, and the fastest filters, which are lags of up to a fifth of a
# millisecond.
NEARLY = {
    "bedrock": 4e-3,
    "geophone_response": 0.05,
    "acquisition_filter": 0.04,
    "load_filter": 8e-3,
}
ABSENT = [
    effect
    for effect in CATALOGUE
    if effect.name == "bedrock" or any(p.absent is not None for p in effect.parameters)
]


@pytest.mark.parametrize("effect", ABSENT, ids=lambda effect: effect.name)
@pytest.mark.parametrize("quantity", ["displacement", "velocity"])
def test_absent_is_without_it_and_a_start_shows(
    effect: Effect, quantity: MotionName, library: SurrogateLibrary
) -> None:
    drops = tuple(
        record(library, Scene(quantity, peak=peak, offsets=(0.0, 0.3, 0.6), length=0.1))
        for peak in (6000.0, 8000.0)
    )
    # A half-sine stands in for a load that is none.
    drops = tuple(
        replace(drop, load=drop.load * (drop.load / drop.load.max()) ** 0.5) for drop in drops
    )
    point = Point(PointRecords("a", drops, (1, 2), load="half-sine"), library)
    ground = replace(GROUND, viscosity=0.0) if effect.name == "viscosity" else GROUND
    model = point.drops[0]
    without = model.predict(ground, [])
    values = {
        p.name: p.starts[0] if p.absent is None else p.absent
        for p in effect.parameters_for(model.context)
    }
    changed = _change(model.predict(ground, [(effect, values)]), without)
    assert changed < NEARLY.get(effect.name, LITTLE)
    largest_change = max(
        _change(model.predict(ground, [(effect, present)]), without)
        for present in _starts(effect, model.context)
    )
    if effect.name == "rebound":  # on such ground no plate jumps
        return
    assert largest_change > max(5e-4, 3.0 * changed)


def _starts(effect: Effect, drop: DropContext) -> list[dict[str, float]]:
    """Return the starting values of its fits, in turn."""
    parameters = effect.parameters_for(drop)
    n_starts = max(len(p.starts) for p in parameters)
    return [{p.name: p.starts[i % len(p.starts)] for p in parameters} for i in range(n_starts)]


def _change(predicted: Array, without: Array) -> float:
    return float(np.abs(predicted - without).max() / without.max())
