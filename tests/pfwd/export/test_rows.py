"""The values of a result become cells."""

import math

from pfwd.export.columns import DROP_COLUMNS
from pfwd.export.rows import _cell


def test_numbers_that_are_none_stay_out() -> None:
    assert [_cell(value) for value in (math.inf, math.nan, 2e3, True)] == [None, None, 2e3, True]


def test_only_the_columns_of_a_medium_name_the_medium() -> None:
    named = [column.name for column in DROP_COLUMNS if column.meaning.startswith("Medium ")]
    assert len(named) == 4 * 6
    assert all(name.startswith("layer_") for name in named)
