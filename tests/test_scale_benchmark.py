"""The list of benchmarks, and the benchmark of many drops."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import scale
from benchmarks.__main__ import CAMPAIGNS, PARTS, QUICK
from benchmarks.__main__ import main as bench
from benchmarks.output import Reporter
from pfwd_device.recording import check, read_survey
from tests.campaigns.power_loss import make_record

TOP = Path(__file__).resolve().parents[1]


def test_the_help_lists_the_parts_that_exist() -> None:
    modules = (TOP / "benchmarks").glob("*.py")
    parts = {path.stem for path in modules if "\ndef run(" in path.read_text(encoding="utf-8")}
    assert set(PARTS) == parts | set(CAMPAIGNS)
    assert set(QUICK) <= parts


@pytest.fixture
def templates() -> list[scale.Template]:
    record = make_record(1, np.random.default_rng(1), 64)
    return [scale.Template(record, (), ({"modulus_pa": 4e7},))]


def test_ten_thousand_drops_are_at_1700_points() -> None:
    numbers = [scale.point_number(number) for number in range(1, 10_001)]
    assert sorted(set(numbers)) == list(range(1, 1701))
    assert numbers == sorted(numbers)


def test_a_built_survey_is_complete_and_can_be_continued(
    tmp_path: Path, templates: list[scale.Template]
) -> None:
    scale.build(tmp_path, 0, 4, templates)
    scale.build(tmp_path, 4, 14, templates)
    assert check(tmp_path).damaged == ()
    survey = read_survey(tmp_path)
    assert [drop.number for drop in survey.drops] == list(range(1, 15))
    assert [point.name for point in survey.points] == ["P 1", "P 2", "P 3"]
    for point in survey.points:
        assert [drop.drop for drop in point.drops] == list(range(1, len(point.drops) + 1))
    for drop in survey.drops:
        assert drop.key == f"bench/{drop.number}"
        assert drop.file is not None
        assert len(drop.results) == 1


@pytest.mark.posix
def test_commands_are_measured_and_failures_are_named(tmp_path: Path) -> None:
    cost = scale.measure(["--help"])
    assert 0 < cost.processor < 60
    ballast = bytearray(300 * 10**6)  # memory of the measuring process does not count
    assert 5 < scale.measure(["--help"]).megabytes < 200 < len(ballast) / 1e6
    with pytest.raises(RuntimeError, match=r"pfwd check .*: status 1: .*expected the folder"):
        scale.measure(["check", str(tmp_path / "none")])


@pytest.mark.parametrize(
    ("processor", "last", "status"),
    [
        ((0.2, 1.2, 5.3), {}, 0),  # a ratio of 1.28
        ((0.2, 1.2, 5.5), {}, 1),  # 1.33
        ((0.2, 1.2, 4.2), {"seconds": 7.9}, 0),
        ((0.2, 1.2, 4.2), {"seconds": 8.1}, 1),
        ((0.2, 1.2, 4.2), {"megabytes": 199.0}, 0),
        ((0.2, 1.2, 4.2), {"megabytes": 201.0}, 1),
    ],
)
def test_excessive_time_growth_or_memory_fails(
    processor: tuple[float, float, float], last: dict[str, float], status: int
) -> None:
    costs = [scale.Cost(1.0, seconds, 50.0) for seconds in processor]
    costs[-1] = replace(costs[-1], **last)
    name = "export h5" if "megabytes" in last else "check"
    assert scale._judge(Reporter(["--json"]), {name: costs}, (1, *scale.DROPS)) == status


def test_invalid_options_have_status_2() -> None:
    assert bench(["scale", "--drops", "5"]) == 2
