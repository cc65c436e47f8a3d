"""Constants of an instrument from drops on a rig of springs whose stiffness is known."""

from inversion.calibration.rig import (
    Calibration,
    CalibrationError,
    Constant,
    RigDrop,
    calibrate,
)

__all__ = ["Calibration", "CalibrationError", "Constant", "RigDrop", "calibrate"]
