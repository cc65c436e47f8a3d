"""Constants of an instrument from drops on a rig of springs whose stiffness is known."""

from inversion.calibration.rig import (
    Calibration,
    CalibrationError,
    Constant,
    Rig,
    RigDrop,
    calibrate,
    describe,
)

__all__ = [
    "Calibration",
    "CalibrationError",
    "Constant",
    "Rig",
    "RigDrop",
    "calibrate",
    "describe",
]
