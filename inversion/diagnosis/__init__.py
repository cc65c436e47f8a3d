"""From the residual to the effect: the diagnosis of points and surveys."""

from inversion.diagnosis.device import cost_of_sharing, fit_device
from inversion.diagnosis.diagnose import diagnose_point
from inversion.diagnosis.drop_prediction import predict_next
from inversion.diagnosis.findings import (
    NEARLY_EXPLAINED,
    DeviceFindings,
    DropCurves,
    EffectParameter,
    EffectResult,
    FittedPoint,
    FittedState,
    HeldOut,
    HeldOutPart,
    LeaveOut,
    PointDiagnosis,
    UnknownKey,
)
from inversion.diagnosis.flat_tops import Channel, largest_values
from inversion.diagnosis.held_out import (
    Allow,
    count_held_out,
    held_out_error,
    without_held_out,
)
from inversion.diagnosis.model import PointRecords
from inversion.diagnosis.prediction import left_out_error

__all__ = [
    "NEARLY_EXPLAINED",
    "Allow",
    "Channel",
    "DeviceFindings",
    "DropCurves",
    "EffectParameter",
    "EffectResult",
    "FittedPoint",
    "FittedState",
    "HeldOut",
    "HeldOutPart",
    "LeaveOut",
    "PointDiagnosis",
    "PointRecords",
    "UnknownKey",
    "cost_of_sharing",
    "count_held_out",
    "diagnose_point",
    "fit_device",
    "held_out_error",
    "largest_values",
    "left_out_error",
    "predict_next",
    "without_held_out",
]
