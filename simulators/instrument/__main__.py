"""`python -m simulators.instrument OPTIONS`: the process behind `SimulatedInstrument`."""

import sys

from simulators.instrument.run import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1]))
