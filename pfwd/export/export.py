"""Export of a survey, for the command line and for scripts."""

import os
from dataclasses import dataclass
from typing import Any

import pfwd_plugins
from pfwd.errors import OptionError, SurveyError, quote, refusal
from pfwd.export.output import refuse_existing
from pfwd.export.registry import (
    BUILT_IN_FORMATS,
    NAME_BY_ENDING,
    ExportFormat,
    find_format,
    format_names,
)
from pfwd.export.rows import Order, Results
from pfwd.files.opening import survey_content
from pfwd_device.errors import RecordingError


@dataclass(frozen=True, slots=True)
class ExportSummary:
    """Summary of an export, for messages."""

    survey: str
    format: str
    path: str
    points: int
    """Number of points of the survey."""
    drops: int
    """Number of drops of the survey, discarded ones included."""
    results: int | None
    """Number of drops with a result; None: the format holds no results."""
    notes: tuple[str, ...]
    """One sentence for each omission or damage."""

    def as_dict(self) -> dict[str, Any]:
        """Return the summary with the keys of ``pfwd export --json``."""
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
    form: str | None,
    path: str | os.PathLike[str],
    *,
    force: bool = False,
    invert: bool = False,
    seed: int = 0,
    delimiter: str | None = None,
    decimal: str | None = None,
) -> ExportSummary:
    """Write a survey to a file, or for ``csv`` to a folder; after an error nothing is left there.

    Parameters
    ----------
    survey : path of a survey's folder, or of a survey in one file
    form : str or None
        Name of a format in `pfwd.export.registry`; None: the format that the path's ending names.
    path : path of the file or folder, in an existing folder
    force : bool
        True: an existing file may be replaced.
    invert : bool
        True: the drops are inverted for the export; their stored results are not used, and nothing
        is written to the survey.
    seed : int
        Random seed of the inversion, >= 0.
    delimiter : str, optional
        Character between the columns of a text, or ``tab``; default: a comma, or a semicolon if the
        decimal sign is a comma.
    decimal : str, optional
        Decimal sign of a text, ``.`` (default) or ``,``.

    Returns
    -------
    ExportSummary

    Raises
    ------
    OptionError
        If the format is unknown, or holds no results although `invert` is set, or the path is in
        use.
    SurveyError
        If the survey cannot be read, or does not fit into the format.
    """
    form = _format_of_path(path) if form is None else form
    chosen = _format(form, invert=invert)
    signs = _signs(chosen, delimiter, decimal)
    refuse_existing(path, force=force)  # early, because an export may take minutes
    content = survey_content(survey)
    inverted = _inverted(os.fspath(survey), seed) if invert else None
    order = Order(content, inverted, force, *signs)
    notes, results = _written(chosen, order, path)
    drops = len(content.drops)
    if results is not None and results < drops:
        notes.append(f"{drops - results} of {drops} drops have no result")
    damage = [f"damaged survey: {text}" for text in content.damage]
    return ExportSummary(
        os.fspath(survey),
        chosen.name,
        os.fspath(path),
        len(content.points),
        drops,
        results,
        (*notes, *damage),
    )


def _written(
    form: ExportFormat, order: Order, path: str | os.PathLike[str]
) -> tuple[list[str], int | None]:
    """Write the file; return the notes and the number of drops with a result (None: not in the
    format).
    """
    try:
        notes = list(form.writer()(order, path))
        return notes, order.results if form.with_results else None
    except RecordingError as err:
        raise SurveyError(str(err)) from err
    except (SurveyError, OSError):
        raise
    except Exception as err:
        if form.name in BUILT_IN_FORMATS:
            raise
        package = pfwd_plugins.package_of(pfwd_plugins.EXPORT_FORMATS, form.name)
        text = f"{type(err).__name__}: {err}"
        raise SurveyError(refusal(f"--format {form.name}", f"a file from {package}", text)) from err


def _format_of_path(path: str | os.PathLike[str]) -> str:
    """Return the name of the format that the ending of a path names.

    The ending ``.csv`` is refused, because several formats are CSV, one of them a folder.
    """
    name = os.path.splitext(path)[1].removeprefix(".").lower()
    name = NAME_BY_ENDING.get(name, name)
    if name in BUILT_IN_FORMATS and name != "csv":
        return name
    names = ", ".join(format_names())
    hint = "--format table, points or csv" if name == "csv" else f"--format, one of {names}"
    expected = "an ending that names a format, such as .xlsx"
    raise OptionError(refusal(f"--output {os.fspath(path)}", expected, quote(name), hint))


def _format(name: str, *, invert: bool) -> ExportFormat:
    form = find_format(name)
    if form is None:
        raise OptionError(refusal("--format", f"one of {', '.join(format_names())}", quote(name)))
    if invert and not form.with_results:
        formats = BUILT_IN_FORMATS.values()
        holding = ", ".join(sorted(format_.name for format_ in formats if format_.with_results))
        raise OptionError(refusal("--invert", f"a format with results ({holding})", name))
    return form


def _signs(form: ExportFormat, delimiter: str | None, decimal: str | None) -> tuple[str, str]:
    """Return the character between columns and the decimal sign, checked."""
    for option, sign in (("--delimiter", delimiter), ("--decimal", decimal)):
        if sign is not None and not form.delimited:
            formats = BUILT_IN_FORMATS.values()
            holding = ", ".join(format_.name for format_ in formats if format_.delimited)
            raise OptionError(refusal(option, f"a format in columns ({holding})", form.name))
    point = "." if decimal is None else decimal
    if point not in (".", ","):
        raise OptionError(refusal("--decimal", "a point or a comma", quote(decimal)))
    between = ";" if point == "," else ","
    if delimiter is not None:
        between = "\t" if delimiter in ("tab", "\\t") else delimiter
    printable = len(between) == 1 and (between == "\t" or between.isprintable())
    if not printable or between in "\"'+-." or between.isalnum():
        expected = "one character such as ; or the word tab"
        raise OptionError(refusal("--delimiter", expected, quote(delimiter)))
    if between == point:
        text = f"{quote(between)} for both"
        raise OptionError(refusal("--delimiter and --decimal", "different characters", text))
    return between, point


def _inverted(survey: str, seed: int) -> Results:
    from pfwd.analysis.analyse import analyse_files
    from pfwd.analysis.options import AnalysisOptions

    (outcome,) = analyse_files([survey], AnalysisOptions(seed=seed))
    if outcome.error is not None:
        raise SurveyError(outcome.error)
    return {(str(result.point), result.drop): result for result in outcome.results}
