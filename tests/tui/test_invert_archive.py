"""``pfwd invert`` over folders, as a user meets it."""

import json
from pathlib import Path

import pytest

from simulators.demo import demo_drops
from tui.cli import main

QUICK = ("--method", "posterior", "--sensors", "centre", "--bedrock-depth", "1.2")


@pytest.fixture(scope="module")
def drops(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("drops")
    text = demo_drops(2, 0, folder / "one").read_text(encoding="utf-8")
    (folder / "two").mkdir()
    (folder / "two" / "b.csv").write_text(text.replace("demo-0", "demo-1"), encoding="utf-8")
    return folder


def test_a_folder_stands_for_what_is_below_it(
    drops: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["invert", str(drops), *QUICK, "--json"]) == 0
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    files = sorted(str(path) for path in drops.rglob("*.csv"))
    assert main(["invert", *files, *QUICK, "--json"]) == 0
    plain = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert len(found) == 4
    # What is declared of the point comes on top of the keys of plain inverting.
    for one, other in zip(found, plain, strict=True):
        assert set(other) <= set(one)
        assert {k: v for k, v in one.items() if k in other and k != "elapsed_s"} == {
            k: v for k, v in other.items() if k != "elapsed_s"
        }


def test_a_damaged_file_is_said_and_the_others_are_kept(
    drops: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("pyarrow")
    damaged = tmp_path / "damaged.csv"
    damaged.write_text("# pfwd-traces = 1\n# plate_radius_m = 0.15\n")
    files = [str(drops), str(damaged)]
    assert main(["invert", *files, *QUICK, "--archive", str(tmp_path / "out")]) == 1
    told = capsys.readouterr()
    assert "3 sources, 0 done before, 0 copies, 4 drops inverted" in told.out
    assert told.err.splitlines()[0].startswith(f"pfwd: {damaged}: expected a row of column names")
    assert main(["invert", *files, *QUICK]) == 1


@pytest.mark.parametrize(
    ("options", "status", "message"),
    [
        (["--archive", "{drops}"], 2, "--archive {drops}: expected a folder that is new"),
        (["--archive", "{out}", "--plot", "x.png"], 2, "--plot with a folder"),
        (["--scheduler", "tcp://x:1", "--jobs", "2"], 2, "--scheduler and --jobs: expected one"),
        (["{none}", "--archive", "{out}"], 2, "expected a file or folder, got nothing of that"),
    ],
)
def test_wrong_usage_is_one_line_and_nothing_is_made(
    options: list[str],
    status: int,
    message: str,
    drops: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    pytest.importorskip("pyarrow")
    names = {"drops": drops, "out": tmp_path / "out", "none": tmp_path / "none"}
    said = [option.format(**names) for option in options]
    assert main(["invert", str(drops), *said]) == status
    told = capsys.readouterr().err
    assert len(told.splitlines()) == 1
    assert message.format(**names) in told
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_drops_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["invert", str(tmp_path)]) == 1
    assert "expected a survey, or files with drops in the folder" in capsys.readouterr().err


def test_without_pyarrow_the_extra_is_named(
    drops: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    assert main(["invert", str(drops), "--archive", str(tmp_path / "out")]) == 2
    assert 'pip install "pfwd[parquet]"' in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
