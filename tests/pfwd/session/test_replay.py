"""Replays of recordings: the same samples give the same results."""

import contextlib
import dataclasses
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from inversion.notices import codes
from pfwd.analysis.options import AnalysisOptions
from pfwd.errors import DeviceError, SurveyError
from pfwd.files.editing import Edit, add_events, edit_survey
from pfwd.files.header import PointSetup
from pfwd.files.importing import import_files
from pfwd.files.traces import TracePoint, write_traces
from pfwd.judging import JobRequest, job_of
from pfwd.session.drop_metadata import feed_item_of
from pfwd.session.events import DropAnalysed, DropSaved, SessionNotice
from pfwd.session.feeds import Ended, RecordedDrop
from pfwd.session.measure import replay
from pfwd.session.plan import Ending
from pfwd.session.replay import Pace, Pause, RecordedFeed, capture_feed, survey_feed
from pfwd.session.session import Session
from pfwd.session.setup_file import MeasuringSetup
from pfwd_device import Drop
from pfwd_device.acquisition.items import Gap
from pfwd_device.recording import SurveyWriter, read_survey
from pfwd_device.wire.messages import Event, EventKind
from tests.pfwd.scripted_feed import (
    Log,
    ScriptedFeed,
    began,
    connected,
    lost,
    pieces,
    run,
    stream,
    with_gaps,
)
from tests.pfwd.session.measured import drops, record


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A survey with drops of every kind: rebounds, gaps, saturation, by hand, cut off."""
    pulses = [(1.0, 8000.0), (1.5, 3000.0), (1.9, 900.0), (4.0, 7900.0)]
    pulses += [(16.0, 600.0), (16.6, 8000.0)]  # a knock, then the drop
    counts = stream(26.0, [*pulses, *((at, 8000.0) for at in (7.0, 10.0, 20.0, 23.0))])
    counts[100_060:100_065, 1] = 2**23 - 1
    items = with_gaps(pieces(counts[:130_000]), [(39_900, 40), (70_050, 30), (15_000, 3)])
    by_hand = Event(EventKind.TRIGGER, 0)
    folder = tmp_path_factory.mktemp("replay") / "recording"
    with SurveyWriter.open(folder, publish=False) as writer:
        later = pieces(counts[130_000:230_500], 7, 130_000)
        feed = ScriptedFeed(connected(), began(), items, by_hand, later[:40], later[40:], lost())
        run(feed, Log(), writer)
        # By hand just after a drop, with a weight still on the plate.
        manual = stream(4.0, [(1.0, 8000.0)], seed=5)
        manual[11_000:, 0] += 2000
        before, after = pieces(manual[:11_500], 8), pieces(manual[11_500:], 8, 11_500)
        feed = ScriptedFeed(connected(again=True), began(8), before, by_hand, after)
        run(feed, Log(), writer, point="B")
    return folder


def traces(folder: Path) -> list[Any]:
    return [drop.read() for drop in read_survey(folder).drops]


def test_every_drop_is_reproduced_bit_for_bit(recording: Path, tmp_path: Path) -> None:
    originals = traces(recording)
    marks = {mark["code"] for record in originals for mark in record.metadata["marks"]}
    assert {"samples-missing", "saturated", "triggered-by-operator", "cut-off"} <= marks
    assert sum(len(record.rebounds) for record in originals) == 2
    log = Log()
    assert replay(recording, log) is Ending.DONE
    saved = [event.saved for event in log.of(DropSaved)]
    assert [(each.point, each.number, codes(each.view.marks)) for each in saved] == [
        (record.point, record.drop.number, record.metadata["marks"]) for record in originals
    ]
    assert all(event.identical for event in log.of(DropSaved))
    assert log.texts == ""
    assert replay(recording, log, output=tmp_path / "copy") is Ending.DONE
    copied = traces(tmp_path / "copy")
    assert len(originals) >= 8
    for each, second in zip(originals, copied, strict=True):
        assert (each.point, each.drop.number) == (second.point, second.drop.number)
        assert each.metadata == second.metadata
        assert each.declared == second.declared
        assert each.counts.tobytes() == second.counts.tobytes()
        assert each.drop.load.tobytes() == second.drop.load.tobytes()
        assert [r.first_sample for r in each.rebounds] == [r.first_sample for r in second.rebounds]
        for mine, theirs in zip(each.rebounds, second.rebounds, strict=True):
            assert mine.counts.tobytes() == theirs.counts.tobytes()
    # Once more adds nothing.
    log = Log()
    assert replay(recording, log, output=tmp_path / "copy") is Ending.DONE
    assert not log.of(DropSaved)
    assert log.texts.count("not recorded twice") == len(originals)
    assert len(traces(tmp_path / "copy")) == len(originals)


def test_a_replay_does_not_wait_for_used_numbers(recording: Path, tmp_path: Path) -> None:
    record(tmp_path / "other", connected(), drops(8000.0, run=99))
    log = Log()
    assert replay(recording, log, output=tmp_path / "other", drops=2) is Ending.DONE
    saved = [(event.saved.point, event.saved.number) for event in log.of(DropSaved)]
    assert saved == [("1", 2), ("1", 3)]
    assert len(traces(tmp_path / "other")[1].rebounds) == 2


def test_the_same_seed_gives_the_same_results(tmp_path: Path) -> None:
    folder = tmp_path / "short"
    record(folder, connected(), drops(8000.0))

    def results() -> list[dict[str, Any]]:
        log = Log()
        options = AnalysisOptions(seed=5)
        assert replay(folder, log, options=options) is Ending.DONE
        analysed = log.of(DropAnalysed)
        assert [each.final for each in analysed].count(True) == 1
        assert all(each.delay is None for each in analysed)
        ordered = sorted(analysed, key=lambda each: (each.saved.number, each.full))
        return [{**each.result.to_json(), "elapsed_s": None} for each in ordered]

    first = results()
    assert [each["method"] for each in first] == ["posterior", "mpga"]
    assert all(each["modulus_pa"] > 0 for each in first)
    assert first == results()


def test_imported_drops_are_replayed(tmp_path: Path, make_drop: Callable[..., Drop]) -> None:
    point = TracePoint("", PointSetup(plate_radius=0.15), (make_drop(), make_drop(number=2)), ())
    write_traces(tmp_path / "t.csv", point)
    list(import_files([str(tmp_path / "t.csv")], tmp_path / "survey"))
    log = Log()
    replay(tmp_path / "survey", log, output=tmp_path / "copy")
    assert [each.saved.number for each in log.of(DropSaved)] == [1, 2]
    assert [each.identical for each in log.of(DropSaved)] == [True, True]
    assert traces(tmp_path / "copy")[1].drop.load.tobytes() == make_drop().load.tobytes()


def test_a_drop_that_a_replay_does_not_detect_is_reported(recording: Path) -> None:
    dropped = next(each for each in traces(recording) if each.point == "B")
    log = Log()
    run(ScriptedFeed(feed_item_of(dropped, "x"), live=False), log)  # its samples never come
    assert "replay: drop B/1 is not detected again" in log.texts


def test_different_traces_are_not_identical(recording: Path) -> None:
    record = traces(recording)[0]
    load = record.drop.load.copy()
    load[7] = np.nextafter(load[7], np.inf)
    second = dataclasses.replace(record, drop=dataclasses.replace(record.drop, load=load))
    item = feed_item_of(second, "x")
    assert isinstance(item, RecordedDrop)
    log = Log()
    samples = pieces(record.counts, item.stream, item.first)
    run(ScriptedFeed(item, samples, Gap(item.stream, 0, 50_000), live=False), log)
    assert [each.identical for each in log.of(DropSaved)] == [False]


@pytest.mark.parametrize(
    ("of_drop", "of_detection"),
    [
        ({"missing": None}, {}),
        ({"missing": [["a", 1]]}, {}),
        ({"identity": {}}, {}),
        ({}, {"stream": "x"}),
        ({}, {"settings": {"unheard_of": 1}}),
        ({}, {"settings": {"hysteresis": 2.0}}),
        ({}, {"at_rest": {}}),
    ],
)
def test_incomplete_metadata_is_refused(recording: Path, of_drop: Any, of_detection: Any) -> None:
    record = traces(recording)[0]
    detection = record.metadata["detection"] | of_detection
    metadata = record.metadata | {"detection": detection} | of_drop
    with pytest.raises(DeviceError):
        feed_item_of(dataclasses.replace(record, metadata=metadata), "x")


def test_a_replay_in_real_time_takes_its_time_and_stays_awake(tmp_path: Path) -> None:
    record(tmp_path / "s", connected(), drops(8000.0, 7000.0))
    slept: list[float] = []
    feed = survey_feed(read_survey(tmp_path / "s"), 2.0, slept.append)
    idle = 0
    while not isinstance(item := feed.next(0.02), Ended):
        idle += item is None
    assert max(slept) <= 0.02
    # A second before the first drop, what went by between drops, and the samples; twice as fast.
    records = traces(tmp_path / "s")
    first, second = (np.datetime64(each.metadata["time_utc"][:26], "us") for each in records)
    pause = (second - first) / np.timedelta64(1, "s")
    samples = sum(len(each.counts) for each in records)
    assert sum(slept) == pytest.approx((1.0 + pause + samples / 10_000) / 2, rel=1e-3)
    assert idle > 0


def test_a_paused_replay_waits_and_steps_drop_by_drop(tmp_path: Path) -> None:
    record(tmp_path / "s", connected(), drops(8000.0, 7000.0))
    pace = Pace()
    pace.pause()
    feed = survey_feed(read_survey(tmp_path / "s"), pace, lambda _: None)

    def drops_before_the_pause() -> int:
        items: list[Any] = []
        while (item := feed.next(0.01)) is not None and not isinstance(item, Ended):
            items.append(item)
        return sum(isinstance(item, RecordedDrop) for item in items)

    assert drops_before_the_pause() == 0
    pace.step()
    assert drops_before_the_pause() == 1
    pace.go_on()
    assert drops_before_the_pause() == 1


def test_the_pace_is_changed_on_the_way() -> None:
    slept: list[float] = []
    pace = Pace(2.0)
    feed = RecordedFeed([Pause(1.0), Ended()], pace, slept.append)
    assert feed.next(0.25) is None  # half of the recorded second
    pace.speed = 0.5
    assert feed.next(0.5) is None  # a quarter
    pace.speed = 0.0
    assert isinstance(feed.next(0.1), Ended)
    assert slept == [0.25, 0.5]


def test_a_replay_is_not_edited(recording: Path) -> None:
    @contextlib.contextmanager
    def asking(session: Session) -> Iterator[None]:
        session.ask(lambda it: it.edit(Edit("note", "x"), point="1"))
        yield

    log = Log()
    replay(recording, log, control=asking)
    assert any("got a replay" in each.text for each in log.of(SessionNotice))


def test_a_pause_at_a_tiny_speed_can_be_interrupted() -> None:
    feed = RecordedFeed([Pause(1.0), Ended()], 1e-300, lambda _: None)
    assert [feed.next(0.02) for _ in range(5)] == [None] * 5


def test_a_file_that_is_no_recording_is_refused(tmp_path: Path, recording: Path) -> None:
    with pytest.raises(SurveyError, match="expected a survey or a capture, got none"):
        replay(tmp_path / "nothing", Log())
    text = tmp_path / "text.txt"
    text.write_text("no capture\n" * 100)
    with pytest.raises((SurveyError, DeviceError), match="capture"):
        capture_feed(text)
    with pytest.raises(SurveyError, match="--setup"):
        replay(recording, Log(), setup=MeasuringSetup())


def test_a_replay_into_a_new_survey_keeps_the_targets(recording: Path, tmp_path: Path) -> None:
    recording = shutil.copytree(recording, tmp_path / "recording")
    add_events(recording, JobRequest(target=33e6).events())
    edit_survey(recording, [Edit("target", 44e6)], "1")
    for _ in range(2):  # the second time it exists, with a target of its own
        replay(recording, Log(), output=tmp_path / "copy")
        copy = read_survey(tmp_path / "copy")
        assert job_of(copy).target == 33e6
        assert {point.name: point.target for point in copy.points}["1"] == 44e6
        add_events(recording, JobRequest(target=20e6).events())
        edit_survey(recording, [Edit("target", 21e6)], "1")
