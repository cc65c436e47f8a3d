"""Position of the instrument from a satellite receiver on a port of its own (NMEA 0183).

A drop never waits for the receiver, which may be disconnected or send noise. The record of a
position states its quality and age.
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
"""Baud rate of most receivers; a receiver on USB ignores it."""

STALE = 10.0
"""Age after which a position is not used, s: a person walks ten metres in it. Receivers send every
second."""

LONGEST_SENTENCE = 1024
"""Longest accepted sentence, bytes; NMEA allows 82. A longer one is another protocol or noise."""

RECONNECT_INTERVAL = 2.0
"""Time between attempts to open the port of a lost receiver, s."""

READ_WAIT = 0.2
"""Longest wait for bytes, s, and thereby for the end of the thread."""

POOR_HDOP = 5.0
"""Horizontal dilution of precision (HDOP) above which a position is reported as poor; receivers
call values above 5 moderate at best."""

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
"""Names of the fix qualities in a GGA sentence; the quality 0 means no position."""


class PositionSource(Protocol):
    """Interface of a source of positions."""

    def record(self) -> dict[str, Any]:
        """Return the position to record with a drop, as JSON data."""


@dataclass(frozen=True, slots=True)
class Fix:
    """One position from a receiver."""

    latitude: float
    """Degrees, north positive."""
    longitude: float
    """Degrees, east positive."""
    altitude: float | None
    """Altitude above mean sea level, m; None: not in the sentence."""
    quality: int
    """Quality as in GGA sentences; key of `FIX_NAMES`."""
    hdop: float | None
    """Horizontal dilution of precision; None: not in the sentence."""
    satellites: int | None
    time_utc: str | None
    """Time of day by the receiver, ISO 8601; None: not in the sentence."""
    received: float
    """Time of arrival, s, monotonic clock."""


class NmeaParser:
    """Parser of NMEA sentences, from bytes that arrive in parts of any size.

    Parameters
    ----------
    clock : callable
        Returns the time, s, monotonic.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._rest = b""
        self.refused = 0
        """Number of sentences with a wrong checksum or invalid content."""
        self.without_fix = 0
        """Number of sentences without a position."""

    def feed(self, data: bytes) -> list[Fix]:
        """Parse further bytes and return the positions that they complete."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > LONGEST_SENTENCE:
            self._rest = b""
            self.refused += 1
        fixes = [self._fix(line) for line in lines]
        return [fix for fix in fixes if fix is not None]

    def _fix(self, line: bytes) -> Fix | None:
        # Noise before a sentence is skipped.
        start = line.rfind(b"$")
        if start < 0 or len(line) > LONGEST_SENTENCE:
            self.refused += bool(line.strip())
            return None
        text = line[start:].decode("ascii", "replace").strip()
        if text[3:6] != "GGA":
            return None  # other sentences have no position
        try:
            # Sentences without checksum are refused: a wrong digit would be a wrong position.
            return self._of(parse(text, check=True))
        except (ParseError, ValueError, TypeError, AttributeError, IndexError):
            self.refused += 1
            return None

    def _of(self, sentence: Any) -> Fix | None:
        quality = int(sentence.gps_qual or 0)
        # Without a position pynmea2 returns 0, 0, which is a valid position in the Atlantic.
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
    """Satellite receiver, read in a thread of its own; a context manager.

    Parameters
    ----------
    url : str
        Port: /dev/ttyACM0, COM4, socket://host:port.
    open_port : callable, optional
        Opens the port; for tests.
    clock : callable
        Returns the time, s, monotonic.
    """

    def __init__(
        self,
        url: str,
        *,
        open_port: Callable[[], Transport] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.url = url
        self._open = open_port or (lambda: open_transport(url, baud_rate=BAUD_RATE))
        self._clock = clock
        self._parser = NmeaParser(clock)
        self._last: Fix | None = None
        self._fault: str | None = "nothing received yet"
        self._end = threading.Event()
        self._first: Transport | None = None
        self._thread = threading.Thread(target=self._run, name="position", daemon=True)

    def open(self) -> None:
        """Open the port and start to read.

        Raises
        ------
        DeviceError
            If the port cannot be opened. A port that is lost later is opened again.
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
        """Return the last position; None: there is none, or it is too old."""
        fix = self._last
        if fix is None or self._clock() - fix.received > STALE:
            return None
        return fix

    def record(self) -> dict[str, Any]:
        """Return the position to record with a drop, with quality and age.

        Returns
        -------
        dict
            JSON data. The key ``fault`` has the reason if there is no position; a position that is
            too old is under ``last_known``.
        """
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
        if age > STALE:
            # Stored under another key, so that no reader uses it as the position of the drop.
            reason = f"stale: {age:.0f} s old"
            return {"source": "nmea", "fault": reason, "last_known": place, **details, **counts}
        return {"source": "nmea", **place, **details, **counts}

    def warning(self) -> str | None:
        """Return a warning for the operator, such as "poor position: HDOP 7"; None: the position is
        good.
        """
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
