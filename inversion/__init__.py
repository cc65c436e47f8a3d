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
    from inversion.forward.contact import PLATE_MODELS, PlateProblem
    from inversion.forward.library import SurrogateLibrary
    from inversion.forward.model import ForwardModel, Grounds, Instrument
    from inversion.measured.half_sine import HalfSineFit, fit_half_sine, fit_half_sine_equal_area
    from inversion.measured.peak_method import PLATE_FACTORS, PeakModulus, peak_modulus
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
]

_NAMES_BY_MODULE = {
    "inversion.drop_inversion": ("Settings", "invert", "invert_joint"),
    "inversion.errors": ("InversionError", "ModelError", "RecordError"),
    "inversion.forward.contact": ("PLATE_MODELS", "PlateProblem"),
    "inversion.forward.library": ("SurrogateLibrary",),
    "inversion.forward.model": ("ForwardModel", "Grounds", "Instrument"),
    "inversion.measured.half_sine": ("HalfSineFit", "fit_half_sine", "fit_half_sine_equal_area"),
    "inversion.measured.peak_method": ("PLATE_FACTORS", "PeakModulus", "peak_modulus"),
    "inversion.measured.record": ("Record", "Sensor"),
    "inversion.result": ("HalfSinePulse", "InversionResult", "LayerResult", "TimeHistories"),
}

__getattr__ = lazy_getattr(globals(), _NAMES_BY_MODULE)


def __dir__() -> list[str]:
    return __all__
