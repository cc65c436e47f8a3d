"""From the residual to the effect: the diagnosis of points and surveys."""

from inversion.diagnosis.device import cost_of_sharing, fit_device
from inversion.diagnosis.diagnose import diagnose_point
from inversion.diagnosis.findings import (
    NEARLY_EXPLAINED,
    DeviceFindings,
    DropCurves,
    FoundEffect,
    FoundParameter,
    HeldOutPart,
    LeaveOut,
    ModelState,
    PointDiagnosis,
    UnknownKey,
)
from inversion.diagnosis.flat_tops import Channel, largest_values
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.prediction import left_out_error

__all__ = [
    "NEARLY_EXPLAINED",
    "Channel",
    "DeviceFindings",
    "DropCurves",
    "FoundEffect",
    "FoundParameter",
    "HeldOutPart",
    "LeaveOut",
    "ModelState",
    "PointDiagnosis",
    "PointRecords",
    "UnknownKey",
    "cost_of_sharing",
    "diagnose_point",
    "fit_device",
    "largest_values",
    "left_out_error",
]
