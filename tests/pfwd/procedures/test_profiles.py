"""Procedures as they are read: every number with its source, nothing guessed."""

import contextlib
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfwd.errors import OptionError
from pfwd.procedures import (
    Quantity,
    find_procedure,
    parse_procedure,
    read_procedure,
    shipped_names,
    shipped_procedures,
)

PLAIN = """
pfwd-procedure = 1
name = "ours"
title = "Ours"
source = "contract 7"
quantity = "E_LWD"
[drops]
seating = { value = 2, source = "contract 7, 1", verified = true }
measured = { value = 3, source = "contract 7, 1", verified = true }
[formula]
factor = { value = 2.0, source = "contract 7, 2", verified = true }
"""


def numbers_in(value: Any, path: str = "") -> list[tuple[str, Any]]:
    """Every number of a TOML file with the table that it stands in."""
    if isinstance(value, dict):
        found = []
        for key, item in value.items():
            if isinstance(item, int | float) and not isinstance(item, bool):
                found.append((f"{path}.{key}", value))
            else:
                found += numbers_in(item, f"{path}.{key}")
        return found
    if isinstance(value, list):
        return [
            one for index, item in enumerate(value) for one in numbers_in(item, f"{path}{index}")
        ]
    return []


@pytest.mark.parametrize("name", shipped_names())
def test_every_shipped_number_has_a_source_or_says_that_it_is_not_verified(name: str) -> None:
    # From the file itself: the reader must not be what proves it.
    folder = resources.files("pfwd.procedures").joinpath("profiles")
    table = tomllib.loads(folder.joinpath(f"{name}.toml").read_text(encoding="utf-8"))
    del table["pfwd-procedure"]
    found = numbers_in(table)
    assert found
    for path, entry in found:
        assert path.endswith(".value"), f"{path} stands without a source"
        assert len(entry["source"]) > 10, path
        assert entry["verified"] in (True, False), path
        hedged = any(word in entry["source"] for word in ("circulates", "circulate", "not seen"))
        assert not (hedged and entry["verified"]), f"{path} is verified by hearsay"


def test_the_helper_finds_bare_numbers() -> None:
    assert [path for path, _ in numbers_in({"a": {"b": 3}})] == [".a.b"]


def test_the_shipped_procedures_are_these() -> None:
    assert shipped_names() == (
        "astm-e2583",
        "astm-e2835",
        "mchw-885",
        "mndot",
        "paper",
        "tp-bf-stb-b8.3",
    )
    assert [one.name for one in shipped_procedures()] == list(shipped_names())


@pytest.mark.parametrize("name", ["tp-bf-stb-b8.3", "mchw-885", "mndot"])
def test_three_seating_and_three_measured_drops(name: str) -> None:
    procedure = find_procedure(name)
    assert (procedure.seating_drops, procedure.measured_drops) == (3, 3)


def test_what_is_not_verified_is_not_enforced_unless_asked_for() -> None:
    careful = find_procedure("astm-e2835")
    assert (careful.seating_drops, careful.measured_drops) == (None, None)
    assert careful.limit("most_deflection_spread") is None
    bold = find_procedure("astm-e2835", enforce_unverified=True)
    assert (bold.seating_drops, bold.measured_drops) == (3, 3)
    assert bold.limit("most_deflection_spread") == 0.1


def test_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "ours.toml"
    path.write_text(PLAIN, encoding="utf-8")
    procedure = find_procedure(str(path))
    assert procedure.name == "ours"
    assert procedure.quantity is Quantity.E_LWD
    assert procedure.file == str(path)
    assert parse_procedure(procedure.text, "again").seating_drops == 2


def test_targets_are_chosen_by_moisture_and_material() -> None:
    text = PLAIN + "".join(
        f"[[targets]]\nvalue_pa = {{ value = {value}e6, source = 'contract 7', verified = true }}\n"
        f"material = 'gravel'\nmoisture_from_percent = {low}\nmoisture_to_percent = {high}\n"
        for value, low, high in ((80, 5, 7), (67, 7, 9))
    )
    procedure = parse_procedure(text, "t")
    chosen = {
        moisture: found and found.value.value
        for moisture in (4.9, 5.0, 6.99, 7.0, 9.0)
        if (found := procedure.target_for(moisture, "gravel")) is not None or True
    }
    assert chosen == {4.9: None, 5.0: 80e6, 6.99: 80e6, 7.0: 67e6, 9.0: None}
    assert procedure.target_for(6.0, "clay") is None
    assert procedure.target_for(None, "gravel") is None, "the moisture is not known"


def test_a_modulus_without_its_factor_is_refused() -> None:
    with pytest.raises(OptionError, match="factor for E_LWD, got none"):
        parse_procedure(PLAIN.split("[formula]")[0], "ours.toml")


def test_unreadable_files_are_told(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"readable TOML file.* No such file or directory"):
        read_procedure(tmp_path / "none.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(OptionError, match="UTF-8"):
        read_procedure(tmp_path / "bytes.toml")
    with pytest.raises(OptionError, match="pfwd procedures lists them"):
        find_procedure("mndott")


_ANYTHING = st.recursive(
    st.one_of(st.booleans(), st.integers(), st.floats(), st.text(max_size=5)),
    lambda inner: st.one_of(st.lists(inner, max_size=2), st.dictionaries(st.text("abc"), inner)),
    max_leaves=4,
)


@given(
    st.sampled_from(["name", "drops", "formula", "checks", "targets", "quantity", "average"]),
    _ANYTHING,
)
def test_no_value_is_an_unforeseen_error(key: str, value: Any) -> None:
    from pfwd.files.toml import toml_line

    lines = [
        "pfwd-procedure = 1",
        *(f'{name} = "x"' for name in ("name", "title", "source") if name != key),
        *(['quantity = "modulus"'] if key != "quantity" else []),
        toml_line(key, value),
    ]
    with contextlib.suppress(OptionError):
        parse_procedure("\n".join(lines), "f")


TARGET = """
[[targets]]
value_pa = { value = 45e6, source = 'contract 7', verified = true }
material = 'gravel'
moisture_from_percent = 5
"""


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("pfwd-procedure = 1", "pfwd-procedure = 2"), "expected pfwd-procedure = 1, got 2"),
        (("name = ", "nmae = "), "got 'nmae'; did you mean name"),
        (
            ("value = 2, ", "value = 2.5, "),
            r"drops\.seating\.value: expected a whole number from 0",
        ),
        (("value = 3, ", "value = 0, "), r"drops\.measured\.value: expected a whole number from 1"),
        (('{ value = 2.0, source = "contract 7, 2", verified = true }', "2.0"), "with its source"),
        (
            (", verified = true }\nmeasured", " }\nmeasured"),
            "verified: expected true or false, got none",
        ),
        (('source = "contract 7, 2"', 'source = " "'), "source: expected text"),
        (("value = 2.0", "value = -2.0"), r"formula\.factor\.value: expected a number > 0"),
        (("value = 2.0", "value = nan"), "value: expected a number > 0, got nan"),
        (('"E_LWD"', '"E_v2"'), 'quantity: expected "E_vd" or .* or "deflection", got .E_v2'),
        (("[formula]", "[formulas]"), "did you mean formula"),
        (("[formula]", "[checks]\nleast_load = 3\n[formula]"), "checks: expected a known key"),
        (
            ("factor =", "poisson_ratio ="),
            r"poisson_ratio\.value: expected a number from 0 to 0\.5",
        ),
        (('name = "ours"\n', ""), "name: expected text in quotation marks, not empty, got none"),
        (('title = "Ours"\n', ""), "title: expected text in quotation marks, not empty, got none"),
        (
            ('source = "contract 7"\n', ""),
            "source: expected text in quotation marks, not empty, got none",
        ),
        (('name = "ours"', 'name = " "'), "name: expected text in quotation marks, not empty"),
        (('name = "ours"', "name = 7"), "name: expected text in quotation marks, not empty, got 7"),
        (("pfwd-procedure = 1", ""), "expected pfwd-procedure = 1, got none"),
        (("pfwd-procedure = 1", "pfwd-procedure = true"), "expected pfwd-procedure = 1"),
        (('quantity = "E_LWD"\n', ""), 'quantity: expected "E_vd" or .*, got none'),
        (
            ("quantity =", 'average = "median"\nquantity ='),
            'average: expected "deflection" or "modulus"',
        ),
        (
            ("value = 2, ", "value = 101, "),
            r"seating\.value: expected a whole number from 0 to 100",
        ),
        (
            ("value = 3, ", "value = 100.5, "),
            r"measured\.value: expected a whole number from 1 to 100",
        ),
        (("value = 2.0", "value = 0"), r"factor\.value: expected a number > 0, got 0"),
        (("value = 2.0", "value = true"), "value: expected a number > 0, got True"),
        (("{ value = 2.0, ", "{ "), "value: expected a number > 0, got none"),
        (("verified = true }\n[formula]", "verified = 1 }\n[formula]"), "true or false, got 1"),
        (('source = "contract 7, 2", ', ""), "source: expected text .*, got none"),
        (("[drops]", "drops = 3\n[other]"), "expected a known key, got 'other'"),
        (("material = 'gravel'", "material = 3"), r"targets\[1\]\.material: expected text"),
        (
            ("percent = 5", "percent = '5'"),
            "moisture_from_percent: expected a finite number, in percent",
        ),
        (
            ("percent = 5", "percent = true"),
            "moisture_from_percent: expected a finite number, in percent",
        ),
        (("value = 45e6", "value = 0"), r"value_pa\.value: expected a number > 0, in Pa, got 0"),
        (("value_pa", "value_m"), "expected value_pa for E_LWD, got value_m"),
        (("[[targets]]", "[targets]"), "targets: expected an array of tables"),
    ],
)
def test_every_rule_of_the_format_is_kept(change: tuple[str, str], message: str) -> None:
    text = PLAIN + TARGET
    assert parse_procedure(text, "ours.toml").targets[0].value.value == 45e6
    assert change[0] in text
    with pytest.raises(OptionError, match=f"^ours.toml.*{message}"):
        parse_procedure(text.replace(*change, 1), "ours.toml")


def test_what_lies_on_a_bound_is_taken() -> None:
    for old, new in (("value = 2, ", "value = 0, "), ("value = 2, ", "value = 100, ")):
        assert parse_procedure(PLAIN.replace(old, new), "t").seating is not None
    for ratio in ("0", "0.5"):
        given = f"poisson_ratio = {{ value = {ratio}, source = 'x', verified = true }}\n"
        assert parse_procedure(PLAIN + given, "t").poisson_ratio is not None
    with pytest.raises(OptionError, match=r"a number from 0 to 0\.5, got 0\.51"):
        parse_procedure(PLAIN + given.replace("0.5,", "0.51,"), "t")
    check = "[checks]\nleast_peak_load_n = {{ value = {}, source = 'x', verified = true }}\n"
    assert parse_procedure(PLAIN + check.format(0), "t").checks["least_peak_load_n"].value == 0
    with pytest.raises(OptionError, match=r"least_peak_load_n\.value: expected a number >= 0"):
        parse_procedure(PLAIN + check.format(-0.5), "t")


def test_the_formula_of_e_vd_needs_its_nominal_pressure() -> None:
    with pytest.raises(OptionError, match="nominal_pressure_pa for E_vd, got none"):
        parse_procedure(PLAIN.replace("E_LWD", "E_vd"), "t")


def test_a_target_of_a_deflection_is_in_metres() -> None:
    text = (PLAIN + TARGET).replace("E_LWD", "deflection").replace("value_pa", "value_m")
    assert parse_procedure(text.replace("45e6", "0.5e-3"), "t").targets[0].value.value == 0.5e-3
    both = text + "value_pa = { value = 45e6, source = 'contract 7', verified = true }\n"
    with pytest.raises(OptionError, match=r"expected value_m for deflection, got .*value_m"):
        parse_procedure(both, "t")


def test_a_target_without_bounds_is_for_every_moisture() -> None:
    open_end = parse_procedure(PLAIN + TARGET, "t")
    assert open_end.target_for(99.0, "gravel") is not None
    assert open_end.target_for(4.9, "gravel") is None
    everything = parse_procedure(PLAIN + "\n".join(TARGET.splitlines()[:3]), "t")
    assert everything.target_for(None, None) is not None
    assert everything.target_for(3.0, "clay") is not None
    unverified = PLAIN + TARGET.replace("true", "false")
    assert parse_procedure(unverified, "t").target_for(6.0, "gravel") is None
    bold = parse_procedure(unverified, "t", enforce_unverified=True)
    assert bold.target_for(6.0, "gravel") is not None


def test_who_does_not_ask_enforces_nothing_unverified() -> None:
    text = PLAIN.replace("true", "false")
    assert parse_procedure(text, "t").seating_drops is None
    assert parse_procedure(text, "t", enforce_unverified=True).seating_drops == 2
    # The other way of making one, and the one that a survey keeps.
    careful = find_procedure("astm-e2835")
    rebuilt = type(careful)(
        name=careful.name, title=careful.title, source=careful.source, seating=careful.seating
    )
    assert rebuilt.seating_drops is None
    assert careful.as_recorded()["enforce_unverified"] is False


def test_only_those_of_the_program_have_no_file(tmp_path: Path) -> None:
    assert [procedure.file for procedure in shipped_procedures()] == [None] * len(shipped_names())
    assert find_procedure("mndot").file is None
    assert parse_procedure(PLAIN, "somewhere").file == "somewhere"
    upper = tmp_path / "OURS.TOML"
    with pytest.raises(OptionError, match="readable TOML file"):
        find_procedure(str(upper))
    other = tmp_path / "ours"
    other.write_text(PLAIN, encoding="utf-8")
    assert find_procedure(str(other)).name == "ours"
    assert find_procedure(str(other), enforce_unverified=True).enforce_unverified


def test_a_file_has_at_most_100_000_characters(tmp_path: Path) -> None:
    path = tmp_path / "ours.toml"
    path.write_text(PLAIN + "#" * (100_000 - len(PLAIN)), encoding="utf-8")
    assert read_procedure(path).name == "ours"
    path.write_text(PLAIN + "#" * (100_001 - len(PLAIN)), encoding="utf-8")
    with pytest.raises(OptionError, match="expected at most 100000 characters, got more"):
        read_procedure(path)


def test_numbers_are_found_by_their_keys() -> None:
    numbers = parse_procedure(PLAIN + TARGET, "t").numbers()
    assert {key: number.value for key, number in numbers.items()} == {
        "seating": 2.0,
        "measured": 3.0,
        "factor": 2.0,
        "target 1": 45e6,
    }
    german = find_procedure("tp-bf-stb-b8.3").numbers()
    assert {"nominal_pressure_pa", "nominal_load_n", "plate_radius_m"} <= set(german)
