"""What the tests of the core share: they are skipped, visibly, where nothing compiles C."""

import pytest

from simulators.firmware import find_compiler

needs_compiler = pytest.mark.skipif(
    find_compiler() is None, reason="needs a C compiler (cc, gcc, clang, or pip install ziglang)"
)
