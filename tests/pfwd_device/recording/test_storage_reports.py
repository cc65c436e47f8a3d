"""What the operator is told of the survey's files, word for word."""

from pathlib import Path

import pytest

from pfwd_device.recording import FallbackMerged, FilesRewritten, SpareUsed, SurveyFilesRemoved

HOME, SPARE = Path("site 1"), Path("spare")


@pytest.mark.parametrize(
    ("records", "drops", "words"),
    [
        (0, 0, "nothing was missing"),
        (5, 3, "3 drops and 2 other records written again"),
    ],
)
def test_files_written_again(records: int, drops: int, words: str) -> None:
    report = FilesRewritten(HOME, records, drops, ())
    assert report.text == f"safe again: site 1 contains all recorded data ({words})"


@pytest.mark.parametrize(
    ("lost", "names"),
    [
        (("drop 3",), "drop 3"),
        (tuple("abcdefghij"), "a, b, c, d, e, f, g, h, i, j"),
        (tuple("abcdefghijk"), "a, b, c, d, e, f, g, h, i, j, ..."),
    ],
)
def test_what_is_lost_is_named_up_to_ten(lost: tuple[str, ...], names: str) -> None:
    assert FilesRewritten(HOME, 20, 12, lost).text == (
        f"NOT SAFE: site 1 lost {len(lost)} records that could not be written again ({names}); "
        "pfwd recover restores drops that have a file"
    )


def test_what_is_not_safe_begins_with_it() -> None:
    assert SurveyFilesRemoved(HOME, "journal/0001.pfwdj: deleted").text == (
        "NOT SAFE in site 1: journal/0001.pfwdj: deleted; the recorded data are written again"
    )
    assert SpareUsed(HOME, SPARE, "no space left").text == (
        "NOT SAFE in site 1: no space left. Further records go to spare; they are moved back as "
        "soon as the folder can be written, or by pfwd recover"
    )
    assert FallbackMerged(HOME, SPARE, 9, 4).text == (
        "safe again: 4 drops were moved from spare to site 1"
    )
