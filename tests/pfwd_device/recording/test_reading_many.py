"""Reading a survey costs each drop the same, and gives what a plain look at all of them gives."""

import shutil
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from benchmarks.scale import UnsyncedStorage
from pfwd_device.errors import RecordingError
from pfwd_device.recording import Survey, SurveyPoint, SurveyWriter, check, read_survey
from pfwd_device.recording import index as index_module
from pfwd_device.recording.framing import RecordKind
from pfwd_device.recording.index import Index, build_index, read_index
from pfwd_device.recording.layout import Layout
from pfwd_device.recording.ledger import Entry, about_drop, ledger_bytes
from pfwd_device.recording.recovery import recover
from tests.pfwd_device.recording.operations import growth
from tests.pfwd_device.recording.records import journal_of, make_survey, open_survey, record_of

FLAT = 1.2
"""Largest growth of the cost of a drop among many; a square would be 4 or more."""


def record(folder: Path, drops: int, *, publish: bool = False, per_point: int = 2) -> Path:
    """A survey of small drops, with what is said of points and drops later."""
    storage = UnsyncedStorage()
    with open_survey(folder, storage=storage, publish=publish) as writer:
        for number in range(1, drops + 1):
            made = record_of(number, 4)
            drop = type(made.drop)(
                (number - 1) % per_point + 1, made.drop.time, made.drop.load, made.drop.channels
            )
            name = f"P {(number - 1) // per_point + 1}"
            saved = writer.save_drop(type(made)(name, drop, made.counts, {}, made.metadata))
            writer.save_result(saved, {"modulus_pa": 1e6 * number})
            writer.edit("note", f"drop {number}", number=saved)
            writer.edit("note", f"point of {number}", point=name)
    return folder


def test_a_survey_is_read_at_the_same_cost_for_each_drop(tmp_path: Path) -> None:
    layouts = {drops: Layout(record(tmp_path / str(drops), drops)) for drops in (25, 50, 200)}
    for read in (build_index, read_index):
        assert growth(lambda drops, read=read: lambda: read(layouts[drops]), 25) < FLAT
    indices = {drops: build_index(layout) for drops, layout in layouts.items()}
    assert growth(lambda drops: lambda: Survey(layouts[drops], indices[drops]), 25) < FLAT


def content(point: SurveyPoint) -> tuple[Any, ...]:
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


@settings(
    max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
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
def test_a_damaged_survey_is_read_as_its_full_index_has_it(
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
    layout = Layout(folder)
    indexed = Survey(layout, build_index(layout))
    assert [content(point) for point in survey.points] == [
        content(point) for point in indexed.points
    ]
    assert (survey.damage, survey.info) == (indexed.damage, indexed.info)
    assert (survey.survey_id, survey.captures) == (indexed.survey_id, indexed.captures)
    assert (survey.events, survey.checks) == (indexed.events, indexed.checks)
    numbers = [drop.number for drop in survey.drops]
    assert numbers == sorted(drop.number for point in survey.points for drop in point.drops)


def index_content(index: Index) -> dict[str, object]:
    """All that an index says, but for what is not read of drops where ledger and journal agree."""
    drops = {n: replace(d, key=None, restored_from=None) for n, d in index.drops.items()}
    omitted = ("drops", "keys", "drops_by_peaks", "has_all_keys", "settled")
    rest = {each.name: getattr(index, each.name) for each in fields(index)}
    return {"drops": drops, **{name: rest[name] for name in rest if name not in omitted}}


def test_an_intact_survey_needs_no_decoding(
    published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layout = Layout(published)
    kinds: list[int] = []
    decode = index_module.payload_data

    def noted(payload: bytes) -> dict[str, object]:
        data = decode(payload)
        kinds.append(RecordKind.DROP if "sensors" in data else 0)
        return data

    monkeypatch.setattr(index_module, "payload_data", noted)
    quick = read_index(layout)
    assert RecordKind.DROP not in kinds
    full = build_index(layout)
    assert kinds.count(RecordKind.DROP) == len(full.drops) == 6
    assert index_content(quick) == index_content(full)
    keys = [drop.key for drop in Survey(layout, quick).drops]
    assert keys == [full.drops[number].key for number in sorted(full.drops)]
    assert None not in keys


def test_a_survey_is_read_while_its_ledger_is_behind(published: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(published, folder)
    lines = (folder / "acknowledged.txt").read_bytes().splitlines(keepends=True)
    for stored in range(len(lines) + 1):
        (folder / "acknowledged.txt").write_bytes(b"".join(lines[:stored]))
        layout = Layout(folder)
        quick, full = read_index(layout), build_index(layout)
        assert index_content(quick) == index_content(full)
        assert len(quick.unacknowledged) == len(lines) - max(stored, 1)


def test_a_line_that_names_another_drop_is_damaged(published: Path, tmp_path: Path) -> None:
    folder = tmp_path / "copy"
    shutil.copytree(published, folder)
    layout = Layout(folder)
    index = build_index(layout)
    assert index.survey is not None
    # No damage does that: the line is whole, and covers the record that it misnames.
    first, second = index.drops[1].entry, index.drops[2].entry
    swapped = {
        first.sequence: first._replace(about=second.about),
        second.sequence: second._replace(about=first.about),
    }
    entries = [swapped.get(number, entry) for number, entry in sorted(index.entries.items())]
    (folder / "acknowledged.txt").write_bytes(ledger_bytes(index.survey, entries))
    for drop in read_survey(folder).drops:  # from their files
        read = drop.read()
        assert (read.point, read.drop.number) == (drop.point, drop.drop)
        assert read.metadata["key"] == f"7/1/{drop.number}"
    for path in (folder / "drops").iterdir():
        path.unlink()
    with pytest.raises(RecordingError, match="expected drop 1 in the journal or in a file"):
        read_survey(folder).read_drop(1)
    assert not check(folder).ok


def test_the_latest_result_is_last(tmp_path: Path) -> None:
    make_survey(tmp_path / "s", extras=False)
    with open_survey(tmp_path / "s") as writer:
        for seed in range(1, 12):
            writer.save_result(1, {"seed": seed})
    first, second, _ = read_survey(tmp_path / "s").drops
    assert len(first.results) == 11
    assert first.results[-1] == tmp_path / "s/results/drop-000001-11.json"
    assert first.read_results()[-1] == {"seed": 11}
    assert (second.results, second.read_results()) == ((), ())
    assert (first.result_count, second.result_count) == (11, 0)


@pytest.mark.parametrize("change", [b'{"seed":3}\n', b'{"seed": 2}\n', b"", None])
def test_a_changed_result_does_not_count_and_is_reported_once(
    tmp_path: Path, change: bytes | None
) -> None:
    make_survey(tmp_path / "s", extras=False)
    with open_survey(tmp_path / "s") as writer:
        path = [writer.save_result(1, {"seed": seed}) for seed in (1, 2)][-1]
        diagnosis = writer.save_result(1, {"seed": 2}, "diagnosis")
    content = path.read_bytes()
    for file in (path, diagnosis):
        if change is None:
            file.unlink()
        else:
            file.write_bytes(change)
    survey = read_survey(tmp_path / "s")
    drop = survey.drops[0]
    assert survey.damage == ()
    for read in (drop.read_results, lambda: drop.read_diagnosis(dict)) * 2:
        with pytest.raises(RecordingError, match=r"-[12]\.json is damaged: expected the stored .*"):
            read()
    assert list(drop.readable_results(dict)) == [{"seed": 1}]
    names = [f"results/{file.name}" for file in (path, diagnosis)]
    assert [text.split(" is damaged")[0] for text in survey.damage] == names
    assert recover(tmp_path / "s").ok
    assert path.read_bytes() == content
    assert read_survey(tmp_path / "s").drops[0].read_results()[-1] == {"seed": 2}


@pytest.fixture(scope="module")
def small_survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("reopened") / "small_survey", 3)


@pytest.fixture
def copy(small_survey: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(small_survey, tmp_path / "copy"))


@pytest.fixture
def readings(monkeypatch: pytest.MonkeyPatch) -> list[Layout]:
    layouts: list[Layout] = []
    for module in ("survey_reader", "survey_writer", "recovery"):

        def noted(layout: Layout) -> object:
            layouts.append(layout)
            return index_module.read_index(layout)

        monkeypatch.setattr(f"pfwd_device.recording.{module}.read_index", noted)
    return layouts


def opened(folder: Path, survey_read: Survey) -> SurveyWriter:
    return open_survey(folder, already_read=survey_read)


def test_a_survey_that_was_just_read_is_not_reread(copy: Path, readings: list[Layout]) -> None:
    survey_read = read_survey(copy)
    assert len(readings) == 1
    with opened(copy, survey_read) as writer:
        writer.edit("note", "wet", number=2)
        assert writer.contents().drops[1].notes[-1] == "wet"
    assert len(readings) == 1
    assert read_survey(copy).drops[1].notes[-1] == "wet"
    assert check(copy).ok


def test_a_survey_that_was_changed_since_is_reread(copy: Path, readings: list[Layout]) -> None:
    survey_read = read_survey(copy)
    with opened(copy, read_survey(copy)) as writer:
        writer.edit("note", "said by another program", number=1)
    readings.clear()
    with opened(copy, survey_read) as writer:
        assert writer.contents().drops[0].notes[-1] == "said by another program"
        writer.edit("note", "wet", number=2)
    assert len(readings) == 1
    assert check(copy).ok


def test_a_journal_damaged_since_is_reread(copy: Path, readings: list[Layout]) -> None:
    survey_read = read_survey(copy)
    path = journal_of(copy)
    damaged = bytearray(path.read_bytes())
    damaged[-20] ^= 1
    with path.open("r+b") as stream:  # the same file, of the same length
        stream.write(damaged)
    readings.clear()
    with opened(copy, survey_read):
        assert len(readings) == 1


def test_another_survey_is_reread(copy: Path, small_survey: Path, readings: list[Layout]) -> None:
    survey_read = read_survey(small_survey)
    readings.clear()
    with opened(copy, survey_read):
        assert len(readings) == 1


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
