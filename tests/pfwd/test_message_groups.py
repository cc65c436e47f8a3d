"""Messages that differ only in their numbers become one."""

from inversion.notices import Notice
from pfwd.message_groups import as_ranges, group_messages


def suspects(*radii: float) -> list[tuple[str, Notice]]:
    return [
        (place, Notice("plate-radius-suspect", {"plate_radius_m": radius}))
        for place, radius in zip("ABC", radii, strict=False)
    ]


def test_three_values_become_a_range_and_two_are_listed() -> None:
    (group,) = group_messages(suspects(15.0, 30.0, 20.0))
    assert (group.text, group.places) == (
        "units suspect: plate_radius_m = 15–30 (in metres?)",
        ("A", "B", "C"),
    )
    (group,) = group_messages(suspects(15.0, 30.0))
    assert group.text == "units suspect: plate_radius_m = 15 and 30 (in metres?)"


def test_messages_with_different_texts_stay_separate() -> None:
    messages = [
        ("A", Notice("effect-ambiguous", {"effect": effect, "others": ("layer",)}))
        for effect in ("bedrock", "seating", "bedrock")
    ]
    assert [group.places for group in group_messages(messages)] == [("A",), ("A",)]


def test_ranges_follow_the_order_and_not_the_alphabet() -> None:
    order = ["9", "10", "11", "2", "1"]
    assert as_ranges(["11", "10", "9"], order) == "9 to 11"
    assert as_ranges(["9", "2", "1"], order) == "9, 2, 1"
    assert as_ranges([], order) == ""
