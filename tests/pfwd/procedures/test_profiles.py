"""Procedures as files: every number has its source."""

import contextlib
import tomllib
from collections.abc import Iterator
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


def numbers_in(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path of every number of a TOML file, with the table that contains it."""
    pairs = {dict: dict.items, list: enumerate}.get(type(value), lambda _: ())
    for key, item in pairs(value):
        if isinstance(item, int | float) and not isinstance(item, bool):
            yield f"{path}.{key}", value
        else:
            yield from numbers_in(item, f"{path}.{key}")


@pytest.mark.parametrize("name", shipped_names())
def test_every_shipped_number_has_a_source_or_says_that_it_is_not_verified(name: str) -> None:
    # From the file itself: the reader must not be what proves it.
    folder = resources.files("pfwd.procedures").joinpath("profiles")
    table = tomllib.loads(folder.joinpath(f"{name}.toml").read_text(encoding="utf-8"))
    del table["pfwd-procedure"]
    entries = list(numbers_in(table))
    assert entries
    for path, entry in entries:
        assert path.endswith(".value"), f"{path} stands without a source"
        assert len(entry["source"]) > 10, path
        assert entry["verified"] in (True, False), path
        hedged = any(word in entry["source"] for word in ("circulates", "circulate", "not seen"))
        assert not (hedged and entry["verified"]), f"{path} is verified by hearsay"


@pytest.mark.parametrize(
    ("name", "drops", "average"),
    [
        ("astm-e2583", (None, None), "deflection"),
        ("astm-e2835", (None, None), "deflection"),
        ("mchw-885", (3, 3), "modulus"),
        ("mndot", (3, 3), "deflection"),
        ("paper", (None, None), "modulus"),
        ("tp-bf-stb-b8.3", (3, 3), "deflection"),
    ],
)
def test_a_shipped_procedure_is_its_document(
    name: str, drops: tuple[int | None, int | None], average: str
) -> None:
    procedure = find_procedure(name)
    assert (procedure.seating_drops, procedure.measured_drops) == drops
    assert procedure.average == average


def test_unverified_numbers_are_enforced_on_request() -> None:
    careful = find_procedure("astm-e2835")
    assert careful.limit("most_deflection_spread") is None
    bold = find_procedure("astm-e2835", enforce_unverified=True)
    assert (bold.seating_drops, bold.measured_drops) == (3, 3)
    assert bold.limit("most_deflection_spread") == 0.1
    # A procedure that is built by its fields, and the one that a survey stores.
    text = {"name": careful.name, "title": careful.title, "source": careful.source}
    assert type(careful)(**text, seating=careful.seating).seating_drops is None
    assert careful.as_recorded()["enforce_unverified"] is False


def test_a_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "ours"
    path.write_text(PLAIN, encoding="utf-8")
    procedure = find_procedure(str(path), enforce_unverified=True)
    assert (procedure.name, procedure.quantity) == ("ours", Quantity.E_LWD)
    assert procedure.file == str(path)
    assert procedure.enforce_unverified
    assert parse_procedure(procedure.text, "again").seating_drops == 2
    shipped = list(shipped_procedures())
    assert [procedure.name for procedure in shipped] == sorted(shipped_names())
    assert [procedure.file for procedure in shipped] == [None] * 6


def test_targets_are_chosen_by_moisture_and_material() -> None:
    text = PLAIN + "".join(
        f"[[targets]]\nvalue_pa = {{ value = {value}e6, source = 'contract 7', verified = true }}\n"
        f"material = 'gravel'\nmoisture_from_percent = {low}\nmoisture_to_percent = {high}\n"
        for value, low, high in ((80, 5, 7), (67, 7, 9))
    )
    procedure = parse_procedure(text, "t")
    targets = {m: procedure.target_for(m, "gravel") for m in (4.9, 5.0, 6.99, 7.0, 9.0)}
    chosen = {moisture: target and target.value.value for moisture, target in targets.items()}
    assert chosen == {4.9: None, 5.0: 80e6, 6.99: 80e6, 7.0: 67e6, 9.0: None}
    assert procedure.target_for(6.0, "clay") is None
    assert procedure.target_for(None, "gravel") is None, "the moisture is not known"


def test_a_modulus_without_its_factor_is_refused() -> None:
    with pytest.raises(OptionError, match="factor for E_LWD, got none"):
        parse_procedure(PLAIN.split("[formula]")[0], "ours.toml")


def test_unreadable_files_are_rejected(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="readable TOML file"):
        read_procedure(tmp_path / "none.toml")
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(OptionError, match="UTF-8"):
        read_procedure(tmp_path / "bytes.toml")
    for name, message in (("mndott", "lists them"), ("OURS.TOML", "readable TOML file")):
        with pytest.raises(OptionError, match=message):
            find_procedure(name)


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
    ("old", "new", "message"),
    [
        ("pfwd-procedure = 1", "pfwd-procedure = 2", "pfwd-procedure = 1, got 2"),
        ("pfwd-procedure = 1", "", "pfwd-procedure = 1, got none"),
        ("name = ", "nmae = ", "got 'nmae'; did you mean name"),
        ('name = "ours"\n', "", "name: .*, got none"),
        ('name = "ours"', 'name = " "', "name: .*, not empty"),
        ('title = "Ours"\n', "", "title: .*, got none"),
        ('source = "contract 7"\n', "", "source: .*, got none"),
        ('quantity = "E_LWD"\n', "", 'quantity: expected "E_vd" or .*, got none'),
        ("quantity =", 'average = "median"\nquantity =', "average: "),
        ("value = 2, ", "value = 101, ", r"drops\.seating\.value: .* from 0 to 100"),
        ("value = 3, ", "value = 0, ", r"drops\.measured\.value: .* from 1 to 100"),
        ('{ value = 2.0, source = "contract 7, 2", verified = true }', "2.0", "with its source"),
        (", verified = true }\nmeasured", " }\nmeasured", "verified: .* got none"),
        ('source = "contract 7, 2", ', "", "source: expected text .*, got none"),
        ("value = 2.0", "value = 0", r"factor\.value: expected a number > 0, got 0"),
        ("[formula]", "[checks]\nleast_load = 3\n[formula]", "checks: expected a known key"),
        ("percent = 5", "percent = '5'", "moisture_from_percent: expected a finite number"),
        ("value = 45e6", "value = 0", r"value_pa\.value: expected a number > 0, in Pa, got 0"),
        ("value_pa", "value_m", "expected value_pa for E_LWD, got value_m"),
    ],
)
def test_every_rule_of_the_format_is_enforced(old: str, new: str, message: str) -> None:
    text = PLAIN + TARGET
    assert parse_procedure(text, "ours.toml").targets[0].value.value == 45e6
    assert old in text
    with pytest.raises(OptionError, match=f"^ours.toml.*{message}"):
        parse_procedure(text.replace(old, new, 1), "ours.toml")


def test_numbers_on_a_bound_are_accepted() -> None:
    for old, new in (("value = 2, ", "value = 0, "), ("value = 2, ", "value = 100, ")):
        assert parse_procedure(PLAIN.replace(old, new), "t").seating is not None
    for ratio in ("0", "0.5"):
        ratio_line = f"poisson_ratio = {{ value = {ratio}, source = 'x', verified = true }}\n"
        assert parse_procedure(PLAIN + ratio_line, "t").poisson_ratio is not None
    with pytest.raises(OptionError, match=r"a number from 0 to 0\.5, got 0\.51"):
        parse_procedure(PLAIN + ratio_line.replace("0.5,", "0.51,"), "t")
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


def test_a_file_is_limited_to_100_000_characters(tmp_path: Path) -> None:
    path = tmp_path / "ours.toml"
    path.write_text(PLAIN + "#" * (100_000 - len(PLAIN)), encoding="utf-8")
    assert read_procedure(path).name == "ours"
    path.write_text(PLAIN + "#" * (100_001 - len(PLAIN)), encoding="utf-8")
    with pytest.raises(OptionError, match="expected at most 100000 characters, got more"):
        read_procedure(path)


def test_numbers_are_listed_by_their_keys() -> None:
    numbers = parse_procedure(PLAIN + TARGET, "t").numbers()
    assert {key: number.value for key, number in numbers.items()} == {
        "seating": 2.0,
        "measured": 3.0,
        "factor": 2.0,
        "target 1": 45e6,
    }
    german = find_procedure("tp-bf-stb-b8.3").numbers()
    assert {"nominal_pressure_pa", "nominal_load_n", "plate_radius_m"} <= set(german)
