"""Whether an instrument keeps the protocol, for the command line."""

from collections.abc import Callable, Collection, Iterator

from pfwd.errors import SurveyError, refusal
from pfwd_device.conformance import Result
from pfwd_device.conformance import conform as _conform
from pfwd_device.conformance.requirements import DROP_WAIT, TITLES
from pfwd_device.transport.opening import BAUD_RATE, open_transport

__all__ = ["Result", "conform"]


def conform(
    url: str,
    *,
    baud_rate: int = BAUD_RATE,
    drop_wait: float = DROP_WAIT,
    announce: Callable[[str], None] = lambda text: None,
    only: Collection[str] = (),
) -> Iterator[Result]:
    """Try the instrument at a port, requirement by requirement.

    Parameters
    ----------
    url : str
        As for `pfwd log`.
    baud_rate : int
        Of a serial port.
    drop_wait : float, s
        How long to wait for a drop.
    announce : callable
        Told what the operator should do.
    only : collection of str
        Numbers of those to try; empty: all.

    Raises
    ------
    PortError, DeviceRefused
        If the port cannot be opened, or drops wait in the instrument.
    SurveyError
        If there is no requirement of a number.
    """
    wrong = [number for number in only if number not in TITLES]
    if wrong:
        last = list(TITLES)[-1]
        raise SurveyError(refusal("--only", f"numbers from P-1 to {last}", ", ".join(wrong)))
    return _conform(
        lambda: open_transport(url, baud_rate), drop_wait=drop_wait, announce=announce, only=only
    )
