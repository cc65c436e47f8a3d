"""Scenarios: reading, rejection of invalid keys, and their documentation."""

import dataclasses
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
        ({"soil": {"modulus": "45e6"}}, r"soil\.modulus: expected a number > 0, got '45e6'"),
        ({"soil": {"modulus": float("inf")}}, r"soil\.modulus: expected a number > 0"),
        ({"soil": {"crust_modulus": 1e8, "crust_thickness": 2.0}}, "soil: thickness"),
        ({"soil": 3}, "soil: expected a table"),
        ({"base": "nowhere"}, "base: expected a built-in scenario, got 'nowhere'"),
        ({"sole": {}}, "expected a known key, got 'sole'; did you mean soil"),
        ({"device": {"adc_bits": 25}}, r"device\.adc_bits: expected a whole number from 8 to 24"),
        ({"device": {"sampling_rate": 7e3}}, r"device\.sampling_rate: expected one of device"),
        ({"device": {"serial_number": "x" * 33}}, "device: .*serial_number up to 32"),
        ({"device": {"channels": {}}}, r"device\.channels: expected an array of tables"),
        ({"device": {"channels": [{"calibrated": "soon"}]}}, r"calibrated: expected a date as"),
        ({"device": {"channels": [{"name": "a"}, {"name": "a"}]}}, "names that differ"),
        ({"drops": {"bounces": [4, 2]}}, r"drops\.bounces: expected two numbers, the smaller"),
        ({"drops": {"jitter": 4.0}}, r"drops\.jitter: expected a shorter time"),
        ({"link": {"dialect": "morse"}}, r"link\.dialect: expected \"pfwd\" or \"ascii\""),
        ({"faults": [{"kind": "fire"}]}, r"faults\[1\]\.kind: expected \"lost\" or"),
        (
            {"faults": [{"kind": "reset", "count": 2}]},
            r"faults\[1\]: expected keys of reset \(none\), got count",
        ),
        ({"effects": [{"kind": "dead", "channel": "x"}]}, r"effects\[1\]\.channel: expected one"),
    ],
)
def test_an_error_names_the_key(tables: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        load_scenario(tables)


def test_a_dialect_has_equal_names_in_setups_and_scenarios() -> None:
    # Loggers are simulated separately.
    names = [e.name for e in BUILT_IN.values() if not (e.needs_inputs or e.needs_frames)]
    assert list(LANGUAGES) == names
    assert load_scenario("default").link.dialect == "pfwd"


def test_an_unknown_scenario_is_rejected_with_the_known_names(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"expected an existing file or one of .*default"):
        load_scenario("defualt")
    broken = tmp_path / "broken.toml"
    broken.write_text("[soil\n", encoding="utf-8")
    with pytest.raises(ScenarioError, match="expected a TOML file, got"):
        load_scenario(str(broken))


# The documentation


def section(title: str) -> str:
    """Return the lines under a heading, up to the next heading."""
    text = DOCUMENT.read_text(encoding="utf-8")
    match = re.search(rf"^#+ {re.escape(title)}\n(.*?)(?=^#|\Z)", text, re.M | re.S)
    assert match is not None, f"docs/simulator.md has no section {title!r}"
    return match[1]


@pytest.mark.parametrize("table", list(TABLES))
def test_all_keys_are_documented_with_their_defaults(table: str) -> None:
    rows = re.findall(r"^\| `(\w+)` \| (.*?) \|", section(f"`{table}`" if table else "Top"), re.M)
    fields = [f for f in dataclasses.fields(TABLES[table]) if f.metadata]
    assert [name for name, _ in rows] == [field.name for field in fields]
    for (name, text), field in zip(rows, fields, strict=True):
        if isinstance(field.default, bool | float | int | str) and field.default != "":
            value = text.strip("`").strip('"')
            if isinstance(field.default, bool):
                assert value == str(field.default).lower(), name
            elif isinstance(field.default, str):
                assert value == field.default, name
            else:
                assert float(value.replace("_", "")) == field.default, name


def test_all_scenarios_are_documented() -> None:
    rows = re.findall(r"^\| `([\w-]+)` \|", section("Built-in scenarios"), re.M)
    assert sorted(rows) == builtin_scenarios()


@pytest.mark.parametrize(("title", "class_"), [("Effects", ChannelEffect), ("Faults", Fault)])
def test_all_kinds_are_documented(title: str, class_: Any) -> None:
    rows = re.findall(r"^\| `([\w-]+)` \| (.*?) \|", section(title), re.M)
    documented = {kind: tuple(re.findall(r"`(\w+)`", keys)) for kind, keys in rows}
    assert documented == class_.KEYS


def test_sensors_at_opposite_offsets_move_alike() -> None:
    scenario = load_scenario("default")
    load, centre = scenario.device.channels
    left, right = (
        dataclasses.replace(centre, name=name, offset=place)
        for name, place in (("left", -0.3), ("right", 0.3))
    )
    device = dataclasses.replace(scenario.device, channels=(load, centre, left, right))
    assert sensor_offsets(dataclasses.replace(scenario, device=device)) == (0.0, 0.0, 0.3, 0.3)
    assert left.identity().offset == -0.3
