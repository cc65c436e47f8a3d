"""Subgrade modulus from falling-weight records: forward model, search, uncertainty.

The public names, usable on plain arrays::

    record = Record(time, load, (Sensor(0.0, "displacement", w),), Instrument(plate_radius=0.15))
    result = invert(record)
    result.modulus_pa                    # Pa; None: the record does not determine it
    result.modulus_interval_pa           # Pa, 95 %, the error of the model included

A name is imported when it is first used, so that stored results can be read without scipy.
"""

from typing import TYPE_CHECKING

from pfwd_plugins.lazy_names import lazy_getattr

if TYPE_CHECKING:
    from inversion.drop_inversion import Settings, invert, invert_joint
    from inversion.errors import InversionError, ModelError, RecordError
    from inversion.forward.contact import PLATE_MODELS, PlateProblem, plate_compliance
    from inversion.forward.library import SurrogateLibrary
    from inversion.forward.model import ForwardModel, Grounds, Instrument
    from inversion.measured.half_sine import HalfSineFit, fit_half_sine, fit_half_sine_equal_area
    from inversion.measured.peak_method import (
        PLATE_FACTORS,
        PeakModulus,
        peak_modulus,
    )
    from inversion.measured.record import Record, Sensor
    from inversion.result import HalfSinePulse, InversionResult, LayerResult, TimeHistories

__all__ = [
    "PLATE_FACTORS",
    "PLATE_MODELS",
    "ForwardModel",
    "Grounds",
    "HalfSineFit",
    "HalfSinePulse",
    "Instrument",
    "InversionError",
    "InversionResult",
    "LayerResult",
    "ModelError",
    "PeakModulus",
    "PlateProblem",
    "Record",
    "RecordError",
    "Sensor",
    "Settings",
    "SurrogateLibrary",
    "TimeHistories",
    "fit_half_sine",
    "fit_half_sine_equal_area",
    "invert",
    "invert_joint",
    "peak_modulus",
    "plate_compliance",
]

_HOMES = {
    "ForwardModel": "inversion.forward.model",
    "Grounds": "inversion.forward.model",
    "HalfSineFit": "inversion.measured.half_sine",
    "HalfSinePulse": "inversion.result",
    "Instrument": "inversion.forward.model",
    "InversionError": "inversion.errors",
    "InversionResult": "inversion.result",
    "LayerResult": "inversion.result",
    "ModelError": "inversion.errors",
    "PLATE_FACTORS": "inversion.measured.peak_method",
    "PLATE_MODELS": "inversion.forward.contact",
    "PeakModulus": "inversion.measured.peak_method",
    "PlateProblem": "inversion.forward.contact",
    "Record": "inversion.measured.record",
    "RecordError": "inversion.errors",
    "Sensor": "inversion.measured.record",
    "Settings": "inversion.drop_inversion",
    "SurrogateLibrary": "inversion.forward.library",
    "TimeHistories": "inversion.result",
    "fit_half_sine": "inversion.measured.half_sine",
    "fit_half_sine_equal_area": "inversion.measured.half_sine",
    "invert": "inversion.drop_inversion",
    "invert_joint": "inversion.drop_inversion",
    "peak_modulus": "inversion.measured.peak_method",
    "plate_compliance": "inversion.forward.contact",
}

__getattr__ = lazy_getattr(globals(), _HOMES)


def __dir__() -> list[str]:
    return __all__
