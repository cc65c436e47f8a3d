"""Condition of the tests of the core: a C compiler; else they are skipped visibly."""

import pytest

from simulators.firmware import find_compiler

# The core cannot be built without a compiler. `.ci/run` installs zig where it can.
needs_compiler = pytest.mark.skipif(
    find_compiler() is None, reason="needs a C compiler (cc, gcc, clang, or pip install ziglang)"
)
