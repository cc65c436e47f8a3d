"""Process that `SimulatedInstrument` starts: `python -m simulators.instrument OPTIONS`."""

import sys

from simulators.instrument.run import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
