"""The drops of a point with their noise at rest: without hum, and as all of them tell it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from inversion.diagnosis.mains_line import hum_before, without_mains_line
from inversion.measured.record import NoiseModel, PreparedDrop, Record, prepare

# Times by which the rms of noise differs between two drops by chance: correlated noise of a few
# tens of samples tells it to a third.
_AS_LOUD = 2.0


@dataclass(frozen=True, eq=False)
class DropAtRest:
    """A drop to its end, with the noise of its channels.

    Parameters
    ----------
    drop : PreparedDrop, sensors from the plate outward
    hum, harmonics, most_hum : of the hum before the pulse, see `DropContext`
    """

    drop: PreparedDrop
    hum: tuple[tuple[float, float, float], ...]
    harmonics: tuple[tuple[int, float, float], ...]
    most_hum: float


def drops_at_rest(records: Sequence[Record]) -> list[DropAtRest]:
    """Drops of one instrument at one point.

    The time before one pulse is short: how large the noise is it tells well, but how slow, which
    counts most once it is integrated, only by chance. So drops in which a channel is about as
    loud have one noise there, that of them all.

    Raises
    ------
    RecordError
        If a load has no positive pulse.
    """
    found = []
    for record in records:
        # Models answer in this order, whatever order the record has.
        ordered = record.nearest_first()
        drop = prepare(ordered).with_tail()
        channels = [
            hum_before(
                sensor.values[: channel.model.samples], drop.step, velocity=channel.integrates
            )
            for sensor, channel in zip(ordered.sensors, drop.channels, strict=True)
        ]
        quiet, line = without_mains_line(drop, ordered)
        middle = 0.5 * (drop.channels[0].model.samples - 1) * drop.step
        since = drop.start - float(ordered.time[0]) - middle
        told = (*((line.told,) if line else ()), *channels[0].lines)
        hum = tuple((size, hertz, (turns + hertz * since) % 1.0) for size, hertz, turns in told)
        most = max(channel.most for channel in channels)
        found.append(DropAtRest(quiet, hum, line.harmonics if line else (), most))
    of_channels = [
        _pooled([channel.model for channel in channels])
        for channels in zip(*(one.drop.channels for one in found), strict=True)
    ]
    return [
        replace(one, drop=_with_noise(one.drop, models))
        for one, models in zip(found, zip(*of_channels, strict=True), strict=True)
    ]


def _pooled(models: Sequence[NoiseModel]) -> list[NoiseModel]:
    """Of one channel in each drop: the noise of those that are about as loud as the middle one."""
    loudness = [model.rms for model in models]
    middle = sorted(loudness)[(len(models) - 1) // 2]
    alike = [middle <= _AS_LOUD * rms <= _AS_LOUD**2 * middle for rms in loudness]
    common = NoiseModel.pooled([m for m, same in zip(models, alike, strict=True) if same])
    return [common if same else model for model, same in zip(models, alike, strict=True)]


def _with_noise(drop: PreparedDrop, models: Sequence[NoiseModel]) -> PreparedDrop:
    channels = tuple(
        replace(channel, model=model) for channel, model in zip(drop.channels, models, strict=True)
    )
    return replace(drop, channels=channels).with_tail()
