"""Scenarios: what is read, what is refused and how, and what the documentation says of it."""

import dataclasses
import datetime
import re
from pathlib import Path
from typing import Any

import pytest

from pfwd_device.wire.registry import BUILT_IN
from simulators.instrument import ScenarioError, builtin_scenarios, load_scenario
from simulators.instrument.language import LANGUAGES
from simulators.instrument.scenario import (
    ChannelEffect,
    ChannelSettings,
    DeviceSettings,
    DropSettings,
    Fault,
    HammerSettings,
    LinkSettings,
    Scenario,
    Soil,
)
from simulators.instrument.units import sensor_offsets

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "simulator.md"
TABLES = {
    "": Scenario,
    "[soil]": Soil,
    "[hammer]": HammerSettings,
    "[device]": DeviceSettings,
    "[[device.channels]]": ChannelSettings,
    "[drops]": DropSettings,
    "[link]": LinkSettings,
    "[[effects]]": ChannelEffect,
    "[[faults]]": Fault,
}


@pytest.mark.parametrize("name", builtin_scenarios())
def test_every_built_in_scenario_reads_and_has_a_plate(name: str) -> None:
    scenario = load_scenario(name)
    assert scenario.name == name
    identity = scenario.device.identity(scenario.device.sampling_rate)
    assert identity.plate_radius == 0.15
    assert identity.channels[0].quantity == "load"


def test_the_default_is_what_a_user_would_assume() -> None:
    scenario = load_scenario("default")
    assert scenario.device.sampling_rate == 10e3
    assert scenario.soil.poisson_ratio == 0.35
    assert [channel.offset for channel in scenario.device.channels] == [0.0, 0.0]
    assert scenario.device.channels[0].calibrated == datetime.date(2026, 3, 2)


def test_a_file_stands_on_a_built_in_scenario(tmp_path: Path) -> None:
    file = tmp_path / "own.toml"
    file.write_text('base = "stiff"\n[device]\nserial_number = "X"\n', encoding="utf-8")
    scenario = load_scenario(str(file))
    stiff = load_scenario("stiff")
    assert scenario.soil == stiff.soil
    assert scenario.device == dataclasses.replace(stiff.device, serial_number="X")


def test_bedrock_may_be_absent() -> None:
    assert load_scenario({"soil": {"bedrock_depth": float("inf")}}).soil.ground().base == "none"


def test_a_crust_lies_on_the_rest() -> None:
    soil = load_scenario({"soil": {"crust_modulus": 9e7, "crust_thickness": 0.3}}).soil
    crust, below = soil.ground(0.5).layers
    assert (crust.modulus, crust.thickness) == (4.5e7, 0.3)
    assert below.thickness == pytest.approx(0.9)


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        (
            {"soil": {"modulos": 1.0}},
            r"soil: expected a known key, got 'modulos'; did you mean modulus",
        ),
        ({"soil": {"modulus": -1.0}}, r"soil\.modulus: expected a number > 0, got -1"),
        ({"soil": {"modulus": "45e6"}}, r"soil\.modulus: expected a number > 0, got '45e6'"),
        ({"soil": {"modulus": True}}, r"soil\.modulus: expected a number"),
        ({"soil": {"modulus": float("nan")}}, r"soil\.modulus: expected a number"),
        ({"soil": {"modulus": float("inf")}}, r"soil\.modulus: expected a number > 0"),
        (
            {"soil": {"poisson_ratio": 0.5}},
            r"soil\.poisson_ratio: expected a number >= 0 and < 0\.5",
        ),
        ({"soil": {"crust_modulus": 1e8, "crust_thickness": 2.0}}, "soil: thickness"),
        ({"soil": 3}, "soil: expected a table"),
        ({"sole": {}}, "expected a known key, got 'sole'; did you mean soil"),
        ({"base": "nowhere"}, "base: expected a built-in scenario, got 'nowhere'"),
        ({"device": {"adc_bits": 25}}, r"device\.adc_bits: expected a whole number from 8 to 24"),
        ({"device": {"adc_bits": 16.5}}, r"device\.adc_bits: expected a whole number"),
        ({"device": {"sampling_rate": 7e3}}, r"device\.sampling_rate: expected one of device"),
        ({"device": {"serial_number": "x" * 33}}, "device: .*serial_number up to 32"),
        ({"device": {"channels": {}}}, r"device\.channels: expected an array of tables"),
        (
            {"device": {"channels": [{"role": "load"}, {"name": "x", "role": "lead"}]}},
            r"device\.channels\[2\]\.role: expected \"load\" or \"geophone\"",
        ),
        ({"device": {"channels": [{"sensitivity": 0.0}]}}, "finite sensitivity other than 0"),
        ({"device": {"channels": [{"calibrated": "soon"}]}}, r"calibrated: expected a date as"),
        ({"device": {"channels": [{"name": "a"}, {"name": "a"}]}}, "names that differ"),
        ({"device": {"channels": []}}, "1 to 8 channels"),
        ({"drops": {"bounces": [4, 2]}}, r"drops\.bounces: expected two numbers, the smaller"),
        ({"drops": {"seating": 0.9}}, r"drops\.seating: expected an array"),
        ({"drops": {"jitter": 4.0}}, r"drops\.jitter: expected a shorter time"),
        ({"link": {"dialect": "morse"}}, r"link\.dialect: expected \"pfwd\" or \"ascii\""),
        ({"link": {"lost_rate": 1.5}}, r"link\.lost_rate: expected a number from 0 to 1"),
        ({"faults": [{"at_s": 1.0}]}, r"faults\[1\]\.kind: expected \"lost\" or"),
        ({"faults": [{"kind": "fire"}]}, r"faults\[1\]\.kind: expected \"lost\" or"),
        (
            {"faults": [{"kind": "reset", "count": 2}]},
            r"faults\[1\]: expected keys of reset \(none\), got count",
        ),
        ({"effects": [{"kind": "dead", "channel": "x"}]}, r"effects\[1\]\.channel: expected one"),
        (
            {"effects": [{"kind": "gain", "channel": "load", "angle": 1.0}]},
            r"effects\[1\]: expected keys of gain \(factor\), got angle",
        ),
    ],
)
def test_an_error_names_the_key(tables: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        load_scenario(tables)


def test_a_dialect_has_one_name_in_setups_and_scenarios() -> None:
    # Loggers have a simulation of their own.
    own = [e.name for e in BUILT_IN.values() if not (e.needs_inputs or e.needs_frames)]
    assert list(LANGUAGES) == own
    assert load_scenario("default").link.dialect == "pfwd"


def test_a_name_that_is_none_is_told_what_there_is(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"expected an existing file or one of .*default"):
        load_scenario("defualt")
    broken = tmp_path / "broken.toml"
    broken.write_text("[soil\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match="expected a TOML file, got"):
        load_scenario(str(broken))


# The documentation


def section(title: str) -> str:
    """The lines under a heading up to the next one of any level."""
    text = DOCUMENT.read_text(encoding="utf-8")
    found = re.search(rf"^#+ {re.escape(title)}\n(.*?)(?=^#|\Z)", text, re.M | re.S)
    assert found is not None, f"docs/simulator.md has no section {title!r}"
    return found[1]


@pytest.mark.parametrize("table", list(TABLES))
def test_the_documented_keys_are_those_of_the_code(table: str) -> None:
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \|", section(f"`{table}`" if table else "Top"), re.M)
    fields = [f for f in dataclasses.fields(TABLES[table]) if f.metadata]
    assert [name for name, _ in rows] == [field.name for field in fields]
    for (name, shown), field in zip(rows, fields, strict=True):
        if isinstance(field.default, bool | float | int | str) and field.default != "":
            text = str(field.default).lower() if field.default in (True, False) else field.default
            value = shown.strip("`").strip('"')
            if isinstance(field.default, bool):
                assert value == text, name
            elif isinstance(field.default, str):
                assert value == field.default, name
            else:
                assert float(value.replace("_", "")) == field.default, name


def test_the_documented_scenarios_are_those_of_the_code() -> None:
    rows = re.findall(r"^\| `([\w-]+)` \|", section("Built-in scenarios"), re.M)
    assert sorted(rows) == builtin_scenarios()


@pytest.mark.parametrize(("title", "class_"), [("Effects", ChannelEffect), ("Faults", Fault)])
def test_the_documented_kinds_are_those_of_the_code(title: str, class_: Any) -> None:
    rows = re.findall(r"^\| `([\w-]+)` \| (.*?) \|", section(title), re.M)
    found = {kind: tuple(re.findall(r"`(\w+)`", keys)) for kind, keys in rows}
    assert found == class_.KEYS


def test_a_sensor_on_the_other_side_of_the_plate_moves_alike() -> None:
    scenario = load_scenario("default")
    load, centre = scenario.device.channels
    left, right = (
        dataclasses.replace(centre, name=name, offset=place)
        for name, place in (("left", -0.3), ("right", 0.3))
    )
    device = dataclasses.replace(scenario.device, channels=(load, centre, left, right))
    assert sensor_offsets(dataclasses.replace(scenario, device=device)) == (0.0, 0.0, 0.3, 0.3)
    assert left.identity().offset == -0.3
