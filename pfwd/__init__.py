"""PFWD for scripts: read the drops of a portable falling weight deflectometer, invert them, plot.

>>> import pfwd
>>> result = pfwd.invert(pfwd.example("layer"))[0]
>>> print(f"{result.modulus / 1e6:.0f} MPa")
45 MPa

All values are in SI units. Only printed and drawn ones are in MPa, ms and µm, with the unit shown.
The names below are imported when they are first used, so that ``import pfwd`` is fast.
"""

from typing import TYPE_CHECKING

from inversion import notices
from pfwd_plugins.lazy_names import lazy_getattr

if TYPE_CHECKING:
    from inversion.errors import InversionError
    from inversion.notices import Notice, text_of
    from pfwd.analysis.results import DiagnosisResult as Diagnosis
    from pfwd.analysis.results import DropResult as Result
    from pfwd.errors import OptionError, SurveyError
    from pfwd.scripting.diagnosing import Diagnoses, diagnose
    from pfwd.scripting.measured import MeasuredDrop as Drop
    from pfwd.scripting.measured import MeasuredPoint as Point
    from pfwd.scripting.measured import Points, drop, read
    from pfwd.scripting.results import Results, invert
    from pfwd.scripting.surveys import StoredSurvey as Survey
    from pfwd.scripting.surveys import example, open

__all__ = [
    "Diagnoses",
    "Diagnosis",
    "Drop",
    "InversionError",
    "Notice",
    "OptionError",
    "Point",
    "Points",
    "Result",
    "Results",
    "Survey",
    "SurveyError",
    "diagnose",
    "drop",
    "example",
    "invert",
    "open",
    "read",
    "text_of",
]

_NAMES_BY_MODULE = {
    "inversion.errors": ("InversionError",),
    "inversion.notices": ("Notice", "text_of"),
    "pfwd.analysis.results": ("DiagnosisResult as Diagnosis", "DropResult as Result"),
    "pfwd.errors": ("OptionError", "SurveyError"),
    "pfwd.scripting.diagnosing": ("Diagnoses", "diagnose"),
    "pfwd.scripting.measured": (
        *("MeasuredDrop as Drop", "MeasuredPoint as Point"),
        *("Points", "drop", "read"),
    ),
    "pfwd.scripting.results": ("Results", "invert"),
    "pfwd.scripting.surveys": ("StoredSurvey as Survey", "example", "open"),
    "pfwd.version": ("__version__",),
}

notices.register("pfwd")

__getattr__ = lazy_getattr(globals(), _NAMES_BY_MODULE)


def __dir__() -> list[str]:
    return __all__
