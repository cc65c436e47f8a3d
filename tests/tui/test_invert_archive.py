"""``pfwd invert`` over folders."""

import sys
from pathlib import Path
from typing import Any

import pytest

from simulators.demo import demo_drops
from tests.tui.console import pfwd, records

QUICK = ("--method", "posterior", "--sensors", "centre", "--bedrock-depth", "1.2")


@pytest.fixture(scope="module")
def drops(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drops")
    text = demo_drops(2, 0, folder / "one").read_text(encoding="utf-8")
    (folder / "two").mkdir()
    (folder / "two" / "b.csv").write_text(text.replace("demo-0", "demo-1"), encoding="utf-8")
    return folder


def test_a_folder_stands_for_its_files(drops: Path) -> None:
    def inverted(*paths: Path) -> list[dict[str, Any]]:
        lines = records(pfwd("invert", *paths, *QUICK, "--json").out)
        return [{key: line[key] for key in line if key != "elapsed_s"} for line in lines]

    of_folder = inverted(drops)
    assert len(of_folder) == 4
    for line, plain in zip(of_folder, inverted(*sorted(drops.rglob("*.csv"))), strict=True):
        # The declarations of the point come on top of the keys of plain inverting.
        assert all(line[key] == plain[key] for key in plain)


def test_a_damaged_file_is_reported_and_the_archive_written(drops: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    damaged = tmp_path / "damaged.csv"
    damaged.write_text("# pfwd-traces = 1\n# plate_radius_m = 0.15\n")
    printed = pfwd("invert", drops, damaged, *QUICK, "--archive", tmp_path / "out")
    assert printed.status == 1
    assert "3 sources, 0 done before, 0 copies, 4 drops inverted" in printed.out
    assert printed.err.startswith(f"pfwd: {damaged}: expected a row of column names")
    assert pfwd("invert", drops / "two", damaged, *QUICK).status == 1


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--archive", "{drops}"], "--archive {drops}: expected a folder that is new"),
        (["--archive", "{out}", "--plot", "x.png"], "--plot with a folder"),
        (["--scheduler", "tcp://x:1", "--jobs", "2"], "--scheduler and --jobs: expected one"),
        (["{none}", "--archive", "{out}"], "expected a file or folder, got nothing of that"),
    ],
)
def test_wrong_usage_is_refused_before_any_file_is_written(
    options: list[str], message: str, drops: Path, tmp_path: Path
) -> None:
    pytest.importorskip("pyarrow")
    names = {"drops": drops, "out": tmp_path / "out", "none": tmp_path / "none"}
    printed = pfwd("invert", drops, *(option.format(**names) for option in options))
    assert printed.status == 2
    assert message.format(**names) in printed.refusal
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_drops_is_refused(tmp_path: Path) -> None:
    line = pfwd("invert", tmp_path).refusal
    assert "expected a survey, or files with drops in the folder" in line


def test_without_pyarrow_the_extra_is_named(
    drops: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    printed = pfwd("invert", drops, "--archive", tmp_path / "out")
    assert 'pip install "pfwd[parquet]"' in printed.refusal
    assert list(tmp_path.iterdir()) == []
