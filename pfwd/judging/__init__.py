"""The job of a survey, its points and their verdicts. Verdicts are made in this package only.

Screen, log, replay, reports, exports and scripts read the same views and cannot differ::

    from pfwd.judging import point_views

    for point in point_views(survey):       # judged by the job of the survey
        point.progress.verdict              # Verdict.PASS, FAIL, UNDECIDED or NONE
        point.progress.value                # PointValue: quantity, value, interval, unit
        point.as_json()                     # the judgement as JSON values

- `job`: the job of a survey (procedure, target, stations), stored in it as dated events.
- `drops`: `DropView`, a drop of a point.
- `verdicts`: `PointView`, a point with its drops, its value and its verdict.
- `view`: `SurveyView`, a survey while it is measured, and the points of a stored one.
- `stations`: the stations of a job, from CSV or GPX.
"""

from pfwd.judging.drops import DropView, drop_from_traces
from pfwd.judging.job import Job, JobRequest, Station, job_of, target_si
from pfwd.judging.verdicts import PointView, value_of_drop
from pfwd.judging.view import SurveyView, point_view, point_views

__all__ = [
    "DropView",
    "Job",
    "JobRequest",
    "PointView",
    "Station",
    "SurveyView",
    "drop_from_traces",
    "job_of",
    "point_view",
    "point_views",
    "target_si",
    "value_of_drop",
]
