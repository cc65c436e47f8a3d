"""``pfwd report``: write a survey as HTML, PDF or workbook."""

import argparse
import time

from pfwd.errors import OptionError, refusal
from pfwd.export.json_text import json_text
from pfwd.message_groups import text_of
from tui.arguments import (
    add_expert_group,
    add_jobs,
    add_json,
    add_options,
    add_seed,
    add_stored,
    add_target,
    analysis_options,
    number,
    report_file,
)
from tui.output import clean, quoted, say
from tui.progress import report_progress


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd report`` and its description to the parser."""
    parser.description = (
        "Writes one file that shows a survey to others: summary, map, profile, a page per point "
        "with traces, fits and residuals, device, procedure, and all that is needed to compute it "
        "again. It uses stored results; missing ones are computed."
    )
    parser.add_argument("survey", metavar="SURVEY", help="folder, or a survey in one file")
    parser.add_argument(
        "-o",
        "--output",
        type=report_file,
        metavar="FILE",
        required=True,
        help=".html or .pdf; .xlsx with a workbook as --template",
    )
    parser.add_argument(
        "--template",
        metavar="FILE",
        help="FILE.xlsx: a workbook whose named cells, or cells with {{ name }}, are filled; "
        "FILE.typ: a layout of the PDF for Typst",
    )
    parser.add_argument(
        "--language",
        metavar="CODE",
        default="en",
        help="en, de or zh, or a TOML file with the texts of another language (default: en)",
    )
    parser.add_argument(
        "--title", metavar="TEXT", help="heading (default: the site, or the folder's name)"
    )
    parser.add_argument("--company", metavar="TEXT", help="company on the first page")
    parser.add_argument("--logo", metavar="FILE", help="picture for the first page (.png, .jpg)")
    parser.add_argument(
        "--procedure", metavar="NAME", help="judge by this procedure (default: that of the survey)"
    )
    add_target(parser)
    parser.add_argument(
        "--diagnose",
        action=argparse.BooleanOptionalAction,
        help="diagnose all points without a stored diagnosis (slow), or none; default: the points "
        "whose fit leaves a residual, in surveys of up to 30 points",
    )
    parser.add_argument("--point", metavar="P", help="report only this point")
    parser.add_argument(
        "--slip",
        action="store_true",
        help="one page for the --point, to sign, with a QR code of point, time and checksum",
    )
    parser.add_argument("--signed", metavar="NAME", help="typed signature of the --slip")
    add_jobs(parser)
    add_json(parser, "point")
    expert = add_expert_group(parser)
    expert.add_argument(
        "--target-deflection",
        type=number,
        metavar="MM",
        help="the same as --target, refused if the procedure judges no deflection",
    )
    add_options(
        expert,
        "layers",
        "thickness",
        layers="number of layers, the ground below them included, 1 to 4 (computes all drops "
        "again; default: as stored), or auto: as many as the record supports",
    )
    add_stored(expert)
    add_seed(expert)


def _target(args: argparse.Namespace) -> float | None:
    """Return the target in Pa or m; the options have it in MPa or mm."""
    if args.target is None and args.target_deflection is None:
        return None
    from pfwd.files.survey_file import survey_folder
    from pfwd.judging import target_si
    from pfwd.procedures import Quantity, find_procedure
    from tui.measuring_options import survey_job

    if args.target is not None and args.target_deflection is not None:
        raise OptionError(refusal("--target and --target-deflection", "one of them", "both"))
    chosen = None if args.procedure is None else find_procedure(args.procedure)
    with survey_folder(args.survey) as folder:
        procedure = chosen or survey_job(folder).procedure_in_force
    if args.target is not None:
        return target_si(args.target, procedure)
    if procedure.quantity is not Quantity.DEFLECTION:
        got = f"{procedure.name}, which judges {procedure.quantity}"
        expected = "a procedure that judges deflections"
        raise OptionError(refusal("--target-deflection", expected, got, "--target, in MPa"))
    return target_si(args.target_deflection, procedure, "--target-deflection")


def run(args: argparse.Namespace) -> int:
    """Write the report, then print the verdict of each point."""
    from pfwd.files.report_settings import read_report_settings
    from pfwd.report.gathering import TARGET_OF_REPORT
    from pfwd.report.report import ReportOptions, write_report
    from tui.screen.settings import settings_file

    settings = read_report_settings(settings_file().with_name("report.toml"))
    options = ReportOptions(
        language=args.language,
        title=args.title,
        procedure=args.procedure,
        target=_target(args),
        refit=args.refit,
        diagnose=args.diagnose,
        store=not args.no_store,
        analysis=analysis_options(args),
        company=args.company or settings.get("company"),
        logo=args.logo or settings.get("logo"),
        template=args.template,
        jobs=args.jobs,
        point=args.point,
        slip=args.slip,
        signed=args.signed,
    )
    start = time.monotonic()
    with report_progress() as show_progress:
        report = write_report(args.survey, args.output, options, progress=show_progress)
    for text in (*report.otherwise, *report.damage):
        say(f"report: {text}")
    for point in report.points:
        progress = point.progress
        if args.json:
            record = {"point": point.name, "discarded": point.discarded, "report": args.output}
            print(json_text({**record, **progress.as_dict()}), flush=True)
        else:
            verdict = f"{progress.verdict.word}, {text_of(progress.verdict_reason)}"
            print(clean(f"point {point.name}: {verdict}"))
    if any(point.progress.target_source == TARGET_OF_REPORT for point in report.points):
        chosen = "" if args.procedure is None else f" --procedure {quoted(args.procedure)}"
        value = args.target if args.target is not None else args.target_deflection
        command = f"pfwd job {quoted(args.survey)}{chosen} --target {value:g}"
        say(
            "report: its target is not stored: other reports, workbooks, exports and pages of the "
            f"survey judge without it. To store it: {command}"
        )
    say(f"{args.output} written in {time.monotonic() - start:.1f} s")
    return 0
