"""Pictures as SVG, by one process and by two."""

import base64
import contextlib
import pickle
from collections.abc import Sequence
from concurrent.futures import Future, wait
from functools import partial
from operator import methodcaller
from pathlib import Path
from typing import Any

import pytest

from pfwd.report import pictures_as_svg
from pfwd.report.blocks import Picture
from pfwd.report.composing import compose
from pfwd.report.fonts import Letters
from pfwd.report.gathering import gather
from pfwd.report.html_file import _flat
from pfwd.report.pictures_as_svg import (
    MIN_DRAWN_LEDGER_BYTES,
    SecondDrawer,
    data_address,
    data_addresses,
    second_drawer,
)
from pfwd.report.report import ReportOptions, write_report
from pfwd.report.texts import load_texts
from pfwd_device.recording.layout import Layout

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
        asked = second.request(PICTURES)
        assert [future.result() for future in asked if future is not None] == alone
        assert list(data_addresses(PICTURES, second)) == alone
    finally:
        second.close()


def test_a_second_process_that_has_ended_leaves_the_pictures_to_this_one() -> None:
    second = SecondDrawer()
    second.request(PICTURES[:1])[0].result()  # type: ignore[union-attr]
    for process in second._pool.processes:
        process.kill()
    try:
        assert list(data_addresses(PICTURES[:2], second)) == list(data_addresses(PICTURES[:2]))
    finally:
        second.close()


class DoneFirst(SecondDrawer):
    """A second process that is done with all pictures before this one begins."""

    def request(self, pictures: Sequence[Picture]) -> Sequence[Future[str] | None]:
        futures = super().request(pictures)
        wait(future for future in futures if future is not None)
        return futures


def test_a_picture_that_cannot_be_pickled_is_drawn_by_this_process() -> None:
    only_here = Picture(lambda figure: figure.suptitle("G"), 40.0, "caption", "alternative")
    pictures = [*PICTURES[:2], only_here, *PICTURES[2:]]
    second = DoneFirst()
    try:
        assert list(data_addresses(pictures, second)) == list(data_addresses(pictures))
    finally:
        second.close()


def test_an_error_of_drawing_is_that_of_this_process() -> None:
    wrong = Picture(methodcaller("no_such_method"), 40.0, "caption", "alternative")
    second = DoneFirst()
    try:
        with pytest.raises(AttributeError, match="no_such_method"):
            list(data_addresses([*PICTURES[:2], wrong], second))
    finally:
        second.close()


def title_of_known_letters(figure: Any, letters: Letters) -> None:
    figure.suptitle(letters.drawable(f"H \N{GREEK SMALL LETTER MU} {letters.width('H', 9):.3f}"))


def test_the_second_process_draws_pictures_that_measure_letters() -> None:
    draw = partial(title_of_known_letters, letters=Letters())
    picture = Picture(draw, 40.0, "caption", "alternative")
    second = SecondDrawer()
    try:
        (future,) = second.request([picture])
        assert future is not None
        assert future.result() == data_address(picture)
    finally:
        second.close()


def test_all_pictures_of_a_report_reach_the_second_process(made: Path, tmp_path: Path) -> None:
    report = gather(made, ReportOptions(store=False))
    blocks = compose(report, load_texts("en"), Letters())
    pictures = [block for block in _flat(blocks) if isinstance(block, Picture)]
    captions = [picture.caption for picture in pictures if pickle.dumps(picture)]
    assert len(captions) == len(pictures) > 2
    second = DoneFirst()
    try:
        write_report(made, tmp_path / "report.html", ReportOptions(store=False), second=second)
    finally:
        second.close()
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert text.count('src="data:image/svg+xml;base64,') == len(pictures)


def survey_of(folder: Path, size: int) -> str:
    ledger = Layout(folder).ledger
    ledger.parent.mkdir(parents=True, exist_ok=True)
    ledger.write_bytes(b"x" * size)
    return str(folder)


@pytest.mark.parametrize(
    ("output", "size", "count", "helps"),
    [
        ("report.html", MIN_DRAWN_LEDGER_BYTES, 2, True),
        ("REPORT.HTML", MIN_DRAWN_LEDGER_BYTES, 2, True),
        ("report.pdf", MIN_DRAWN_LEDGER_BYTES, 2, False),
        ("report.html", MIN_DRAWN_LEDGER_BYTES - 1, 2, False),
        ("report.html", MIN_DRAWN_LEDGER_BYTES, 1, False),
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

    def drawer() -> contextlib.ExitStack:
        stack = contextlib.ExitStack()
        stack.callback(ended.append, True)
        return stack

    monkeypatch.setattr(pictures_as_svg, "processors", lambda: count)
    monkeypatch.setattr(pictures_as_svg, "SecondDrawer", drawer)
    with second_drawer(survey_of(tmp_path, size), output) as second:
        assert (second is not None) is helps
    assert bool(ended) is helps


def test_no_survey_to_be_had(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures_as_svg, "processors", lambda: 2)
    with second_drawer(str(tmp_path / "none"), "report.html") as second:
        assert second is None
