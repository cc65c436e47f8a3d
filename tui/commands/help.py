"""``pfwd help``: list of the commands in groups, or the help of one command."""

import argparse

from tui.parser import COMMANDS, build_parser, overview


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd help`` and its description to the parser."""
    parser.description = "Shows the commands for everyday work, all commands, or the help of one."
    names = [name for commands in COMMANDS.values() for name in commands]
    parser.add_argument(
        "topic", nargs="?", choices=names, metavar="COMMAND", help="show the help of this command"
    )
    parser.add_argument("--all", action="store_true", help="show all commands")


def run(args: argparse.Namespace) -> int:
    """Print the list of commands, or the help of one command."""
    if args.topic is None:
        print(overview(everything=args.all), end="")
    else:
        build_parser().parse_args([args.topic, "--help"])
    return 0
