"""Result of one drop, composed of its screening and its inversion."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Sequence
from typing import Any

from inversion.notices import Notice
from inversion.records import without_nan
from inversion.result import InversionResult
from pfwd.analysis.drop_facts import (
    corrected_deflection,
    facts_to_store,
    unbroken_peaks,
    uncompared_facts,
)
from pfwd.analysis.results import DropAnalysis, DropResult
from pfwd.analysis.screening.drops import DropStatus


def drop_result(
    path: str | os.PathLike[str],
    analysis: DropAnalysis,
    point_warnings: Sequence[Notice] = (),
    point: Any = None,
) -> DropResult:
    """Return the result of one drop, with the keys of ``pfwd invert --json``.

    Parameters
    ----------
    path : str or path-like
        File with the drop.
    analysis : DropAnalysis
    point_warnings : sequence of Notice
        Warnings about the point.
    point : optional
        Name of the test point.
    """
    if analysis.stored is not None:
        number, name = analysis.drop.number, os.fspath(path)
        return dataclasses.replace(
            analysis.stored, file=name, point=point, drop=number, refit=None, stored=True
        )
    status: DropStatus = analysis.screening.status
    reason = analysis.screening.reason
    if analysis.fault is not None:
        status, reason = "rejected", analysis.fault
    warnings = [*point_warnings, *analysis.screening.warnings]
    fields: dict[str, Any] = {}
    if analysis.result is not None:
        names = [field.name for field in dataclasses.fields(InversionResult)]
        fields = {name: getattr(analysis.result, name) for name in names}
        fields["explained"] = analysis.result.explained and not analysis.screening.clipped
        warnings += fields.pop("warnings") or ()
    if analysis.request is not None and analysis.fault is None:
        fields |= dataclasses.asdict(analysis.request)
    return DropResult(
        file=os.fspath(path),
        point=point,
        drop=analysis.drop.number,
        status=status,
        reason=reason if status == "rejected" else None,
        **_peaks(analysis),
        warnings=tuple(warnings),
        **fields,
    )


def _peaks(analysis: DropAnalysis) -> dict[str, Any]:
    """Return the peaks of load and centre sensor, and the facts for the procedure."""
    drop, setup = analysis.drop, analysis.setup
    peaks = unbroken_peaks(drop)
    facts = None
    if setup is not None and analysis.screening.status != "rejected":
        facts = facts_to_store(*uncompared_facts(drop, setup, analysis.screening), setup)
    if facts is not None:
        corrected = facts.deflection_m
    else:
        corrected = None if setup is None else corrected_deflection(drop, setup)
    return {
        "peak_load_n": None if peaks is None else without_nan(peaks.load),
        "deflection_recorded_m": None if peaks is None else without_nan(peaks.centre),
        "deflection_corrected_m": corrected,
        "facts": facts,
    }
