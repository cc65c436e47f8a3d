"""Diagnosis of points and surveys: the effects that explain the residual of a fit.

An effect is a physical or instrumental cause that the base model (homogeneous ground under a plate)
does not contain. A name is imported when it is first used, so that stored diagnoses can be read
without scipy.
"""

from typing import TYPE_CHECKING

from pfwd_plugins.lazy_names import lazy_getattr

if TYPE_CHECKING:
    from inversion.diagnosis.findings import (
        NEARLY_EXPLAINED,
        DeviceFindings,
        DropCurves,
        EffectParameter,
        EffectResult,
        FittedState,
        HeldOut,
        HeldOutPart,
        LeaveOut,
        PointDiagnosis,
    )
    from inversion.diagnosis.flat_tops import Channel, largest_values
    from inversion.diagnosis.model import PointRecords

__all__ = [
    "NEARLY_EXPLAINED",
    "Channel",
    "DeviceFindings",
    "DropCurves",
    "EffectParameter",
    "EffectResult",
    "FittedState",
    "HeldOut",
    "HeldOutPart",
    "LeaveOut",
    "PointDiagnosis",
    "PointRecords",
    "largest_values",
]


__getattr__ = lazy_getattr(
    globals(),
    {
        "Channel": "inversion.diagnosis.flat_tops",
        "DeviceFindings": "inversion.diagnosis.findings",
        "DropCurves": "inversion.diagnosis.findings",
        "EffectParameter": "inversion.diagnosis.findings",
        "EffectResult": "inversion.diagnosis.findings",
        "FittedState": "inversion.diagnosis.findings",
        "HeldOut": "inversion.diagnosis.findings",
        "HeldOutPart": "inversion.diagnosis.findings",
        "LeaveOut": "inversion.diagnosis.findings",
        "NEARLY_EXPLAINED": "inversion.diagnosis.findings",
        "PointDiagnosis": "inversion.diagnosis.findings",
        "PointRecords": "inversion.diagnosis.model",
        "largest_values": "inversion.diagnosis.flat_tops",
    },
)


def __dir__() -> list[str]:
    return __all__
