"""The numbers that drops get, compared with a look at every drop, which is how they were found."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pfwd_device.recording import DropRecord
from pfwd_device.recording.framing import RecordKind
from pfwd_device.recording.index import DropEntry, Index
from pfwd_device.recording.ledger import Entry, about_drop
from tests.pfwd_device.recording.records import open_survey

POINTS = ("A", "B")

DROPS = st.lists(st.tuples(st.integers(1, 6), st.sampled_from(POINTS), st.integers(1, 6)))
"""Survey-wide number, point and number within it, over one another as no writer leaves them."""


def entry_of(sequence: int, number: int, point: str, drop: int) -> Entry:
    return Entry(sequence, RecordKind.DROP, 1, 0, 48, 0, about_drop(number, point, drop))


def index_of(drops: list[tuple[int, str, int]], lost: list[tuple[int, str, int]]) -> Index:
    index = Index()
    for sequence, (number, point, drop) in enumerate(drops, start=1):
        data = {"number": number, "point": point, "drop": drop}
        index.add(entry_of(sequence, number, point, drop), data)
        index.next_drop(point)  # what was said once must not be remembered for ever
    for sequence, (number, point, drop) in enumerate(lost, start=len(drops) + 1):
        index.lost[sequence] = entry_of(sequence, number, point, drop)
    return index


@given(drops=DROPS, lost=DROPS)
def test_numbers_agree_with_a_scan_of_every_drop(
    drops: list[tuple[int, str, int]], lost: list[tuple[int, str, int]]
) -> None:
    index = index_of(drops, lost)
    assert index.next_number() == max([0, *index.drops, *index.lost_drops]) + 1
    for point in (*POINTS, "C"):
        used = [drop for _, name, drop in drops if name == point]
        lost_numbers = [drop for name, drop in index.lost_drops.values() if name == point]
        assert index.next_drop(point) == max([0, *used, *lost_numbers]) + 1
        for drop in range(8):
            assert index.is_used(point, drop) == (drop in used)


class CountingDrops(dict[int, DropEntry]):
    """Drops that count how often all of them are looked at."""

    looks = 0

    def __iter__(self) -> Iterator[int]:
        self.looks += 1
        return super().__iter__()

    def values(self) -> Any:
        self.looks += 1
        return super().values()


def test_a_drop_is_saved_without_a_scan_of_all_drops(
    tmp_path: Path, new_record: Callable[[int], DropRecord], monkeypatch: pytest.MonkeyPatch
) -> None:
    with open_survey(tmp_path) as writer:
        drops = CountingDrops()
        monkeypatch.setattr(writer._index, "drops", drops)
        for number in range(1, 21):
            record = new_record(number)
            assert writer.next_number(record.point) == record.drop.number
            assert writer.save_drop(record) == number
        assert len(drops) == 20
        assert drops.looks == 0
