"""Gives an instrument its calibration, to keep: what its Identity says from then on."""

from collections.abc import Callable, Sequence

from pfwd_device.conformance.talk import Failed, Talk
from pfwd_device.errors import DeviceRefused
from pfwd_device.identity import Identity
from pfwd_device.transport.base import Transport
from pfwd_device.wire.fields import day
from pfwd_device.wire.messages import Calibrate, Hello, Refusal, RefusalCode

_HINTS: dict[int, str] = {
    RefusalCode.UNKNOWN: "it has no memory that lasts, or an older firmware",
    RefusalCode.BUSY: "end what measures; `pfwd log` records the drops that wait",
}


def calibration_of(identity: Identity, channel: int) -> Calibrate:
    """What an identity says of a channel, as it can be stored.

    Parameters
    ----------
    identity : Identity
    channel : int
        From 0.
    """
    said = identity.channels[channel]
    return Calibrate(
        channel,
        said.sensitivity,
        said.zero,
        said.natural_frequency,
        said.damping,
        said.shunt,
        day(said.calibrated),
        day(said.due),
    )


def store_calibration(
    open_port: Callable[[], Transport], calibrations: Sequence[Calibrate]
) -> Identity:
    """Have an instrument keep a calibration, channel by channel.

    Parameters
    ----------
    open_port : callable
        Opens the link.
    calibrations : sequence of Calibrate
        `calibration_of` gives those that it has, to be changed.

    Returns
    -------
    Identity
        What the instrument says of itself afterwards.

    Raises
    ------
    PortError
        If the link cannot be opened.
    DeviceRefused
        If the instrument does not answer, or keeps one of them not; those before it are kept.
    """
    talk = Talk(open_port)
    try:
        identity = talk.answer(Hello(), Identity)
        for calibration in calibrations:
            identity = _store(talk, calibration)
    except Failed as err:
        raise DeviceRefused(f"calibration: {err}; try again, or `pfwd conform`") from err
    finally:
        talk.close()
    return identity


def answer(talk: Talk, calibration: Calibrate) -> Identity | Refusal:
    """What a calibration is answered by; `Failed` when it is not, not even the second time."""
    for _ in range(2):
        talk.say(calibration)
        said = talk.until(object, which=lambda said: isinstance(said, Identity | Refusal))
        if isinstance(said, Identity | Refusal):
            return said
    raise Failed(f"expected Identity or Refusal of Calibrate, got {talk.lately()}")


def _store(talk: Talk, calibration: Calibrate) -> Identity:
    said = answer(talk, calibration)
    if isinstance(said, Identity):
        return said
    hint = _HINTS.get(said.code, "see `pfwd conform`")
    text = f"expected the instrument to keep it, got a refusal (code {said.code}): {said.text}"
    raise DeviceRefused(f"calibration of channel {calibration.channel}: {text}; {hint}")
