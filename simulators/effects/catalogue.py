"""Every effect by name: scope, strengths, and how a point with it is made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from simulators.effects import channels, mechanics, outsiders
from simulators.effects.scene import Outcome, Scene, undisturbed

Scope = Literal["drop", "point", "device"]
Build = Callable[[Scene, float], Outcome]


@dataclass(frozen=True)
class Effect:
    """One effect and how strong it comes."""

    name: str
    scope: Scope
    strengths: tuple[float, ...]
    """From below to well above what can be seen; the unit is the builder's."""
    build: Build
    misread: str
    """What a naive reader would make of it."""
    known: bool = True
    """Whether the vocabulary of effects has it."""
    sites: Literal["any", "few", "shallow", "contact"] = "any"
    """Which grounds: any; few (each strength needs finite elements of its own); with bedrock;
    with a low or the usual Poisson's ratio, where slip under the plate shows."""
    least_drops: int = 1
    least_sensors: int = 1
    variant: str = ""
    """Tells apart the ways to make one effect."""

    @property
    def key(self) -> str:
        """Name and variant."""
        return f"{self.name}:{self.variant}" if self.variant else self.name

    def curve(self, count: int) -> tuple[float, ...]:
        """`count` strengths from the weakest to the strongest, where all grounds allow any."""
        if self.sites != "any":
            return self.strengths
        return tuple(float(x) for x in np.geomspace(self.strengths[0], self.strengths[-1], count))


def _lag(scene: Scene, delay: float) -> Outcome:
    return undisturbed(scene).through(lambda s: channels.sensor_lag(s, delay), delay_s=delay)


def _geophone(scene: Scene, frequency: float) -> Outcome:
    damping = float(scene.device.uniform(0.2, 0.7))
    return undisturbed(scene).through(
        lambda s: channels.geophone_response(s, frequency, damping),
        frequency_hz=frequency,
        damping=damping,
    )


def _filter(scene: Scene, corner: float) -> Outcome:
    order = int(scene.device.integers(2, 7))
    # group delay at 0 of a Butterworth filter, about 0.16 s Hz per pole; most of it taken back
    advance = float(scene.device.uniform(0.7, 1.0)) * 0.16 * order / corner
    channel: channels.Channel = "both" if scene.device.random() < 0.3 else "sensors"
    return undisturbed(scene).through(
        lambda s: channels.acquisition_filter(s, corner, order, advance, channel),
        corner_hz=corner,
        order=float(order),
        advance_s=advance,
        on_load=float(channel == "both"),
    )


def _drift(scene: Scene, share: float) -> Outcome:
    clean = undisturbed(scene)
    sign = -1.0 if scene.generator.random() < 0.5 else 1.0
    offset = sign * share * clean.signals[0].peak_velocity
    drift = offset * float(scene.generator.uniform(-10.0, 10.0))
    return clean.through(
        lambda s: channels.baseline_drift(s, offset, drift), offset_m_s=offset, drift_m_s2=drift
    )


def _hum(scene: Scene, share: float) -> Outcome:
    clean = undisturbed(scene)
    amplitude = share * clean.signals[0].peak_velocity
    frequency = float(scene.generator.choice([50.0, 60.0]))
    phases = scene.generator.uniform(0.0, 6.28, len(clean.signals))
    hummed = [
        channels.mains_hum(signals, amplitude, frequency, float(phase))
        for signals, phase in zip(clean.signals, phases, strict=True)
    ]
    parameters = {"amplitude_m_s": amplitude, "frequency_hz": frequency}
    return Outcome(hummed, clean.modulus, parameters)


def _saturation(scene: Scene, share: float) -> Outcome:
    channel: Literal["load", "sensors"] = "load" if scene.generator.random() < 0.5 else "sensors"
    clean = undisturbed(scene)
    largest = max(clean.signals, key=lambda s: s.peak_load)
    level = share * (largest.peak_load if channel == "load" else largest.peak_velocity)
    return clean.through(
        lambda s: channels.saturation(s, level, channel), level=level, on_load=channel == "load"
    )


def _flexure(scene: Scene, share: float) -> Outcome:
    frequency, damping = scene.device.uniform([150.0, 0.01], [300.0, 0.04])
    return undisturbed(scene).through(
        lambda s: outsiders.plate_flexure(s, frequency, damping, share),
        share=share,
        frequency_hz=float(frequency),
    )


def _rocking(scene: Scene, share: float) -> Outcome:
    frequency, damping = scene.generator.uniform([20.0, 0.03], [50.0, 0.12])
    return undisturbed(scene).through(
        lambda s: outsiders.plate_rocking(s, frequency, damping, share),
        share=share,
        frequency_hz=float(frequency),
    )


def _crosstalk(scene: Scene, share: float) -> Outcome:
    corner = float(scene.device.uniform(1.0, 60.0))
    return undisturbed(scene).through(
        lambda s: outsiders.cable_crosstalk(s, share, corner), share=share, corner_hz=corner
    )


def _clock(scene: Scene, error: float) -> Outcome:
    return undisturbed(scene).through(lambda s: outsiders.time_base_error(s, error), error=error)


def _glitch(scene: Scene, share: float) -> Outcome:
    time = float(scene.generator.uniform(0.3, 1.2)) * scene.hammer_pulse
    return undisturbed(scene).through(
        lambda s: outsiders.gain_glitch(s, time, share), share=share, time_s=time
    )


def _traffic(scene: Scene, share: float) -> Outcome:
    clean = undisturbed(scene)
    amplitude = share * clean.signals[0].peak_velocity
    frequency = float(scene.generator.uniform(10.0, 20.0))
    shaken = []
    for signals in clean.signals:
        centre, width = scene.generator.uniform([0.0, 0.02], [0.05, 0.05])
        shaken.append(outsiders.passing_traffic(signals, amplitude, frequency, centre, width))
    return Outcome(shaken, clean.modulus, {"share": share, "frequency_hz": frequency})


def _curvature(scene: Scene, share: float) -> Outcome:
    return undisturbed(scene).through(
        lambda s: outsiders.load_cell_curvature(s, share), share=share
    )


CLEAN = "clean"
_m = mechanics
EFFECTS: dict[str, Effect] = {
    effect.key: effect
    for effect in (
        Effect(CLEAN, "drop", (0.0,), lambda scene, _: undisturbed(scene), "nothing"),
        Effect("bedrock", "point", (12.0, 6.0, 3.0), _m.bedrock, "stiffer ground", True, "shallow"),
        Effect("layer", "point", (1.15, 0.6, 2.5), _m.layer, "one modulus", True, "few", 1, 2),
        Effect("stress_dependence", "point", (0.05, 0.2, 0.45), _m.stress_within, "damping, a lag"),
        Effect(
            "stress_dependence",
            "point",
            (0.05, 0.2, 0.4),
            _m.stress_between,
            "scatter",
            True,
            "few",
            2,
            1,
            "between_drops",
        ),
        Effect(
            "hysteretic_unloading", "drop", (0.02, 0.1, 0.3), _m.hysteretic_unloading, "damping"
        ),
        Effect("permanent_set", "drop", (0.01, 0.05, 0.2), _m.permanent_set, "softer ground"),
        Effect("plate_inertia", "device", (0.03, 0.15, 0.5), _m.plate_inertia, "wrong density"),
        Effect(
            "rough_contact",
            "point",
            (1.0, 0.97, 0.9),
            _m.rough_contact,
            "softer ground",
            True,
            "contact",
            1,
            2,
        ),
        Effect("rebound", "drop", (0.002, 0.008, 0.02), _m.rebound, "ringing ground"),
        Effect("spring_rig", "point", (0.01, 0.03, 0.1), _m.spring_rig, "ground without damping"),
        Effect("load_shape", "drop", (0.1, 0.3, 0.6), _m.load_shape, "wrong peak"),
        Effect("acquisition_filter", "device", (1500.0, 500.0, 200.0), _filter, "damping"),
        Effect("sensor_lag", "device", (2e-5, 1e-4, 5e-4), _lag, "viscosity"),
        Effect("geophone_response", "device", (0.3, 2.0, 8.0), _geophone, "bedrock"),
        Effect("baseline_drift", "drop", (2e-4, 2e-3, 2e-2), _drift, "a permanent set"),
        Effect("mains_hum", "drop", (5e-4, 5e-3, 5e-2), _hum, "a resonance"),
        Effect("saturation", "drop", (0.98, 0.85, 0.6), _saturation, "stiffer or softer ground"),
        Effect("false_trigger", "drop", (0.03, 0.1, 0.3), _m.false_trigger, "a drop"),
        Effect("plate_flexure", "device", (0.002, 0.02, 0.1), _flexure, "softer", False),
        Effect("plate_rocking", "point", (0.005, 0.03, 0.15), _rocking, "softer", False),
        Effect("cable_crosstalk", "device", (0.002, 0.02, 0.1), _crosstalk, "viscosity", False),
        Effect("time_base_error", "device", (0.002, 0.02, 0.06), _clock, "another depth", False),
        Effect("gain_glitch", "drop", (0.005, 0.03, 0.15), _glitch, "a set", False),
        Effect("passing_traffic", "drop", (0.002, 0.02, 0.1), _traffic, "a set", False),
        Effect("load_cell_curvature", "device", (0.01, 0.04, 0.12), _curvature, "stress", False),
    )
}
