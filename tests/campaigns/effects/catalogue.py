"""Catalogue of the simulated effects: name, scope, strengths and the function that simulates it.

An effect is a deviation of ground, plate or instrument from the declared model, such as a delayed
sensor or rock below the soil. The function builds a test point, whose drops all have the effect
with a given strength. `tests.campaigns.blind` writes trace files of them, whose headers do not
declare the effect.

Finite elements compute the ground (`response`). The motion of hammer, plate and nonlinear contact
is computed on it (`march`, `soil`, `mechanics`), and operators change the channels (`channels`).
The diagnosis knows some effects, its vocabulary; `unmodelled` and `faults` have others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tests.campaigns.effects import channels, faults, mechanics, unmodelled
from tests.campaigns.effects.scene import Scene, SimulatedPoint, altered, undisturbed

Build = Callable[[Scene, float], SimulatedPoint]


@dataclass(frozen=True)
class SimulatedEffect:
    """Entry of the catalogue: an effect with its strengths and its simulation."""

    name: str
    """Name of the effect."""
    scope: Literal["drop", "point", "device"]
    """Part that has the effect: a drop, all drops of a point, or all points of an instrument."""
    strengths: tuple[float, ...]
    """Strengths from undetectable to well detectable, in the unit of the second argument of
    `build`."""
    build: Build
    """Function that simulates a point with the effect, given its scene and the strength."""
    group: Literal["clean", "known", "unknown", "soil"] = "known"
    """`known`: in the vocabulary of effects; `unknown`: not in it; `soil`: the ground is no
    Kelvin-Voigt soil, and there is no other effect."""
    sites: Literal["any", "few", "shallow", "contact", "kelvin-voigt", "constant-q", "growth"] = (
        "any"
    )
    """Grounds on which the effect is simulated: `any`; `few`, because each strength needs a run of
    finite elements; `shallow`, with bedrock; `contact`, with a Poisson's ratio for which slip under
    the plate matters; or the name of a soil."""
    min_drops: int = 1
    """Smallest number of drops at a point."""
    min_sensors: int = 1
    """Smallest number of sensors."""
    variant: str = ""
    """Name of one of several ways to produce an effect."""

    @property
    def is_in_vocabulary(self) -> bool:
        """True if a diagnosis is expected to name the effect."""
        return self.group in ("clean", "known")

    @property
    def key(self) -> str:
        """Name of the effect, with its variant after a colon; key of `EFFECTS`."""
        return f"{self.name}:{self.variant}" if self.variant else self.name

    def curve(self, count: int) -> tuple[float, ...]:
        """Return `count` strengths from the weakest to the strongest, in geometric progression.

        If a ground allows only certain strengths, these are returned instead.
        """
        if self.sites not in ("any", "kelvin-voigt"):
            return self.strengths
        return tuple(float(x) for x in np.geomspace(self.strengths[0], self.strengths[-1], count))

    def drawn(self, generator: np.random.Generator) -> float:
        """Return a random strength between the weakest and the strongest, log-uniform.

        If a ground allows only certain strengths, one of these is returned.
        """
        if self.sites not in ("any", "kelvin-voigt") or self.strengths[0] == 0:
            return float(generator.choice(self.strengths))
        weakest, strongest = self.strengths[0], self.strengths[-1]
        return float(weakest * (strongest / weakest) ** generator.random())


def _lag(scene: Scene, delay: float) -> SimulatedPoint:
    return altered(scene, channels.sensor_lag, delay_s=delay)


def _geophone(scene: Scene, frequency: float) -> SimulatedPoint:
    damping = float(scene.device.uniform(0.2, 0.7))
    return altered(scene, channels.geophone_response, frequency_hz=frequency, damping=damping)


def _filter(scene: Scene, corner: float) -> SimulatedPoint:
    order = int(scene.device.integers(2, 7))
    # group delay at 0 of a Butterworth filter, about 0.16 s Hz per pole; most of it is compensated
    advance = float(scene.device.uniform(0.7, 1.0)) * 0.16 * order / corner
    channel: channels.AffectedChannels = "both" if scene.device.random() < 0.3 else "sensors"
    return undisturbed(scene).through(
        lambda s: channels.acquisition_filter(s, corner, order, advance, channel),
        corner_hz=corner,
        order=float(order),
        advance_s=advance,
        on_load=float(channel == "both"),
    )


def _drift(scene: Scene, share: float) -> SimulatedPoint:
    clean = undisturbed(scene)
    sign = -1.0 if scene.generator.random() < 0.5 else 1.0
    offset = sign * share * clean.signals[0].peak_velocity
    drift = offset * float(scene.generator.uniform(-10.0, 10.0))
    return clean.through(
        lambda s: channels.baseline_drift(s, offset, drift), offset_m_s=offset, drift_m_s2=drift
    )


def _hum(scene: Scene, share: float) -> SimulatedPoint:
    clean = undisturbed(scene)
    amplitude = share * clean.signals[0].peak_velocity
    frequency = float(scene.generator.choice([50.0, 60.0]))
    phases = scene.generator.uniform(0.0, 6.28, len(clean.signals))
    hummed = [
        channels.mains_hum(signals, amplitude, frequency, float(phase))
        for signals, phase in zip(clean.signals, phases, strict=True)
    ]
    parameters = {"amplitude_m_s": amplitude, "frequency_hz": frequency}
    return SimulatedPoint(hummed, clean.modulus, parameters)


def _saturation(scene: Scene, share: float) -> SimulatedPoint:
    channel: Literal["load", "sensors"] = "load" if scene.generator.random() < 0.5 else "sensors"
    clean = undisturbed(scene)
    largest = max(clean.signals, key=lambda s: s.peak_load)
    level = share * (largest.peak_load if channel == "load" else largest.peak_velocity)
    return clean.through(
        lambda s: channels.saturation(s, level, channel), level=level, on_load=channel == "load"
    )


def _flexure(scene: Scene, share: float) -> SimulatedPoint:
    frequency, damping = scene.device.uniform([150.0, 0.01], [300.0, 0.04]).tolist()
    return altered(
        scene, unmodelled.plate_mode, frequency_hz=frequency, damping=damping, share=share
    )


def _rocking(scene: Scene, share: float) -> SimulatedPoint:
    frequency, damping = scene.generator.uniform([20.0, 0.03], [50.0, 0.12]).tolist()
    return altered(
        scene, unmodelled.plate_mode, frequency_hz=frequency, damping=damping, share=share
    )


def _crosstalk(scene: Scene, share: float) -> SimulatedPoint:
    corner = float(scene.device.uniform(1.0, 60.0))
    return altered(scene, unmodelled.cable_crosstalk, share=share, corner_hz=corner)


def _clock(scene: Scene, error: float) -> SimulatedPoint:
    return altered(scene, unmodelled.time_base_error, error=error)


def _glitch(scene: Scene, share: float) -> SimulatedPoint:
    time = float(scene.generator.uniform(0.3, 1.2)) * scene.hammer_pulse
    return altered(scene, unmodelled.gain_glitch, time_s=time, share=share)


def _traffic(scene: Scene, share: float) -> SimulatedPoint:
    clean = undisturbed(scene)
    amplitude = share * clean.signals[0].peak_velocity
    frequency = float(scene.generator.uniform(8.0, 20.0))
    shaken = []
    for signals in clean.signals:
        # the vibration of a lorry lasts longer than the pulse, before, during and after it
        centre, width = scene.generator.uniform([-0.02, 0.02], [0.06, 0.2])
        shaken.append(unmodelled.passing_traffic(signals, amplitude, frequency, centre, width))
    return SimulatedPoint(shaken, clean.modulus, {"share": share, "frequency_hz": frequency})


def _curvature(scene: Scene, share: float) -> SimulatedPoint:
    return altered(scene, unmodelled.load_cell_curvature, share=share)


def _loose(scene: Scene, frequency: float) -> SimulatedPoint:
    damping = float(scene.generator.uniform(0.03, 0.15))
    return altered(scene, unmodelled.loose_sensor, frequency_hz=frequency, damping=damping)


def _smoothed_load(scene: Scene, corner: float) -> SimulatedPoint:
    order = int(scene.device.integers(1, 5))
    return altered(scene, channels.load_channel_filter, corner_hz=corner, order=order)


def _lost(scene: Scene, share: float) -> SimulatedPoint:
    clean = undisturbed(scene)
    time = float(scene.generator.uniform(0.2, 0.9)) * scene.hammer_pulse
    count = max(1, round(share * scene.hammer_pulse / clean.signals[0].time_step))
    return clean.through(
        lambda s: unmodelled.lost_samples(s, time, count), time_s=time, samples=float(count)
    )


CLEAN = "clean"
_m, _f = mechanics, faults
EFFECTS: dict[str, SimulatedEffect] = {
    effect.key: effect
    for effect in (
        SimulatedEffect(
            CLEAN, "drop", (0.0,), lambda scene, _: undisturbed(scene), "clean", "kelvin-voigt"
        ),
        SimulatedEffect("bedrock", "point", (12.0, 6.0, 3.0), _m.bedrock, sites="shallow"),
        SimulatedEffect("layer", "point", (1.15, 0.6, 2.5), _m.layer, sites="few", min_sensors=2),
        SimulatedEffect(
            "layer",
            "point",
            (0.7, 1.4, 1.8),
            _m.two_layers,
            sites="few",
            min_sensors=3,
            variant="two",
        ),
        SimulatedEffect("stress_dependence", "point", (0.05, 0.2, 0.45), _m.stress_within),
        SimulatedEffect(
            "stress_dependence",
            "point",
            (0.05, 0.2, 0.4),
            _m.stress_between,
            sites="few",
            min_drops=2,
            variant="between_drops",
        ),
        SimulatedEffect("hysteretic_unloading", "drop", (0.02, 0.1, 0.3), _m.hysteretic_unloading),
        SimulatedEffect("permanent_set", "drop", (0.01, 0.05, 0.2), _m.permanent_set),
        SimulatedEffect("plate_inertia", "device", (0.03, 0.15, 0.5), _m.plate_inertia),
        SimulatedEffect(
            "rough_contact",
            "point",
            (1.0, 0.97, 0.9),
            _m.rough_contact,
            sites="contact",
            min_sensors=2,
        ),
        SimulatedEffect("rebound", "drop", (0.002, 0.008, 0.02), _m.rebound),
        SimulatedEffect(
            "spring_rig", "point", (0.01, 0.03, 0.1), _m.spring_rig, sites="kelvin-voigt"
        ),
        SimulatedEffect("load_shape", "drop", (0.1, 0.3, 0.6), _m.load_shape),
        SimulatedEffect("acquisition_filter", "device", (1500.0, 500.0, 200.0), _filter),
        SimulatedEffect("sensor_lag", "device", (2e-5, 1e-4, 5e-4), _lag),
        SimulatedEffect("load_filter", "device", (800.0, 200.0, 60.0), _smoothed_load),
        SimulatedEffect("geophone_response", "device", (0.3, 2.0, 8.0), _geophone),
        SimulatedEffect("baseline_drift", "drop", (2e-4, 2e-3, 2e-2), _drift),
        SimulatedEffect("mains_hum", "drop", (5e-4, 5e-3, 5e-2), _hum),
        SimulatedEffect("saturation", "drop", (0.98, 0.85, 0.6), _saturation),
        SimulatedEffect("false_trigger", "drop", (0.03, 0.1, 0.3), _m.false_trigger),
        SimulatedEffect("plate_flexure", "device", (0.002, 0.02, 0.1), _flexure, "unknown"),
        SimulatedEffect("plate_rocking", "point", (0.005, 0.03, 0.15), _rocking, "unknown"),
        SimulatedEffect("cable_crosstalk", "device", (0.002, 0.02, 0.1), _crosstalk, "unknown"),
        SimulatedEffect("time_base_error", "device", (0.002, 0.02, 0.06), _clock, "unknown"),
        SimulatedEffect("gain_glitch", "drop", (0.005, 0.03, 0.15), _glitch, "unknown"),
        SimulatedEffect("passing_traffic", "drop", (0.002, 0.02, 0.1), _traffic, "unknown"),
        SimulatedEffect("load_cell_curvature", "device", (0.01, 0.04, 0.12), _curvature, "unknown"),
        SimulatedEffect("loose_sensor", "drop", (400.0, 150.0, 60.0), _loose, "unknown"),
        SimulatedEffect("tilted_plate", "point", (0.003, 0.02, 0.1), _f.tilted_plate, "unknown"),
        SimulatedEffect(
            "sensor_creep", "device", (0.03, 0.15, 0.5), _f.sensor_creep, "unknown", min_sensors=2
        ),
        SimulatedEffect(
            "ringing_load_cell", "device", (1200.0, 600.0, 250.0), _f.ringing_load_cell, "unknown"
        ),
        SimulatedEffect(
            "ringing_guide_rod", "device", (0.005, 0.02, 0.1), _f.ringing_guide_rod, "unknown"
        ),
        SimulatedEffect("coil_at_stop", "drop", (0.98, 0.85, 0.6), _f.coil_at_stop, "unknown"),
        SimulatedEffect(
            "missing_codes", "device", (0.003, 0.01, 0.05), _f.missing_codes, "unknown"
        ),
        SimulatedEffect(
            "channel_crosstalk", "device", (0.002, 0.02, 0.1), _f.channel_crosstalk, "unknown"
        ),
        SimulatedEffect(
            "damping_law", "point", (20.0, 10.0, 5.0), _m.undeclared_soil, "soil", "constant-q"
        ),
        SimulatedEffect(
            "modulus_gradient", "point", (0.1, 0.4, 1.0), _m.undeclared_soil, "soil", "growth"
        ),
        SimulatedEffect("lost_samples", "drop", (0.01, 0.03, 0.1), _lost, "unknown"),
    )
}
