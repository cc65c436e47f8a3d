"""Check of zero and span of the load cell, and of the noise of every channel.

The shunt is a resistor that the instrument switches to the load cell; it simulates a known load,
by which the span (sensitivity) is checked.
"""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from inversion.notices import Notice, Value
from pfwd_device.acquisition.items import Samples
from pfwd_device.calibration import load_channel, to_si
from pfwd_device.identity import Identity

AT_REST = 0.3
"""Length of the samples at rest that are evaluated, s: fifteen periods of mains hum."""

SHUNTED = 0.2
"""Length of the samples with the shunt on that are evaluated, s, after `SETTLING`."""

SETTLING = 0.05
"""Time after switching the shunt whose samples are not evaluated, s."""

LARGEST_ZERO = 0.01
"""Largest zero of the load channel, relative to its range: a load cell drifts by a percent of full
scale over a season. A larger zero means that something leans on it or that it was overloaded."""

LARGEST_ZERO_FLOOR = 150.0
"""Load at rest that is accepted in any case, N, such as the weight of parts on the load cell."""

SHUNT_ANSWER = 2.0
"""Longest time from the command until the shunt is on, or off again, s."""

REPEAT_AFTER = 0.25
"""Time after which a command to the shunt is repeated if it has no effect, s."""

SPAN_TOLERANCE = 0.02
"""Relative tolerance of the load that the shunt simulates: the accuracy of a calibration."""

CHECK_INTERVAL = 600.0
"""Time without a drop after which the sensors are checked again, s."""

Finding = tuple[dict[str, Any], tuple[Notice, ...]]


class Switch(Protocol):
    """Type of a function that switches the calibration shunt of the load cell on or off."""

    def __call__(self, on: bool) -> None: ...


class SensorChecker:
    """Checks the sensors before the first drop and after a pause, while the instrument is at rest.

    Parameters
    ----------
    identity : Identity
        Identity of the instrument, with the values of the setup file.
    shunt : callable
        Switches the calibration shunt.
    """

    def __init__(self, identity: Identity, shunt: Switch) -> None:
        self._identity = identity
        self._shunt = shunt
        self._rate = identity.sampling_rate
        self._load_index = load_channel(identity)
        self._has_shunt = identity.channels[self._load_index].shunt is not None
        self._is_on = False
        self._begin()

    @property
    def due(self) -> bool:
        """True if a check runs or is due, or if the shunt is on, during which no drop can be
        recorded.
        """
        return self._due or self._is_on

    def _begin(self) -> None:
        self._due = True
        self._rest: list[NDArray[np.int32]] = []
        self._shunted: list[NDArray[np.int32]] = []
        self._idle = 0
        self.shunt_requested = self._is_measured = False
        self._unanswered = self._unrepeated = 0

    def _switch(self, on: bool) -> None:
        self.shunt_requested = on
        self._unanswered = self._unrepeated = 0
        self._shunt(on)

    def _repeat_command(self, samples: Samples) -> None:
        """Repeat the last command to the shunt if it had no effect.

        The command may have been lost, or another program may have left the shunt on.
        """
        self._is_on = samples.shunt
        if samples.shunt == self.shunt_requested:
            return
        self._unanswered += len(samples.counts)
        self._unrepeated += len(samples.counts)
        if self._unrepeated > REPEAT_AFTER * self._rate:
            self._unrepeated = 0
            self._shunt(self.shunt_requested)

    def feed(self, samples: Samples, *, at_rest: bool) -> Finding | None:
        """Evaluate further samples; return the result of a check that they complete.

        Parameters
        ----------
        samples : Samples
        at_rest : bool
            True: no drop is in progress.

        Returns
        -------
        None
            No check is complete.
        details : dict
            ``zero_n``, ``span_ratio`` (measured over expected load of the shunt; None: no shunt)
            and ``channels``, a list with ``name``, ``noise`` (root mean square) and ``unit``.
        faults : tuple of Notice
        """
        self._repeat_command(samples)
        if not at_rest:
            self._idle = 0
            self._interrupt()
            return None
        self._idle += len(samples.counts)
        if not self._due:
            if self._idle > CHECK_INTERVAL * self._rate:
                self._begin()
            return None
        if self._is_measured:
            return self._wait_for_off(samples)
        if not self.shunt_requested:
            return self._feed_rest(samples)
        return self._feed_shunted(samples)

    def _feed_rest(self, samples: Samples) -> Finding | None:
        if samples.shunt:
            return None
        self._rest.append(samples.counts)
        if _length(self._rest) < AT_REST * self._rate:
            return None
        if not self._has_shunt:
            return self._conclude()
        self._switch(True)
        return None

    def _feed_shunted(self, samples: Samples) -> Finding | None:
        if samples.shunt:
            self._shunted.append(samples.counts)
        complete = _length(self._shunted) >= (SETTLING + SHUNTED) * self._rate
        if not complete and self._unanswered < SHUNT_ANSWER * self._rate:
            return None
        self._switch(False)
        self._is_measured = True
        return self._wait_for_off(samples) if not self._is_on else None

    def _wait_for_off(self, samples: Samples) -> Finding | None:
        """Return the result once the shunt is off, because drops cannot be recorded before."""
        if samples.shunt and self._unanswered < SHUNT_ANSWER * self._rate:
            return None
        return self._conclude()

    def _interrupt(self) -> None:
        """Interrupt a check because of a drop; it starts again afterwards."""
        if self._due:
            if self.shunt_requested:
                self._switch(False)
            self._begin()

    def _conclude(self) -> Finding:
        self._due = False
        return self._result()

    def _result(self) -> Finding:
        identity = self._identity
        counts = np.concatenate(self._rest)
        index = self._load_index
        load = identity.channels[index]
        # The median, on which a short disturbance has no influence.
        zero = float(np.median(to_si(counts[:, index], load, identity)))
        ratio = None
        faults = _zero_faults(zero, identity)
        if self._has_shunt and _length(self._shunted) < (SETTLING + SHUNTED) * self._rate:
            faults.append(Notice("span-not-checked"))
        elif load.shunt is not None:
            shunted = np.concatenate(self._shunted)[round(SETTLING * self._rate) :]
            values = to_si(shunted[:, index], load, identity)
            reading = float(np.median(values)) - zero
            ratio = reading / load.shunt
            if not abs(ratio - 1) <= SPAN_TOLERANCE:
                loads = {"shunt_n": load.shunt, "reading_n": reading}
                faults.append(Notice("span-off", loads))
        if self._is_on:
            faults.append(Notice("shunt-stays-on", {"limit_s": SHUNT_ANSWER}))
        channels = []
        for channel, column in zip(identity.channels, counts.T, strict=True):
            noise = float(to_si(column, channel, identity).std())
            channels.append({"name": channel.name, "noise": noise, "unit": channel.quantity.unit})
            if channel.is_used and np.ptp(column) == 0:
                constant: dict[str, Value] = {"channel": channel.name, "value": int(column[0])}
                faults.append(Notice("channel-constant", constant))
        details = {"zero_n": zero, "span_ratio": ratio, "channels": channels}
        return details, tuple(faults)


def _zero_faults(zero: float, identity: Identity) -> list[Notice]:
    load = identity.channels[load_channel(identity)]
    limit = max(LARGEST_ZERO * abs(identity.adc_range / load.sensitivity), LARGEST_ZERO_FLOOR)
    if abs(zero) <= limit:
        return []
    return [Notice("zero-too-large", {"limit_n": limit, "zero_n": zero})]


def _length(parts: list[NDArray[np.int32]]) -> int:
    return sum(map(len, parts))
