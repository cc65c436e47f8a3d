"""Edits of drops, points and job by the operator, and their undo."""

from collections.abc import Callable
from dataclasses import dataclass

from pfwd.files.editing import Edit, add_events, edit_survey
from pfwd.judging import JobRequest
from pfwd.judging.view import job_of_folder
from pfwd.session.events import Edited, JobReported
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_drop import ScreenDrop
from tui.screen.session.screen_events import ScreenEvent
from tui.screen.session.sources import SessionSource


@dataclass(frozen=True, slots=True)
class Undo:
    """Edit that takes back an earlier edit of a drop."""

    description: str
    """Edit that is reverted, in words."""
    edit: Edit
    drop: ScreenDrop


class SurveyEdits:
    """Edits drops, points and job through the running session, or in the survey's folder.

    Parameters
    ----------
    source : SessionSource
    runner : SessionRunner
        Its session makes the edit if one runs; otherwise the edit is reported to it.
    show_message : callable
        Shows one line to the operator.
    in_thread : callable
        Runs slow work in a thread, in a named group; its event or its error is shown.
    """

    def __init__(
        self,
        source: SessionSource,
        runner: SessionRunner,
        show_message: Callable[[str], None],
        in_thread: Callable[[Callable[[], ScreenEvent | None], str], None],
    ) -> None:
        self._source, self._runner = source, runner
        self._show_message, self._in_thread = show_message, in_thread
        self._undo: list[Undo] = []

    def discard(self, drop: ScreenDrop | None) -> None:
        """Discard a drop, or restore a discarded one."""
        if drop is None or drop.record is None:
            self._show_message("there is no drop that could be discarded")
            return
        kind = "restore" if drop.discarded else "discard"
        revert = Edit("discard" if drop.discarded else "restore")
        value = None if drop.discarded else "by the operator"
        if self.add(Edit(kind, value), drop=drop):
            self._undo.append(Undo(f"{kind} of drop {drop.number}", revert, drop))
            text = "discarded; u takes it back" if kind == "discard" else "restored"
            self._show_message(f"drop {drop.number} {text}")

    def undo(self) -> None:
        """Revert the last discard, restore or move."""
        if not self._undo:
            self._show_message("there is nothing to take back")
            return
        last = self._undo.pop()
        if self.add(last.edit, drop=last.drop):
            self._show_message(f"taken back: {last.description}")

    def add(self, edit: Edit, *, drop: ScreenDrop | None = None, point: str | None = None) -> bool:
        """Edit a drop or a point; return whether there is a survey to edit."""
        number = None if drop is None else drop.record
        if self._source.writes and self._runner.request(
            lambda session: session.edit(edit, point=point, number=number)
        ):
            return True
        folder = self._source.survey
        if folder is None:
            self._show_message("there is no survey that could be edited")
            return False

        def store() -> None:
            edit_survey(folder, [edit], point if drop is None else drop.point, number)
            edited = Edited(edit.what, edit.value, None if drop else point, number)
            self._runner.report(edited)

        self._in_thread(store, "edit")
        return True

    def move(self, drop: ScreenDrop | None, to: str) -> None:
        """Move a drop to another point."""
        if drop is None or drop.record is None:
            self._show_message("there is no drop that could be moved")
            return
        if drop.discarded:
            word = drop.edited_word.lower()
            self._show_message(f"drop {drop.number} is {word}; d restores it, then it can be moved")
            return
        if drop.point == to:
            self._show_message(f"drop {drop.number} is at point {to} already")
            return
        record = drop.record
        if self._source.writes and self._runner.request(lambda it: it.move_drop(record, to)):
            self._undo.append(Undo(f"move of drop {drop.number} to {to}", Edit("restore"), drop))
            self._show_message(f"drop {drop.number} is moved to {to}; u takes it back")
            return
        self._show_message("a recording is edited with pfwd edit --move")

    def change_job(self, request: JobRequest) -> None:
        """Change procedure, target, stations or operator of the survey."""
        if not request:
            self._show_message("nothing was changed")
            return
        if self._source.writes and self._runner.request(
            lambda session: session.change_job(request)
        ):
            self._show_message("the setup is in force")
            return
        folder = self._source.survey
        if folder is None:
            self._show_message("there is no survey to store it in")
            return

        def store() -> None:
            add_events(folder, request.events())
            self._runner.report(JobReported(job_of_folder(folder)))

        self._in_thread(store, "job")
