"""Writes a report of a survey, as HTML or PDF by the ending of its name."""

import os
from pathlib import Path

from pfwd_survey.errors import OptionError, refusal
from pfwd_survey.files.output_path import require_writable
from pfwd_survey.reporting.blocks import Heading
from pfwd_survey.reporting.certificate_blocks import read_logo
from pfwd_survey.reporting.composing import compose
from pfwd_survey.reporting.content import Report
from pfwd_survey.reporting.fonts import Letters, require_letters
from pfwd_survey.reporting.gathering import Progress, ReportOptions, gather
from pfwd_survey.reporting.texts import load_texts

__all__ = ["ReportOptions", "write_report"]

ENDINGS = (".html", ".pdf")


def write_report(
    survey: str | os.PathLike[str],
    output: str | os.PathLike[str],
    options: ReportOptions | None = None,
    progress: Progress | None = None,
) -> Report:
    """Write a report of a survey; the survey itself is not changed.

    Parameters
    ----------
    survey : path of a survey
    output : path ending in .html or .pdf
    options : ReportOptions, optional
    progress : callable, optional
        Told what is done, one sentence each.

    Returns
    -------
    Report
        What it shows.

    Raises
    ------
    OptionError
        If the language, the ending or the procedure is refused, or the file cannot be written.
    SurveyError, RecordingError
        If it is no survey, or holds no drop.
    """
    options = options or ReportOptions()
    target = Path(output)
    if target.suffix.lower() not in ENDINGS:
        raise OptionError(refusal("--output", "a name ending in .html or .pdf", str(target)))
    texts = load_texts(options.language)
    require_letters(texts.code)
    require_writable(target, "--output")
    if options.logo is not None:
        read_logo(options.logo)  # said now, and not after the work
    report = gather(Path(survey), options, progress)
    letters = Letters()
    blocks = compose(report, texts, letters, options.company, options.logo)
    title = next(block.text for block in blocks if isinstance(block, Heading))
    if target.suffix.lower() == ".pdf":
        from pfwd_survey.reporting.pdf_file import render_pdf

        data = render_pdf(blocks, texts, title, letters)
    else:
        from pfwd_survey.reporting.html_file import render_html

        data = render_html(blocks, texts, title).encode("utf-8")
    temporary = target.with_name(f".{target.name}.{os.getpid()}")
    try:
        # Another program never sees half of it.
        temporary.write_bytes(data)
        os.replace(temporary, target)
    except OSError as err:
        temporary.unlink(missing_ok=True)
        came = err.strerror or str(err)
        raise OptionError(refusal(f"--output {target}", "a file to write", came)) from err
    return report
