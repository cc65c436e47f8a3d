"""``pfwd check`` and ``pfwd recover``: verify a survey, repair it after a crash."""

import argparse

from pfwd.export.json_text import json_text
from tui.arguments import add_json, add_spare
from tui.output import clean, counted, say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd check`` and ``pfwd recover`` and a description to the parser."""
    parser.description = (
        "Reads every record of a survey, or a drop file, and compares "
        "checksums and recorded peaks with the traces. Changes nothing without --repair. Exit "
        "status 1 when something is damaged or missing."
    )
    parser.add_argument(
        "survey", metavar="SURVEY", help="folder, survey in one file (.pfwdz), or drop file (.h5)"
    )
    parser.add_argument(
        "--repair",
        action="store_true",
        help="restore a survey after a crash, a full disk or a pulled drive (pfwd recover does "
        "the same): every acknowledged drop gets its file again, damaged files are moved aside "
        "byte for byte, nothing is deleted",
    )
    add_spare(parser)
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Check or repair the survey and print its state; return 1 if data are damaged or missing."""
    from pfwd.files.upkeep import check_survey, recover_survey

    repair = args.repair or args.command == "recover"
    record, remarks = (recover_survey if repair else check_survey)(args.survey, args.spare)
    for remark in remarks:
        say(remark)
    if args.json:
        print(json_text(record), flush=True)
    else:
        print(
            f"{clean(record['survey'])}: "
            f"{counted(record['drops_acknowledged'], 'drop')} acknowledged, "
            f"{record['drops_published']} with a verified file, {record['recovered']} recovered"
        )
        for text in record["damaged"]:
            print(f"  DAMAGED: {clean(text)}")
        print("complete" if record["ok"] else "NOT complete", flush=True)
    return 0 if record["ok"] else 1
