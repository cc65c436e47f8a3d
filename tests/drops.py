"""Drops whose shape is known."""

import numpy as np
from numpy.typing import NDArray

from pfwd_device import Channel, Drop


def half_sine_drop(
    *,
    number: int = 1,
    peak: float = 8000.0,
    duration: float = 0.018,
    pre_trigger: float = 0.005,
    window: float = 0.06,
    rate: float = 10_000.0,
    offset: float = 0.0,
    offsets: tuple[float, ...] = (0.0,),
    quantity: str = "displacement",
) -> Drop:
    """A drop of `peak` N and `duration` s; the load cell adds `offset` N."""
    first = -round(pre_trigger * rate)
    time = np.arange(first, round(window * rate)) / rate
    load = peak * _half_sine(time, duration)
    channels = []
    for place in offsets:
        # 0.5 mm per 8 kN in the centre, later and less further out; late and long like a real one.
        pulse = 5e-4 * _half_sine(time - 1e-3 - abs(place) / 100, 1.2 * duration) * peak / 8000
        values = pulse / (1 + 5 * abs(place))
        if quantity == "velocity":
            values = np.gradient(values, time)
        channels.append(Channel(place, quantity, values))  # type: ignore[arg-type]
    return Drop(number, time, load + offset, tuple(channels))


def _half_sine(time: NDArray[np.float64], duration: float) -> NDArray[np.float64]:
    inside = (time > 0) & (time < duration)
    return np.where(inside, np.sin(np.pi * time / duration), 0.0)
