"""Verdicts on points that no survey holds."""

import dataclasses

from inversion.notices import Notice
from pfwd.judging import Job, PointView
from pfwd.procedures import PointProgress


def judge_point(
    job: Job, point: PointView, fallback: tuple[float, Notice] | None = None
) -> PointProgress:
    """Return value and verdict of a point by a job."""
    return dataclasses.replace(point, job=job, fallback_target=fallback).progress
