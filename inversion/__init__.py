"""Subgrade modulus from falling-weight records: forward model, search, uncertainty.

The public names, usable on plain arrays::

    record = Record(time, load, (Sensor(0.0, "displacement", w),), Instrument(plate_radius=0.15))
    result = invert(record)
    result.subgrade.modulus.value        # Pa
    result.modulus_interval              # Pa, 95 %, the model's own error included
"""

from inversion.errors import InversionError, ModelError, RecordError
from inversion.forward.contact import PLATE_MODELS, PlateProblem, plate_compliance
from inversion.forward.library import SurrogateLibrary
from inversion.forward.model import ForwardModel, Grounds, Instrument
from inversion.invert import Settings, invert, invert_joint
from inversion.measured.half_sine import HalfSineFit, fit_half_sine, fit_half_sine_equal_area
from inversion.measured.peak_method import (
    PLATE_FACTORS,
    PeakModulus,
    dynamic_modulus_evd,
    peak_modulus,
)
from inversion.measured.record import Record, Sensor
from inversion.result import InversionResult, Subgrade, TimeHistories, Value

__all__ = [
    "PLATE_FACTORS",
    "PLATE_MODELS",
    "ForwardModel",
    "Grounds",
    "HalfSineFit",
    "Instrument",
    "InversionError",
    "InversionResult",
    "ModelError",
    "PeakModulus",
    "PlateProblem",
    "Record",
    "RecordError",
    "Sensor",
    "Settings",
    "Subgrade",
    "SurrogateLibrary",
    "TimeHistories",
    "Value",
    "dynamic_modulus_evd",
    "fit_half_sine",
    "fit_half_sine_equal_area",
    "invert",
    "invert_joint",
    "peak_modulus",
    "plate_compliance",
]
