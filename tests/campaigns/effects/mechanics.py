"""Effects in ground, plate and hammer, computed with finite elements.

Each function builds a test point with an effect, given the scene (ground, plate, hammer, sensors)
and the strength of the effect.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from simulators.drop import STANDARD_GRAVITY, SimulatedDrop
from simulators.mesh import Array, SoilProfile
from tests.campaigns.effects.march import Indentation, strike
from tests.campaigns.effects.response import stacked_ground
from tests.campaigns.effects.scene import Scene, SimulatedPoint
from tests.campaigns.effects.soil import Hysteresis, PowerLaw
from tests.campaigns.effects.unmodelled import oscillator


def bedrock(scene: Scene, strength: float) -> SimulatedPoint:
    """Return a test point on rock, whose header declares ground without rock.

    The strength has no further effect than the choice of the site, which was made before.
    """
    depth = scene.ground.bedrock_depth
    signals = scene.signals(scene.strike_all())
    return SimulatedPoint(signals, scene.modulus, {"depth_m": depth}, declared_depth=math.inf)


def soil_parameters(ground: SoilProfile) -> dict[str, float | list[float]]:
    """Return the parameters of growth and damping law, with SI units in their names."""
    parameters: dict[str, float | list[float]] = {}
    law, growth, modulus = ground.damping_law, ground.growth, ground.layers[0].modulus
    if law is not None:
        parameters["quality"] = law.quality
        parameters["reference_hz"] = law.reference / (2 * math.pi)
        parameters["modulus_at_reference_pa"] = modulus
    if growth is not None:
        parameters["growth_depth_m"] = growth.depth
        parameters["growth_exponent"] = growth.exponent
        parameters["growth_limit_m"] = min(growth.limit, ground.bedrock_depth)
        parameters["surface_modulus_pa"] = modulus
    return parameters


def undeclared_soil(scene: Scene, strength: float) -> SimulatedPoint:
    """Return a test point on soil that the analysis does not model.

    It is constant-Q soil, or soil whose modulus grows with depth. The strength has no further
    effect than the choice of the site, which was made before.
    """
    return SimulatedPoint(
        scene.signals(scene.strike_all()), scene.modulus, soil_parameters(scene.ground)
    )


def layer(scene: Scene, ratio: float) -> SimulatedPoint:
    """Return a test point with a top layer whose modulus is `ratio` times that of the ground."""
    return _on_layers(scene, (ratio,), ratio=ratio)


def two_layers(scene: Scene, ratio: float) -> SimulatedPoint:
    """Return a test point with two layers on the ground.

    Their moduli are `ratio` squared (top) and `ratio` times that of the ground below.
    """
    return _on_layers(scene, (ratio**2, ratio), ratio=ratio**2, middle_ratio=ratio)


def _on_layers(
    scene: Scene, ratios: tuple[float, ...], **parameters: float | list[float]
) -> SimulatedPoint:
    """Return a test point with layers, each one plate radius thick; the ratios are from the top."""
    above = [(ratio, scene.radius) for ratio in ratios]
    response = scene.response(stacked_ground(scene.site.layers[-1], above))
    drops = scene.strike_all([response] * len(scene.heights))
    return SimulatedPoint(
        scene.signals(drops),
        response.ground.layers[-1].modulus,
        {**parameters, "thickness_m": scene.radius},
        math.inf,
    )


def stress_within(scene: Scene, exponent: float) -> SimulatedPoint:
    """Return a test point whose modulus grows with the momentary stress to the power `exponent`.

    Its true modulus is the secant modulus at the largest peak.
    """
    response = scene.response()
    linear = scene.strike_all()
    reference = max(float(np.max(drop.plate_displacement)) for drop in linear)
    weight = (scene.plate_mass + scene.hammer_mass) * STANDARD_GRAVITY
    # the static weight, and interlocking of the grains, equivalent to a pressure of 5 kPa
    rest = (weight + 5e3 * math.pi * scene.radius**2) / response.static_stiffness

    def law() -> PowerLaw:
        return PowerLaw(response.static_stiffness, reference, exponent, rest)

    drops = scene.strike_all(law=law)
    peak = max(float(np.max(drop.plate_displacement)) for drop in drops)
    modulus = scene.modulus * law().curve(peak)[0] / peak
    parameters = {"exponent": exponent, "sigma_ref_pa": _pressure(scene, drops)}
    return SimulatedPoint(scene.signals(drops), modulus, parameters)


def stress_between(scene: Scene, exponent: float) -> SimulatedPoint:
    """Return a test point whose modulus and viscosity are constant in each drop.

    They grow from drop to drop with the drop height to the power `exponent`. Every height needs a
    run of finite elements.
    """
    responses = []
    for height in scene.heights:
        factor = height**exponent
        layers = tuple(
            replace(layer, modulus=layer.modulus * factor, viscosity=layer.viscosity * factor)
            for layer in scene.site.layers
        )
        responses.append(scene.response(replace(scene.site, layers=layers)))
    drops = scene.strike_all(responses)
    moduli = [response.ground.layers[-1].modulus for response in responses]
    parameters: dict[str, float | list[float]] = {
        "exponent": exponent,
        "sigma_ref_pa": _pressure(scene, drops),
        "moduli_pa": moduli,
    }
    return SimulatedPoint(scene.signals(drops), max(moduli), parameters)


def _pressure(scene: Scene, drops: list[SimulatedDrop]) -> float:
    largest = max(float(np.max(drop.contact_force)) for drop in drops)
    return largest / (math.pi * scene.radius**2)


def hysteretic_unloading(scene: Scene, unrecovered: float) -> SimulatedPoint:
    """Return a test point whose soil unloads on a steeper path and recovers only partly.

    `unrecovered` is the fraction of the peak deflection that remains.
    """
    stiffness = scene.response().static_stiffness
    exponent = 1 + 4 * unrecovered
    drops = scene.strike_all(law=lambda: Hysteresis(stiffness, exponent, unrecovered))
    parameters = {"exponent": exponent, "unrecovered_fraction": unrecovered}
    return SimulatedPoint(scene.signals(drops), scene.modulus, parameters)


def permanent_set(scene: Scene, share: float) -> SimulatedPoint:
    """Return a test point whose plate settles permanently.

    It settles by `share` of the peak deflection in the first drop, and by half as much in each
    further one.
    """
    linear = scene.strike_all()
    reference = max(float(np.max(drop.plate_displacement)) for drop in linear)

    def indentation(number: int) -> Indentation:
        force = float(np.max(linear[number].contact_force))
        return Indentation(share * reference * 0.5**number, force)

    drops = scene.strike_all(indentation=indentation)
    sets = [indentation(n).at(float(np.max(drop.contact_force))) for n, drop in enumerate(drops)]
    return SimulatedPoint(scene.signals(drops), scene.modulus, {"set_m": sets})


def plate_inertia(scene: Scene, extra: float) -> SimulatedPoint:
    """Return a test point with an undeclared mass below the load cell.

    The mass is `extra` times the declared mass of the plate.
    """
    mass = extra * scene.plate_mass
    drops = scene.strike_all(plate_mass=scene.plate_mass + mass)
    return SimulatedPoint(scene.signals(drops), scene.modulus, {"mass_kg": mass})


def rough_contact(scene: Scene, share: float) -> SimulatedPoint:
    """Return a test point whose plate is not bonded to the ground as assumed.

    For `share` = 1 the contact has no friction. Otherwise the plate touches the ground only out to
    `share` of its radius.
    """
    bonded = scene.response()
    if share < 1:
        response = scene.response(radius=share * scene.radius)
    else:
        response = scene.response(contact="smooth")
    drops = scene.strike_all([response] * len(scene.heights))
    factor = response.static_stiffness / bonded.static_stiffness
    return SimulatedPoint(
        scene.signals(drops),
        scene.modulus,
        {"stiffness_factor": factor, "contact_share": share},
    )


def rebound(scene: Scene, flight: float) -> SimulatedPoint:
    """Return a test point whose plate the frame of the hammer lifts off the ground after the pulse.

    The plate is in the air for about `flight` seconds.
    """
    weight = scene.plate_mass * STANDARD_GRAVITY
    tug = 0.003  # duration of the upward force, s
    linear = scene.strike_all()[0]
    loaded = np.flatnonzero(linear.load > 0.02 * np.max(linear.load))
    begin = float(linear.time[loaded[-1]])
    peak = math.pi / 2 * weight * (1 + flight / (2 * tug))  # impulse of weight and of the flight

    def pull(time: float) -> float:
        inside = begin < time < begin + tug
        return peak * math.sin(math.pi * (time - begin) / tug) if inside else 0.0

    drops = scene.strike_all(weight=weight, pull=pull)
    flights = [
        float(np.count_nonzero(drop.contact_force <= -0.999 * weight) * drop.time[1])
        for drop in drops
    ]
    return SimulatedPoint(
        scene.signals(drops), scene.modulus, {"liftoff_s": begin, "flights_s": flights}
    )


def spring_rig(scene: Scene, damping: float) -> SimulatedPoint:
    """Return a test point with plate and frame on springs instead of ground.

    `damping` is the damping as a fraction of critical damping.
    """
    stiffness = float(scene.device.uniform(8e6, 30e6))
    moving = scene.plate_mass * float(scene.device.uniform(1.0, 2.0))
    dashpot = 2 * damping * math.sqrt(stiffness * moving)
    signals = []
    for drop in scene.strike_all():
        load = drop.load
        time_step = float(drop.time[1])
        plate, speed = oscillator(load, moving, dashpot, stiffness, time_step)
        still = np.zeros_like(drop.ground_displacement[1:])
        changed = replace(
            drop,
            plate_displacement=plate,
            plate_velocity=speed,
            ground_displacement=np.vstack([plate, still]),
            ground_velocity=np.vstack([speed, still]),
        )
        signals += replace(scene, sensors=1).signals([changed])
    parameters = {
        "stiffness_n_m": stiffness,
        "moving_mass_kg": moving,
        "damping_of_critical": damping,
    }
    return SimulatedPoint(signals, None, parameters)


def load_shape(scene: Scene, asymmetry: float) -> SimulatedPoint:
    """Return a test point with the load pulse of worn buffers; see `worn_pulse`."""
    response = scene.response()
    steps = scene.samples
    force = worn_pulse(
        np.arange(steps, dtype=float) * response.time_step, 1.4 * scene.hammer_pulse, asymmetry
    )
    force *= scene.peak_force / np.max(force)
    drops = [strike(response, scene.plate_mass, height * force, steps) for height in scene.heights]
    return SimulatedPoint(scene.signals(drops), scene.modulus, {"asymmetry": asymmetry})


def worn_pulse(time: Array, duration: float, asymmetry: float) -> Array:
    """Return the load pulse of worn buffers: a steep front, a long tail and a hump.

    Parameters
    ----------
    time : (n,) ndarray of float, s
        0 is the start of the pulse.
    duration : float, s
        Length of the pulse.
    asymmetry : float
        0 gives a half-sine; the hump is `asymmetry`/2 of the pulse.

    Returns
    -------
    (n,) ndarray of float
        Force relative to the peak of the half-sine.
    """
    phase = np.clip(time / duration, 0.0, 1.0)
    bent = phase ** (1 / (1 + asymmetry))
    pulse = np.sin(math.pi * bent) * (1 + asymmetry / 2 * np.sin(3 * math.pi * phase) ** 2)
    return np.where((time > 0) & (time < duration), pulse, 0.0)


def false_trigger(scene: Scene, share: float) -> SimulatedPoint:
    """Return a test point whose last record is not a drop, but for example a step on the plate.

    The record has small pulses at irregular times, up to `share` of the peak load.
    """
    response = scene.response()
    steps = scene.samples
    time = np.arange(steps, dtype=float) * response.time_step
    force = np.zeros(steps)
    for begin in np.cumsum(scene.generator.uniform(0.001, 0.012, 4)):
        width, size = scene.generator.uniform([0.002, 0.3], [0.012, 1.0])
        inside = (time > begin) & (time < begin + width)
        force += np.where(inside, size * np.sin(math.pi * (time - begin) / width), 0.0)
    force *= share * scene.peak_force / np.max(force)
    good = scene.strike_all()[:-1]
    drops = [*good, strike(response, scene.plate_mass, force, steps)]
    modulus = scene.modulus if good else None
    return SimulatedPoint(
        scene.signals(drops), modulus, {"share": share, "drop": float(len(drops))}
    )
