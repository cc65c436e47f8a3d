"""The requirements of docs/protocol.md by their numbers, and what tries each."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from pfwd_device.conformance import basics, calibrating, keeping, streaming
from pfwd_device.conformance.talk import Failed, NotOffered, Talk
from pfwd_device.errors import DeviceError, DeviceRefused
from pfwd_device.identity import Identity
from pfwd_device.transport.base import Transport
from pfwd_device.wire.messages import Hello, Status, Stop

DROP_WAIT = 15.0
"""s to wait for a drop."""
MOST_DAMAGED = 0.02
"""Of the frames: a link damages some, an instrument with a wrong CRC all of them."""

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
BY_HAND = {"P-38", "P-39", "P-42"}
"""Nobody can switch an instrument off over its link."""

FEWEST_FRAMES = 8
"""From which something can be said of their counter."""
NEED_A_DROP = {"P-28", "P-29", "P-30", "P-32", "P-33"}

Check = Callable[[Talk], str]


@dataclass(frozen=True, slots=True)
class Result:
    """What became of one requirement."""

    requirement: str
    """Its number."""
    title: str
    result: Literal["passed", "failed", "not-offered"]
    detail: str
    """What came."""


def conform(
    open_port: Callable[[], Transport],
    *,
    drop_wait: float = DROP_WAIT,
    announce: Callable[[str], None] = lambda text: None,
    only: Collection[str] = (),
) -> Iterator[Result]:
    """Try an instrument, requirement by requirement.

    Parameters
    ----------
    open_port : callable
        Opens the link, as often as it is called.
    drop_wait : float, s
        How long to wait for a drop.
    announce : callable
        Told what the operator should do.
    only : collection of str
        Numbers of those to try; empty: all. Hello (P-3) is tried always, and a drop has to be
        offered (P-27) before anything can be tried with it.

    Yields
    ------
    Result

    Raises
    ------
    PortError
        If the link cannot be opened, the first time.
    DeviceRefused
        If drops wait in the instrument: they would be acknowledged without being recorded.
    """
    talk = Talk(open_port)
    try:
        first = _try("P-3", basics.greeting, talk)
        yield first
        if first.result == "failed":
            yield from _all_failed(first)
            return
        _refuse_waiting(talk)
        wanted = set(only) | ({"P-27"} if NEED_A_DROP & set(only) else set())
        for number, check in _checks(drop_wait, announce):
            if not wanted or number in wanted:
                yield _try(number, check, talk)
        for number in sorted(BY_HAND & wanted if wanted else BY_HAND):
            yield Result(number, TITLES[number], "not-offered", "needs hands; try it yourself")
    finally:
        talk.close()


def _checks(wait: float, announce: Callable[[str], None]) -> list[tuple[str, Check]]:
    drop = keeping.BufferedDropCheck(wait, announce)
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
        ("P-24", keeping.waiting),
        ("P-25", keeping.arms),
        ("P-26", keeping.run_goes_on),
        ("P-27", drop.offered),
        ("P-28", drop.cut),
        ("P-29", drop.whole),
        ("P-30", drop.again),
        ("P-31", drop.nothing_there),
        ("P-32", drop.kept),
        ("P-33", drop.acknowledged),
        ("P-34", streaming.sent_again),
        ("P-35", streaming.gone),
        ("P-36", streaming.ring_length),
        ("P-37", keeping.spoken_to_in_version_1),
        ("P-40", calibrating.stores),
        ("P-41", calibrating.not_while_busy),
        ("P-1", frames_whole),
        ("P-2", frames_counted),
    ]


def frames_whole(talk: Talk) -> str:
    """P-1."""
    counters = talk.counters
    frames = counters.frames_good + counters.frames_damaged
    if counters.frames_damaged > max(3, MOST_DAMAGED * frames):
        raise Failed(f"expected whole frames, got {counters.frames_damaged} damaged of {frames}")
    return f"{counters.frames_damaged} damaged of {frames}"


def frames_counted(talk: Talk) -> str:
    """P-2."""
    if len(talk.heard) < FEWEST_FRAMES:
        talk.listen(0.5 * FEWEST_FRAMES)
    steps = [
        (later.counter - earlier.counter) % 65536
        for earlier, later in pairwise(talk.heard)
        if later.visit == earlier.visit
    ]
    wrong = sum(step != 1 for step in steps)
    # Damaged frames leave their numbers out; the number of another instrument's reset is one more.
    if wrong > talk.counters.frames_damaged + MOST_DAMAGED * len(steps):
        raise Failed(f"expected one more for each frame, got {wrong} other steps of {len(steps)}")
    return f"{len(steps) + 1} frames"


def _refuse_waiting(talk: Talk) -> None:
    try:
        talk.answer(Hello(), Identity)
        status = talk.answer(Stop(), Status)
    except Failed:
        return  # what is wrong with it is told by its number
    if status.drops_waiting:
        raise DeviceRefused(
            f"expected an instrument in which no drop waits, got one with {status.drops_waiting}; "
            "`pfwd log` records them first"
        )


def _try(number: str, check: Check, talk: Talk) -> Result:
    title = TITLES[number]
    try:
        return Result(number, title, "passed", check(talk))
    except NotOffered as err:
        return Result(number, title, "not-offered", str(err))
    except Failed as err:
        return Result(number, title, "failed", str(err))
    except DeviceError as err:
        detail = f"the link was lost: {err}"
        try:
            talk.open()
        except DeviceError as other:
            detail = f"the link was lost: {other}"
        return Result(number, title, "failed", detail)


def _all_failed(first: Result) -> Iterator[Result]:
    for number, title in TITLES.items():
        if number != first.requirement and number not in BY_HAND:
            detail = f"not tried: {first.requirement} failed"
            yield Result(number, title, "failed", detail)
