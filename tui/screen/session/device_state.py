"""The instrument as the screen shows it."""

import datetime
from collections.abc import Mapping
from dataclasses import dataclass

from pfwd.session.events import InstrumentReady


@dataclass(slots=True)
class Device:
    """The instrument and its link."""

    url: str = ""
    serial_number: str = ""
    model: str = ""
    firmware: str = ""
    rate: float | None = None
    """Hz."""
    due: datetime.date | None = None
    """The first calibration that expires."""
    battery: float | None = None
    """V."""
    temperature: float | None = None
    lost_samples: int = 0
    overruns_before: float | None = None
    """What the instrument had lost before this session; None: it has not said."""
    connected: bool = False
    lost_reason: str = ""
    ready: bool = False
    """The load at rest is known."""
    battery_low: bool = False
    check_faults: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def device_of(event: InstrumentReady, before: Device) -> Device:
    """The instrument that has just said who it is; what is counted goes on from `before`."""
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
    """Samples that did not arrive since the session began, wherever they were lost.

    Parameters
    ----------
    counters : mapping
    overruns_before : float
        What the instrument had counted before: its counter goes on from when it was switched on.
    """
    lost, overruns = (counters.get(name) or 0 for name in ("samples_lost", "instrument_overruns"))
    # A counter below what it was has begun anew.
    new = overruns - overruns_before if overruns >= overruns_before else overruns
    return int(lost + new)
