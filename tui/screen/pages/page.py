"""Base class of the pages: lines that fill the terminal, keys, and the application behind."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol, cast

from textual.app import ComposeResult
from textual.screen import Screen

from pfwd.judging import PointView
from pfwd.session.plan import SessionPlan
from pfwd.units import Units
from tui.screen.drawing.glyphs import Glyphs
from tui.screen.drawing.lines import Line
from tui.screen.lines_view import LinesView
from tui.screen.session.diagnosis import RequestedDiagnoses
from tui.screen.session.drop_fits import DropFits
from tui.screen.session.runner import SessionRunner
from tui.screen.session.screen_drop import ScreenDrop
from tui.screen.session.sources import SessionSource
from tui.screen.session.state import SessionState
from tui.screen.session.stations import ReceiverStatus
from tui.screen.session.status import StatusWord
from tui.screen.session.survey_edits import SurveyEdits
from tui.screen.settings import ScreenSettings
from tui.screen.themes import ScreenTheme

MIN_WIDTH, MIN_HEIGHT = 40, 10
"""Smallest terminal on which a page is useful, columns and rows."""


class Host(Protocol):
    """What the pages require of the application that shows them."""

    state: SessionState
    source: SessionSource
    settings: ScreenSettings
    glyphs: Glyphs
    diagnoses: RequestedDiagnoses
    edits: SurveyEdits
    fits: DropFits
    runner: SessionRunner
    selected_drop: tuple[str, int] | None

    @property
    def screen_theme(self) -> ScreenTheme:
        """Colours of the theme that the operator chose."""

    @property
    def units(self) -> Units:
        """Units in which all pages show numbers."""

    @property
    def message(self) -> str:
        """Last message; empty after some seconds."""

    def clock(self) -> str:
        """Return the local time of day as HH:MM:SS."""

    def word(self) -> StatusWord:
        """Return the status word at the top of the measure page, with its instruction."""

    def position(self) -> ReceiverStatus | None:
        """Return the fix of the satellite receiver as text; None: none is connected."""

    def coordinates(self) -> tuple[float, float] | None:
        """Return latitude and longitude of the last fix, degrees; None: there is no fix."""

    def pace_text(self) -> str:
        """Return the speed of a replay in words."""

    def busy_text(self) -> str:
        """Return what runs in the background, a diagnosis or a fit, in words; empty: nothing."""

    def restart(self, plan: SessionPlan, url: str) -> None:
        """Start the session again with another plan, and another port if one is given."""

    def show_message(self, text: str) -> None:
        """Show a line of text on every page for some seconds."""

    def change(self, **values: Any) -> None:
        """Change settings of the screen, as ``theme="dark"``, and store them."""

    def action_page(self, name: str) -> None:
        """Show the page of this name, as "points"."""

    def ask_for_slip(self, point: PointView) -> None:
        """Ask for the signature of the slip of a point, then write the slip."""

    def open_drop(self, drop: ScreenDrop | None, *, refit: bool = False) -> None:
        """Open the drop page; with `refit` also its dialog for a fit with other settings."""


class Page(Screen[None]):
    """Base class of a page that fills the terminal with lines of text."""

    NAME: ClassVar[str] = ""
    HELP: ClassVar[str] = ""
    """Purpose of the page in a few sentences, for the help."""
    WORDS: ClassVar[Mapping[str, str]] = {}
    """Words on the page and their meaning, for the help."""
    KEYS: ClassVar[Sequence[tuple[str, str]]] = ()
    """Keys and their effect, most important first, for the last line of the page."""

    def compose(self) -> ComposeResult:
        """Yield the view of the lines."""
        yield LinesView(id="lines")

    @property
    def pfwd(self) -> Host:
        """Application that shows the page."""
        return cast(Host, self.app)

    @property
    def view(self) -> LinesView:
        """Widget that shows the lines."""
        return self.query_one("#lines", LinesView)

    def lines(self, width: int, height: int) -> Sequence[Line]:
        """Return the lines of the page for a size of the terminal."""
        raise NotImplementedError

    def draw(self) -> None:
        """Draw the page, once it is mounted."""
        if not self.query("#lines"):
            return
        size = self.view.size
        if size.width and size.height:
            self.view.show(self.lines(size.width, size.height), self.pfwd.screen_theme)

    def on_screen_resume(self) -> None:
        """Draw the page when it is on top again."""
        self.call_after_refresh(self.draw)

    def on_resize(self) -> None:
        """Draw the page for another size."""
        self.call_after_refresh(self.draw)
