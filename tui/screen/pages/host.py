"""What the pages ask of the application that shows them."""

from typing import Any, Protocol

from pfwd.session.plan import SessionPlan
from tui.screen.drawing.glyphs import Glyphs
from tui.screen.looks import Look
from tui.screen.session.diagnosis import Diagnoses
from tui.screen.session.drop_fits import DropFits
from tui.screen.session.drop_state import DropState
from tui.screen.session.runner import SessionRunner
from tui.screen.session.sources import SessionSource
from tui.screen.session.state import SessionState
from tui.screen.session.stations import ReceiverStatus
from tui.screen.session.status import StatusWord
from tui.screen.session.survey_edits import SurveyEdits
from tui.screen.settings import ScreenSettings
from tui.screen.units import Units


class Host(Protocol):
    """The application, as far as the pages know it."""

    state: SessionState
    source: SessionSource
    settings: ScreenSettings
    glyphs: Glyphs
    diagnoses: Diagnoses
    edits: SurveyEdits
    fits: DropFits
    runner: SessionRunner
    shown_drop: tuple[str, int] | None

    @property
    def look(self) -> Look:
        """Colours of the theme."""

    @property
    def units(self) -> Units:
        """What numbers are shown in."""

    @property
    def message(self) -> str:
        """What was said last."""

    def clock(self) -> str:
        """The time of day."""

    def word(self) -> StatusWord:
        """What is going on."""

    def position(self) -> ReceiverStatus | None:
        """Where the instrument stands; None: no receiver."""

    def coordinates(self) -> tuple[float, float] | None:
        """Latitude and longitude now, degrees."""

    def pace_text(self) -> str:
        """How fast a replay goes."""

    def busy_text(self) -> str:
        """What is under way besides measuring."""

    def restart(self, plan: SessionPlan, url: str) -> None:
        """Measure with another plan or instrument."""

    def show_message(self, text: str) -> None:
        """Show a sentence until the next key."""

    def change(self, **values: Any) -> None:
        """Other settings."""

    def action_page(self, name: str) -> None:
        """Go to a page."""

    def open_drop(self, drop: DropState | None, *, refit: bool = False) -> None:
        """Go to the page of a drop."""
