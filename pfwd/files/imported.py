"""What comes of an import."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from pfwd.files.header import IMPORTED
from pfwd_device import Drop

Kind = Literal["traces", "peaks", "stiffness"]


@dataclass(frozen=True, slots=True)
class Imported:
    """One drop that is in the survey now, or a file that was refused, or a remark on one."""

    file: str
    point: str = ""
    number: int = 0
    """Of the drop within the point."""
    record: int = 0
    """Of the drop within the survey."""
    before: bool = False
    """It was there before: nothing is imported twice."""
    error: str | None = None
    """Why the file was refused; None when it was not."""
    remark: str | None = None
    """What was left out of a file whose drops are in the survey; then this is no drop."""
    kind: Kind = "traces"
    """What was recorded of the drop."""
    remarks: tuple[str, ...] = ()
    """How its file was read, and what was unclear in it."""


def kind_of(drop: Drop, declared: Mapping[str, Any]) -> Kind:
    """What was recorded of a drop: time histories on the ground or on a rig, or peaks alone."""
    if drop.only_peaks is not None:
        return "peaks"
    return "stiffness" if on_rig(declared) else "traces"


def on_rig(declared: Mapping[str, Any]) -> bool:
    """Whether a drop fell on a rig of springs, as `PointSetup.is_stiffness_test` has it."""
    return declared.get("test") == "stiffness" or declared.get("stiffness_n_per_m") is not None


def remarks_of(declared: Mapping[str, Any]) -> tuple[str, ...]:
    """The remarks on how another program's file was read."""
    noted = declared.get(IMPORTED)
    said = noted.get("remarks") if isinstance(noted, Mapping) else None
    return tuple(str(text) for text in said) if isinstance(said, list | tuple) else ()
