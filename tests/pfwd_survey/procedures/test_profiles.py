"""Procedures as they are read: every number with its source, nothing guessed."""

import contextlib
import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfwd_survey.errors import OptionError
from pfwd_survey.procedures import (
    Quantity,
    find_procedure,
    parse_procedure,
    read_procedure,
    shipped_names,
    shipped_procedures,
)
from pfwd_survey.procedures.profile import CHECKS

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
    folder = resources.files("pfwd_survey.procedures").joinpath("profiles")
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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("pfwd-procedure = 1", "pfwd-procedure = 2"), "expected pfwd-procedure = 1, came 2"),
        (("name = ", "nmae = "), "came 'nmae'; did you mean name"),
        (("value = 2, ", "value = 2.5, "), r"\[drops\] seating: expected a whole number from 0"),
        (("value = 3, ", "value = 0, "), r"\[drops\] measured: expected a whole number from 1"),
        (('{ value = 2.0, source = "contract 7, 2", verified = true }', "2.0"), "with its source"),
        ((", verified = true }\nmeasured", " }\nmeasured"), "verified, true or false, came none"),
        (('source = "contract 7, 2"', 'source = " "'), "expected source, a text"),
        (("value = 2.0", "value = -2.0"), r"\[formula\] factor: expected a number > 0"),
        (("value = 2.0", "value = nan"), "expected value, a finite number"),
        (('"E_LWD"', '"E_v2"'), "quantity, one of E_vd, E_LWD, modulus, deflection, came 'E_v2'"),
        (("[formula]", "[formulas]"), "did you mean formula"),
        (("[formula]", "[checks]\nleast_load = 3\n[formula]"), r"\[checks\]: expected a key"),
        (("factor =", "poisson_ratio ="), r"\[formula\] poisson_ratio: expected 0 <= number"),
    ],
)
def test_a_fault_is_told_with_its_place(change: tuple[str, str], message: str) -> None:
    assert change[0] in PLAIN
    with pytest.raises(OptionError, match=f"^ours.toml.*{message}"):
        parse_procedure(PLAIN.replace(*change, 1), "ours.toml")


def test_a_modulus_without_its_factor_is_refused() -> None:
    with pytest.raises(OptionError, match="factor for E_LWD, came none"):
        parse_procedure(PLAIN.split("[formula]")[0], "ours.toml")


def test_unreadable_files_are_told(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="readable TOML file"):
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
    from pfwd_survey.files.toml import toml_line

    lines = [
        "pfwd-procedure = 1",
        *(f'{name} = "x"' for name in ("name", "title", "source") if name != key),
        *(['quantity = "modulus"'] if key != "quantity" else []),
        toml_line(key, value),
    ]
    with contextlib.suppress(OptionError):
        parse_procedure("\n".join(lines), "f")


def test_every_check_of_a_profile_is_known_by_name() -> None:
    for procedure in shipped_procedures():
        assert set(procedure.checks) <= set(CHECKS)
