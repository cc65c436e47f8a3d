"""``pfwd report``: a survey as one HTML file or a PDF."""

import argparse
import time

from pfwd_survey.errors import OptionError, refusal
from pfwd_survey.exporting.json_text import json_text
from pfwd_survey.files.editing import target_pa
from tui.output import clean, say
from tui.progress import telling
from tui.report_settings import load_report_settings


def _metres(millimetres: float | None) -> float | None:
    return None if millimetres is None else millimetres / 1e3


def run(args: argparse.Namespace) -> int:
    """Write the report, then say how the points stand."""
    from pfwd_survey.reporting.report import ReportOptions, write_report

    if args.seed < 0:
        raise OptionError(refusal("--seed", "a whole number >= 0", str(args.seed)))
    settings = load_report_settings()
    options = ReportOptions(
        language=args.language,
        title=args.title,
        procedure=args.procedure,
        target=None if args.target is None else target_pa(args.target),
        target_deflection=_metres(args.target_deflection),
        refit=args.refit,
        diagnose=args.diagnose,
        store=not args.no_store,
        seed=args.seed,
        layers=args.layers,
        thickness=args.thickness,
        company=args.company or settings.company,
        logo=args.logo or settings.logo,
        template=args.template,
        jobs=args.jobs,
    )
    begun = time.monotonic()
    with telling() as tell:
        report = write_report(args.survey, args.output, options, progress=tell)
    for point in report.points:
        progress = point.progress
        if args.json:
            said = {"point": point.name, "discarded": point.discarded, "report": args.output}
            print(json_text({**said, **progress.as_dict()}), flush=True)
        else:
            print(clean(f"point {point.name}: {progress.verdict}, {progress.verdict_reason}"))
    say(f"{args.output} written in {time.monotonic() - begun:.1f} s")
    return 0
