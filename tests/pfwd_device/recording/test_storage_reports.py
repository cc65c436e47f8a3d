"""Sentences on the safety of the recorded data."""

from pathlib import Path

import pytest

from pfwd_device.recording import SurveyNotSafe


@pytest.mark.parametrize(
    ("drops", "lost", "text"),
    [
        (0, (), "further drops; pfwd recover moves them"),
        (4, (), "4 earlier drops and all further ones; pfwd recover moves them"),
        (
            0,
            tuple(f"drop 1/{n}" for n in range(1, 13)),
            "further drops; pfwd recover moves them. 12 records could not be read "
            f"({', '.join(f'drop 1/{n}' for n in range(1, 11))}, ...); pfwd recover restores drops "
            "that have a file",
        ),
    ],
)
def test_the_spare_folder_and_lost_records_are_named(
    drops: int, lost: tuple[str, ...], text: str
) -> None:
    report = SurveyNotSafe("site 1: no space left", Path("spare"), drops, lost)
    assert report.text == f"NOT SAFE: site 1: no space left. Written to spare: {text}"


def test_without_a_spare_folder_the_reason_is_named() -> None:
    assert SurveyNotSafe("site 1: no space left").text == "NOT SAFE: site 1: no space left"
