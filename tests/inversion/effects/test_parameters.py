"""Numbers between bounds, and the coordinates in which they are fitted."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inversion.effects.bedrock import depth_parameter
from inversion.effects.parameters import Parameter, coordinate_of, parameter_value
from inversion.forward.surrogate import MIN_DEPTH_RADII

PLAIN = Parameter("viscosity", "Pa s", 0.0, 4e5)
LOGARITHMIC = Parameter("modulus", "Pa", 5e6, 3e8, logarithmic=True)
SHIFTED = Parameter("delay", "s", 2e-3, 5e-3)


@pytest.mark.parametrize("parameter", [PLAIN, LOGARITHMIC, SHIFTED])
@given(unit=st.floats(0, 1))
def test_points_of_the_unit_interval_are_within_the_bounds(
    parameter: Parameter, unit: float
) -> None:
    value = float(parameter.value(np.array(unit)))
    assert parameter.lower * (1 - 1e-12) <= value <= parameter.upper * (1 + 1e-12)


def test_a_coordinate_is_the_number_or_its_logarithm() -> None:
    plain, logarithmic = coordinate_of(PLAIN), coordinate_of(LOGARITHMIC)
    assert (plain.lower, plain.upper) == (0.0, 4e5)
    assert (logarithmic.lower, logarithmic.upper) == pytest.approx((math.log(5e6), math.log(3e8)))
    assert parameter_value(PLAIN, 3e4) == 3e4
    assert parameter_value(LOGARITHMIC, math.log(4e7)) == pytest.approx(4e7)
    both = parameter_value(LOGARITHMIC, np.log([4e7, 5e7]))
    assert both == pytest.approx([4e7, 5e7])


def test_rock_is_searched_where_the_tables_reach() -> None:
    depth = depth_parameter(0.2)
    assert (depth.lower, depth.upper) == pytest.approx((1.001 * MIN_DEPTH_RADII * 0.2, 12.0))
    assert depth.logarithmic
