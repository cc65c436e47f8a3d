"""The requirements of the protocol by their numbers in docs/protocol.md, and the test of each."""

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
"""Largest fraction of damaged frames that is accepted: a link damages a few frames, whereas an
instrument with a wrong CRC damages all."""

TITLES = {
    "P-1": "every frame has a valid COBS encoding, length and CRC",
    "P-2": "the frame counter increases by one with each frame",
    "P-3": "Hello is answered by an Identity within 1 s",
    "P-4": "the newest common version is chosen, and a host without a common version is refused "
    "(version)",
    "P-5": "the Identity is complete, within its limits, and the same each time",
    "P-6": "Configure sets the nearest possible rate, and the responding Identity contains it",
    "P-7": "a rate of NaN, 0 or below is refused (argument)",
    "P-8": "Start is answered by samples within 1 s",
    "P-9": "each Start begins a stream with a new number, at index 0 unless the instrument is "
    "armed",
    "P-10": "sample indices are consecutive, and omitted samples are counted as overruns",
    "P-11": "samples arrive at least every 0.1 s, at most 5 ms in a frame, with the channels of "
    "the Identity",
    "P-12": "the sampling rate is that of the Identity, by the clocks of host and instrument",
    "P-13": "the clock of the instrument runs evenly and never back",
    "P-14": "Stop ends the samples, and the responding Status reports it",
    "P-15": "a Status arrives at least every 0.5 s, with and without sampling",
    "P-16": "Hello does not disturb a running stream",
    "P-17": "an unknown message is refused (unknown)",
    "P-18": "damaged frames are not answered, and the next undamaged one is",
    "P-19": "bytes after the fields of a message are ignored",
    "P-20": "Shunt is answered by an Event, and a flag of the samples reports the shunt",
    "P-21": "the shunt switches off by itself 10 s after it was switched on",
    "P-22": "after commands in any order and state the instrument still answers",
    "P-23": "after the link is reopened the instrument answers, and its stream continues or a "
    "Status reports that it does not",
    "P-24": "a Status counts the stored drops",
    "P-25": "Arm is answered by Armed with the settings in force, and invalid settings are refused "
    "(argument)",
    "P-26": "while the instrument is armed, Start and Stop do not begin a new stream",
    "P-27": "a drop is offered when it is complete, and again until it is acknowledged",
    "P-28": "a drop has as many samples before and after the trigger as Armed reported",
    "P-29": "the blocks of a drop are numbered from 0, have the lengths of the Offer, and together "
    "its CRC",
    "P-30": "any range of blocks can be fetched again, with the same bytes",
    "P-31": "a Fetch of an unknown drop or block is refused (argument)",
    "P-32": "a drop stays stored until it is acknowledged, also after Hello and over a new link",
    "P-33": "each Acknowledge is answered by Released, and the drop is no longer offered",
    "P-34": "Resend returns the same samples with the same indices",
    "P-35": "a Resend of samples that are no longer, or not yet, in the ring is answered by Gone",
    "P-36": "the ring is as long as the Identity reports",
    "P-38": "stored drops survive a reset if the Identity reports so",
    "P-39": "a drop during a lost link, or with the shunt on, is stored",
    "P-40": "Calibrate is answered by an Identity with the calibration, and invalid values are "
    "refused (argument)",
    "P-41": "Calibrate is refused (busy) while samples are sent, the shunt is on, or a drop is "
    "recorded or stored",
    "P-42": "a stored calibration survives a reset, and is never stored in part",
}
MANUAL_TESTS = {"P-38", "P-39", "P-42"}
"""Requirements that need the power or the cable of the instrument to be switched by hand."""

MIN_FRAMES = 8
"""Smallest number of frames for a test of their counter."""
NEED_A_DROP = {"P-28", "P-29", "P-30", "P-32", "P-33"}
"""Requirements that concern a drop that the operator makes during the test of P-27."""

Check = Callable[[InstrumentLink], str]


@dataclass(frozen=True, slots=True)
class Result:
    """Result of the test of one requirement."""

    requirement: str
    """Number of the requirement in docs/protocol.md, such as "P-12"."""
    title: str
    """The requirement as a sentence."""
    result: Literal["passed", "failed", "not-offered"]
    """Outcome; "not-offered" if the instrument lacks the function, or the test needs hands."""
    detail: str
    """Short description of the behaviour of the instrument."""


def conform(
    open_port: Callable[[], Transport],
    *,
    drop_wait: float = DROP_TIMEOUT_S,
    announce: Callable[[str], None] = lambda text: None,
    only: Collection[str] = (),
) -> Iterator[Result]:
    """Test whether an instrument meets the requirements of the protocol, one after the other.

    Parameters
    ----------
    open_port : callable
        Function that opens the port and returns its transport; it is called several times.
    drop_wait : float, s
        Longest wait for a drop that the operator makes.
    announce : callable
        Function that receives a text for the operator, who has to make a drop.
    only : collection of str
        Numbers of the requirements to test, such as "P-12"; empty: all. The first response (P-3) is
        always tested, and the announcement of a stored drop (P-27) with each test of such a drop.

    Yields
    ------
    Result

    Raises
    ------
    PortError
        If the port cannot be opened at the beginning.
    DeviceRefused
        If the instrument has stored drops, which the test would delete without recording them.
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
            yield Result(number, TITLES[number], "not-offered", "has to be tested by hand")
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
        ("P-40", calibrating.stores),
        ("P-41", calibrating.not_while_busy),
        ("P-1", frames_valid),
        ("P-2", frames_counted),
    ]


def frames_valid(link: InstrumentLink) -> str:
    """Test that the received frames have a valid encoding, length and CRC."""
    counters = link.counters
    frames = counters.frames_good + counters.frames_damaged
    if counters.frames_damaged > max(3, MAX_DAMAGED_FRACTION * frames):
        raise Failed(f"expected valid frames, got {counters.frames_damaged} damaged of {frames}")
    return f"{counters.frames_damaged} damaged of {frames}"


def frames_counted(link: InstrumentLink) -> str:
    """Test that the number of each received frame is one more than that of the frame before it."""
    if len(link.received) < MIN_FRAMES:
        link.receive(0.5 * MIN_FRAMES)
    steps = [
        (later.counter - earlier.counter) % 65536
        for earlier, later in pairwise(link.received)
        if later.connection == earlier.connection
    ]
    n_wrong = sum(step != 1 for step in steps)
    # Each damaged frame causes a gap in the numbers, and so does a reset of the instrument.
    if n_wrong > link.counters.frames_damaged + MAX_DAMAGED_FRACTION * len(steps):
        raise Failed(
            f"expected frame numbers that increase by 1, got {n_wrong} other steps of {len(steps)}"
        )
    return f"{len(steps) + 1} frames"


def _refuse_waiting(link: InstrumentLink) -> None:
    try:
        link.request(Hello(), Identity)
        status = link.request(Stop(), Status)
    except Failed:
        return  # the test of this requirement reports it
    if status.drops_waiting:
        raise DeviceRefused(
            f"expected an instrument without stored drops, got one with {status.drops_waiting}; "
            "record them first with `pfwd log`"
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
            detail = f"not tested, because {first.requirement} failed"
            yield Result(number, title, "failed", detail)
