"""Catalogue of all effects, in the order in which they act. A new effect is added to `OWN`.

Effects of other packages, which declare the entry point group ``pfwd.effects``, follow.
"""

from typing import get_args

import pfwd_plugins
from inversion.effects.acquisition_filter import AcquisitionFilter
from inversion.effects.base import Effect, Scope
from inversion.effects.baseline_drift import BaselineDrift
from inversion.effects.bedrock import Bedrock
from inversion.effects.carrier_resonance import CarrierResonance
from inversion.effects.damping_law import DampingLaw
from inversion.effects.geophone_response import GeophoneResponse
from inversion.effects.hysteretic_unloading import HystereticUnloading
from inversion.effects.layer import Layer
from inversion.effects.load_filter import LoadFilter
from inversion.effects.load_gain import LoadGain
from inversion.effects.load_shape import LoadShape
from inversion.effects.mains_hum import MainsHum
from inversion.effects.modulus_gradient import LinearGradient, RootGradient
from inversion.effects.permanent_set import PermanentSet
from inversion.effects.plate_inertia import PlateInertia
from inversion.effects.rebound import Rebound
from inversion.effects.rough_contact import RoughContact
from inversion.effects.saturation import Saturation
from inversion.effects.seating import Seating
from inversion.effects.sensor_gain import SensorGain
from inversion.effects.sensor_lag import SensorLag
from inversion.effects.spring_rig import SpringRig
from inversion.effects.stress_dependence import StressDependence
from inversion.effects.viscosity import Viscosity

OWN: tuple[Effect, ...] = (
    # the ground and the mass on it
    DampingLaw(),
    RootGradient(),
    LinearGradient(),
    Bedrock(),
    Viscosity(),
    PlateInertia(),
    Seating(),
    RoughContact(),
    Layer(),
    SpringRig(),
    # motion of plate and ground in time
    StressDependence(),
    HystereticUnloading(),
    LoadShape(),
    PermanentSet(),
    Rebound(),
    # sensor and processing
    LoadGain(),
    SensorGain(),
    LoadFilter(),
    GeophoneResponse(),
    AcquisitionFilter(),
    SensorLag(),
    Saturation(),
    BaselineDrift(),
    MainsHum(),
    CarrierResonance(),
)


def plugin_effects() -> tuple[Effect, ...]:
    """Return the effects of other packages that are valid.

    A valid effect has the name of its entry point, which no other effect has, parameters and a
    scope; a remark is made about each of the others.
    """
    by_name: dict[str, Effect] = {}
    built_in_names = {effect.name for effect in OWN}
    for entry, effect in pfwd_plugins.load_all(pfwd_plugins.EFFECTS, Effect, built_in_names):
        name, parameters = getattr(effect, "name", None), getattr(effect, "parameters", ())
        if name != entry:
            expected = f"an effect with the name of its entry point, got {name!r}"
            pfwd_plugins.remark(pfwd_plugins.EFFECTS, entry, expected)
        elif not parameters or getattr(effect, "scope", None) not in get_args(Scope):
            scopes = ", ".join(get_args(Scope))
            expected = f"an effect with parameters and a scope ({scopes}), got none"
            pfwd_plugins.remark(pfwd_plugins.EFFECTS, entry, expected)
        else:
            by_name[entry] = effect
    return tuple(by_name.values())


CATALOGUE: tuple[Effect, ...] = (*OWN, *plugin_effects())

BY_NAME = {effect.name: effect for effect in CATALOGUE}
