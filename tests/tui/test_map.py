"""``pfwd map``: a draft from the form of a text, and the text read by it."""

import math
import os
import shlex
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from pfwd.errors import TraceError
from pfwd.files.foreign.column_map import read_map
from pfwd.files.foreign.map_draft import draft_map, map_text
from pfwd.files.reading import read_points
from tests.tui.console import PFWD, TOP, pfwd
from tui.cli import main


def text_file(
    path: Path,
    head: str,
    delimiter: str = ";",
    decimal: str = ",",
    columns: int = 3,
    encoding: str = "utf-8",
) -> Path:
    rows = [head] if head else []
    for i in range(200):
        t = i * 0.1
        pulse = math.sin(math.pi * (t - 2) / 18) if 2 < t < 20 else 0.0
        values = [t, 7.0 * pulse, *(0.5 * pulse / (n + 1) for n in range(columns - 2))]
        rows.append(delimiter.join(f"{value:.4f}".replace(".", decimal) for value in values))
    path.write_text("\n".join(rows) + "\n", encoding=encoding)
    return path


def test_a_german_spreadsheet_is_recognised_and_read(tmp_path: Path) -> None:
    file = text_file(tmp_path / "excel.csv", "Zeit [ms];Kraft [kN];Setzung [mm]", encoding="cp1252")
    column_map = tmp_path / "excel.map.toml"
    completed = pfwd("map", file, "-o", column_map)
    assert completed.status == 0, completed.err
    assert "plate radius" in completed.err
    column_map.write_text(
        "plate_radius_m = 0.15\n" + column_map.read_text(encoding="utf-8"), encoding="utf-8"
    )
    (point,) = read_points(file, column_map=column_map)
    (drop,) = point.drops
    assert drop.load.max() == pytest.approx(7000.0, rel=1e-3)
    assert drop.channels[0].values.max() == pytest.approx(0.5e-3, rel=1e-3)
    assert drop.channels[0].quantity == "displacement"
    second = pfwd("map", file, "-o", column_map)
    assert second.status == 2
    assert "--force" in second.err


@pytest.mark.parametrize(
    ("head", "delimiter", "decimal"),
    [
        ("time (s),force (N),v0 (mm/s)", ",", "."),
        ("t [ms]\tF [kN]\ts0 [µm]", "\t", ","),
        ("site km 12\nt/ms;load/lbf;geophone/in/s", ";", "."),
        ("A;B;C\n[ms];[kN];[mm]", ";", ","),
    ],
)
def test_separators_and_roles(head: str, delimiter: str, decimal: str, tmp_path: Path) -> None:
    draft = draft_map(text_file(tmp_path / "a.txt", head, delimiter, decimal))
    assert (draft.delimiter, draft.decimal) == (delimiter, decimal)
    assert [column.role for column in draft.columns] == ["time", "load", "sensor"]
    assert all(column.unit is not None for column in draft.columns)
    assert draft.missing == []
    (tmp_path / "m.toml").write_text(map_text(draft), encoding="utf-8")
    assert read_map(tmp_path / "m.toml").decimal == decimal


def test_columns_without_names_have_no_roles(tmp_path: Path) -> None:
    draft = draft_map(text_file(tmp_path / "a.txt", "", "   ", "."))
    assert (draft.delimiter, draft.names, len(draft.columns)) == (None, False, 3)
    assert "which column is the time" in draft.missing


def test_the_distance_of_a_sensor_is_that_of_its_name_or_missing(tmp_path: Path) -> None:
    head = "time [s];load [kN];center [mm];defl 300 mm [mm];defl B [mm]"
    draft = draft_map(text_file(tmp_path / "a.csv", head, columns=5))
    assert [column.offset for column in draft.columns[2:]] == [0.0, 0.3, None]
    assert draft.missing == ["the distance of defl B [mm] from the centre"]
    completed = pfwd("map", tmp_path / "a.csv", "-o", tmp_path / "m.toml")
    assert completed.status == 1
    assert "# offset_m = ?" in (tmp_path / "m.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize("content", [b"", b"hello\nworld\n", b"PK\x03\x04\x00\x00", b"\x00\x01"])
def test_a_text_without_numbers_is_refused(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "x").write_bytes(content)
    with pytest.raises(TraceError, match="expected"):
        draft_map(tmp_path / "x")


def test_the_map_is_written_to_the_current_folder_and_the_next_command_can_be_pasted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    file = text_file(tmp_path / "site 12 (b).csv", "Zeit [ms];Kraft [kN];Setzung [mm]")
    assert main(["map", str(file), "--no-questions"]) == 0
    assert [path.name for path in Path().iterdir()] == ["site 12 (b).map.toml"]
    words = shlex.split(capsys.readouterr().err.split("next: ")[1])
    assert words == [
        *("pfwd", "import", str(file), "--map", "site 12 (b).map.toml", "-o", "SURVEY"),
    ]


def test_the_error_of_an_unknown_text_names_both_commands(tmp_path: Path) -> None:
    file = text_file(tmp_path / "excel.csv", "Zeit [ms];Kraft [kN];Setzung [mm]")
    completed = pfwd("import", file, "-o", tmp_path / "s")
    assert completed.status == 1
    assert "pfwd import --map" in completed.err
    assert "pfwd map" in completed.err


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no pseudo-terminals")
def test_a_terminal_gets_questions(tmp_path: Path) -> None:
    import pty

    file = text_file(tmp_path / "a.csv", "A;B;C")
    keeper, terminal = pty.openpty()
    with subprocess.Popen(
        [*PFWD, "map", str(file), "-o", str(tmp_path / "a.map.toml")],
        cwd=TOP,
        stdin=terminal,
        stdout=terminal,
        stderr=terminal,
    ) as asking:
        os.close(terminal)
        answers = ["0.15", "time", "ms", "load", "kN", "wrong", "sensor", "velocity", "0", "mm/s"]
        os.write(keeper, ("\n".join(answers) + "\n").encode())
        output = b""

        def read() -> None:
            nonlocal output
            try:
                while part := os.read(keeper, 4096):
                    output += part
            except OSError:
                return

        reader = threading.Thread(target=read)
        reader.start()
        assert asking.wait(60) == 0, output.decode()
        reader.join(10)
    os.close(keeper)
    assert b"expected one of time, load" in output
    column_map = read_map(tmp_path / "a.map.toml")
    assert column_map.sensors[0].quantity == "velocity"
    assert column_map.declarations["plate_radius_m"].value == 0.15
