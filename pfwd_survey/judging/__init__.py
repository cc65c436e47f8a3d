"""What a survey is measured by, and how its points stand: the one place that says so.

The screen, the headless logger, a replay, the report and the exports call the same function, with
the same job, and cannot differ::

    from pfwd_survey.judging import job_of, judged_points

    job = job_of(survey)                    # procedure, targets, stations, ... with their dates
    for point in judged_points(survey, job):
        point.progress.verdict              # Verdict.PASS, FAIL, UNDECIDED or NONE
        point.progress.value                # PointValue: quantity, value, interval, unit
        point.as_json()                     # the line of a complete point

- `job`: the job of a survey, kept in it as dated events, and what is written when it changes.
- `drops`: a drop as it takes part in the judgement of its point.
- `verdicts`: `judge_point`, from a job and the drops of a point to value and verdict.
- `contents`: the same from a survey that is read: `judged_points`.
- `stations`: the stations of a job, from CSV or GPX.
"""

from pfwd_survey.judging.contents import judged_points, kept_result, measured_point
from pfwd_survey.judging.drops import MeasuredDrop, measured_drop
from pfwd_survey.judging.job import Job, JobRequest, Station, job_of, target_si
from pfwd_survey.judging.verdicts import JudgedPoint, MeasuredPoint, judge_point, value_of_drop

__all__ = [
    "Job",
    "JobRequest",
    "JudgedPoint",
    "MeasuredDrop",
    "MeasuredPoint",
    "Station",
    "job_of",
    "judge_point",
    "judged_points",
    "kept_result",
    "measured_drop",
    "measured_point",
    "target_si",
    "value_of_drop",
]
