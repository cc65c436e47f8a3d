"""Messages that mean the same as one; what only looks like a number stays."""

import pytest

from pfwd.message_groups import as_ranges, fill, group_messages, split_numbers


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("drop 3 of 12", ("3", "12")),
        ("12-points.prjz, line 7: 64%", ("7", "64")),
        ("2022-01-21 at 14:05, 12+320, E2583, station_1", ()),
        ("is -0.0 to +152.9 % off", ("-0.0 to +152.9",)),
        ("1.5e-3 m (0.002)", ("1.5e-3", "0.002")),
        ("100 kPa.", ("100",)),
        ("a {} b 4", ("4",)),
    ],
)
def test_numbers_of_a_message(text: str, numbers: tuple[str, ...]) -> None:
    pattern, found = split_numbers(text)
    assert found == numbers
    assert fill(pattern, found) == text.replace("{}", "( )")


def test_many_values_become_a_range_and_two_are_listed() -> None:
    said = [("A", "1 kN and 7 m"), ("B", "10 kN and 7 m"), ("C", "9 kN and 7 m")]
    assert [g.text for g in group_messages(said)] == ["1–10 kN and 7 m"]
    assert [g.text for g in group_messages(said[:2])] == ["1 and 10 kN and 7 m"]


def test_signs_are_not_taken_for_dashes() -> None:
    said = [(i, f"{v:+.1f} % off") for i, v in enumerate((-2.0, 3.0, 1.0))]
    assert group_messages(said)[0].text == "-2.0 to +3.0 % off"
    said = [("A", "-1 to +2 %"), ("B", "-3 to +1 %")]
    assert group_messages(said)[0].text == "-3 to +2 %"


def test_a_place_counts_once() -> None:
    (group,) = group_messages([("A", "x"), ("B", "x"), ("A", "x")])
    assert group.places == ("A", "B")


def test_ranges_follow_the_order_and_not_the_alphabet() -> None:
    order = ["9", "10", "11", "2", "1"]
    assert as_ranges(["11", "10", "9"], order) == "9 to 11"
    assert as_ranges(["9", "2", "1"], order) == "9, 2, 1"
    assert as_ranges([], order) == ""
