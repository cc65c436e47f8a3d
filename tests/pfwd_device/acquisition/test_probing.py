"""Identification of the instrument at a port.

On Windows the probes of instruments run over TCP; only ports in use and several at once do not.
"""

import contextlib
import os
import threading
import time
from pathlib import Path

import pytest
from serial.tools.list_ports_common import ListPortInfo

from pfwd_device.acquisition import probing
from pfwd_device.acquisition.probing import Probe, probe, probe_all
from pfwd_device.transport import ports
from pfwd_device.transport.opening import open_transport
from pfwd_device.wire.ascii_lines import looks_like_lines
from pfwd_device.wire.registry import BUILT_IN
from simulators.instrument.endpoint import TcpEndpoint
from tests.pfwd_device.acquisition.scripted import Host, Instrument, talker


def ask(url: str, timeout: float = 0.5) -> Probe:
    return probe(url, list(BUILT_IN.values()), timeout)


def test_an_instrument_answers() -> None:
    instrument = Instrument()
    with Host(instrument, TcpEndpoint()) as host:
        answer = ask(host.url, 10.0)
    assert (answer.answers, answer.identity) == ("pfwd", instrument.identity)
    assert "SN-1" in answer.reason
    assert not instrument.sampling


def test_lines_of_numbers_are_recognised() -> None:
    with talker(lambda k: f"{100 * k},{0.5 * k:.3f},-1e-3\r\n".encode()) as url:
        answer = ask(url, 10.0)
    assert (answer.answers, answer.identity) == ("ascii", None)
    assert "setup file" in answer.reason


def test_foreign_and_silent_ports_are_described() -> None:
    with talker(lambda k: b"$GPGGA,123519,4807.038,N\r\n") as url:
        answer = ask(url, 2.0)
    assert answer.answers is None
    assert "no known PFWD" in answer.reason
    with talker(lambda k: b"") as url:
        assert "silent" in ask(url).reason
    assert "refused" in ask(url).reason


@pytest.mark.posix
def test_a_port_in_use_and_a_missing_port_are_described(tmp_path: Path) -> None:
    master, slave = os.openpty()
    with contextlib.closing(open_transport(os.ttyname(slave))):
        assert "in use" in ask(os.ttyname(slave)).reason
    os.close(slave)
    os.close(master)
    assert "not found" in ask(str(tmp_path / "ttyUSB9")).reason


@pytest.mark.posix
def test_usb_numbers_show_a_logger_at_its_port(monkeypatch: pytest.MonkeyPatch) -> None:
    numbers = [(0x0683, 0x1111), (0x0683, 0x4209), (0x0683, 0x0001), (0x1A86, 0x1111)]
    with contextlib.ExitStack() as stack:
        pairs = [os.openpty() for _ in numbers]
        listed = []
        for (master, slave), (vid, pid) in zip(pairs, numbers, strict=True):
            stack.callback(os.close, master)
            stack.callback(os.close, slave)
            port = ListPortInfo(os.ttyname(slave))
            port.vid, port.pid = vid, pid
            listed.append(port)
        urls = [port.device for port in listed]
        monkeypatch.setattr(ports._serial_ports, "comports", lambda: listed)
        stack.enter_context(contextlib.closing(open_transport(urls[0])))
        answers = probe_all(urls, list(BUILT_IN.values()), 0.2)
        received = [os.read(master, 4096) for master, _ in pairs[1:]]
        untested = probe_all(urls[:1], list(BUILT_IN.values()), None)
    assert answers[0].reason.startswith("DATAQ DI-1110 by its USB numbers: port ")
    assert "in use" in answers[0].reason
    assert answers[1].reason.startswith("DATAQ DI-4208 by its USB numbers: silent")
    assert answers[2].reason.startswith("DATAQ logger by its USB numbers: silent")
    assert answers[3].reason.startswith("silent")
    assert received[0].replace(b"info 0\r", b"") == b""  # no request of another dialect
    assert received[2].replace(b"info 0\r", b"") != b""
    assert untested[0].reason == "DATAQ DI-1110 by its USB numbers: not tested"


def test_a_port_that_does_not_open_is_abandoned(monkeypatch: pytest.MonkeyPatch) -> None:
    release = threading.Event()

    def hang(*_: object) -> Probe:
        release.wait(30)
        return Probe("", None, None, "")

    monkeypatch.setattr(probing, "probe", hang)
    monkeypatch.setattr(probing, "_OPENING_TIMEOUT_S", 0.1)
    began = time.monotonic()
    (answer,) = probe_all(["/dev/rfcomm0"], list(BUILT_IN.values()), 0.1)
    assert time.monotonic() - began < 10
    assert "did not open" in answer.reason
    waiting = [each for each in threading.enumerate() if each.name.startswith("pfwd-probe")]
    assert [each.daemon for each in waiting] == [True], "it does not keep the program"
    release.set()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (b"0,1\n1,2\n2,3\n3,4\n4,", True),
        (b"\xff\xfe,1\r\n100, -2.5, 3e-4\r\n200,2,3\r\n300,2,3\r\n", False),  # the last may go on
        (b"x\n100, -2.5, 3e-4\r\n200,2,3\r\n300,2,3\r\n4", True),
        (b"0,1\n1,2\n", False),
        (b"0\n1\n2\n3\n4\n5\n", False),
        (b"a,1\na,2\na,3\na,4\na,5\n", False),
        (b"", False),
    ],
)
def test_lines_are_recognised_by_their_numbers(text: bytes, expected: bool) -> None:
    assert looks_like_lines(text) is expected
