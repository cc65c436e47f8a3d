"""State of the instrument on the screen."""

import datetime
from collections.abc import Mapping
from dataclasses import dataclass

from pfwd.session.events import InstrumentReady


@dataclass(slots=True)
class Device:
    """Instrument of the session: identity, link, battery, lost samples, faults."""

    url: str = ""
    serial_number: str = ""
    model: str = ""
    firmware: str = ""
    rate: float | None = None
    """Sampling rate, Hz."""
    due: datetime.date | None = None
    """Date on which the first calibration of a channel expires."""
    battery: float | None = None
    """Battery, V."""
    temperature: float | None = None
    lost_samples: int = 0
    overruns_before: float | None = None
    """Lost samples that the instrument counted before this session; None: not reported yet."""
    connected: bool = False
    lost_reason: str = ""
    ready: bool = False
    """True once the load at rest is known, while drops can be recorded."""
    not_ready_reason: str = ""
    battery_low: bool = False
    check_faults: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def device_of(event: InstrumentReady, before: Device) -> Device:
    """Return the state of an instrument that has identified itself; counters continue."""
    identity = event.identity
    dues = [channel.due for channel in identity.channels if channel.due is not None]
    return Device(
        url=event.url,
        serial_number=identity.serial_number,
        model=identity.model,
        firmware=identity.firmware,
        rate=identity.sampling_rate,
        due=min(dues, default=None),
        lost_samples=before.lost_samples,
        overruns_before=before.overruns_before,
        battery=before.battery,
        connected=True,
        warnings=(*event.differences, *event.warnings),
    )


def lost_samples(counters: Mapping[str, float | None], overruns_before: float = 0) -> int:
    """Return the samples lost since the session began, in the instrument and on the way.

    Parameters
    ----------
    counters : mapping
    overruns_before : float
        Counter of the instrument at the begin of the session; it counts from power-up.
    """
    lost, overruns = (counters.get(name) or 0 for name in ("samples_lost", "instrument_overruns"))
    # A smaller counter than before means that the instrument was restarted.
    new = overruns - overruns_before if overruns >= overruns_before else overruns
    return int(lost + new)
