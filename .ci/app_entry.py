"""What the one-folder program begins with: the command, or a module for a process beside it."""

import runpy
import sys


def main() -> int:
    """Run ``pfwd``; ``-m MODULE ARGS`` runs a module, as Python does for the program's helpers."""
    if sys.argv[1:2] == ["-m"]:
        module = sys.argv[2]
        sys.argv = sys.argv[2:]
        runpy.run_module(module, run_name="__main__", alter_sys=True)
        return 0
    from tui.cli import main as command

    return command()


if __name__ == "__main__":
    sys.exit(main())
