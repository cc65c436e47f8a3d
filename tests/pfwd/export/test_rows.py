"""The values of a result become cells."""

import math

from pfwd.analysis.results import DropResult
from pfwd.export.columns import DROP_COLUMNS
from pfwd.export.rows import _cells


def test_numbers_that_are_none_stay_out() -> None:
    result = DropResult(modulus_pa=math.inf, viscosity_pa_s=math.nan, density_kg_m3=2000)
    cells = _cells(result)
    assert (cells["modulus_pa"], cells["viscosity_pa_s"]) == (None, None)
    assert (cells["density_kg_m3"], type(cells["density_kg_m3"])) == (2000.0, float)


def test_only_the_columns_of_a_medium_name_the_medium() -> None:
    named = [column.name for column in DROP_COLUMNS if column.meaning.startswith("Medium ")]
    assert len(named) == 4 * 6
    assert all(name.startswith("layer_") for name in named)
