"""Run of the tests of the requirements, one after the other, and their results."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from typing import Literal

from pfwd_device.conformance.instrument_link import (
    DROP_TIMEOUT_S,
    Failed,
    InstrumentLink,
    NotSupported,
)
from pfwd_device.conformance.requirements import NEED_A_DROP, REQUIREMENTS, by_hand
from pfwd_device.errors import DeviceError, DeviceRefused
from pfwd_device.transport.base import Transport


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
    link = InstrumentLink(open_port, drop_wait, announce)
    first, *numbers = REQUIREMENTS
    try:
        greeting = _try(first, link)
        yield greeting
        if greeting.result == "failed":
            for number in sorted(numbers, key=lambda number: int(number[2:])):
                sentence, test = REQUIREMENTS[number]
                if test is not by_hand:
                    yield Result(number, sentence, "failed", f"not tested, because {first} failed")
            return
        _refuse_waiting(link)
        selected = set(only) | ({"P-27"} if NEED_A_DROP & set(only) else set())
        for number in numbers:
            if not selected or number in selected:
                yield _try(number, link)
    finally:
        link.close()


def _refuse_waiting(link: InstrumentLink) -> None:
    try:
        link.identify()
        status = link.stop()
    except Failed:
        return  # the test of this requirement reports it
    if status.drops_waiting:
        raise DeviceRefused(
            f"expected an instrument without stored drops, got one with {status.drops_waiting}; "
            "record them first with `pfwd log`"
        )


def _try(number: str, link: InstrumentLink) -> Result:
    sentence, test = REQUIREMENTS[number]
    try:
        return Result(number, sentence, "passed", test(link))
    except NotSupported as err:
        return Result(number, sentence, "not-offered", str(err))
    except Failed as err:
        return Result(number, sentence, "failed", str(err))
    except DeviceError as err:
        detail = f"the link was lost: {err}"
        try:
            link.open()
        except DeviceError as second_error:
            detail = f"the link was lost: {second_error}"
        return Result(number, sentence, "failed", detail)
