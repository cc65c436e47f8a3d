"""Warnings as codes with values: their sentences and their JSON."""

import json
import math
import tomllib
from importlib import resources

import pytest

from inversion import notices
from inversion.notices import Notice, Value, from_json, text_of
from inversion.result import InversionResult

DEPTH = Notice("depth-not-unique", {"depth_low_m": 0.484, "depth_high_m": 1.3})


def test_a_warning_is_its_sentence_with_code_and_values() -> None:
    assert text_of(DEPTH).startswith(
        "depth not unique: the data allow bedrock from 0.48 m to 1.3 m;"
    )
    assert (DEPTH.code, dict(DEPTH.values)) == (
        "depth-not-unique",
        {"depth_low_m": 0.484, "depth_high_m": 1.3},
    )


def test_unknown_codes_and_values_are_refused() -> None:
    with pytest.raises(ValueError, match="expected the code of a message, got 'rain'"):
        Notice("rain")
    with pytest.raises(ValueError, match=r"expected \['parameter'\], got \['depth'\]"):
        Notice("parameter-on-bound", {"depth": 1.0})


def test_a_code_is_in_a_single_package() -> None:
    tables = [
        tomllib.loads(resources.files(package).joinpath("messages.toml").read_text("utf-8"))
        for package in ("inversion", "pfwd")
    ]
    codes = [code for table in tables for code in table["messages"]]
    assert len(codes) == len(set(codes))
    assert {*codes, "other"} == notices.templates().keys()
    assert {
        code for table in tables for level in table["invalidates"].values() for code in level
    } <= {*codes}


def test_numbers_are_in_the_unit_of_the_sentence() -> None:
    interval = (4.04e6, 1.63e8)
    warning = Notice("layer-modulus-unknown", {"layer": 1, "modulus_interval_pa": interval})
    assert text_of(warning) == "modulus of layer 1 not known: 4 to 160 MPa fit as well"


def test_a_number_rounded_to_zero_has_a_plus_sign() -> None:
    values = {"file": "a", "traces": "raw_channels", "deviation": (-0.0004, 0.691)}
    notice = Notice("stored-deflection-differs", values)
    assert "is +0.0 to +69.1 % off" in text_of(notice)


def test_json_has_the_codes_in_the_order_of_the_sentences() -> None:
    result = InversionResult(warnings=(Notice("not-converged"), DEPTH))
    written = json.loads(json.dumps(result.to_json()))
    keys = list(written)
    assert keys[keys.index("warnings") + 1] == "warning_codes"
    assert written["warnings"] == [text_of(warning) for warning in result.warnings or ()]
    assert written["warning_codes"] == [
        {"code": "not-converged", "values": {}},
        {"code": "depth-not-unique", "values": {"depth_low_m": 0.484, "depth_high_m": 1.3}},
    ]
    reread = InversionResult.from_json(written)
    assert reread == result
    assert [w.values for w in reread.warnings or ()] == [w.values for w in result.warnings or ()]


@pytest.mark.parametrize(
    "codes",
    [
        None,
        "not-converged",
        [3],
        [{"code": "of-a-later-version", "values": {}}],
        [{"code": "depth-not-unique", "values": {"depth_low_m": 0.5}}],
        [{"code": "depth-not-unique", "values": {"depth_low_m": [], "depth_high_m": "deep"}}],
    ],
)
def test_codes_that_cannot_be_read_leave_the_sentence(codes: object) -> None:
    (warning,) = from_json(["the fit did not converge"], codes)
    assert (warning.code, text_of(warning)) == ("other", "the fit did not converge")


def sample(form: str) -> Value:
    """A value for a gap of a template."""
    values: dict[str, Value] = {
        "": "abc", "words": "bedrock_depth", "names": "layer",
        "list": ("a", "b"), "d": 3, "more": 2,
        "terms": tuple(notices.terms())[:2] or "abc", "drops": (1, 2), "digits": "4.50",
        "message": DEPTH,
    }  # fmt: skip
    return values.get(form, 0.5)


def test_every_warning_is_read_by_its_code() -> None:
    for code, template in notices.templates().items():
        values = {name: sample(form) for name, form in notices.gaps_of(template).items()}
        warning = Notice(code, values)
        (reread,) = from_json([text_of(warning)], json.loads(json.dumps(notices.codes([warning]))))
        assert (reread.code, dict(reread.values)) == (code, dict(warning.values))


def test_further_cases_are_mentioned() -> None:
    values: dict[str, Value] = {"file": "a.F25", "line": 7, "more": 0}
    once, often = Notice("drop-cut-off", values), Notice("drop-cut-off", {**values, "more": 2})
    assert text_of(often) == f"{text_of(once)}; 2 more of that kind"


def test_numbers_that_json_does_not_know_come_back() -> None:
    warning = Notice("depth-not-unique", {"depth_low_m": 2.0, "depth_high_m": math.inf})
    written = json.dumps(notices.codes([warning]), allow_nan=False)
    (reread,) = from_json([text_of(warning)], json.loads(written))
    assert reread.values["depth_high_m"] == math.inf
