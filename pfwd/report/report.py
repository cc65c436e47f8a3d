"""Write a report of a survey as HTML or PDF, by the ending of its name, or fill a workbook."""

import contextlib
import gc
import os
from collections.abc import Iterator
from pathlib import Path

from pfwd.errors import OptionError, refusal
from pfwd.files.output_path import replaced_at_once, require_writable
from pfwd.files.survey_file import survey_folder
from pfwd.report.blocks import Heading
from pfwd.report.certificate_blocks import read_logo
from pfwd.report.composing import compose
from pfwd.report.content import Report
from pfwd.report.fonts import Letters, require_letters
from pfwd.report.gathering import Progress, ReportOptions, gather
from pfwd.report.slip_blocks import slip_blocks
from pfwd.report.texts import Texts, load_texts

__all__ = ["ReportOptions", "write_report"]

PDF = ".pdf"
ENDINGS = (".html", PDF)
WORKBOOK = ".xlsx"
"""Ending of a workbook, which needs a template."""

GC_THRESHOLD = 50_000
"""New objects after which the garbage collector runs while pictures are drawn. With Python's usual
700 it takes a tenth of the time; this many objects take a few MB."""


def write_report(
    survey: str | os.PathLike[str],
    output: str | os.PathLike[str],
    options: ReportOptions | None = None,
    progress: Progress | None = None,
) -> Report:
    """Write a report of a survey; the survey itself is not changed.

    Parameters
    ----------
    survey : path of a survey, its folder or one file
    output : path ending in .html or .pdf; in .xlsx with a workbook as template
    options : ReportOptions, optional
    progress : callable, optional
        Receives one sentence for each step.

    Returns
    -------
    Report
        Data of the report.

    Raises
    ------
    OptionError
        If the language, the ending or the procedure is refused, or the file cannot be written.
    SurveyError, RecordingError
        If it is no survey, or holds no drop.
    """
    options = options or ReportOptions()
    target = Path(output)
    ending = target.suffix.lower()
    page_template = _page_template(options)
    if page_template is not None and ending != PDF:
        raise OptionError(refusal("--template", f"--output with {PDF}", str(target)))
    if options.template is not None and page_template is None and ending != WORKBOOK:
        raise OptionError(refusal("--template", f"--output with {WORKBOOK}", str(target)))
    if ending not in (*ENDINGS, WORKBOOK):
        raise OptionError(refusal("--output", "a name ending in .html or .pdf", str(target)))
    if ending == WORKBOOK and options.template is None:
        hint = "pfwd export --format xlsx makes a workbook without one"
        raise OptionError(refusal(f"--output {target}", "--template T.xlsx", "none", hint))
    if ending == WORKBOOK and options.slip:
        raise OptionError(refusal("--slip", "--output with .html or .pdf", str(target)))
    texts = load_texts(options.language)
    require_writable(target, "--output")
    if ending != WORKBOOK:
        require_letters(texts.code)
        if options.logo is not None:
            read_logo(options.logo)  # refused before the work, not after it
    if options.template is not None and not Path(options.template).is_file():
        where = f"--template {options.template}"
        kind = "a workbook (.xlsx)" if page_template is None else "a template of Typst (.typ)"
        raise OptionError(refusal(where, kind, "no such file"))
    if options.template is not None and target.exists() and target.samefile(options.template):
        raise OptionError(refusal("--output", "another file than the template", str(target)))
    with survey_folder(survey) as folder:
        report = gather(Path(folder), options, progress, target.name)
        data = _filled(report, options) if ending == WORKBOOK else None
        _write(target, _rendered(report, options, texts, ending) if data is None else data)
    return report


def _page_template(options: ReportOptions) -> Path | None:
    """Return the template of a PDF; None where there is none, or it is a workbook."""
    template = None if options.template is None else Path(options.template)
    return template if template is not None and template.suffix.lower() == ".typ" else None


def _filled(report: Report, options: ReportOptions) -> bytes:
    from pfwd.report.template import fill_template

    assert options.template is not None
    return fill_template(report, options.template, options.company)[0]


def _rendered(report: Report, options: ReportOptions, texts: Texts, ending: str) -> bytes:
    with _rare_garbage_collection():
        letters = Letters()
        if options.slip:
            blocks = slip_blocks(report, texts, letters, options)
        else:
            blocks = compose(report, texts, letters, options.company, options.logo)
        title = next(block.text for block in blocks if isinstance(block, Heading))
        if ending == PDF:
            from pfwd.report.typst_file import render_pdf

            return render_pdf(blocks, texts, title, letters, _page_template(options))
        from pfwd.report.html_file import render_html

        return render_html(blocks, texts, title).encode("utf-8")


@contextlib.contextmanager
def _rare_garbage_collection() -> Iterator[None]:
    before = gc.get_threshold()
    gc.set_threshold(max(before[0], GC_THRESHOLD) if before[0] else 0, *before[1:])
    try:
        yield
    finally:
        gc.set_threshold(*before)


def _write(target: Path, data: bytes) -> None:
    try:
        with replaced_at_once(target) as draft:
            draft.write_bytes(data)
    except OSError as err:
        problem = err.strerror or str(err)
        raise OptionError(refusal(f"--output {target}", "a file to write", problem)) from err
