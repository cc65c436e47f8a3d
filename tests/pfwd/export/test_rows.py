"""The values of a result become cells, whoever wrote the result."""

import math

import pytest

from pfwd.analysis.results import DropResult
from pfwd.export.columns import DROP_COLUMNS
from pfwd.export.rows import _cells


def test_numbers_that_are_none_stay_out() -> None:
    result = DropResult(modulus_pa=math.inf, viscosity_pa_s=math.nan, density_kg_m3=2000)
    cells = _cells(result)
    assert (cells["modulus_pa"], cells["viscosity_pa_s"]) == (None, None)
    assert (cells["density_kg_m3"], type(cells["density_kg_m3"])) == (2000.0, float)


@pytest.mark.parametrize(
    ("key", "said", "cell"),
    [
        ("half_sine_duration_s", 0.02, 0.02),  # of another version
        ("method", 7, "7"),
        ("modulus_pa", "45e6", None),
        ("at_bound", "viscosity", ["viscosity"]),
    ],
)
def test_what_another_program_wrote_is_looked_at_one_by_one(
    key: str, said: object, cell: object
) -> None:
    result = DropResult.from_json({key: said})
    assert key in result.more
    assert _cells(result)[key] == cell


def test_only_the_columns_of_a_medium_name_the_medium() -> None:
    named = [column.name for column in DROP_COLUMNS if column.meaning.startswith("Medium ")]
    assert len(named) == 4 * 6
    assert all(name.startswith("layer_") for name in named)
