"""The compiled core as an instrument: what is put into it is recorded, bit for bit."""

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

pytestmark = [needs_compiler, pytest.mark.timeout(60)]
QUICK = {"drops": {"first": 0.6, "interval": 2.0, "quiet": 0.5, "bounces": [0, 0]}}


RING = 8 << 20
"""Bytes; 35 s at four times the real rate: a computer that does something else loses no samples."""


@pytest.fixture(scope="module")
def with_shunt() -> Played:
    return play_scenario(QUICK, drops=2, seed=3)


def without_shunt(played: Played) -> Played:
    """The check of a shunt takes as long as the computer is busy, and a drop that falls meanwhile
    is kept with what the shunt adds."""
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
        found = record.metadata["detection"]
        assert record.metadata["missing"] == []
        first = found["first_sample"]
        put_in = played.counts[first : first + len(record.counts)]
        np.testing.assert_array_equal(record.counts, put_in)
        touch = played.truth[drop.number - 1]["touch_sample"]
        assert 0 <= first + found["trigger"] - touch < 30  # the load takes 3 ms to the threshold


@pytest.mark.parametrize("streams", [True, False], ids=["streaming", "buffered"])
def test_drops_are_recorded_bit_for_bit(tmp_path: Path, played: Played, streams: bool) -> None:
    with HostBoard(played, BoardOptions(streams=streams, speed=4.0, memory=RING)) as board:
        measured(board, tmp_path / "survey")
    assert_recorded_bit_for_bit(tmp_path / "survey", played)


@pytest.mark.posix
@pytest.mark.skipif(sys.platform == "win32", reason="needs a pseudo-terminal")
def test_it_is_found_at_a_pseudo_terminal(tmp_path: Path, played: Played) -> None:
    with HostBoard(played, BoardOptions(listen="pty", speed=4.0, memory=RING)) as board:
        assert board.url.startswith("/dev/")
        measured(board, tmp_path / "survey", drops=1)


def test_a_drop_that_the_instrument_found_is_found_again_in_a_replay(
    tmp_path: Path, played: Played
) -> None:
    with HostBoard(played, BoardOptions(streams=False, speed=4.0)) as board:
        measured(board, tmp_path / "survey")
    events: list[SessionEvent] = []
    replay(tmp_path / "survey", events.append)
    saved = [event for event in events if isinstance(event, DropSaved)]
    assert [event.identical for event in saved] == [True, True]


def two_drops_wait(board: HostBoard, played: Played, log: Path) -> tuple[BinaryDialect, Transport]:
    trigger = trigger_for(played.identity, DetectionSettings(rebound_window=0.5))
    transport, dialect = open_transport(board.url), BinaryDialect()
    transport.write(dialect.encode(Hello()) + dialect.encode(Arm(trigger)))
    end = time.monotonic() + 20
    while len(log.read_text().splitlines()) < 2 and time.monotonic() < end:
        time.sleep(0.02)
    return dialect, transport


def test_drops_that_wait_outlast_the_host_and_the_instrument(
    tmp_path: Path, played: Played
) -> None:
    store, log = tmp_path / "store", tmp_path / "log"
    options = BoardOptions(streams=False, speed=4.0, store=store, log=log)
    with HostBoard(played, options) as board:
        _, transport = two_drops_wait(board, played, log)
        transport.close()  # a host that is killed says no more
        board.kill()
    options = replace(options, begin=len(played.counts) - 1)
    with HostBoard(played, options) as board:
        events = measured(board, tmp_path / "survey")
    assert_recorded_bit_for_bit(tmp_path / "survey", played)
    saved = [event for event in events if isinstance(event, DropSaved)]
    assert [event.saved.view.marks for event in saved] == [(Notice("buffered-before-restart"),)] * 2
    with HostBoard(played, options) as board, Driver(board.url, BinaryDialect()) as driver:
        items = [driver.next(0.5) for _ in range(4)]
    assert not [item for item in items if isinstance(item, BufferedDrop)]  # it has let go of them


def test_of_drops_every_one_and_a_half_seconds_all_are_kept_and_no_bounce(tmp_path: Path) -> None:
    drops = {"first": 0.8, "interval": 1.4, "quiet": 1.2, "bounces": [1, 2]}
    played = play_scenario({"drops": drops}, drops=8, seed=5)
    played = without_shunt(played)
    with HostBoard(played, BoardOptions(streams=False, speed=2.0)) as board:
        measured(board, tmp_path / "survey", drops=8)
    assert_recorded_bit_for_bit(tmp_path / "survey", played)
    assert len(read_survey(tmp_path / "survey").drops) == 8


def test_a_drop_that_nobody_fetches_does_not_block_the_next(tmp_path: Path, played: Played) -> None:
    log = tmp_path / "log"
    options = BoardOptions(streams=False, speed=4.0, log=log)
    with HostBoard(played, options) as board:
        dialect, transport = two_drops_wait(board, played, log)
        transport.write(dialect.encode(Hello()))  # the Offers begin with the oldest
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


def test_what_does_not_compile_says_so() -> None:
    with pytest.raises(FirmwareError, match=r"expected a program, got .*error"):
        build_host("-DPFWD_FAULT=(")


def test_a_drop_that_falls_while_the_shunt_is_on_is_kept(with_shunt: Played) -> None:
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


def test_cables_that_are_pulled_lose_no_drop_and_damage_is_asked_for_again(
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


def test_streamed_samples_that_were_damaged_come_again(tmp_path: Path, played: Played) -> None:
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
def test_a_trace_file_is_played(tmp_path: Path, played: Played) -> None:
    time_s = np.arange(-100, 500) / 5000.0
    load = np.where((time_s > 0) & (time_s < 0.02), 8000 * np.sin(np.pi * time_s / 0.02), 0.0)
    records = [np.column_stack([load * scale + 100.0, load * 1e-5 * scale]) for scale in (0.9, 1.0)]
    made = play_records(records, 5000.0, [(Measurand.VELOCITY, 0.0)], 0.15, "traces")
    with HostBoard(made, BoardOptions(speed=4.0)) as board:
        measured(board, tmp_path / "survey")
    for number, drop in enumerate(read_survey(tmp_path / "survey").drops):
        found = drop.read().drop
        peak = float(np.max(found.load))
        assert peak == pytest.approx(8000 * (0.9, 1.0)[number], rel=1e-3)
