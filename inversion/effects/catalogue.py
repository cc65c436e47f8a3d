"""All effects, in the order in which they act; a new one gets its line here."""

from inversion.effects.acquisition_filter import AcquisitionFilter
from inversion.effects.base import Effect
from inversion.effects.baseline_drift import BaselineDrift
from inversion.effects.bedrock import Bedrock
from inversion.effects.geophone_response import GeophoneResponse
from inversion.effects.hysteretic_unloading import HystereticUnloading
from inversion.effects.layer import Layer
from inversion.effects.load_shape import LoadShape
from inversion.effects.mains_hum import MainsHum
from inversion.effects.permanent_set import PermanentSet
from inversion.effects.plate_inertia import PlateInertia
from inversion.effects.rebound import Rebound
from inversion.effects.rough_contact import RoughContact
from inversion.effects.saturation import Saturation
from inversion.effects.seating import Seating
from inversion.effects.sensor_lag import SensorLag
from inversion.effects.spring_rig import SpringRig
from inversion.effects.stress_dependence import StressDependence
from inversion.effects.viscosity import Viscosity

CATALOGUE: tuple[Effect, ...] = (
    # the ground and what stands on it
    Bedrock(),
    Viscosity(),
    PlateInertia(),
    Seating(),
    RoughContact(),
    Layer(),
    SpringRig(),
    # what they do in time
    StressDependence(),
    HystereticUnloading(),
    LoadShape(),
    PermanentSet(),
    Rebound(),
    # what sensor and processing make of it
    GeophoneResponse(),
    AcquisitionFilter(),
    SensorLag(),
    Saturation(),
    BaselineDrift(),
    MainsHum(),
)

BY_NAME = {effect.name: effect for effect in CATALOGUE}
