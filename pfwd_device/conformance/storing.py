"""Storage of a calibration in the permanent memory of an instrument.

The identity that the instrument reports contains the calibration from then on.
"""

from collections.abc import Callable, Sequence

from pfwd_device.conformance.instrument_link import Failed, InstrumentLink
from pfwd_device.errors import DeviceRefused
from pfwd_device.identity import Identity
from pfwd_device.transport.base import Transport
from pfwd_device.wire.fields import day
from pfwd_device.wire.messages import Calibrate, Refusal, RefusalCode

_HINTS: dict[int, str] = {
    RefusalCode.UNKNOWN: "the instrument has no permanent memory, or an older firmware",
    RefusalCode.BUSY: "end the measurement, and record stored drops with `pfwd log`",
}


def calibration_of(identity: Identity, channel: int) -> Calibrate:
    """Return the present calibration of a channel, in the form of the command that stores it.

    Parameters
    ----------
    identity : Identity
    channel : int
        Index of the channel, from 0.
    """
    source = identity.channels[channel]
    resonance = source.natural_frequency, source.damping
    days = day(source.calibrated), day(source.due)
    return Calibrate(channel, source.sensitivity, source.zero, *resonance, source.shunt, *days)


def store_calibration(
    open_port: Callable[[], Transport], calibrations: Sequence[Calibrate]
) -> Identity:
    """Store calibrations in an instrument, channel by channel.

    Parameters
    ----------
    open_port : callable
        Function that opens the port and returns its transport.
    calibrations : sequence of Calibrate
        New calibrations; `calibration_of` returns the present ones.

    Returns
    -------
    Identity
        Identity of the instrument afterwards.

    Raises
    ------
    PortError
        If the port cannot be opened.
    DeviceRefused
        If the instrument does not respond or refuses a calibration; the earlier ones are stored.
    """
    link = InstrumentLink(open_port)
    try:
        identity = link.identify()
        for calibration in calibrations:
            response = send_calibration(link, calibration)
            if isinstance(response, Refusal):
                hint = _HINTS.get(response.code, "test the instrument with `pfwd conform`")
                raise DeviceRefused(
                    f"calibration of channel {calibration.channel}: expected the instrument to "
                    f"store it, got a refusal (code {response.code}): {response.text}; {hint}"
                )
            identity = response
    except Failed as err:
        raise DeviceRefused(
            f"calibration: {err}; try again, or test the instrument with `pfwd conform`"
        ) from err
    finally:
        link.close()
    return identity


def send_calibration(link: InstrumentLink, calibration: Calibrate) -> Identity | Refusal:
    """Send a calibration to the instrument and return its response.

    Raises
    ------
    Failed
        If two attempts have no response.
    """
    for _ in range(2):
        link.send(calibration)
        response = link.wait_for(object, accept=lambda each: isinstance(each, Identity | Refusal))
        if isinstance(response, Identity | Refusal):
            return response
    raise Failed(f"expected Identity or Refusal of Calibrate, got {link.latest_kinds()}")
