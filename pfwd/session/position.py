"""Position of the instrument, from a satellite receiver on a port of its own (NMEA 0183).

The receiver may come and go, send garbage or stand still: a drop is never held up for it. What is
recorded says how good the position was and how old.
"""

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

from pynmea2 import ParseError, parse

from pfwd.files.header import is_position
from pfwd_device.errors import DeviceError
from pfwd_device.transport.base import Transport
from pfwd_device.transport.opening import open_transport

BAUD_RATE = 9600
"""Baud rate of most receivers; those on USB ignore it."""

STALE = 10.0
"""s; a person walks ten metres in it. Receivers send every second."""

LONGEST_SENTENCE = 1024
"""Bytes; NMEA allows 82. What is longer is another protocol or noise."""

RECONNECT_INTERVAL = 2.0
"""s between attempts to open a receiver that is gone."""

READ_WAIT = 0.2
"""s; how soon the thread notices that it is to end."""

POOR_HDOP = 5.0
"""Horizontal dilution of precision from which a position is reported as poor; receivers call more
than 5 moderate at best."""

FIX_NAMES = {
    1: "satellites",
    2: "differential",
    3: "military",
    4: "RTK fixed",
    5: "RTK float",
    6: "dead reckoning",
    7: "typed into the receiver",
    8: "simulated",
}
"""Fix quality of a GGA sentence; 0 is no fix."""


class PositionSource(Protocol):
    """Position of the instrument."""

    def record(self) -> dict[str, Any]:
        """Return the position as JSON, as recorded with a drop."""


@dataclass(frozen=True, slots=True)
class Fix:
    """One position of a receiver."""

    latitude: float
    """Degrees, north positive."""
    longitude: float
    """Degrees, east positive."""
    altitude: float | None
    """m above mean sea level, by the receiver."""
    quality: int
    """1 satellites, 2 differential, 4 RTK fixed, 5 RTK float, ..., as GGA has it; never 0."""
    hdop: float | None
    """Horizontal dilution of precision."""
    satellites: int | None
    time_utc: str | None
    """Time of day that the receiver gives, ISO 8601."""
    received: float
    """Monotonic clock, s."""


class NmeaParser:
    """Parser of NMEA sentences from bytes in parts of any size.

    Parameters
    ----------
    clock : callable
        Monotonic clock, s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._rest = b""
        self.refused = 0
        """Sentences with a wrong checksum or no sense."""
        self.without_fix = 0
        """Number of sentences without a position."""

    def feed(self, data: bytes) -> list[Fix]:
        """Return the positions that are complete with further bytes."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_SENTENCE:
            self._rest = b""
            self.refused += 1
        fixes = [self._fix(line) for line in lines]
        return [fix for fix in fixes if fix is not None]

    def _fix(self, line: bytes) -> Fix | None:
        # Garbage before a sentence costs what is before it, not the sentence.
        start = line.rfind(b"$")
        if start < 0 or len(line) > LONGEST_SENTENCE:
            self.refused += bool(line.strip())
            return None
        text = line[start:].decode("ascii", "replace").strip()
        if text[3:6] != "GGA":
            return None  # other sentences have no position
        try:
            # A checksum has to be there: a flipped digit is a position elsewhere.
            return self._of(parse(text, check=True))
        except (ParseError, ValueError, TypeError, AttributeError, IndexError):
            self.refused += 1
            return None

    def _of(self, sentence: Any) -> Fix | None:
        quality = int(sentence.gps_qual or 0)
        # Without a fix the library gives 0, 0, which is a place in the Atlantic.
        if quality <= 0 or not sentence.lat or not sentence.lon:
            self.without_fix += 1
            return None
        latitude, longitude = float(sentence.latitude), float(sentence.longitude)
        if not is_position(latitude, longitude):
            raise ValueError("outside of the globe")
        stamp = sentence.timestamp
        return Fix(
            latitude,
            longitude,
            _number(sentence.altitude),
            quality,
            _number(sentence.horizontal_dil),
            None if _number(sentence.num_sats) is None else int(float(sentence.num_sats)),
            stamp.isoformat() if stamp else None,
            self._clock(),
        )


def _number(value: object) -> float | None:
    try:
        number = float(str(value))
    except ValueError:
        return None
    return number if math.isfinite(number) else None


class PositionReceiver:
    """Reader of a receiver in a thread of its own; a context manager.

    Parameters
    ----------
    url : str
        Port: /dev/ttyACM0, COM4, socket://host:port.
    open_port : callable
        Opens the port; for tests.
    clock : callable
        Monotonic clock, s.
    stale : float
        s after which a position is none any more.
    """

    def __init__(
        self,
        url: str,
        *,
        open_port: Callable[[], Transport] | None = None,
        clock: Callable[[], float] = time.monotonic,
        stale: float = STALE,
    ) -> None:
        self.url = url
        self._open = open_port or (lambda: open_transport(url, baud_rate=BAUD_RATE))
        self._clock = clock
        self._stale = stale
        self._parser = NmeaParser(clock)
        self._last: Fix | None = None
        self._fault: str | None = "nothing received yet"
        self._end = threading.Event()
        self._first: Transport | None = None
        self._thread = threading.Thread(target=self._run, name="position", daemon=True)

    def open(self) -> None:
        """Open the port and begin to read.

        Raises
        ------
        DeviceError
            If the port cannot be opened now; later losses are waited out.
        """
        self._first = self._open()
        self._thread.start()

    def close(self) -> None:
        """End the thread and close the port."""
        self._end.set()
        if self._thread.ident is not None:
            self._thread.join(timeout=5.0)

    def __enter__(self) -> "PositionReceiver":
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def latest(self) -> Fix | None:
        """Last position; None: there is none, or it is stale."""
        fix = self._last
        if fix is None or self._clock() - fix.received > self._stale:
            return None
        return fix

    def record(self) -> dict[str, Any]:
        """Return the position recorded with a drop, its quality and age, or why there is none."""
        fix, counts = self._last, {"sentences_refused": self._parser.refused}
        if fix is None:
            reason = self._fault or "the receiver has no fix"
            return {"source": "nmea", "fault": reason, **counts}
        age = self._clock() - fix.received
        details: dict[str, Any] = {
            "altitude_m": fix.altitude,
            "fix_quality": fix.quality,
            "fix": FIX_NAMES.get(fix.quality, "unknown"),
            "hdop": fix.hdop,
            "satellites": fix.satellites,
            "receiver_time_utc": fix.time_utc,
            "age_s": age,
        }
        place = {"latitude": fix.latitude, "longitude": fix.longitude}
        if age > self._stale:
            # Stored under another name, so that no reader takes it for the place of the drop.
            reason = f"stale: {age:.0f} s old"
            return {"source": "nmea", "fault": reason, "last_known": place, **details, **counts}
        return {"source": "nmea", **place, **details, **counts}

    def warning(self) -> str | None:
        """Return the warning for the operator; None: the position is good."""
        fix = self.latest()
        if fix is None:
            return f"no position: {self.record().get('fault')}"
        if fix.hdop is not None and fix.hdop > POOR_HDOP:
            return f"poor position: HDOP {fix.hdop:g}"
        return None

    def _run(self) -> None:
        port, self._first = self._first, None
        while not self._end.is_set():
            try:
                if port is None:
                    port = self._open()
                data = port.read(READ_WAIT)
                for fix in self._parser.feed(data):
                    self._last = replace(fix)
                if data:
                    self._fault = None
            except (DeviceError, OSError) as err:
                self._fault = f"the receiver is lost: {err}"
                if port is not None:
                    port.close()
                port = None
                self._end.wait(RECONNECT_INTERVAL)
        if port is not None:
            port.close()
