"""``pfwd export``: write a survey as a file for other programs."""

import argparse

from pfwd.export.json_text import json_text
from pfwd.export.registry import BUILT_IN_FORMATS as EXPORT_FORMATS
from tui.arguments import add_expert_group, add_json, add_seed
from tui.output import clean, counted, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd export`` and its description to the parser."""
    parser.description = (
        "Writes a survey as one file, or as a folder for csv. An export that fails leaves nothing "
        "behind. It holds the last stored result of each drop, always with uncertainty, model, "
        "plate radius, Poisson's ratio and warnings."
    )
    parser.add_argument("survey", metavar="SURVEY", help="folder, or a survey in one file")
    parser.add_argument(
        "--format",
        # No choices here: a plug-in may have the format, and plug-ins are searched later.
        metavar="FORMAT",
        help="; ".join(f"{form.name}: {form.holds}" for form in EXPORT_FORMATS.values())
        + "; or a format of another installed package (default: from the ending of PATH)",
    )
    parser.add_argument("-o", "--output", metavar="PATH", required=True, help="file or folder")
    parser.add_argument("--force", action="store_true", help="overwrite an existing file")
    parser.add_argument(
        "--delimiter",
        metavar="SIGN",
        help="for table and points: sign between columns, or tab (default: comma, or semicolon "
        "with a decimal comma)",
    )
    parser.add_argument(
        "--decimal", metavar="SIGN", help="for table and points: decimal sign, . or , (default: .)"
    )
    add_json(parser)
    expert = add_expert_group(parser)
    expert.add_argument(
        "--invert", action="store_true", help="compute results instead of using the stored ones"
    )
    add_seed(expert)


def run(args: argparse.Namespace) -> int:
    """Export the survey, and print a summary and all omissions."""
    from pfwd.export.export import export_survey

    export = export_survey(
        args.survey,
        args.format,
        args.output,
        force=args.force,
        invert=args.invert,
        seed=args.seed,
        delimiter=args.delimiter,
        decimal=args.decimal,
    )
    for note in export.notes:
        say(f"export: {note}")
    if args.json:
        print(json_text(export.as_dict()), flush=True)
    else:
        print(
            clean(
                f"{export.path}: format {export.format}, {counted(export.points, 'point')}, "
                f"{counted(export.drops, 'drop')}"
            ),
            flush=True,
        )
    return 0
