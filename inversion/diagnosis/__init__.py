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
    left_out_error,
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
    "left_out_error",
]
