"""The mock instrument in a process of its own."""

import socket
import subprocess
import sys
from pathlib import Path

import pytest

from pfwd_device.wire.binary import BinaryDialect
from pfwd_device.wire.messages import Event, EventKind, Hello, Start
from simulators.instrument import serve
from simulators.mesh import SimulationError

TOP = Path(__file__).resolve().parents[2]
BRIEF = {
    "base": "soft",
    "drops": {"first": 0.3, "interval": 0.5, "quiet": 0.2, "bounces": [0, 0]},
}


def read_to_the_end(url: str) -> bytes:
    host, _, port = url.removeprefix("socket://").rpartition(":")
    dialect, data = BinaryDialect(), b""
    with socket.create_connection((host, int(port)), 20) as connection:
        connection.sendall(dialect.encode(Hello()) + dialect.encode(Start()))
        while part := connection.recv(65_536):
            data += part
    return data


def test_the_truth_is_available_after_the_end() -> None:
    with serve(BRIEF, listen="tcp://127.0.0.1:0", drops=2, rate=0) as instrument:
        with pytest.raises(SimulationError, match="stop it first"):
            instrument.truth()
        messages = BinaryDialect().feed(read_to_the_end(instrument.url))
        assert instrument.wait(20)
        truth = instrument.truth()
    assert any(isinstance(m, Event) and m.kind == EventKind.END for m in messages)
    assert [entry["modulus_pa"] for entry in truth] == pytest.approx([0.85 * 15e6, 0.94 * 15e6])
    assert {"drop", "viscosity_pa_s", "density_kg_m3", "peak_load_n"} <= set(truth[0])


def test_a_stopped_instrument_states_the_truth() -> None:
    with serve("default", listen="tcp://127.0.0.1:0") as instrument:
        assert instrument.url.startswith("socket://127.0.0.1:")
        instrument.stop()
        assert instrument.truth() == []


def test_the_reason_of_a_failure_reaches_the_caller() -> None:
    with pytest.raises(SimulationError, match=r"soil\.modulus: expected a number > 0, got -1"):
        serve({"soil": {"modulus": -1}})


def test_the_process_ends_with_its_caller() -> None:
    code = (
        "import os; from simulators.instrument import serve; "
        "i = serve(listen='tcp://127.0.0.1:0'); print(i.url, flush=True); os._exit(0)"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=TOP, capture_output=True, text=True, check=True
    )
    port = int(run.stdout.strip().rpartition(":")[2])
    for _ in range(2000):
        try:
            with socket.create_connection(("127.0.0.1", port), 5) as connection:
                connection.recv(1)
        except OSError:
            return
    pytest.fail("it still listens")
