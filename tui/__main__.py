"""Start of the command by ``python -m tui``, where the folder of ``pfwd`` is not on the PATH."""

import sys

from tui.cli import main

# A worker process of a command imports this module under another name.
if __name__ == "__main__":
    sys.exit(main())
