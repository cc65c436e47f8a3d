"""The files of docs/extending.md in an empty folder, each of them used."""

import dataclasses
import inspect
import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inversion.effects import DropContext, Effect
from pfwd_device.recording import read_survey
from pfwd_device.wire.messages import SampleBlock
from tests.installed_package import install
from tests.pfwd_device.acquisition.scripted import talker

TOP = Path(__file__).resolve().parents[1]
TEXT = (TOP / "docs" / "extending.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"<!-- file: (\S+) -->\n```\w+\n(.*?)```", TEXT, re.S))
EXAMPLES = dict(re.findall(r"<!-- example: (\w+) -->\n```python\n(.*?)```", TEXT, re.S))
PATIENCE_S = 240
COMMAND = "import sys; from tui.cli import main; sys.exit(main())"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of the document; its package is installed in `site`."""
    folder = tmp_path_factory.mktemp("extending")
    modules = {name: text for name, text in FILES.items() if name.startswith("toy_pfwd/")}
    project = tomllib.loads(FILES["pyproject.toml"])["project"]
    groups = project["entry-points"]
    points = "".join(
        f"[{group}]\n" + "".join(f"{name} = {value}\n" for name, value in entries.items())
        for group, entries in groups.items()
    )
    install(folder / "site", modules, points, project["name"], project["version"])
    for name in FILES.keys() - modules.keys():
        (folder / name).write_text(FILES[name], encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def results(folder: Path) -> dict[str, list[Any]]:
    """Status, output and errors of each command and example, all in one process."""
    (folder / "point.toy").write_text(toy_file(), encoding="utf-8")
    (folder / "cut.toy").write_text("toy 1\n150\n0 1\n", encoding="utf-8")
    (entry,) = re.findall(r"`(PageEntry\(.*?\))`", TEXT)
    page = PAGE.replace("FOLDER", str(folder)).replace("ENTRY", entry)
    data, size = lines_of_an_instrument(), 1900
    with talker(lambda number: data[number * size :][:size]) as url:
        log = ("log", url, "--setup", "pairs-setup.toml", "-o", "measured", "--drops", "1")
        report = ("report", "site-7", "--language", "norsk.toml", "--procedure", "lot-7.toml")
        steps: dict[str, tuple[str, ...] | str] = {
            **EXAMPLES,
            "log": (*log, "--no-invert", "--json"),
            "ports": ("ports", url, "--json"),
            "import": ("import", "point.toy", "-o", "site-7"),
            "invert": ("invert", "cut.toy"),
            "export": ("export", "site-7", "--format", "peaks", "-o", "peaks.txt"),
            "unknown format": ("export", "site-7", "--format", "peak", "-o", "other.txt"),
            "click": CLICK,
            "report": (*report, "-o", "site.html"),
            "page": page,
        }
        command = [sys.executable, "-P", "-c", RUNNER]
        run = subprocess.run(
            command,
            input=json.dumps(steps),
            cwd=folder,
            env=environment(folder / "site", TOP),
            capture_output=True,
            encoding="utf-8",
            timeout=PATIENCE_S,
        )
    assert run.returncode == 0, run.stderr
    outcomes: dict[str, list[Any]] = json.loads(run.stdout)
    return outcomes


RUNNER = """
import contextlib, io, json, sys, traceback
from tui.cli import main

outcomes = {}
for name, step in json.load(sys.stdin).items():
    output, errors, status = io.StringIO(), io.StringIO(), 0
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
        try:
            if isinstance(step, str):
                exec(compile(step, name, "exec"), {"__name__": "__main__"})
            else:
                status = main(step)
        except SystemExit as exit_request:
            status = exit_request.code
        except Exception:
            traceback.print_exc()
            status = -1
    outcomes[name] = status, output.getvalue(), errors.getvalue()
print(json.dumps(outcomes))
"""


def output_of(outcome: list[Any]) -> str:
    status, output, errors = outcome
    assert status == 0, errors
    return str(output)


def environment(*paths: Path | str) -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths)), "PYTHONUTF8": "1"}


def toy_file() -> str:
    """Return a toy file of a plate of 10 kg on a spring and a dashpot."""
    step, stiffness, damping, mass = 1e-4, 15.4e6, 2e4, 10.0
    time = np.arange(-100, 600) * step
    load = np.where((time > 0) & (time < 0.018), 8e3 * np.sin(np.pi * time / 0.018), 0.0)
    moved, speed = [0.0], 0.0
    for force in load[1:]:
        speed += step * (force - damping * speed - stiffness * moved[-1]) / mass
        moved.append(moved[-1] + step * speed)
    rows = np.column_stack([time * 1e3, load / 1e3, np.array(moved) * 1e6])
    return "\n".join(["toy 1", "150", *(f"{t:.6f} {f:.6f} {u:.6f}" for t, f, u in rows), ""])


def lines_of_an_instrument() -> bytes:
    """Return 12 s at 10 kHz with a drop of 8 kN after 2 s and a damaged line."""
    time = np.arange(120_000) * 1e-4 - 2.0
    during = (time > 0) & (time < 0.02)
    force = np.where(during, 8000 * np.sin(np.pi * time / 0.02), 0.0)
    speed = np.where(during, 0.05 * np.cos(np.pi * time / 0.02), 0.0)
    step = 2 * 5.0 / 2**18  # V a count
    noise = np.random.default_rng(1).integers(-3, 4, (time.size, 2))
    counts = np.column_stack([force * 4e-4, speed * 28.8]) / step + noise
    lines = [f"{load} {moved}\n" for load, moved in np.rint(counts).astype(int).tolist()]
    lines[5000] = "7 x\n"
    return "".join(lines).encode()


def test_the_arguments_of_a_stage_agree_with_the_table() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \| `([\w, ]+)` \|", TEXT, re.M))
    stages = {"ground", "compliance", "nonlinear_stiffness", "motion", "record"}
    assert rows.keys() == stages
    for stage, arguments in rows.items():
        signature = inspect.signature(getattr(Effect, stage))
        assert arguments.split(", ") == list(signature.parameters)[1:]
    fields = {field.name for field in dataclasses.fields(DropContext)}
    (named,) = re.findall(r"`drop` is a `DropContext`.*?and more", TEXT, re.S)
    assert set(re.findall(r"`([a-z_]+)`", named)) - {"drop", "record"} <= fields


def test_the_fields_of_a_block_agree_with_the_table() -> None:
    (row,) = re.findall(r"^\| `SampleBlock` \| (.*) \|$", TEXT, re.M)
    fields = [field.name for field in dataclasses.fields(SampleBlock)]
    assert re.findall(r"`(\w+)`", row) == fields[:4]


def test_installed_plugins_are_listed(results: dict[str, list[Any]]) -> None:
    assert output_of(results["found"]).splitlines() == ["('connector_click',)", "()"]


def test_a_dialect_measures(folder: Path, results: dict[str, list[Any]]) -> None:
    lines = [json.loads(line) for line in output_of(results["log"]).splitlines()]
    (drop,) = [line for line in lines if line.get("drop")]
    assert drop["saved"]
    record = read_survey(folder / "measured").drops[0].read()
    assert record.drop.load.max() == pytest.approx(8000, rel=0.01)
    port = json.loads(output_of(results["ports"]))
    assert (port["answers"], port["identity"]) == ("pairs", None)
    assert "declare the instrument in a setup file" in port["reason"]


def test_an_import_format_is_read(folder: Path, results: dict[str, list[Any]]) -> None:
    assert results["import"] == [0, results["import"][1], ""]
    record = read_survey(folder / "site-7").drops[0].read()
    assert record.declared["plate_radius_m"] == 0.15
    assert record.drop.load.max() == pytest.approx(8000, rel=1e-3)
    status, _, errors = results["invert"]
    assert (status, "cut.toy, line 3" in errors) == (1, True)


def test_an_export_format_is_written(folder: Path, results: dict[str, list[Any]]) -> None:
    output_of(results["export"])
    name, load, deflection = (folder / "peaks.txt").read_text().split()
    assert name == "point/1"
    assert float(load) == pytest.approx(8.0, rel=1e-3)
    assert 0.1 < float(deflection) < 2
    status, _, errors = results["unknown format"]
    assert (status, "pddx, peaks" in errors) == (2, True)


CLICK = """
import numpy as np
from inversion import Instrument, Record, Sensor
from inversion.diagnosis.model import PointRecords
from inversion.inference.diagnose import diagnose_point
from inversion.effects import BY_NAME
from simulators.demo import DEMO_PLATE, demo_ground, demo_simulations

depth = sum(layer.thickness for layer in demo_ground(4).layers)
(drop,) = demo_simulations(1, 4)
time = np.arange(-100, drop.time.size) * (drop.time[1] - drop.time[0])
load = np.concatenate([np.zeros(100), drop.load])
moved = np.concatenate([np.zeros(100), drop.plate_displacement])
moved += 0.2 * moved.max() * np.exp(-(((time - 0.034) / 2e-3) ** 2))
moved += 1e-3 * moved.max() * np.random.default_rng(2).standard_normal(time.size)
instrument = Instrument(plate_radius=DEMO_PLATE.radius, plate_mass=DEMO_PLATE.mass)
sensors = (Sensor(0.0, "displacement", moved),)
record = Record(time, load, sensors, instrument, poisson_ratio=0.35, bedrock_depth=depth)
point = PointRecords("toy", (record,), (1,))
diagnosis = diagnose_point(point, compare_declarations=False)
print(list(BY_NAME)[-1], diagnosis.verdict, *(effect.name for effect in diagnosis.effects))
(click,) = [effect for effect in diagnosis.effects if effect.name == "connector_click"]
print(click.parameters[0].value / moved.max(), click.advice)
"""


def test_an_effect_is_listed_and_detected(results: dict[str, list[Any]]) -> None:
    first, second = output_of(results["click"]).splitlines()
    assert first == "connector_click explained connector_click"
    value, _, advice = second.partition(" ")
    assert float(value) == pytest.approx(0.2, rel=0.1)
    assert advice.startswith("press the connector")


def test_a_procedure_judges(results: dict[str, list[Any]]) -> None:
    verdict, value = output_of(results["procedure"]).split()
    assert verdict == "pass"
    assert float(value) == pytest.approx(0.4e-3)


def test_a_report_is_written_in_a_new_language(folder: Path, results: dict[str, list[Any]]) -> None:
    output_of(results["language"])
    output_of(results["report"])
    page = (folder / "site.html").read_text("utf-8")
    assert '<html lang="nb">' in page
    assert "Sammendrag" in page
    assert "Subgrade, lot 7" in page
    assert files("pfwd.report").joinpath("catalogues", "en.toml").is_file()


PAGE = """
import tui.screen.pages as pages

pages.__path__.append(r"FOLDER")
pages.PAGES = (*pages.PAGES, pages.ENTRY)

from tests.tui.screen.scripted import App, play, ready, deliver


async def script(app, pilot):
    app.show_message("all is well")
    await deliver(app, pilot, ready())
    await pilot.press("6")
    await pilot.pause(0.2)
    texts.append(app.text)


texts = []
play(App(), script)
print(texts[0])
"""


def test_a_key_opens_its_page(results: dict[str, list[Any]]) -> None:
    assert "Last messages" in output_of(results["page"])


def test_a_package_in_the_current_folder_is_not_loaded(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder / "site", tmp_path / "received")
    script = tmp_path / "script.py"
    script.write_text(COMMAND)
    for entry in ("", ".", str(tmp_path / "received")):
        run = subprocess.run(
            [sys.executable, script, "export", "x", "--format", "peaks", "-o", "y"],
            cwd=tmp_path / "received",
            env=environment(TOP, entry),
            capture_output=True,
            text=True,
            timeout=PATIENCE_S,
        )
        assert run.returncode == 2
        assert "gpx, pddx, got 'peaks'" in run.stderr


def test_a_package_that_cannot_be_loaded_is_reported_in_a_line(
    folder: Path, results: dict[str, list[Any]]
) -> None:
    broken = folder / "broken"
    points = "[pfwd.effects]\nno_such = no_such_module:X\n[pfwd.import_formats]\nbad = no_such:X\n"
    install(broken, {}, points, "broken-toy", "2.0")
    run = subprocess.run(
        [sys.executable, "-P", "-c", COMMAND, "import", "point.toy", "-o", "site-8"],
        cwd=folder,
        env=environment(broken, folder / "site", TOP),
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert run.returncode == 0
    (line,) = run.stderr.splitlines()
    assert line.startswith("pfwd: plug-in bad of broken-toy 2.0 (pfwd.import_formats)")
