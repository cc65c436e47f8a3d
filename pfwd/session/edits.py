"""Edits of a survey during its session, as the events that report them."""

from pfwd.files.editing import MOVED_TO, Edit, move_with, point_called, restore_with
from pfwd.session.events import Edited
from pfwd_device.errors import RecordingError
from pfwd_device.recording.survey_reader import SurveyDrop
from pfwd_device.recording.survey_writer import SurveyWriter


def apply_edit(
    writer: SurveyWriter, edit: Edit, point: str | None, number: int | None
) -> list[Edited]:
    """Edit a point by its name, or a drop by its number within the survey.

    Raises
    ------
    RecordingError
        If there is no such point or drop, or the survey cannot be written.
    """
    if edit.what != "restore" or number is None:
        writer.edit(edit.what, edit.value, point=point, number=number)
        return [Edited(edit.what, edit.value, point, number)]
    drop = _drop_of(writer, number, "restore")
    copy = restore_with(writer, drop)
    events = [Edited("restore", None, None, number)]
    if copy is not None:
        value = {MOVED_TO: {"point": drop.point, "drop": drop.drop}}
        events.insert(0, Edited("discard", value, None, copy.number))
    return events


def apply_move(writer: SurveyWriter, number: int, to: str) -> tuple[str, Edited]:
    """Move a drop to another point; return the name of that point and the event.

    Parameters
    ----------
    writer : SurveyWriter
    number : int
        Number of the drop within the survey.
    to : str
        Name or title of the point to which the drop belongs, or a new name.

    Raises
    ------
    RecordingError
        If there is no such drop, or the survey cannot be written.
    OptionError
        If the drop cannot be moved there.
    """
    drop = _drop_of(writer, number, "move")
    to = point_called(writer.contents(), to)
    within = move_with(writer, drop, to)
    value = {MOVED_TO: {"point": to, "drop": within}}
    return to, Edited("discard", value, None, number)


def _drop_of(writer: SurveyWriter, number: int, where: str) -> SurveyDrop:
    """Return a drop by its number within the survey; raise RecordingError if there is none."""
    for drop in writer.contents().drops:
        if drop.number == number:
            return drop
    raise RecordingError(f"{where}: expected a drop of the survey, got number {number}")
