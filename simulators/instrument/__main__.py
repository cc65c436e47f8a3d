"""Program of the process that `SimulatedInstrument` starts.

It is run by `python -m simulators.instrument OPTIONS`, with the options as JSON.
"""

import sys

from simulators.instrument.run import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
