"""``h5``: the whole survey in one file, which every command reads like the survey."""

import os

from pfwd_survey.exporting.order import Order
from pfwd_survey.exporting.output import new_file
from pfwd_survey.files.survey_file import write_survey_file


def write(order: Order, path: str | os.PathLike[str]) -> list[str]:
    """Write the survey; nothing is left out."""
    with new_file(path, force=order.force) as draft:
        write_survey_file(draft, order.content)
    return []
