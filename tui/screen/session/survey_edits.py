"""What the operator says of drops and points: to the session, or into the survey; taken back."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pfwd.errors import DeviceError, SurveyError
from pfwd.files.editing import Edit, add_events, edit_survey
from pfwd.judging import JobRequest
from pfwd.judging.view import job_of_folder
from pfwd.session.events import Edited, JobReported, Notice
from tui.screen.session.drop_state import DropState
from tui.screen.session.runner import SessionRunner
from tui.screen.session.sources import SessionSource


@dataclass(frozen=True, slots=True)
class Undo:
    """How to take something back."""

    what: str
    edit: Edit
    drop: DropState


class SurveyEdits:
    """Edits, and those that can be taken back.

    Parameters
    ----------
    source : SessionSource
    runner : SessionRunner
        Whose session is asked first; told what was edited without one.
    say : callable
        Takes one line for the operator.
    in_thread : callable
        Runs something slow, in a group of that name.
    """

    def __init__(
        self,
        source: SessionSource,
        runner: SessionRunner,
        say: Callable[[str], None],
        in_thread: Callable[[Callable[[], None], str], None],
    ) -> None:
        self._source, self._runner = source, runner
        self._say, self._in_thread = say, in_thread
        self._undo: list[Undo] = []

    def discard(self, drop: DropState | None) -> None:
        """Mark a drop as not to be used, or take that back."""
        if drop is None or drop.record is None:
            self._say("there is no drop that could be discarded")
            return
        what = "restore" if drop.discarded else "discard"
        back = Edit("discard" if drop.discarded else "restore")
        value = None if drop.discarded else "by the operator"
        if self.add(Edit(what, value), drop=drop):
            self._undo.append(Undo(f"{what} of drop {drop.number}", back, drop))
            done = "discarded; u takes it back" if what == "discard" else "restored"
            self._say(f"drop {drop.number} {done}")

    def undo(self) -> None:
        """Take the last discard, restore or move back."""
        if not self._undo:
            self._say("there is nothing to take back")
            return
        last = self._undo.pop()
        if self.add(last.edit, drop=last.drop):
            self._say(f"taken back: {last.what}")

    def add(self, edit: Edit, *, drop: DropState | None = None, point: str | None = None) -> bool:
        """Say something of a drop or point of the survey; whether it could be tried."""
        number = None if drop is None else drop.record
        if self._source.writes and self._runner.ask(
            lambda session: session.edit(edit, point=point, number=number)
        ):
            return True
        folder = self._source.survey
        if folder is None:
            self._say("there is no survey that could be edited")
            return False
        self._in_thread(lambda: self._edit_folder(folder, edit, drop, point), "edit")
        return True

    def move(self, drop: DropState | None, to: str) -> None:
        """Move a drop to the point where it belongs."""
        if drop is None or drop.record is None:
            self._say("there is no drop that could be moved")
            return
        if drop.discarded:
            self._say(f"drop {drop.number} is discarded; d restores it, then it can be moved")
            return
        if drop.point == to:
            self._say(f"drop {drop.number} is at point {to} already")
            return
        record = drop.record
        if self._source.writes and self._runner.ask(lambda it: it.move_drop(record, to)):
            self._undo.append(Undo(f"move of drop {drop.number} to {to}", Edit("restore"), drop))
            self._say(f"drop {drop.number} is moved to {to}; u takes it back")
            return
        self._say("a recording is edited with pfwd edit --move")

    def say_of_job(self, request: JobRequest) -> None:
        """Say something of what the survey is measured by."""
        if not request:
            self._say("nothing was changed")
            return
        if self._source.writes and self._runner.ask(lambda session: session.change_job(request)):
            self._say("taken")
            return
        folder = self._source.survey
        if folder is None:
            self._say("there is no survey that could keep it")
            return
        self._in_thread(lambda: self._keep_job(folder, request), "job")

    def _keep_job(self, folder: Path, request: JobRequest) -> None:
        try:
            add_events(folder, request.events())
            job = job_of_folder(folder)
        except (SurveyError, DeviceError, OSError) as err:
            self._runner.put(Notice(str(err), serious=True))
            return
        self._runner.put(JobReported(job))

    def _edit_folder(
        self, folder: Path, edit: Edit, drop: DropState | None, point: str | None
    ) -> None:
        name = drop.point if drop is not None else point
        try:
            edit_survey(folder, [edit], name, None if drop is None else drop.number)
        except (SurveyError, DeviceError, OSError) as err:
            self._runner.put(Notice(str(err), serious=True))
            return
        record = None if drop is None else drop.record
        self._runner.put(Edited(edit.what, edit.value, None if drop else point, record))
