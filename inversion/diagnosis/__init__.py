"""From the residual to the effect: the diagnosis of points and surveys."""

from inversion.diagnosis.diagnose import (
    DeviceFindings,
    DropCurves,
    FoundEffect,
    FoundParameter,
    PointDiagnosis,
    State,
    diagnose_point,
    fit_device,
)
from inversion.diagnosis.model import PointRecords

__all__ = [
    "DeviceFindings",
    "DropCurves",
    "FoundEffect",
    "FoundParameter",
    "PointDiagnosis",
    "PointRecords",
    "State",
    "diagnose_point",
    "fit_device",
]
