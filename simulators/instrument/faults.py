"""What a bad cable does to frames and bytes, reproducibly."""

from __future__ import annotations

import numpy as np

from simulators.instrument.scenario import LinkSettings

_FRAMES, _BYTES, _GARBAGE = 4, 5, 6  # streams of random numbers


class BadCable:
    """Loses, repeats and reorders frames, and flips bits of what is left.

    Whole frames first, then bytes, as in a cable behind a driver with a queue. Which frame and
    which byte are hit depends on their number since the start alone, not on how bytes are cut.

    Parameters
    ----------
    settings : LinkSettings
        The rates.
    seed : int
    """

    def __init__(self, settings: LinkSettings, seed: int) -> None:
        self._settings = settings
        self._frames = np.random.default_rng([seed, _FRAMES])
        self._bytes = np.random.default_rng([seed, _BYTES])
        self._garbage = np.random.default_rng([seed, _GARBAGE])
        self._rates = (settings.lost_rate, settings.repeated_rate, settings.reordered_rate)
        self._held = b""
        self._due: dict[str, int] = {}
        self._until_error = self._gap()

    def order(self, kind: str, count: int) -> None:
        """Do this to the next frames of samples: `lost`, `repeated`, `reordered`, `bit-errors`."""
        self._due[kind] = self._due.get(kind, 0) + count

    def garbage(self, count: int) -> bytes:
        """Random bytes."""
        return self._garbage.bytes(count)

    def carry(self, frame: bytes, samples: bool = True) -> bytes:
        """The bytes that come out at the other end when this frame is sent.

        Parameters
        ----------
        samples : bool
            Whether the frame holds samples: others are spared by `order`, not by the rates.
        """
        if not frame:
            return b""
        kind = self._ordered() if samples else ""
        if not kind and any(self._rates):
            kind = self._drawn()
        if kind == "bit-errors":
            frame = self._flip(frame, self._due.pop("bit-errors"))
        out = b""
        match kind:
            case "lost":
                pass
            case "repeated":
                out = frame + frame
            case "reordered":
                if self._held:
                    out = frame
                else:
                    self._held = frame
            case _:
                out = frame
        if out and self._held:
            out, self._held = out + self._held, b""
        return self.wear(out)

    def wear(self, data: bytes) -> bytes:
        """The same bytes with the errors that the rate brings."""
        if self._until_error is None:
            return data
        if self._until_error >= len(data):
            self._until_error -= len(data)
            return data
        worn = bytearray(data)
        place = self._until_error
        while place < len(worn):
            worn[place] ^= 1 << int(self._bytes.integers(8))
            place += 1 + (self._gap() or 0)
        self._until_error = place - len(worn)
        return bytes(worn)

    def release(self) -> bytes:
        """A frame that still waits for its follower: there is none."""
        out, self._held = self._held, b""
        return self.wear(out)

    def _ordered(self) -> str:
        if self._due.get("bit-errors"):
            return "bit-errors"
        for kind in ("lost", "repeated", "reordered"):
            if self._due.get(kind):
                self._due[kind] -= 1
                return kind
        return ""

    def _drawn(self) -> str:
        draw = float(self._frames.uniform())
        for kind, rate in zip(("lost", "repeated", "reordered"), self._rates, strict=True):
            if draw < rate:
                return kind
            draw -= rate
        return ""

    def _flip(self, frame: bytes, count: int) -> bytes:
        """Different bits of one frame, flipped."""
        worn = bytearray(frame)
        bits = self._bytes.choice(8 * len(frame), min(count, 8 * len(frame)), replace=False)
        for bit in bits.tolist():
            worn[bit // 8] ^= 1 << bit % 8
        return bytes(worn)

    def _gap(self) -> int | None:
        """Whole bytes before the next that is hit."""
        rate = self._settings.bit_error_rate
        return int(self._bytes.geometric(rate)) - 1 if rate > 0 else None
