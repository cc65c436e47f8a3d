"""docs/extending.md, done as it says: its files in an empty folder, and each of them used."""

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
PATIENCE = 240
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
def survey(folder: Path) -> Path:
    """A survey of a toy file: a plate of 10 kg on a spring and a dashpot."""
    step, stiffness, damping, mass = 1e-4, 15.4e6, 2e4, 10.0
    time = np.arange(-100, 600) * step
    load = np.where((time > 0) & (time < 0.018), 8e3 * np.sin(np.pi * time / 0.018), 0.0)
    moved, speed = [0.0], 0.0
    for force in load[1:]:
        speed += step * (force - damping * speed - stiffness * moved[-1]) / mass
        moved.append(moved[-1] + step * speed)
    rows = np.column_stack([time * 1e3, load / 1e3, np.array(moved) * 1e6])
    lines = ["toy 1", "150", *(f"{t:.6f} {force:.6f} {far:.6f}" for t, force, far in rows)]
    (folder / "point.toy").write_text("\n".join(lines) + "\n")
    done = pfwd(folder, "import", "point.toy", "-o", "site-7")
    assert (done.returncode, done.stderr) == (0, "")
    return folder / "site-7"


def environment(folder: Path) -> dict[str, str]:
    paths = [str(folder / "site"), str(TOP)]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "PYTHONUTF8": "1"}


def pfwd(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    return python(folder, "-c", COMMAND, *arguments)


def python(folder: Path, *arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-P", *map(str, arguments)],
        cwd=folder,
        env=environment(folder),
        capture_output=True,
        encoding="utf-8",
        timeout=PATIENCE,
        stdin=subprocess.DEVNULL,
    )


def lines_of_an_instrument() -> bytes:
    """12 s at 10 kHz with a drop of 8 kN after 2 s; a line of it is damaged."""
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


def test_the_table_names_what_is_there() -> None:
    rows = re.findall(r"^\| [^|]+ \| ([^|]+) \| ([^|]+) \|[^|]*\|$", TEXT, re.M)[1:]
    assert len(rows) == 7
    for place, entry in rows:
        for name in re.findall(r"`([\w/]+(?:\.py)?)`", place + entry):
            if "/" in name:
                assert (TOP / name).exists(), name
    for name in set(re.findall(r"`((?:pfwd_\w+|inversion|simulators|tui)/[\w/.]+)`", TEXT)):
        assert (TOP / name).exists(), name


def test_what_a_stage_gets_is_as_the_table_says() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \| `([\w, ]+)` \|", TEXT, re.M))
    stages = {"ground", "compliance", "nonlinear_stiffness", "motion", "record"}
    assert rows.keys() == stages
    for stage, arguments in rows.items():
        signature = inspect.signature(getattr(Effect, stage))
        assert arguments.split(", ") == list(signature.parameters)[1:]
    fields = {field.name for field in dataclasses.fields(DropContext)}
    (named,) = re.findall(r"`drop` is a `DropContext`.*?and more", TEXT, re.S)
    assert set(re.findall(r"`([a-z_]+)`", named)) - {"drop", "record"} <= fields


def test_the_fields_of_a_block_are_as_the_table_says() -> None:
    (row,) = re.findall(r"^\| `SampleBlock` \| (.*) \|$", TEXT, re.M)
    fields = [field.name for field in dataclasses.fields(SampleBlock)]
    assert re.findall(r"`(\w+)`", row) == fields[:4]


def test_what_is_installed_is_found(folder: Path, tmp_path: Path) -> None:
    done = python(folder, "-c", EXAMPLES["found"])
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["('connector_click',)", "()"]


def test_a_dialect_measures(folder: Path) -> None:
    data, size = lines_of_an_instrument(), 1900
    with talker(lambda number: data[number * size :][:size]) as url:
        options = ("--setup", "pairs-setup.toml", "-o", "measured", "--drops", 1)
        done = pfwd(folder, "log", url, *options, "--no-invert", "--json")
        found = pfwd(folder, "ports", url, "--json")
    assert done.returncode == 0, done.stderr
    (line,) = [one for text in done.stdout.splitlines() if (one := json.loads(text)).get("drop")]
    assert line["saved"]
    record = read_survey(folder / "measured").drops[0].read()
    assert record.drop.load.max() == pytest.approx(8000, rel=0.01)
    (port,) = map(json.loads, found.stdout.splitlines())
    assert (port["answers"], port["identity"]) == ("pairs", None)
    assert port["reason"] == "sends pairs of numbers; declare the instrument in a setup file"


CUTS = """
import sys
import numpy as np
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_device.wire.registry import DeclaredLink, find_dialect
from pfwd_plugins.quantities import Measurand

channels = (ChannelIdentity("load", Measurand.LOAD), ChannelIdentity("g", Measurand.VELOCITY))
identity = Identity("1", "m", "1", 1e4, 18, 5.0, channels)
data = b"1 2\\n3 4\\nx\\n5 6\\n" + 60 * b"9" + b"\\n7 8\\n9 "
for size in range(1, len(data) + 1):
    dialect = find_dialect("pairs").make(DeclaredLink(identity, first_stream=3))
    found = [m for at in range(0, len(data), size) for m in dialect.feed(data[at : at + size])]
    assert found.pop(0) is identity
    samples = [
        (block.stream, block.first_sample + i, *row)
        for block in found
        for i, row in enumerate(block.counts.tolist())
    ]
    assert samples[:3] == [(3, 0, 1, 2), (3, 1, 3, 4), (3, 3, 5, 6)], samples
    assert dialect.counters.bytes_discarded == 2 + 61
"""


def test_a_dialect_does_not_depend_on_how_the_bytes_were_cut(folder: Path) -> None:
    (folder / "cuts.py").write_text(CUTS)
    done = python(folder, "cuts.py")
    assert done.returncode == 0, done.stderr


def test_an_import_format_is_read(folder: Path, survey: Path) -> None:
    code = "from pfwd.files.reading import read_points; (p,) = read_points('point.toy');"
    done = python(folder, "-c", code + "print(p.setup.plate_radius, p.drops[0].load.max())")
    radius, peak = map(float, done.stdout.split())
    assert radius == 0.15
    assert peak == pytest.approx(8000, rel=1e-3)
    (folder / "cut.toy").write_text("toy 1\n150\n0 1\n")
    done = pfwd(folder, "invert", "cut.toy")
    assert done.returncode == 1
    assert "cut.toy, line 3: expected three numbers, got 0 1" in done.stderr


def test_an_export_format_is_written(folder: Path, survey: Path) -> None:
    done = pfwd(folder, "export", survey, "--format", "peaks", "-o", "peaks.txt")
    assert done.returncode == 0, done.stderr
    name, load, deflection = (folder / "peaks.txt").read_text().split()
    assert name == "point/1"
    assert float(load) == pytest.approx(8.0, rel=1e-3)
    assert 0.1 < float(deflection) < 2
    done = pfwd(folder, "export", survey, "--format", "peak", "-o", "other.txt")
    assert done.returncode == 2
    assert "pddx, peaks, got 'peak'" in done.stderr


CLICK = """
import numpy as np
from inversion import Instrument, Record, Sensor
from inversion.diagnosis.model import PointRecords
from inversion.inference.diagnose import diagnose_point
from inversion.effects import BY_NAME
from simulators.demo import DEMO_PLATE, demo_simulations

(drop,) = demo_simulations(1, 4)
time = np.arange(-100, drop.time.size) * (drop.time[1] - drop.time[0])
load = np.concatenate([np.zeros(100), drop.load])
moved = np.concatenate([np.zeros(100), drop.plate_displacement])
moved += 0.2 * moved.max() * np.exp(-(((time - 0.034) / 2e-3) ** 2))
moved += 1e-3 * moved.max() * np.random.default_rng(2).standard_normal(time.size)
instrument = Instrument(plate_radius=DEMO_PLATE.radius, plate_mass=DEMO_PLATE.mass)
sensors = (Sensor(0.0, "displacement", moved),)
record = Record(time, load, sensors, instrument, poisson_ratio=0.35, bedrock_depth=BEDROCK)
found = diagnose_point(PointRecords("toy", (record,), (1,)))
print(list(BY_NAME)[-1], found.verdict, *(effect.name for effect in found.effects))
(click,) = [effect for effect in found.effects if effect.name == "connector_click"]
print(click.parameters[0].value / moved.max(), click.advice)
"""


def test_an_effect_is_listed_and_found(folder: Path) -> None:
    from simulators.demo import demo_ground

    depth = sum(layer.thickness for layer in demo_ground(4).layers)
    (folder / "click.py").write_text(CLICK.replace("BEDROCK", repr(depth)))
    done = python(folder, "click.py")
    assert done.returncode == 0, done.stderr
    first, second = done.stdout.splitlines()
    assert first == "connector_click explained connector_click"
    value, _, advice = second.partition(" ")
    assert float(value) == pytest.approx(0.2, rel=0.1)
    assert advice.startswith("press the connector")


def test_a_procedure_judges(folder: Path) -> None:
    done = python(folder, "-c", EXAMPLES["procedure"])
    assert done.returncode == 0, done.stderr
    verdict, value = done.stdout.split()
    assert verdict == "pass"
    assert float(value) == pytest.approx(0.4e-3)


def test_a_language_is_reported_in(folder: Path, survey: Path) -> None:
    done = python(folder, "-c", EXAMPLES["language"])
    assert done.returncode == 0, done.stderr
    options = ("--language", "norsk.toml", "--procedure", "lot-7.toml", "-o", "site.html")
    done = pfwd(folder, "report", survey, *options)
    assert done.returncode == 0, done.stderr
    page = (folder / "site.html").read_text("utf-8")
    assert '<html lang="nb">' in page
    assert "Sammendrag" in page
    assert "Subgrade, lot 7" in page


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
    print(app.text)


play(App(), script)
"""


def test_a_page_is_shown_by_its_key(folder: Path) -> None:
    (entry,) = re.findall(r"`(PageEntry\(.*?\))`", TEXT)
    script = PAGE.replace("FOLDER", str(folder)).replace("ENTRY", entry)
    (folder / "page.py").write_text(script)
    done = python(folder, "page.py")
    assert done.returncode == 0, done.stderr
    assert "Last messages" in done.stdout


def test_the_catalogue_of_texts_that_is_copied_is_there() -> None:
    assert files("pfwd.report").joinpath("catalogues", "en.toml").is_file()


def test_without_the_package_nothing_of_it_is_known(folder: Path, tmp_path: Path) -> None:
    # It lies in the current folder: that is no installation.
    shutil.copytree(folder / "site", tmp_path / "received")
    script = tmp_path / "script.py"
    script.write_text("import sys\nfrom tui.cli import main\nsys.exit(main())\n")
    for entry in ("", ".", str(tmp_path / "received")):
        done = subprocess.run(
            [sys.executable, script, "export", "x", "--format", "peaks", "-o", "y"],
            cwd=tmp_path / "received",
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(TOP), entry])},
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )
        assert done.returncode == 2
        assert "gpx, pddx, got 'peaks'" in done.stderr


def test_a_package_that_cannot_be_loaded_costs_one_remark(folder: Path, survey: Path) -> None:
    broken = folder / "broken"
    points = "[pfwd.effects]\nno_such = no_such_module:X\n[pfwd.import_formats]\nbad = no_such:X\n"
    install(broken, {}, points, "broken-toy", "2.0")
    env = environment(folder)
    env["PYTHONPATH"] = os.pathsep.join([str(broken), env["PYTHONPATH"]])
    done = subprocess.run(
        [sys.executable, "-P", "-c", COMMAND, "import", "point.toy", "-o", "site-8"],
        cwd=folder,
        env=env,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
    )
    assert done.returncode == 0
    (line,) = done.stderr.splitlines()
    assert line.startswith("pfwd: plug-in bad of broken-toy 2.0 (pfwd.import_formats) is left out")
