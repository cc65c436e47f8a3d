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
    from inversion.drop_inversion import Settings as Settings
    from inversion.drop_inversion import invert as invert
    from inversion.drop_inversion import invert_joint as invert_joint
    from inversion.errors import InversionError as InversionError
    from inversion.errors import ModelError as ModelError
    from inversion.errors import RecordError as RecordError
    from inversion.forward.contact import PLATE_MODELS as PLATE_MODELS
    from inversion.forward.contact import PlateProblem as PlateProblem
    from inversion.forward.library import SurrogateLibrary as SurrogateLibrary
    from inversion.forward.model import ForwardModel as ForwardModel
    from inversion.forward.model import Grounds as Grounds
    from inversion.forward.model import Instrument as Instrument
    from inversion.measured.half_sine import fit_half_sine_equal_area as fit_half_sine_equal_area
    from inversion.measured.record import Record as Record
    from inversion.measured.record import Sensor as Sensor
    from inversion.result import InversionResult as InversionResult

_NAMES_BY_MODULE = {
    "inversion.drop_inversion": ("Settings", "invert", "invert_joint"),
    "inversion.errors": ("InversionError", "ModelError", "RecordError"),
    "inversion.forward.contact": ("PLATE_MODELS", "PlateProblem"),
    "inversion.forward.library": ("SurrogateLibrary",),
    "inversion.forward.model": ("ForwardModel", "Grounds", "Instrument"),
    "inversion.measured.half_sine": ("fit_half_sine_equal_area",),
    "inversion.measured.record": ("Record", "Sensor"),
    "inversion.result": ("InversionResult",),
}

__getattr__ = lazy_getattr(globals(), _NAMES_BY_MODULE)


def __dir__() -> list[str]:
    return sorted(name for names in _NAMES_BY_MODULE.values() for name in names)
