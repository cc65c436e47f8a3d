"""Writes tests/data/recording, a survey in the present version of each format.

python -m tests.pfwd_device.recording.make_recording FOLDER
"""

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pfwd_device import Channel, Drop
from pfwd_device.recording import DropRecord, ReboundRecord, SurveyWriter


def values(number: int) -> DropRecord:
    """A drop by formula, so that the test knows every value."""
    step = np.arange(24, dtype=np.float64)
    load = 1000.0 * number + step
    velocity: NDArray[np.float64] = 0.001 * step * number
    velocity[5] = np.nan
    counts = np.column_stack([step, -step]).astype(np.int32) * number
    return DropRecord(
        point="Köln 1",
        drop=Drop(number, (step - 4) / 8192.0, load, (Channel(0.0, "velocity", velocity),)),
        counts=counts,
        declared={"plate_radius_m": 0.15, "plate_mass_kg": 10.6, "bedrock_depth_m": float("inf")},
        metadata={"key": f"PFWD-7/3/{number}", "operator": "T. Ünal", "missing": [[5, 1]]},
        rebounds=(ReboundRecord(0.4375, 812.5, 4242, counts[:3]),) if number == 2 else (),
    )


def main(folder: Path) -> None:
    """Write the survey."""
    with SurveyWriter.open(folder, reserve_bytes=0) as writer:
        writer.add_point("Köln 1", {"plate_radius_m": 0.15})
        for number in (1, 2):
            writer.save_drop(values(number))
        writer.edit("note", "nass", number=1)
        writer.edit("discard", number=2)
        writer.note_event("gap", {"samples": 1})
        writer.save_check({"zero": 0.5})
        writer.save_result(1, {"modulus_pa": 45e6, "seed": 0})
        writer.open_capture("link", {"url": "socket://127.0.0.1:1"}).write("from", b"\x00\x01")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
