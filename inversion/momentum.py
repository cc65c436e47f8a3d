r"""Gain of a load cell from the momentum of a hammer of known mass that falls from a known height.

Over one contact the impulse of the force is the change of momentum and the weight:

.. math::
    \int F \, dt = m (v_1 + v_2) + m g T, \quad
    v_1 = \sqrt{2 g h (1 - f)}, \quad
    v_2 = g t \left/ \left(\frac{1}{1 + f} + \frac{1}{\sqrt{1 - f^2}}\right) \right.

with m the mass, h the height of fall, T the time of contact, and t the time from its end to the
second contact, in which the hammer rises and falls again. Friction of the guide is a share f of the
weight; it is declared, and any value up to the declared one is taken as equally likely.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit  # the same function in scipy.stats takes 0.3 s to import

from inversion.arrays import FloatArray
from inversion.errors import InversionError

GRAVITY = 9.80665
"""Standard gravity, m/s2; the true one differs by at most 0.3 %."""
MAX_SCATTER = 0.03
"""Largest relative standard deviation of the gains of single drops, beyond which the hammer did not
fall alike. A height that is kept to 1 % changes the gain by 0.4 %, friction of 3 % by 1 %."""
_EDGE = 0.002
"""Load over its peak at which a contact begins and ends."""
_SECOND_CONTACT = 0.05
"""Load over the peak of the first contact from which a second contact is searched back."""
_MIN_QUIET_SAMPLES = 4


@dataclass(frozen=True)
class Contact:
    """First contact of a drop, as the load cell reads it."""

    impulse: float
    """Integral of the reading over the contact, N s."""
    duration: float
    """Time of contact, s."""
    flight: float
    """Time from its end to the second contact, s."""


@dataclass(frozen=True)
class MomentumGain:
    """Gain of a load cell: reading over true force."""

    value: float
    deviation: float
    """Standard deviation from repeatability and friction."""
    interval: tuple[float, float]
    """95 % interval."""
    drops: int


def contact_of(time: FloatArray, load: FloatArray) -> Contact:
    """Return impulse and times of the first contact.

    Parameters
    ----------
    time : (n,) ndarray of float, s
        Times with 0 at the trigger.
    load : (n,) ndarray of float, N

    Raises
    ------
    InversionError
        If the record does not reach the second contact, or has missing samples.
    """
    quiet = int(np.searchsorted(time, 0.0)) // 2
    if quiet < _MIN_QUIET_SAMPLES or not np.isfinite(load).all():
        raise InversionError("expected a complete record with some samples at rest, got another")
    load = load - load[:quiet].mean()
    noise = float(load[:quiet].std())
    peak = int(np.argmax(load[: int(np.searchsorted(time, 0.1))]))
    edge = max(_EDGE * load[peak], 3 * noise)
    first = int(np.flatnonzero(load[:peak] < edge)[-1])
    after = np.flatnonzero(load[peak:] < edge)
    if not len(after):
        raise InversionError("expected a record up to the second contact, got one that ends before")
    last = peak + int(after[0])
    higher = np.flatnonzero(load[last + 1 :] > _SECOND_CONTACT * load[peak])
    if not len(higher):
        raise InversionError("expected a record up to the second contact, got one that ends before")
    second = last + 1 + int(higher[0])
    second = last + int(np.flatnonzero(load[last:second] < edge)[-1])
    inside = slice(first, last + 1)
    impulse = float(np.trapezoid(load[inside], time[inside]))
    return Contact(impulse, float(time[last] - time[first]), float(time[second] - time[last]))


def gain_by_momentum(
    contacts: Sequence[Contact], mass: float, height: float, friction: float = 0.0
) -> MomentumGain:
    """Return the gain of the load cell from several drops of one hammer.

    Parameters
    ----------
    contacts : sequence of Contact
    mass : float, kg
    height : float, m
        Height of fall.
    friction : float
        Largest friction of the guide over the weight, from 0.

    Raises
    ------
    InversionError
        If there are less than two drops, or they do not repeat.
    """
    count = len(contacts)
    if count < 2:
        raise InversionError(
            f"expected at least two drops with a second contact, got {count}; one does not show "
            "how they repeat"
        )
    shares = np.array([0.0, 0.5, 1.0]) * friction
    gains = np.array([[_gain(each, mass, height, f) for f in shares] for each in contacts])
    without_friction, value, with_friction = gains.mean(axis=0)
    scatter = float(gains[:, 1].std(ddof=1))
    if scatter > MAX_SCATTER * abs(float(value)):
        raise InversionError(
            f"expected gains of single drops within {100 * MAX_SCATTER:g} %, got "
            f"{100 * scatter / abs(float(value)):.2g} %; the hammer has to fall from one height "
            "and to bounce freely"
        )
    of_mean = scatter / np.sqrt(count)
    width = float(stdtrit(count - 1, 0.975)) * of_mean
    low, high = sorted((float(without_friction), float(with_friction)))
    deviation = float(np.hypot(of_mean, (high - low) / np.sqrt(12.0)))
    return MomentumGain(float(value), deviation, (low - width, high + width), count)


def _gain(contact: Contact, mass: float, height: float, friction: float) -> float:
    """Return the reading over the true force for a certain friction."""
    before = np.sqrt(2 * GRAVITY * height * (1 - friction))
    after = GRAVITY * contact.flight / (1 / (1 + friction) + 1 / np.sqrt(1 - friction**2))
    return float(contact.impulse / (mass * (before + after + GRAVITY * contact.duration)))
