"""What is to be exported."""

from dataclasses import dataclass
from functools import cached_property

from pfwd_survey.exporting.rows import Results, Row, rows_of
from pfwd_survey.files.survey_content import SurveyContent


@dataclass(frozen=True)  # without slots, which leave no room for what is computed once
class Order:
    """A survey on its way into a format."""

    content: SurveyContent
    inverted: Results | None = None
    """Results in place of the stored ones."""
    force: bool = False
    """Whether a file that is there may be replaced."""

    @cached_property
    def rows(self) -> list[Row]:
        """All drops, point by point; read once."""
        return list(rows_of(self.content, self.inverted))
