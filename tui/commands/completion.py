"""``pfwd completion``: a script by which a shell completes commands and options."""

import argparse

from tui.parser import COMMANDS, build_parser

SHELLS = ("bash", "zsh", "fish", "tcsh", "powershell")

_FILES = {"FILE", "FILE.toml", "D.toml", "MAP.toml", "PATH", "SURVEY", "TRACES"}
_FOLDERS = {"FOLDER", "OUT"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of ``pfwd completion`` and its description to the parser."""
    parser.description = (
        "Prints a script with which a shell completes commands, options, their values and files "
        "when you press Tab. Its first lines say where to store it."
    )
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help=", ".join(SHELLS))


def run(args: argparse.Namespace) -> int:
    """Print the script for a shell."""
    import shtab

    parser = build_parser()
    purposes = {name: text for group in COMMANDS.values() for name, text in group.items()}
    for name, command in parser.commands.items():
        command.add_arguments()
        command.description = purposes[name]  # one line, for the list that a shell shows
        for action in command._actions:
            if action.metavar in _FILES | _FOLDERS:
                kind = shtab.FILE if action.metavar in _FILES else shtab.DIRECTORY
                action.complete = kind  # type: ignore[attr-defined]
    print(shtab.complete(parser, args.shell))
    return 0
