"""Measuring procedures: the requirements of a standard on the drops of a point, and the verdict.

A procedure is read from a profile: a TOML file that names the source of every number. The screen,
the report and scripts use the same two calls::

    from pfwd.procedures import Kind, PointDrop, find_procedure, judge

    procedure = find_procedure("tp-bf-stb-b8.3")     # a shipped name, or the path of a TOML file
    drops = [                                        # in the order they fell; SI units
        PointDrop(1, Kind.SEATING, peak_load=7.1e3, peak_deflection=9.0e-4),
        ...
    ]
    progress = judge(procedure, drops, plate_radius=0.15, target=45e6)

    progress.next_kind          # Kind.SEATING, Kind.MEASURED, or None: the point is done
    progress.instruction        # one sentence: the next step
    progress.seating_done, progress.seating_wanted      # 3, 3 (wanted None: not stated)
    progress.measured_done, progress.measured_wanted    # 2, 3
    progress.excluded           # every drop that is not averaged, with the reason
    progress.used               # numbers of the drops that are averaged
    progress.value              # PointValue (quantity, value, interval, factor, ...) or None
    progress.verdict            # Verdict.PASS, FAIL, UNDECIDED or NONE, with verdict_reason
    progress.notes              # numbers of the profile that are not verified, hence not enforced

`pfwd.analysis.drop_facts.point_drop` makes a `PointDrop` of a recorded drop, and removes the
declared geophone response from the peak. Call ``judge`` after every drop with all drops of the
point; it has no state.
``None`` in a field of `PointDrop` means unknown; a check that needs the field is skipped.

A profile names the source of every number. A number whose source could not be confirmed is marked
``verified = false``: it is shown, and enforced only on request (``enforce_unverified``).
"""

from pfwd.procedures.judging import judge
from pfwd.procedures.point import (
    DiagnosedModulus,
    ExcludedDrop,
    Exclusion,
    Kind,
    PointDrop,
    PointModulus,
    PointProgress,
    PointValue,
    ReasonCode,
    StressLaw,
    Verdict,
)
from pfwd.procedures.profile import Procedure, Quantity, SourcedNumber, Target
from pfwd.procedures.reading import parse_procedure, read_procedure
from pfwd.procedures.shipped import (
    NO_PROCEDURE,
    PLAIN,
    find_procedure,
    plain_procedure,
    shipped_names,
    shipped_procedures,
)

__all__ = [
    "NO_PROCEDURE",
    "PLAIN",
    "DiagnosedModulus",
    "ExcludedDrop",
    "Exclusion",
    "Kind",
    "PointDrop",
    "PointModulus",
    "PointProgress",
    "PointValue",
    "Procedure",
    "Quantity",
    "ReasonCode",
    "SourcedNumber",
    "StressLaw",
    "Target",
    "Verdict",
    "find_procedure",
    "judge",
    "parse_procedure",
    "plain_procedure",
    "read_procedure",
    "shipped_names",
    "shipped_procedures",
]
