"""Commands of ``pfwd`` in groups, and the parser of the command line.

Each command has a module in `tui.commands` with `add_arguments(parser)` and `run(args)`. It is
imported when the command is used, so that ``pfwd --help`` answers at once.
"""

import argparse
import difflib
import importlib
from collections.abc import Sequence
from typing import Any

COMMANDS = {
    "measure": {
        "demo": "try the program with a simulated instrument",
        "ports": "list the serial ports and the instruments on them",
        "live": "measure with an instrument, on a screen",
        "log": "measure with an instrument, line by line",
        "import": "read files of other programs into a survey",
    },
    "look": {
        "open": "show a survey on a screen or in a browser",
        "invert": "compute a modulus for each drop",
        "diagnose": "find what disturbs the records, and the modulus to use",
    },
    "export": {
        "report": "write a report as HTML, PDF or workbook",
        "export": "write a survey for Excel, GIS and other programs",
    },
    "repair": {
        "edit": "add notes and targets, move, discard or restore drops",
        "check": "verify that a survey is complete, repair it",
    },
    "more": {
        "job": "show or set procedure, targets and stations of a survey",
        "procedures": "list the measuring procedures, with their sources",
        "setup": "write the setup file of a logger, question by question",
        "map": "describe the columns of a text file, for import",
        "calibrate": "calibrate load cell and geophone: springs, momentum, decay",
        "replay": "detect and invert recorded drops again",
        "recover": "repair a survey after a crash, as check --repair",
        "schema": "print the JSON Schema of a file, for an editor",
        "simulate": "run a simulated instrument to connect to",
        "conform": "test whether an instrument follows the protocol",
        "completion": "print a script for completion by the Tab key",
        "bench": "run the project's benchmarks, from a checkout",
        "help": "show this list, or the help of a command",
    },
}
"""Purpose of each command by its name, in the groups of the help; ``pfwd --help`` does not show the
last group."""

_MODULES = {"import": "import_", "recover": "check"}
"""Modules whose name is not that of the command: "import" is a keyword of Python, and "recover" is
another name of "check"."""

FIRST_STEPS = """\
pfwd measures the modulus of the ground with a portable falling weight deflectometer.

  pfwd demo                                try it without an instrument
  pfwd ports                               find the port of the instrument
  pfwd live PORT -o "Ring road"            measure, on the screen
  pfwd open "Ring road"                    look at what was measured
  pfwd report "Ring road" -o report.html   write a report

pfwd --help lists the commands, pfwd COMMAND --help their options."""
"""Text that ``pfwd`` prints without arguments."""


def command_module(command: str) -> Any:
    """Return the module of a command."""
    return importlib.import_module(f"tui.commands.{_MODULES.get(command, command)}")


def overview(*, everything: bool = False) -> str:
    """Return the help of ``pfwd``: its commands in groups.

    Parameters
    ----------
    everything : bool
        True: all commands. False: without the last group.
    """
    groups = dict(COMMANDS)
    more = groups.pop("more")
    lines = [
        "usage: pfwd COMMAND [OPTIONS]",
        "",
        "Modulus of the ground from drops of a portable falling weight deflectometer.",
    ]
    for title, commands in (COMMANDS if everything else groups).items():
        lines += ["", f"{title}:"]
        lines += [f"  {name:<10}  {purpose}" for name, purpose in commands.items()]
    lines += ["", "pfwd COMMAND --help    options of a command"]
    if not everything:
        lines.append(f"pfwd help --all        {len(more)} more commands")
    lines += [
        "pfwd --version         version",
        "",
        "Exit status: 0 done, 1 data refused, 2 wrong usage, 3 device lost.",
    ]
    return "\n".join(lines) + "\n"


class _HelpFormatter(argparse.HelpFormatter):
    """Formatter of help texts whose usage line has only the required arguments."""

    def _format_usage(self, usage: Any, actions: Any, groups: Any, prefix: Any) -> str:
        positional = [action for action in actions if not action.option_strings]
        line = super()._format_usage(usage, positional, groups, prefix)
        required = [
            f" {action.option_strings[0]} {action.metavar}"
            for action in actions
            if action.option_strings and action.required
        ]
        return line if usage else f"{line.rstrip()}{''.join(required)} [OPTIONS]\n\n"


class _Parser(argparse.ArgumentParser):
    """Parser that suggests the most similar word if an option or command is unknown."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse arguments; the error about an unknown option suggests a similar one."""
        parsed, unknown = self.parse_known_args(args, namespace)
        if unknown:
            owner = self.commands.get(getattr(parsed, "command", None) or "") or self
            hints = [_suggestion(word.split("=")[0], owner.options) for word in unknown]
            hint = next(filter(None, hints), "")
            owner.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")
        return parsed

    @property
    def commands(self) -> "dict[str, CommandParser]":
        """Parsers of the commands, by name."""
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                return dict(action.choices)
        return {}

    @property
    def options(self) -> list[str]:
        """Long names of all options, such as "--json"."""
        names = [name for action in self._actions for name in action.option_strings]
        return [name for name in names if name.startswith("--")]

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as err:
            hint = _suggestion(str(value), [str(choice) for choice in action.choices or ()])
            if isinstance(action, argparse._SubParsersAction):
                text = f"{value!r} is not a command{hint}; pfwd help --all lists all commands"
                raise argparse.ArgumentError(None, text) from err
            if hint:
                text = f"invalid choice: {value!r}{hint}"
                raise argparse.ArgumentError(action, text) from err
            raise


class _ProgramParser(_Parser):
    """Parser of ``pfwd`` itself, whose help lists the commands in groups."""

    def format_help(self) -> str:
        """Return the help with the commands for everyday work."""
        return overview()


class CommandParser(_Parser):
    """Parser of a command; it gets its arguments from the command's module when it is used."""

    def __init__(self, *, command: str, **settings: Any) -> None:
        super().__init__(**settings, allow_abbrev=False, formatter_class=_HelpFormatter)
        self._positionals.title = "arguments"
        self._command: str | None = command

    def add_arguments(self) -> None:
        """Add the arguments of the command's module, once."""
        if self._command is not None:
            command_module(self._command).add_arguments(self)
            self._command = None

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Add the arguments of the command, then parse."""
        self.add_arguments()
        return super().parse_known_args(args, namespace)


def _suggestion(word: str, candidates: Sequence[str]) -> str:
    matches = difflib.get_close_matches(word, candidates, 1, 0.6)
    return f"; did you mean {matches[0]}?" if matches else ""


def build_parser() -> _Parser:
    """Return the parser of the command line."""
    parser = _ProgramParser(prog="pfwd", usage="pfwd COMMAND [OPTIONS]", allow_abbrev=False)
    parser.add_argument("--version", action=_Version)
    subparsers = parser.add_subparsers(
        dest="command", metavar="COMMAND", prog="pfwd", parser_class=CommandParser
    )
    for commands in COMMANDS.values():
        for name, purpose in commands.items():
            subparsers.add_parser(name, command=name, help=purpose)
    return parser


class _Version(argparse.Action):
    """Option ``--version``; the version is looked up only when the option is used."""

    def __init__(self, option_strings: Sequence[str], dest: str) -> None:
        super().__init__(option_strings, dest, nargs=0, help="show the version and exit")

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        from importlib.metadata import PackageNotFoundError, version

        try:
            installed = version("pfwd")
        except PackageNotFoundError:
            installed = "(not installed)"
        print(f"pfwd {installed}")
        parser.exit()
