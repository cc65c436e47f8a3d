"""Reading a survey costs each drop the same, and gives what a plain look at all of them gives."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.power_loss import make_record
from pfwd_device.recording import (
    DropRecord,
    Storage,
    Survey,
    SurveyPoint,
    SurveyWriter,
    read_drop_file,
    read_survey,
)
from pfwd_device.recording.index import build_index
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.publishing import InlinePublisher
from pfwd_device.recording.recovery import lost_texts
from tests.pfwd_device.recording.operations import growth, operations

FLAT = 1.2
"""How much more a drop may cost among many; the square would be 4 or more."""


class UnsyncedStorage(Storage):
    """Does not wait for the disk."""

    def sync(self, descriptor: int) -> None:
        """Nothing."""

    def sync_directory(self, path: Path) -> None:
        """Nothing."""


def record(folder: Path, drops: int, *, publish: bool = False, per_point: int = 2) -> Path:
    """A survey of small drops, with what is said of points and drops later."""
    storage = UnsyncedStorage()
    with SurveyWriter.open(
        folder,
        storage=storage,
        publish=publish,
        publisher=InlinePublisher(storage),
        reserve_bytes=0,
    ) as writer:
        for number in range(1, drops + 1):
            made = make_record(number, np.random.default_rng(number), 4)
            drop = type(made.drop)(
                (number - 1) % per_point + 1, made.drop.time, made.drop.load, made.drop.channels
            )
            name = f"P {(number - 1) // per_point + 1}"
            saved = writer.save_drop(type(made)(name, drop, made.counts, {}, made.metadata))
            writer.save_result(saved, {"modulus_pa": 1e6 * number})
            writer.edit("note", f"drop {number}", number=saved)
            writer.edit("note", f"point of {number}", point=name)
    return folder


def test_operations_are_counted() -> None:
    assert operations(lambda: None) < operations(lambda: [n + 1 for n in range(100)])

    def square(size: int) -> Callable[[], object]:
        return lambda: [n for n in range(size) for _ in range(size)]

    def line(size: int) -> Callable[[], object]:
        return lambda: [n + 1 for n in range(size)]

    assert growth(square, 50) > 3
    assert growth(line, 50) == pytest.approx(1.0, abs=0.05)


def test_a_survey_is_read_at_the_same_cost_for_each_drop(tmp_path: Path) -> None:
    def indexing(drops: int) -> Callable[[], object]:
        layout = Layout(record(tmp_path / str(drops), drops))
        return lambda: build_index(layout)

    def joining(drops: int) -> Callable[[], object]:
        layout = Layout(tmp_path / str(drops))
        index = build_index(layout)
        return lambda: Survey(layout, index)

    assert growth(indexing, 50) < FLAT
    assert growth(joining, 50) < FLAT


def test_a_survey_whose_journal_is_lost_is_read_at_the_same_cost_for_each_drop(
    tmp_path: Path,
) -> None:
    kept = read_drop_file(record(tmp_path / "kept", 1, publish=True) / "drops/drop-000001.h5")

    def joining(drops: int) -> Callable[[], object]:
        folder = record(tmp_path / str(drops), drops)
        (folder / "journal" / "0001.pfwdj").unlink()
        layout = Layout(folder)
        index = build_index(layout)
        assert len(index.lost_drops) == drops
        return lambda: FromFiles(layout, index)

    class FromFiles(Survey):
        """Every drop has a file, without the time that HDF5 takes."""

        def _from_file(self, number: int) -> DropRecord | None:
            return replace(kept, point=f"P {number // 2}")

    assert growth(joining, 50) < FLAT


def plain_points(survey: Survey) -> list[tuple[Any, ...]]:
    """The points with their drops, by a look at every drop for every point."""
    index = survey._index
    drops = {entry.number: survey._drop(entry) for entry in index.drops.values()}
    for number in sorted({*index.lost_drops, *survey._layout.drop_files()} - set(drops)):
        kept = survey._from_file(number)
        if kept is not None:
            drops[number] = survey._drop_of_file(number, kept)
    known = dict(index.points)
    for drop in drops.values():
        known.setdefault(drop.point, {"name": drop.point, "order": len(known) + 1, "declared": {}})
    ordered = sorted(known.values(), key=lambda point: int(point["order"]))
    return [
        said(survey._point(point, tuple(d for _, d in sorted(drops.items()) if d.point == name)))
        for point in ordered
        for name in [point["name"]]
    ]


def plain_damage(survey: Survey) -> tuple[str, ...]:
    """What is lost and in no file, by a look at every drop for every text."""
    return tuple(
        text
        for text in lost_texts(survey._index)
        if not any(
            text == f"drop {drop.point}/{drop.drop} is lost"
            for drop in survey.drops
            if drop.source == "file"
        )
    )


def said(point: SurveyPoint) -> tuple[Any, ...]:
    """Everything that a point says of itself and its drops."""
    drops = [
        (
            *(drop.number, drop.point, drop.drop, drop.key, drop.discarded, drop.notes),
            *(drop.position, drop.target, drop.edits, drop.results, drop.file, drop.source),
        )
        for drop in point.drops
    ]
    return (
        *(point.name, point.title, point.order, point.declared, point.discarded),
        *(point.notes, point.position, point.target, point.edits, drops),
    )


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("many") / "survey", 6, publish=True)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    damage=st.lists(
        st.tuples(
            st.sampled_from(["journal", "acknowledged.txt", "drops"]),
            st.floats(0.0, 1.0, exclude_max=True),
            st.sampled_from(["flip", "cut", "unlink"]),
        ),
        max_size=4,
    )
)
def test_a_damaged_survey_is_what_a_plain_look_makes_of_it(
    published: Path, tmp_path: Path, damage: list[tuple[str, float, str]]
) -> None:
    folder = tmp_path / "copy"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(published, folder)
    for name, place, how in damage:
        files = [folder / name] if name.endswith(".txt") else sorted((folder / name).iterdir())
        files = [path for path in files if path.exists()]
        if not files:
            continue
        path = files[int(place * len(files))]
        data = bytearray(path.read_bytes())
        at = int(place * len(data))
        if how == "unlink":
            path.unlink()
            continue
        if how == "flip" and data:
            data[at] ^= 1
        path.write_bytes(data if how == "flip" else data[:at])
    if not (folder / "acknowledged.txt").exists() and not any(folder.glob("*/*.*")):
        return  # nothing of a survey is left
    survey = read_survey(folder)
    assert [said(point) for point in survey.points] == plain_points(survey)
    assert survey.damage == plain_damage(survey)
    numbers = [drop.number for drop in survey.drops]
    assert numbers == sorted(drop.number for point in survey.points for drop in point.drops)
