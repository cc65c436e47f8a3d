"""What the tests of the core share: they are skipped, visibly, where nothing compiles C."""

import pytest

from simulators.firmware import find_compiler

# Users need no compiler, and nothing else here does: without one the core cannot be built, so there
# is nothing to try. `.ci/run` brings zig where it can, and says where it cannot.
needs_compiler = pytest.mark.skipif(
    find_compiler() is None, reason="needs a C compiler (cc, gcc, clang, or pip install ziglang)"
)
