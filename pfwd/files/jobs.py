"""Keeps events in a survey that nobody measures into now."""

import os
from collections.abc import Iterable, Mapping
from typing import Any

from pfwd.files.folders import refuse_no_survey
from pfwd.files.spare import open_for_edits


def keep_events(
    folder: str | os.PathLike[str], events: Iterable[tuple[str, Mapping[str, Any]]]
) -> None:
    """Add events to a survey.

    Parameters
    ----------
    folder : path of a survey
    events : iterable of name and details

    Raises
    ------
    SurveyError, RecordingError
        If it is no survey, or another program writes it.
    """
    refuse_no_survey(folder)
    with open_for_edits(folder) as writer:
        for kind, details in events:
            writer.note_event(kind, details)
