"""Pictures as SVG, by one process and by two."""

import base64
from operator import methodcaller
from pathlib import Path

import pytest

from pfwd_device.recording.layout import Layout
from pfwd_survey.reporting import pictures_as_svg
from pfwd_survey.reporting.blocks import Picture
from pfwd_survey.reporting.pictures_as_svg import (
    MANY_DROPS,
    SecondDrawer,
    data_addresses,
    second_drawer,
)

PICTURES = [
    Picture(methodcaller("suptitle", text), 40.0, "caption", "alternative") for text in "ABCDEF"
]


def test_two_processes_draw_what_one_does() -> None:
    alone = list(data_addresses(PICTURES))
    assert len(set(alone)) == len(PICTURES)
    head, data = alone[0].split(",")
    assert head == "data:image/svg+xml;base64"
    assert base64.b64decode(data).startswith(b"<?xml")
    second = SecondDrawer()
    try:
        # It has drawn all of them before this one begins.
        asked = second.ask(PICTURES)
        assert [future.result() for future in asked if future is not None] == alone
        assert list(data_addresses(PICTURES, second)) == alone
    finally:
        second.close()


def test_a_second_process_that_has_ended_leaves_the_pictures_to_this_one() -> None:
    second = SecondDrawer()
    second.ask(PICTURES[:1])[0].result()  # type: ignore[union-attr]
    for process in second._pool._processes.values():
        process.kill()
    try:
        assert list(data_addresses(PICTURES[:2], second)) == list(data_addresses(PICTURES[:2]))
    finally:
        second.close()


def survey_of(folder: Path, size: int) -> str:
    ledger = Layout(folder).ledger
    ledger.parent.mkdir(parents=True, exist_ok=True)
    ledger.write_bytes(b"x" * size)
    return str(folder)


@pytest.mark.parametrize(
    ("output", "size", "count", "helps"),
    [
        ("report.html", MANY_DROPS, 2, True),
        ("REPORT.HTML", MANY_DROPS, 2, True),
        ("report.pdf", MANY_DROPS, 2, False),
        ("report.html", MANY_DROPS - 1, 2, False),
        ("report.html", MANY_DROPS, 1, False),
    ],
)
def test_a_second_process_where_it_helps(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    output: str,
    size: int,
    count: int,
    helps: bool,
) -> None:
    ended = []

    class Drawer:
        def close(self) -> None:
            ended.append(True)

    monkeypatch.setattr(pictures_as_svg, "processors", lambda: count)
    monkeypatch.setattr(pictures_as_svg, "SecondDrawer", Drawer)
    with second_drawer(survey_of(tmp_path, size), output) as second:
        assert (second is not None) is helps
    assert bool(ended) is helps


def test_no_survey_and_no_process_to_be_had(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pictures_as_svg, "processors", lambda: 2)

    def refuse() -> SecondDrawer:
        raise OSError("no more processes")

    monkeypatch.setattr(pictures_as_svg, "SecondDrawer", refuse)
    with second_drawer(str(tmp_path / "none"), "report.html") as second:
        assert second is None
    with second_drawer(survey_of(tmp_path, MANY_DROPS), "report.html") as second:
        assert second is None
