"""JSON Schemas accept the files of the program and refuse what its readers refuse."""

import datetime
import json
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from pfwd.errors import OptionError
from pfwd.files.report_settings import read_report_settings
from pfwd.procedures import shipped_names
from pfwd.procedures.shipped import find_procedure
from pfwd.schemas import json_schema, schema_names
from simulators.instrument.scenario import FOLDER, builtin_scenarios, scenario_schema
from tui.cli import main

TOP = Path(__file__).resolve().parents[2]


def as_json(value: Any) -> Any:
    """Return TOML values as an editor passes them to a validator: dates are texts."""
    return json.loads(json.dumps(value, default=datetime.date.isoformat))


def faults(schema: dict[str, Any], text: str) -> list[str]:
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    return [error.message for error in validator.iter_errors(as_json(tomllib.loads(text)))]


@pytest.mark.parametrize("name", builtin_scenarios())
def test_the_scenarios_of_the_program_are_valid(name: str) -> None:
    text = FOLDER.joinpath(f"{name}.toml").read_text(encoding="utf-8")
    assert faults(scenario_schema(), text) == []


@pytest.mark.parametrize("name", shipped_names())
def test_the_procedures_of_the_program_are_valid(name: str) -> None:
    assert faults(json_schema("procedure"), find_procedure(name).text) == []


def test_the_example_of_a_column_map_is_valid() -> None:
    text = (TOP / "examples" / "column-map.toml").read_text(encoding="utf-8")
    assert faults(json_schema("column-map"), text) == []


SETUP = """
plate_radius_m = 0.15
bedrock_depth_m = 1.5
procedure = "mndot"
[[channels]]
name = "load"
role = "load"
calibrated = 2026-03-02
"""


@pytest.mark.parametrize(("old", "new"), [("0.15", "-1"), ('"mndot"', "{ name = 3 }")])
def test_a_setup_is_checked(old: str, new: str) -> None:
    assert faults(json_schema("setup"), SETUP) == []
    assert len(faults(json_schema("setup"), SETUP.replace(old, new, 1))) == 1


def test_company_and_logo_of_all_reports_are_read(tmp_path: Path) -> None:
    file = tmp_path / "report.toml"
    assert read_report_settings(file) == {}
    text = 'company = "A & B"\nlogo = "logo.png"\n'
    file.write_text(text, encoding="utf-8")
    assert faults(json_schema("report"), text) == []
    assert read_report_settings(file) == {"company": "A & B", "logo": str(tmp_path / "logo.png")}
    for wrong in ("colour = 3\n", "logo = 3\n"):
        file.write_text(wrong, encoding="utf-8")
        assert faults(json_schema("report"), wrong)
        with pytest.raises(OptionError, match=r"report.toml.*: expected"):
            read_report_settings(file)


def test_a_device_file_is_checked() -> None:
    text = "[sensor_lag]\ndrops = 3\ndelay_s = 6e-4\ndelay_sd_s = 2e-5\n"
    assert faults(json_schema("device"), text) == []
    for old, new in (("6e-4", "1.0"), ("sensor_lag", "bedrock")):
        assert faults(json_schema("device"), text.replace(old, new, 1))


@pytest.mark.parametrize("name", [*schema_names(), "scenario"])
def test_the_command_prints_a_schema(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", name]) == 0
    schema = json.loads(capsys.readouterr().out)
    jsonschema.Draft202012Validator.check_schema(schema)
    described = [key for key in schema["properties"].values() if key.get("description")]
    assert len(described) >= 0.5 * len(schema["properties"])
