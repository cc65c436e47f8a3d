"""Simulation of a bad cable that damages frames and bytes, reproducible by a seed.

A frame is the packed form of one message of the protocol.
"""

from __future__ import annotations

import numpy as np

from simulators.instrument.scenario import LinkSettings

_FRAMES, _BYTES, _GARBAGE = 4, 5, 6  # streams of random numbers


class BadCable:
    """Simulated cable that loses, repeats and reorders frames, and flips bits in the others.

    Which frames and bytes are damaged depends only on the seed and on their number since the start,
    not on the sizes in which they are sent.

    Parameters
    ----------
    settings : LinkSettings
        Fractions of frames and bytes to damage.
    seed : int
        Seed of the random numbers.
    """

    def __init__(self, settings: LinkSettings, seed: int) -> None:
        self._settings = settings
        self._frames = np.random.default_rng([seed, _FRAMES])
        self._bytes = np.random.default_rng([seed, _BYTES])
        self._garbage = np.random.default_rng([seed, _GARBAGE])
        self._rates = (settings.lost_rate, settings.repeated_rate, settings.reordered_rate)
        self._delayed_frame = b""
        self._ordered_counts: dict[str, int] = {}
        self._until_error = self._bytes_to_next_error()

    def order(self, kind: str, count: int) -> None:
        """Request that the next frames with samples are damaged.

        Parameters
        ----------
        kind : "lost", "repeated", "reordered" or "bit-errors"
        count : int
            Number of frames; for "bit-errors" the number of bits in the next frame.
        """
        self._ordered_counts[kind] = self._ordered_counts.get(kind, 0) + count

    def garbage(self, count: int) -> bytes:
        """Return `count` random bytes, as noise on the line."""
        return self._garbage.bytes(count)

    def carry(self, frame: bytes, samples: bool = True) -> bytes:
        """Return the bytes that arrive when a frame is sent.

        Parameters
        ----------
        frame : bytes
        samples : bool
            True if the frame contains samples; `order` affects only such frames.
        """
        if not frame:
            return b""
        kind = self._next_ordered() if samples else ""
        if not kind and any(self._rates):
            kind = self._draw_fault()
        if kind == "bit-errors":
            frame = self._flip(frame, self._ordered_counts.pop("bit-errors"))
        out = b""
        match kind:
            case "lost":
                pass
            case "repeated":
                out = frame + frame
            case "reordered":
                if self._delayed_frame:
                    out = frame
                else:
                    self._delayed_frame = frame
            case _:
                out = frame
        if out and self._delayed_frame:
            out, self._delayed_frame = out + self._delayed_frame, b""
        return self.flip_bits(out)

    def flip_bits(self, data: bytes) -> bytes:
        """Return the bytes with random bits flipped, at the rate of the settings."""
        if self._until_error is None:
            return data
        if self._until_error >= len(data):
            self._until_error -= len(data)
            return data
        damaged = bytearray(data)
        place = self._until_error
        while place < len(damaged):
            damaged[place] ^= 1 << int(self._bytes.integers(8))
            place += 1 + (self._bytes_to_next_error() or 0)
        self._until_error = place - len(damaged)
        return bytes(damaged)

    def release(self) -> bytes:
        """Return a frame that was delayed to reorder it, at the end of the transmission."""
        out, self._delayed_frame = self._delayed_frame, b""
        return self.flip_bits(out)

    def _next_ordered(self) -> str:
        if self._ordered_counts.get("bit-errors"):
            return "bit-errors"
        for kind in ("lost", "repeated", "reordered"):
            if self._ordered_counts.get(kind):
                self._ordered_counts[kind] -= 1
                return kind
        return ""

    def _draw_fault(self) -> str:
        draw = float(self._frames.uniform())
        for kind, rate in zip(("lost", "repeated", "reordered"), self._rates, strict=True):
            if draw < rate:
                return kind
            draw -= rate
        return ""

    def _flip(self, frame: bytes, count: int) -> bytes:
        """Return a frame with `count` of its bits flipped."""
        damaged = bytearray(frame)
        bits = self._bytes.choice(8 * len(frame), min(count, 8 * len(frame)), replace=False)
        for bit in bits.tolist():
            damaged[bit // 8] ^= 1 << bit % 8
        return bytes(damaged)

    def _bytes_to_next_error(self) -> int | None:
        """Return the number of undamaged bytes before the next error; None without errors."""
        rate = self._settings.bit_error_rate
        return int(self._bytes.geometric(rate)) - 1 if rate > 0 else None
