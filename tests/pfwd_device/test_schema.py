"""Keys, their values and the tables that they stand in."""

import datetime
import math
from dataclasses import dataclass, field
from typing import Any

import jsonschema
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd_device.errors import SetupError
from pfwd_device.schema import (
    JSON_SCHEMA,
    AnyOf,
    Array,
    Choice,
    Date,
    Flag,
    Integer,
    Key,
    Number,
    TableReader,
    Text,
    TomlTable,
    Value,
    describe,
    keys_of,
    readable_values,
    table_schema,
)

KINDS: list[tuple[Value, list[Any], list[Any], str]] = [
    (Number(), [0, -1.5], [math.inf, math.nan, True, "1", 10**400], "a finite number"),
    (Number("m", above=0), [1e-9], [0, -1, datetime.date(2026, 1, 1)], "a number > 0, in m"),
    (Number(minimum=0, below=0.5), [0, 0.49], [0.5, -1e-9], "a number >= 0 and < 0.5"),
    (Number("V", nonzero=True), [-1, 2], [0, 0.0], "a number other than 0, in V"),
    (Number(minimum=0, integral=True), [3, 3.0], [2.5, -1], "a whole number >= 0"),
    (
        Number("m", minimum=1, maximum=9, infinity_means="none"),
        [1, 9, math.inf],
        [0, 10, -math.inf],
        "a number from 1 to 9, in m, or inf for none",
    ),
    (Integer(1, 3), [1, 3], [0, 4, 2.0, True], "a whole number from 1 to 3"),
    (Text(), ["", "a\n"], [1, None], "text in quotation marks"),
    (Text(min_length=1), ["a"], ["", " "], "text in quotation marks, not empty"),
    (Text(4, min_length=1), ["abcd"], ["abcde", "", "a\x1b"], "text of 1 to 4 letters on one line"),
    (Choice(("up", "down")), ["up"], ["left", 1], '"up" or "down"'),
    (Choice(lambda: ["up"]), ["up"], ["down"], '"up"'),
    (Flag(), [True], [1, "true"], "true or false"),
    (
        Date(),
        [datetime.date(2026, 5, 31)],
        [datetime.datetime(2026, 5, 31), "2026-05-31"],
        "a date as 2026-05-31, without quotation marks",
    ),
    (Date(text=True), ["2026-05-31"], ["soon", 1], "a date as 2026-05-31"),
    (AnyOf((Text(), Number()), "either"), ["a", 1], [True, []], "either"),
    (Array(Number(), min_items=1), [[1]], [[], 1], "an array with 1 or more"),
    (Array(TomlTable({})), [[]], [{}], "an array of tables"),
    (TomlTable({}), [{}], [[], 1], "a table"),
]


@pytest.mark.parametrize(("kind", "accepted", "refused", "expected"), KINDS)
def test_a_kind_accepts_and_describes_its_values(
    kind: Value, accepted: list[Any], refused: list[Any], expected: str
) -> None:
    assert [value for value in accepted if not kind.accepts(value)] == []
    assert [value for value in refused if kind.accepts(value)] == []
    assert kind.expected == expected


@pytest.mark.parametrize("kind", [kind for kind, *_ in KINDS if not isinstance(kind, Date)])
@settings(max_examples=30)
@given(
    st.one_of(
        st.integers(-3, 12),
        st.floats(-3, 12).map(lambda value: round(value, 1)),
        st.booleans(),
        st.sampled_from(["", " ", "a", "up", "abcde"]),
        st.lists(st.integers(0, 2), max_size=2),
        st.just({}),
    )
)
def test_json_schema_and_reader_accept_the_same_values(kind: Value, value: Any) -> None:
    """JSON Schema knows 3.0 as an integer and no infinity; both are left out here."""
    if isinstance(kind, Integer) and isinstance(value, float):
        return
    if isinstance(kind, Number) and kind.infinity_means:
        return
    keys = {"key": Key(kind)}
    schema = {"$schema": JSON_SCHEMA, **table_schema(keys)}
    jsonschema.Draft202012Validator.check_schema(schema)
    is_valid = jsonschema.Draft202012Validator(schema).is_valid({"key": value})
    try:
        TableReader(ValueError).read({"key": value}, keys)
    except ValueError:
        assert not is_valid
    else:
        assert is_valid


@dataclass(frozen=True)
class Sample:
    mass: float = field(metadata=describe(Number("kg", above=0), "Mass.", key="mass_kg"))
    name: str = field(default="", metadata=describe(Text(8), "Name.", hint="short"))
    comment: str = ""


def test_the_keys_of_a_dataclass_come_from_its_fields() -> None:
    keys = keys_of(Sample)
    assert list(keys) == ["mass_kg", "name"]
    assert (keys["mass_kg"].attribute, keys["mass_kg"].required) == ("mass", True)
    assert not keys["name"].required
    values = TableReader(ValueError).read({"mass_kg": 2}, keys)
    assert Sample(**values) == Sample(2.0)


INNER = {"rate": Key(Number("Hz", above=0), hint="see the data sheet", required=True)}
KEYS = {"links": Key(Array(TomlTable(INNER))), "limits": Key(Array(Number(above=0)))}


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"links": [{"rate": 1}, {"rate": 0}]}, r"links\[2\]\.rate: expected a number > 0, in Hz"),
        ({"links": [{}]}, r"links\[1\]\.rate: expected .*, got none; see the data sheet"),
        (
            {"links": [{"rat": 1}]},
            r"links\[1\]: expected a known key, got 'rat'; did you mean rate",
        ),
        ({"links": [3]}, r"links\[1\]: expected a table, got 3"),
        ({"links": {}}, "links: expected an array of tables"),
        ({"limits": [1, -1]}, r"limits\[2\]: expected a number > 0, got -1"),
        ({"zzz": 1}, "f.toml: expected a known key, got 'zzz'; known are links, limits"),
        ([], r"f.toml: expected a table, got \[\]"),
    ],
)
def test_an_error_names_file_key_and_value(table: Any, message: str) -> None:
    with pytest.raises(SetupError, match=f"^f.toml.*{message}|^{message}"):
        TableReader(SetupError, "f.toml").read(table, KEYS)


def test_a_json_schema_has_meanings_limits_and_required_keys() -> None:
    schema = table_schema(keys_of(Sample))
    assert schema["required"] == ["mass_kg"]
    assert schema["additionalProperties"] is False
    assert schema["properties"]["mass_kg"] == {
        "type": "number",
        "exclusiveMinimum": 0,
        "description": "Mass. Expected a number > 0, in kg.",
    }
    assert table_schema({}, more_keys=True)["additionalProperties"] is True


def test_accepted_stored_values_are_read() -> None:
    table = {"mass_kg": 2, "name": "far too long a name", "other": 1}
    assert readable_values(table, keys_of(Sample)) == {"mass": 2.0}
    assert readable_values({"limits": [1, 2]}, KEYS) == {"limits": (1.0, 2.0)}
    assert readable_values({"limits": [1, -2]}, KEYS) == {}
    assert readable_values([1], KEYS) == {}
