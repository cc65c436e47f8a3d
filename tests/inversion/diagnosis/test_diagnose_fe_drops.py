"""The diagnosis on drops of other finite elements, whose records stay outside the project."""

from dataclasses import replace
from pathlib import Path

import pytest

from inversion import SurrogateLibrary
from inversion.diagnosis.model import PointRecords
from inversion.inference.diagnose import diagnose_point
from pfwd.analysis.analyse import record_of
from pfwd.files.traces import TracePoint, read_traces


def computed_elsewhere(shared: Path, number: int) -> tuple[float, float, TracePoint]:
    """Modulus, Pa, depth of the rock, m, and the drops of other finite elements."""
    table = (shared / "fe_drops" / "README.md").read_text(encoding="utf-8").splitlines()
    (row,) = [line for line in table if line.startswith(f"| fe_{number:02d} ")]
    modulus, depth = (float(row.split("|")[column]) for column in (2, 4))
    return 1e6 * modulus, depth, read_traces(shared / "fe_drops" / f"fe_{number:02d}.csv")


# Three every day, the others with the slow tests.
DROPS = [n if n in (2, 4, 7) else pytest.param(n, marks=pytest.mark.slow) for n in range(1, 9)]


@pytest.mark.parametrize("number", DROPS)
def test_rock_in_external_finite_elements_is_detected(
    number: int, shared: Path, library: SurrogateLibrary
) -> None:
    modulus, depth, point = computed_elsewhere(shared, number)
    records = tuple(record_of(drop, point.setup) for drop in point.drops)
    result = diagnose_point(PointRecords("fe", records, (1,)), library)
    (effect,) = result.effects
    assert effect.name == "bedrock"
    assert effect.parameters[0].value == pytest.approx(depth, rel=0.03)
    assert result.after.modulus_pa == pytest.approx(modulus, rel=0.012)


@pytest.mark.parametrize("number", DROPS)
def test_external_finite_elements_with_declared_rock_are_clean(
    number: int, shared: Path, library: SurrogateLibrary
) -> None:
    modulus, depth, point = computed_elsewhere(shared, number)
    records = tuple(
        replace(record_of(drop, point.setup), bedrock_depth=depth) for drop in point.drops
    )
    result = diagnose_point(PointRecords("fe", records, (1,)), library)
    assert result.effects == ()
    assert result.after.modulus_pa == pytest.approx(modulus, rel=0.007)
    # Undamped ground rings on until the side of the mesh answers: that is no noise, nor an effect.
    assert result.verdict == ("unexplained" if number == 6 else "clean")
