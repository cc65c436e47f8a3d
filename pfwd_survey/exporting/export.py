"""Exports a survey: the one road for the command line and scripts."""

import os
from dataclasses import dataclass
from typing import Any

from pfwd_device.errors import RecordingError
from pfwd_survey.errors import OptionError, SurveyError, refusal
from pfwd_survey.exporting.formats import FORMATS, WITH_RESULTS, writer_of
from pfwd_survey.exporting.order import Order
from pfwd_survey.exporting.rows import NO_RESULT, Results
from pfwd_survey.files.reading import survey_content


@dataclass(frozen=True, slots=True)
class Exported:
    """What came of an export."""

    survey: str
    format: str
    path: str
    points: int
    """Of the survey."""
    drops: int
    """Of the survey, discarded ones with them."""
    results: int | None
    """How many drops have a result; None: the format holds none."""
    notes: tuple[str, ...]
    """What was left out, a sentence each."""

    def as_dict(self) -> dict[str, Any]:
        """The record of ``pfwd export --json``."""
        return {
            "survey": self.survey,
            "format": self.format,
            "path": self.path,
            "points": self.points,
            "drops": self.drops,
            "results": self.results,
            "without_result": None if self.results is None else self.drops - self.results,
            "notes": list(self.notes),
        }


def export_survey(
    survey: str | os.PathLike[str],
    form: str,
    path: str | os.PathLike[str],
    *,
    force: bool = False,
    invert: bool = False,
    seed: int = 0,
) -> Exported:
    """Write a survey to a file, or for ``csv`` to a folder; it is there whole or not at all.

    Parameters
    ----------
    survey : path of a survey's folder, or of an exported one
    form : str
        One of ``FORMATS``.
    path : of the file or folder, in a folder that is there
    force : bool
        Whether what is there may be replaced.
    invert : bool
        Invert the drops in place of taking the stored results. Nothing is written to the survey.
    seed : int
        Of the inversion, >= 0.

    Returns
    -------
    Exported

    Raises
    ------
    OptionError
        If the format is unknown or holds no results to invert for, or the name is taken.
    SurveyError
        If the survey cannot be read, or what it holds does not fit into the format.
    """
    _check_format(form, invert=invert)
    content = survey_content(survey)
    order = Order(content, _inverted(os.fspath(survey), seed) if invert else None, force)
    try:
        notes = writer_of(form)(order, path)
        results = None
        if form in WITH_RESULTS:
            results = sum(row.values["status"] != NO_RESULT for row in order.rows)
    except RecordingError as err:
        raise SurveyError(str(err)) from err
    drops = len(content.drops)
    if results is not None and results < drops:
        notes.append(f"{drops - results} of {drops} drops have no result")
    lost = [f"damaged survey: {text}" for text in content.damage]
    return Exported(
        os.fspath(survey),
        form,
        os.fspath(path),
        len(content.points),
        drops,
        results,
        (*notes, *lost),
    )


def _check_format(form: str, *, invert: bool) -> None:
    if form not in FORMATS:
        raise OptionError(refusal("--format", f"one of {', '.join(FORMATS)}", repr(form)))
    if invert and form not in WITH_RESULTS:
        expected = f"a format with results ({', '.join(sorted(WITH_RESULTS))})"
        raise OptionError(refusal("--invert", expected, form))


def _inverted(survey: str, seed: int) -> Results:
    from pfwd_survey.inverting.analysis import analyse_files
    from pfwd_survey.inverting.options import AnalysisOptions

    (outcome,) = analyse_files([survey], AnalysisOptions(seed=seed))
    if outcome.error is not None:
        raise SurveyError(outcome.error)
    return {(str(found.point), int(found.drop or 0)): found for found in outcome.results}
