"""The compiled core as an instrument: played drops are recorded bit for bit."""

import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from inversion.notices import Notice
from pfwd.session.buffered_drops import trigger_for
from pfwd.session.events import DropSaved, SessionEvent
from pfwd.session.measure import measure, replay
from pfwd.session.session import Ending, SessionPlan
from pfwd_device.acquisition.detection import DetectionSettings
from pfwd_device.acquisition.driver import Driver
from pfwd_device.acquisition.items import BufferedDrop
from pfwd_device.identity import Identity
from pfwd_device.recording import read_survey
from pfwd_device.transport.base import Transport
from pfwd_device.transport.opening import open_transport
from pfwd_device.wire.binary import BinaryDialect
from pfwd_device.wire.messages import Arm, Armed, DropOffer, Hello
from pfwd_plugins.quantities import Measurand
from simulators.bad_link import BadLink
from simulators.firmware import (
    BoardOptions,
    FirmwareError,
    HostBoard,
    Played,
    build_host,
    play_records,
    play_scenario,
)
from tests.firmware.compiled import needs_compiler
from tests.simulators.instrument_wire import of_kind

pytestmark = [needs_compiler, pytest.mark.timeout(60)]
QUICK = {"drops": {"first": 0.6, "interval": 2.0, "quiet": 0.5, "bounces": [0, 0]}}


RING = 8 << 20
"""Size of the ring, bytes: a busy computer may take 35 s at four times the real rate."""


@pytest.fixture(scope="module")
def with_shunt() -> Played:
    return play_scenario(QUICK, drops=2, seed=3)


def without_shunt(played: Played) -> Played:
    """Return the record of an instrument without shunt, whose check may last until a drop."""
    channels = tuple(replace(channel, shunt=None) for channel in played.identity.channels)
    return replace(played, identity=replace(played.identity, channels=channels))


@pytest.fixture(scope="module")
def played(with_shunt: Played) -> Played:
    return without_shunt(with_shunt)


def measured(
    board: HostBoard, folder: Path, drops: int = 2, url: str | None = None
) -> list[SessionEvent]:
    events: list[SessionEvent] = []
    assert measure(url or board.url, folder, events.append, SessionPlan(drops=drops)) is Ending.DONE
    return events


def assert_recorded_bit_for_bit(folder: Path, played: Played) -> None:
    for drop in read_survey(folder).drops:
        record = drop.read()
        assert record.counts is not None
        detection = record.metadata["detection"]
        assert record.metadata["missing"] == []
        first = detection["first_sample"]
        expected = played.counts[first : first + len(record.counts)]
        np.testing.assert_array_equal(record.counts, expected)
        touch = played.truth[drop.number - 1]["touch_sample"]
        assert (
            0 <= first + detection["trigger"] - touch < 30
        )  # the load takes 3 ms to the threshold


@pytest.mark.parametrize("streams", [True, False], ids=["streaming", "buffered"])
def test_drops_are_recorded_bit_for_bit_and_replayed(
    tmp_path: Path, played: Played, streams: bool
) -> None:
    with HostBoard(played, BoardOptions(streams=streams, speed=4.0, memory=RING)) as board:
        measured(board, tmp_path / "survey")
    assert_recorded_bit_for_bit(tmp_path / "survey", played)
    events: list[SessionEvent] = []
    replay(tmp_path / "survey", events.append)
    assert [event.identical for event in of_kind(events, DropSaved)] == [True, True]


@pytest.mark.posix
@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_the_board_is_measured_at_a_pseudo_terminal(tmp_path: Path, played: Played) -> None:
    with HostBoard(played, BoardOptions(listen="pty", speed=4.0, memory=RING)) as board:
        assert board.url.startswith("/dev/")
        measured(board, tmp_path / "survey", drops=1)


def two_drops_wait(board: HostBoard, played: Played, log: Path) -> tuple[BinaryDialect, Transport]:
    trigger = trigger_for(played.identity, DetectionSettings(rebound_window=0.5))
    transport, dialect = open_transport(board.url), BinaryDialect()
    transport.write(dialect.encode(Hello()) + dialect.encode(Arm(trigger)))
    end = time.monotonic() + 20
    while len(log.read_text().splitlines()) < 2 and time.monotonic() < end:
        time.sleep(0.02)
    return dialect, transport


def test_stored_drops_survive_the_end_of_host_and_instrument(
    tmp_path: Path, played: Played
) -> None:
    store, log = tmp_path / "store", tmp_path / "log"
    options = BoardOptions(streams=False, speed=4.0, store=store, log=log)
    with HostBoard(played, options) as board:
        _, transport = two_drops_wait(board, played, log)
        transport.close()  # as a killed host
        board.kill()
    options = replace(options, begin=len(played.counts) - 1)
    with HostBoard(played, options) as board:
        events = measured(board, tmp_path / "survey")
    assert_recorded_bit_for_bit(tmp_path / "survey", played)
    marks = [event.saved.view.marks for event in of_kind(events, DropSaved)]
    assert marks == [(Notice("buffered-before-restart"),)] * 2
    with HostBoard(played, options) as board, Driver(board.url, BinaryDialect()) as driver:
        items = [driver.next(0.5) for _ in range(4)]
    assert not of_kind(items, BufferedDrop)  # they were released


def test_every_drop_of_a_quick_series_is_stored_without_its_bounces(tmp_path: Path) -> None:
    drops = {"first": 0.8, "interval": 1.4, "quiet": 1.2, "bounces": [1, 2]}
    played = play_scenario({"drops": drops}, drops=4, seed=5)
    played = without_shunt(played)
    with HostBoard(played, BoardOptions(streams=False, speed=2.0)) as board:
        measured(board, tmp_path / "survey", drops=4)
    assert_recorded_bit_for_bit(tmp_path / "survey", played)
    assert len(read_survey(tmp_path / "survey").drops) == 4


def test_an_unfetched_drop_does_not_block_the_next(tmp_path: Path, played: Played) -> None:
    log = tmp_path / "log"
    options = BoardOptions(streams=False, speed=4.0, log=log)
    with HostBoard(played, options) as board:
        dialect, transport = two_drops_wait(board, played, log)
        transport.write(dialect.encode(Hello()))  # the offers restart with the oldest
        offers: list[int] = []
        end = time.monotonic() + 20
        while len(offers) < 12 and time.monotonic() < end:
            for message in dialect.feed(transport.read(0.1)):
                if isinstance(message, Identity):
                    offers.clear()
                if isinstance(message, DropOffer):
                    offers.append(message.first_sample)
        oldest = offers[0]
        transport.close()
    assert offers[:8] == [oldest] * 8
    second = offers[8]
    assert second > oldest
    assert offers[8:12] == [second, oldest, second, oldest]


def test_a_compiler_error_is_reported() -> None:
    with pytest.raises(FirmwareError, match=r"expected a program, got .*error"):
        build_host("-DPFWD_FAULT=(")


def test_a_drop_during_the_shunt_is_recorded_with_it(with_shunt: Played) -> None:
    played = with_shunt
    trigger = trigger_for(played.identity, DetectionSettings())
    with (
        HostBoard(played, BoardOptions(speed=2.0)) as board,
        Driver(board.url, BinaryDialect(), trigger=lambda identity: trigger) as driver,
    ):
        drops: list[BufferedDrop] = []
        end = time.monotonic() + 20
        while not drops and time.monotonic() < end:
            item = driver.next(0.5)
            if isinstance(item, Armed):
                driver.shunt(True)
            if isinstance(item, BufferedDrop):
                drops.append(item)
    (drop,) = drops
    assert drop.offer.shunt
    first = drop.offer.first_sample
    expected = played.counts[first : first + len(drop.counts)].copy()
    # 5000 N of the identity as counts, up to the end of the converter's range.
    expected[:, 0] = np.minimum(expected[:, 0] + 52_429, (1 << 17) - 1)
    np.testing.assert_array_equal(drop.counts, expected)


def test_no_drop_is_lost_by_pulled_cables_and_damaged_frames(
    tmp_path: Path, played: Played
) -> None:
    options = BoardOptions(streams=False, speed=4.0)
    with (
        HostBoard(played, options) as board,
        BadLink(lambda: board.url, rate=60_000, bit_error_rate=3e-4) as link,
    ):
        stop = threading.Event()

        def pull() -> None:
            while not stop.wait(0.23):
                link.cut()

        thread = threading.Thread(target=pull)
        thread.start()
        try:
            measured(board, tmp_path / "survey", url=link.url)
        finally:
            stop.set()
            thread.join()
        assert link.cuts >= 2
    assert_recorded_bit_for_bit(tmp_path / "survey", played)


def test_damaged_streamed_samples_are_sent_again(tmp_path: Path, played: Played) -> None:
    with (
        HostBoard(played, BoardOptions(drop_samples=0, speed=2.0, memory=RING)) as board,
        BadLink(lambda: board.url, bit_error_rate=1e-4) as link,
    ):
        measured(board, tmp_path / "survey", url=link.url)
    assert_recorded_bit_for_bit(tmp_path / "survey", played)
    counters = read_survey(tmp_path / "survey").drops[-1].read().metadata["link"]
    assert counters["frames_damaged"] > 3
    assert counters["samples_recovered"] > 0


@pytest.mark.slow
def test_a_trace_file_is_played(tmp_path: Path) -> None:
    time_s = np.arange(-100, 500) / 5000.0
    load = np.where((time_s > 0) & (time_s < 0.02), 8000 * np.sin(np.pi * time_s / 0.02), 0.0)
    records = [np.column_stack([load * scale + 100.0, load * 1e-5 * scale]) for scale in (0.9, 1.0)]
    made = play_records(records, 5000.0, [(Measurand.VELOCITY, 0.0)], 0.15, "traces")
    with HostBoard(made, BoardOptions(speed=4.0)) as board:
        measured(board, tmp_path / "survey")
    for number, drop in enumerate(read_survey(tmp_path / "survey").drops):
        peak = float(np.max(drop.read().drop.load))
        assert peak == pytest.approx(8000 * (0.9, 1.0)[number], rel=1e-3)
