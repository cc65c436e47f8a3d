"""Noise of the drops of a point, estimated before the trigger, without hum and pooled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from inversion.diagnosis.mains_line import hum_before, without_mains_line
from inversion.measured.record import NoiseModel, PreparedDrop, Record, prepare

# Largest ratio of the noise of two drops that are pooled. A few tens of correlated samples
# determine the root mean square of the noise to a third.
_SIMILAR_RMS_RATIO = 2.0


@dataclass(frozen=True, eq=False)
class PreTriggerNoise:
    """Noise of a drop before its trigger, with the drop up to the end of its record.

    Parameters
    ----------
    drop : PreparedDrop, sensors from the plate outward
    hum, harmonics, max_hum : mains hum before the pulse, see `DropContext`
    """

    drop: PreparedDrop
    hum: tuple[tuple[float, float, float], ...]
    harmonics: tuple[tuple[int, float, float], ...]
    max_hum: float


def estimate_pre_trigger_noise(records: Sequence[Record]) -> list[PreTriggerNoise]:
    """Return the drops of one point with the noise of their channels.

    The record before one pulse is short. It determines the root mean square of the noise well, but
    not its slow part, which dominates after integration. Therefore the noise of a channel is pooled
    over the drops with a similar root mean square.

    Raises
    ------
    RecordError
        If a load has no positive pulse.
    """
    estimates = []
    for record in records:
        # Models return the sensors in this order, whatever order the record has.
        ordered = record.nearest_first()
        drop = prepare(ordered).with_tail()
        channels = [
            hum_before(sensor.values[: channel.model.samples], drop.step, channel.integrations)
            for sensor, channel in zip(ordered.sensors, drop.channels, strict=True)
        ]
        quiet, line = without_mains_line(drop, ordered)
        centre = 0.5 * (drop.channels[0].model.samples - 1) * drop.step
        delay = drop.start - float(ordered.time[0]) - centre
        lines = (*((line.as_tuple,) if line else ()), *channels[0].lines)
        hum = tuple((size, hertz, (turns + hertz * delay) % 1.0) for size, hertz, turns in lines)
        max_amplitude = max(channel.max_amplitude for channel in channels)
        estimates.append(PreTriggerNoise(quiet, hum, line.harmonics if line else (), max_amplitude))
    of_channels = [
        _pool_noise([channel.model for channel in channels])
        for channels in zip(*(estimate.drop.channels for estimate in estimates), strict=True)
    ]
    return [
        replace(estimate, drop=_with_noise(estimate.drop, models))
        for estimate, models in zip(estimates, zip(*of_channels, strict=True), strict=True)
    ]


def _pool_noise(models: Sequence[NoiseModel]) -> list[NoiseModel]:
    """Return the noise of one channel in each drop, pooled over the drops near the median."""
    loudness = [model.rms for model in models]
    median = sorted(loudness)[(len(models) - 1) // 2]
    is_similar = [
        median <= _SIMILAR_RMS_RATIO * rms <= _SIMILAR_RMS_RATIO**2 * median for rms in loudness
    ]
    common = NoiseModel.pooled([m for m, same in zip(models, is_similar, strict=True) if same])
    return [common if same else model for model, same in zip(models, is_similar, strict=True)]


def _with_noise(drop: PreparedDrop, models: Sequence[NoiseModel]) -> PreparedDrop:
    channels = tuple(
        replace(channel, model=model) for channel, model in zip(drop.channels, models, strict=True)
    )
    return replace(drop, channels=channels).with_tail()
