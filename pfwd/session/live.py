"""Feed of a session from an instrument."""

import dataclasses
import datetime
import secrets
from typing import Any, Literal

from pfwd.session.buffered_drops import trigger_for
from pfwd.session.feeds import FeedItem
from pfwd.session.setup_file import MeasuringSetup
from pfwd_device.acquisition.driver import Driver
from pfwd_device.errors import DeviceRefused
from pfwd_device.recording import CaptureWriter
from pfwd_device.wire.messages import DropOffer

SETTLE_TIME_S = 2.0
"""Time to wait at the end. A lost Acknowledge is repeated after 1 s, when the drop is offered
again; later the survey recognises the drop by its key."""


class LiveFeed:
    """Feed of one instrument.

    Parameters
    ----------
    url : str
        Port of the instrument.
    setup : MeasuringSetup
        Says its language.
    capture : bool
        Keep every byte in `captured`, which is set before `open`.
    first_stream : int, optional
        Number of the first run of a sampler that does not number its runs; at random otherwise.
    """

    live = True

    def __init__(
        self,
        url: str,
        setup: MeasuringSetup,
        *,
        capture: bool = False,
        first_stream: int | None = None,
    ) -> None:
        device = setup.device
        self.captured: CaptureWriter | None = None
        self._driver = Driver(
            url,
            device.make_dialect(random_stream() if first_stream is None else first_stream),
            sampling_rate=device.sampling_rate,
            capture=self._keep if capture else None,
            baud_rate=device.baud_rate,
            trigger=lambda identity: trigger_for(setup.identity_with(identity), device.detection),
        )

    def open_port(self) -> None:
        """Open the port alone; nothing is read before `open`.

        Raises
        ------
        PortError
        """
        self._driver.open_port()

    def open(self) -> None:
        """Begin, and open the port unless it is open; without this call `next` does it.

        Raises
        ------
        PortError
        """
        self._driver.open()

    def next(self, timeout: float) -> FeedItem | None:
        """Return the next item; None: no item within a number of seconds."""
        return self._driver.next(timeout)

    def shunt(self, on: bool) -> None:
        """Switch the calibration shunt, if the instrument takes commands."""
        try:
            self._driver.shunt(on)
        except DeviceRefused:
            return  # it only sends, and has no shunt that could be switched

    def acknowledge(self, offer: DropOffer) -> None:
        """Report that the buffered drop of an offer is safe."""
        self._driver.acknowledge(offer)

    def settle(self) -> None:
        """Wait until the instrument has released its safe drops, or `SETTLE_TIME_S`."""
        self._driver.settle(SETTLE_TIME_S)

    def counters(self) -> dict[str, float | None]:
        """Return counts of discarded items by name, and the drift of the clock in ppm."""
        nested = dataclasses.asdict(self._driver.counters)
        link: dict[str, Any] = nested.pop("link")
        driver = self._driver
        return {**link, **nested, "drift_ppm": driver.drift_ppm, "clock_speed": driver.clock_speed}

    @property
    def lost_since(self) -> float | None:
        """Monotonic clock when the instrument was lost, s; None: it answers."""
        return self._driver.lost_since

    def close(self) -> None:
        """Stop the instrument and close the port."""
        self._driver.close()

    def _keep(
        self, _ns: int, _utc: datetime.datetime, direction: Literal["from", "to"], data: bytes
    ) -> None:
        assert self.captured is not None
        self.captured.write(direction, data)


def random_stream() -> int:
    """Return a random number for the first run of a sampler: keys of its drops are new."""
    return secrets.randbits(32)
