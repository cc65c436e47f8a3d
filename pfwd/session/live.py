"""Feed of a session from a connected instrument."""

import dataclasses
import datetime
import secrets
from typing import Any

from pfwd.session.buffered_drops import trigger_for
from pfwd.session.feeds import FeedItem
from pfwd.session.setup_file import MeasuringSetup
from pfwd_device.acquisition.driver import CaptureDirection, Driver
from pfwd_device.errors import DeviceRefused
from pfwd_device.recording import CaptureWriter
from pfwd_device.wire.messages import DropOffer, Status

SETTLE_TIME_S = 2.0
"""Longest wait for confirmations at the end of a session. An acknowledgement that was lost is
repeated when the instrument offers the drop again, after 1 s. If that is too late, the survey
recognises the drop by its key the next time."""


class LiveFeed:
    """Feed from one instrument.

    Parameters
    ----------
    url : str
        Port of the instrument, as in /dev/ttyUSB0, COM3 or socket://127.0.0.1:4000.
    setup : MeasuringSetup
        Declares the dialect (protocol) and the sampling rate of the instrument.
    capture : bool
        True: every byte is written to the attribute `captured`, which is set before `open`.
    first_stream : int, optional
        Number of the first sampling run, for an instrument that does not number its runs; None: a
        random number.
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
        """Open the port; nothing is read from it before `open`.

        Raises
        ------
        PortError
        """
        self._driver.open_port()

    def open(self) -> None:
        """Connect to the instrument, after opening the port if necessary.

        Raises
        ------
        PortError
        """
        self._driver.open()

    def next(self, timeout: float) -> FeedItem | None:
        """Return the next item; None: none arrived within `timeout`, s."""
        return self._driver.next(timeout)

    def shunt(self, on: bool) -> None:
        """Switch the calibration shunt of the load cell; no effect if the instrument takes no
        commands.
        """
        try:
            self._driver.shunt(on)
        except DeviceRefused:
            return  # the instrument takes no commands

    def acknowledge(self, offer: DropOffer) -> None:
        """Report to the instrument that a buffered drop is saved and may be erased."""
        self._driver.acknowledge(offer)

    def settle(self) -> Status | None:
        """Wait until the instrument has confirmed the acknowledged drops, or `SETTLE_TIME_S`;
        return its last status.
        """
        return self._driver.settle(SETTLE_TIME_S)

    def counters(self) -> dict[str, float | None]:
        """Return the numbers of discarded messages by kind, and the drift of the instrument's
        clock, ppm.
        """
        nested = dataclasses.asdict(self._driver.counters)
        link: dict[str, Any] = nested.pop("link")
        driver = self._driver
        return {**link, **nested, "drift_ppm": driver.drift_ppm, "clock_speed": driver.clock_speed}

    @property
    def lost_since(self) -> float | None:
        """Time at which the connection was lost, s, monotonic clock; None: it is not lost."""
        return self._driver.lost_since

    def close(self) -> None:
        """Stop the instrument's sampling and close the port."""
        self._driver.close()

    def _keep(
        self, ns: int, utc: datetime.datetime, direction: CaptureDirection, data: bytes
    ) -> None:
        assert self.captured is not None
        self.captured.write(direction, data, ns, round(utc.timestamp() * 1e6) * 1000)


def random_stream() -> int:
    """Return a random number for a first sampling run, so that the keys of its drops are new."""
    return secrets.randbits(32)
