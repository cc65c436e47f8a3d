"""PFWD for scientists: read drops, invert them, look at what came out.

>>> import pfwd
>>> result = pfwd.invert(pfwd.example("layer"))[0]
>>> print(f"{result.modulus / 1e6:.0f} MPa")
45 MPa

SI units inside, always; MPa, ms and µm only in what is printed or drawn, with the unit shown. The
names below are loaded on first use, so that the import is quick.
"""

from typing import TYPE_CHECKING

from pfwd_plugins.lazy_names import lazy_getattr

if TYPE_CHECKING:
    from inversion.errors import InversionError
    from pfwd.diagnosing import Diagnoses, Diagnosis, diagnose
    from pfwd.examples import example
    from pfwd.inverting import invert
    from pfwd.measured import Drop, Point, Points, drop, read
    from pfwd.results import Result, Results
    from pfwd.surveys import Survey, open
    from pfwd_survey.errors import OptionError, SurveyError

__all__ = [
    "Diagnoses",
    "Diagnosis",
    "Drop",
    "InversionError",
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
]

_HOMES = {
    "Diagnoses": "pfwd.diagnosing",
    "Diagnosis": "pfwd.diagnosing",
    "Drop": "pfwd.measured",
    "InversionError": "inversion.errors",
    "OptionError": "pfwd_survey.errors",
    "Point": "pfwd.measured",
    "Points": "pfwd.measured",
    "Result": "pfwd.results",
    "Results": "pfwd.results",
    "Survey": "pfwd.surveys",
    "SurveyError": "pfwd_survey.errors",
    "__version__": "pfwd.version",
    "diagnose": "pfwd.diagnosing",
    "drop": "pfwd.measured",
    "example": "pfwd.examples",
    "invert": "pfwd.inverting",
    "open": "pfwd.surveys",
    "read": "pfwd.measured",
}

__getattr__ = lazy_getattr(globals(), _HOMES)


def __dir__() -> list[str]:
    return __all__
