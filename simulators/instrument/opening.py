"""The endpoint that a user names: a virtual serial port, or TCP."""

from __future__ import annotations

import os
import sys

from simulators.instrument.endpoint import Endpoint, EndpointError, TcpEndpoint

HAS_PTY = os.name == "posix"


def open_endpoint(listen: str | None) -> Endpoint:
    """The endpoint that `--listen` names; by default a virtual serial port where there are any.

    Raises
    ------
    EndpointError
        If it cannot be offered here.
    """
    if listen is None:
        listen = "pty" if HAS_PTY else "tcp://127.0.0.1:0"
    if listen == "pty":
        if sys.platform == "win32":
            raise EndpointError("pty: this platform has no virtual serial ports; try tcp://")
        else:  # noqa: RET506 - only an else is left out of the checks for Windows
            from simulators.instrument.pseudo_terminal import PtyEndpoint

            return PtyEndpoint()
    host, colon, port = listen.removeprefix("tcp://").rpartition(":")
    good = listen.startswith("tcp://") and colon and host and port.isdecimal()
    if not good or int(port) > 65_535:
        raise EndpointError(f"{listen}: expected pty or tcp://HOST:PORT")
    return TcpEndpoint(host.strip("[]"), int(port))
