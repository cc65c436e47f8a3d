"""The core driven step by step through pipes, with sanitizers where the compiler has them."""

import struct
import subprocess

from simulators.firmware import FirmwareError, build_host

SANITIZED = ("-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")


def build_steps() -> tuple[str, bool]:
    """Return the program, and True if it has sanitizers."""
    try:
        return str(build_host(*SANITIZED, main="host/steps.c")), True
    except FirmwareError:
        return str(build_host(main="host/steps.c")), False


class Steps:
    """Core that runs step by step."""

    def __init__(self, program: str) -> None:
        self._process = subprocess.Popen(
            [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE
        )

    def step(self, letter: str, data: bytes = b"") -> bytes:
        """Run a step and return the output; raise the report of a sanitizer as an error."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(letter.encode() + struct.pack("<H", len(data)) + data)
            self._process.stdin.flush()
        except OSError:
            self._complain()
        head = self._process.stdout.read(4)
        if len(head) < 4:
            self._complain()
        return self._process.stdout.read(struct.unpack("<I", head)[0])

    def advance(self, seconds: float) -> bytes:
        """Advance the time in steps of a millisecond and return the output."""
        return b"".join(
            self.step("T", struct.pack("<I", 1000)) for _ in range(round(seconds * 1e3))
        )

    def _complain(self) -> None:
        assert self._process.stderr is not None
        self._process.kill()
        raise AssertionError(self._process.stderr.read().decode(errors="replace")[:3000])

    def __enter__(self) -> "Steps":
        return self

    def __exit__(self, *exception: object) -> None:
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            if pipe is not None:
                pipe.close()
        self._process.wait(10)
