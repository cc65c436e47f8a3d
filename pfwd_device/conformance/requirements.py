"""The requirements of docs/protocol.md by their numbers, and the test of each."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from pfwd_device.conformance import basics, calibrating, stored_drops, streaming
from pfwd_device.conformance.instrument_link import Failed, InstrumentLink, NotSupported
from pfwd_device.errors import DeviceError, DeviceRefused
from pfwd_device.identity import Identity
from pfwd_device.transport.base import Transport
from pfwd_device.wire.messages import Hello, Status, Stop

DROP_TIMEOUT_S = 15.0
"""Longest wait for a drop, s."""
MAX_DAMAGED_FRACTION = 0.02
"""Largest fraction of damaged frames: a link damages some, a wrong CRC in the instrument all."""

TITLES = {
    "P-1": "every frame has a right COBS, length and CRC",
    "P-2": "the counter of frames rises by one each",
    "P-3": "Hello is answered by an Identity within 1 s",
    "P-4": "the newest version in common is agreed on, and none in common is refused (version)",
    "P-5": "the Identity is whole, in range, and the same each time",
    "P-6": "Configure sets the nearest rate and is answered by an Identity with it",
    "P-7": "a rate of NaN, 0 or below is refused (argument)",
    "P-8": "Start is answered by samples within 1 s",
    "P-9": "each Start begins a stream with a new number, from index 0 unless armed",
    "P-10": "indices follow each other, and what is left out is counted as overruns",
    "P-11": "samples come at least every 0.1 s, 5 ms a frame at most, with the channels of the "
    "Identity",
    "P-12": "the converter runs at the rate that the Identity says, by the clocks of both",
    "P-13": "the device clock goes on evenly and never back",
    "P-14": "Stop ends the samples and is answered by a Status that says so",
    "P-15": "a Status comes at least every 0.5 s, sampling or not",
    "P-16": "Hello does not disturb a stream that runs",
    "P-17": "an unknown message is refused (unknown)",
    "P-18": "damaged frames are not answered, and the next whole one is",
    "P-19": "bytes behind the fields of a message are ignored",
    "P-20": "the shunt is answered by an Event, and samples carry its flag",
    "P-21": "the shunt goes off by itself 10 s after it was switched on",
    "P-22": "commands in any order and state leave it able to answer",
    "P-23": "after the link is opened anew it answers, and a stream that ran goes on or says that "
    "it does not",
    "P-24": "a Status of version 2 counts the drops that wait",
    "P-25": "Arm is answered by Armed with what was set, and nonsense is refused (argument)",
    "P-26": "while armed, Start and Stop leave the run of the converter as it is",
    "P-27": "a drop is offered when it is whole, and again while it waits",
    "P-28": "a drop holds the samples before and after the trigger that Armed says",
    "P-29": "blocks are numbered from 0, as long as the Offer says, and together have its CRC",
    "P-30": "any row of blocks can be fetched again, with the same bytes",
    "P-31": "a drop or block that is not there is refused (argument)",
    "P-32": "a drop waits until it is acknowledged, over Hello and a new link too",
    "P-33": "Acknowledge is answered by Released, each time, and the drop is offered no more",
    "P-34": "Resend brings the same samples with the same indices",
    "P-35": "what the ring does not hold any more, or not yet, is answered by Gone",
    "P-36": "the ring is as long as the Identity says",
    "P-37": "a host of version 1 is spoken to in version 1",
    "P-38": "drops that wait outlast a reset where the Identity says so",
    "P-39": "a drop that falls while the link is lost, or the shunt is on, is kept",
    "P-40": "Calibrate is answered by an Identity with it, and nonsense is refused (argument)",
    "P-41": "Calibrate is refused (busy) while samples are sent, the shunt is on, or a drop is "
    "found or waits",
    "P-42": "a calibration that was stored outlasts a reset, and is never there by half",
}
MANUAL_TESTS = {"P-38", "P-39", "P-42"}
"""Requirements that need the power of the instrument to be switched, which no command can do."""

MIN_FRAMES = 8
"""Smallest number of frames for a test of their counter."""
NEED_A_DROP = {"P-28", "P-29", "P-30", "P-32", "P-33"}

Check = Callable[[InstrumentLink], str]


@dataclass(frozen=True, slots=True)
class Result:
    """Result of the test of one requirement."""

    requirement: str
    """Number of the requirement."""
    title: str
    result: Literal["passed", "failed", "not-offered"]
    detail: str
    """Details of the behaviour."""


def conform(
    open_port: Callable[[], Transport],
    *,
    drop_wait: float = DROP_TIMEOUT_S,
    announce: Callable[[str], None] = lambda text: None,
    only: Collection[str] = (),
) -> Iterator[Result]:
    """Test an instrument, requirement by requirement.

    Parameters
    ----------
    open_port : callable
        Function that opens the port on each call.
    drop_wait : float, s
        Longest wait for a drop.
    announce : callable
        Function that receives requests to the operator.
    only : collection of str
        Numbers of the requirements to test; empty: all. Hello (P-3) is always tested. The tests of
        a stored drop include its Offer (P-27).

    Yields
    ------
    Result

    Raises
    ------
    PortError
        If the port cannot be opened at the beginning.
    DeviceRefused
        If drops wait in the instrument: the test would acknowledge them without a record.
    """
    link = InstrumentLink(open_port)
    try:
        first = _try("P-3", basics.greeting, link)
        yield first
        if first.result == "failed":
            yield from _all_failed(first)
            return
        _refuse_waiting(link)
        selected = set(only) | ({"P-27"} if NEED_A_DROP & set(only) else set())
        for number, check in _checks(drop_wait, announce):
            if not selected or number in selected:
                yield _try(number, check, link)
        for number in sorted(MANUAL_TESTS & selected if selected else MANUAL_TESTS):
            yield Result(number, TITLES[number], "not-offered", "needs a test by hand")
    finally:
        link.close()


def _checks(wait: float, announce: Callable[[str], None]) -> list[tuple[str, Check]]:
    drop = stored_drops.BufferedDropCheck(wait, announce)
    return [
        ("P-4", basics.versions),
        ("P-5", basics.same_identity),
        ("P-6", basics.configure),
        ("P-7", basics.wrong_rates),
        ("P-8", streaming.starts),
        ("P-9", streaming.new_streams),
        ("P-10", streaming.indices),
        ("P-11", streaming.frames),
        ("P-12", streaming.rate),
        ("P-13", streaming.clock),
        ("P-14", streaming.stops),
        ("P-15", basics.heartbeat),
        ("P-16", streaming.undisturbed),
        ("P-17", basics.unknown),
        ("P-18", basics.damaged),
        ("P-19", basics.bytes_behind),
        ("P-20", basics.shunt),
        ("P-21", basics.shunt_by_itself),
        ("P-22", basics.any_order),
        ("P-23", basics.new_link),
        ("P-24", stored_drops.waiting),
        ("P-25", stored_drops.arms),
        ("P-26", stored_drops.run_goes_on),
        ("P-27", drop.offered),
        ("P-28", drop.cut),
        ("P-29", drop.complete),
        ("P-30", drop.repeated),
        ("P-31", drop.unknown_drop),
        ("P-32", drop.stays_stored),
        ("P-33", drop.acknowledged),
        ("P-34", streaming.resends),
        ("P-35", streaming.reports_missing),
        ("P-36", streaming.ring_length),
        ("P-37", stored_drops.host_of_version_1),
        ("P-40", calibrating.stores),
        ("P-41", calibrating.not_while_busy),
        ("P-1", frames_valid),
        ("P-2", frames_counted),
    ]


def frames_valid(link: InstrumentLink) -> str:
    """Test requirement P-1."""
    counters = link.counters
    frames = counters.frames_good + counters.frames_damaged
    if counters.frames_damaged > max(3, MAX_DAMAGED_FRACTION * frames):
        raise Failed(f"expected whole frames, got {counters.frames_damaged} damaged of {frames}")
    return f"{counters.frames_damaged} damaged of {frames}"


def frames_counted(link: InstrumentLink) -> str:
    """Test requirement P-2."""
    if len(link.received) < MIN_FRAMES:
        link.receive(0.5 * MIN_FRAMES)
    steps = [
        (later.counter - earlier.counter) % 65536
        for earlier, later in pairwise(link.received)
        if later.connection == earlier.connection
    ]
    n_wrong = sum(step != 1 for step in steps)
    # Each damaged frame makes a gap in the numbers, and so does a reset of the instrument.
    if n_wrong > link.counters.frames_damaged + MAX_DAMAGED_FRACTION * len(steps):
        raise Failed(f"expected one more for each frame, got {n_wrong} other steps of {len(steps)}")
    return f"{len(steps) + 1} frames"


def _refuse_waiting(link: InstrumentLink) -> None:
    try:
        link.request(Hello(), Identity)
        status = link.request(Stop(), Status)
    except Failed:
        return  # the test of this requirement reports it
    if status.drops_waiting:
        raise DeviceRefused(
            f"expected an instrument in which no drop waits, got one with {status.drops_waiting}; "
            "`pfwd log` records them first"
        )


def _try(number: str, check: Check, link: InstrumentLink) -> Result:
    title = TITLES[number]
    try:
        return Result(number, title, "passed", check(link))
    except NotSupported as err:
        return Result(number, title, "not-offered", str(err))
    except Failed as err:
        return Result(number, title, "failed", str(err))
    except DeviceError as err:
        detail = f"the link was lost: {err}"
        try:
            link.open()
        except DeviceError as second_error:
            detail = f"the link was lost: {second_error}"
        return Result(number, title, "failed", detail)


def _all_failed(first: Result) -> Iterator[Result]:
    for number, title in TITLES.items():
        if number != first.requirement and number not in MANUAL_TESTS:
            detail = f"not tried: {first.requirement} failed"
            yield Result(number, title, "failed", detail)
