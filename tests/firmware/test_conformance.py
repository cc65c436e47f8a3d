"""`pfwd conform` passes the core as it is, and fails it with each of the planted faults."""

import re
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from pfwd_device.conformance import Result, conform
from pfwd_device.conformance.instrument_link import Failed, InstrumentLink, Received
from pfwd_device.conformance.requirements import REQUIREMENTS, by_hand, rate
from pfwd_device.transport.opening import open_transport
from pfwd_device.wire.messages import SampleBlock
from simulators.firmware import BoardOptions, HostBoard, Played, play_scenario
from tests.firmware.compiled import needs_compiler
from tests.tui.console import pfwd, records

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "protocol.md"
DROPS = {"drops": {"first": 0.6, "interval": 2.0, "quiet": 0.5, "bounces": [0, 0]}}
FAULTS = {
    1: "P-3",  # a wrong CRC: nothing that it says arrives
    2: "P-10",  # repeats a sample now and then
    3: "P-21",  # never switches the shunt off
    4: "P-15",  # a Status every two seconds
    5: "P-33",  # keeps what was acknowledged
    6: "P-29",  # a wrong CRC over the drop
    7: "P-29",  # blocks from 1 on
    8: "P-34",  # sends samples again with other indices
    9: "P-17",  # no answer to what it does not know
    10: "P-32",  # forgets a drop when it has sent it
    11: "P-9",  # the stream number of before
    12: "P-7",  # takes any rate
    13: "P-4",  # agrees to any version
    14: "P-12",  # a clock that runs away from the samples
    15: "P-2",  # frames are not counted
    16: "P-18",  # finds no frame after noise
    17: "P-28",  # keeps half of what was to be kept before the trigger
    18: "P-16",  # stops at a Hello
    19: "P-41",  # takes a calibration while it samples
}
EVERYDAY = {9, 12, 13, 19}
"""Those that show within a second; the others are as many seconds as the protocol gives."""


@pytest.fixture(scope="module")
def played() -> Played:
    return play_scenario(DROPS, drops=60, seed=3)


def tried(played: Played, *only: str, fault: int = 0, memory: int = 131_072) -> dict[str, Result]:
    flags = (f"-DPFWD_FAULT={fault}",) if fault else ()
    with TemporaryDirectory() as folder:  # memory that lasts, for the calibration
        options = BoardOptions(flags=flags, memory=memory, store=Path(folder) / "store")
        with HostBoard(played, options) as board:
            found = list(conform(lambda: open_transport(board.url), only=only, drop_wait=10.0))
    return {result.requirement: result for result in found}


def test_the_document_lists_every_requirement() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    rows = re.findall(r"^\| (P-\d+) \| (.*) \|$", text, re.MULTILINE)
    assert dict(rows) == {number: sentence for number, (sentence, _) in REQUIREMENTS.items()}
    assert len(rows) == len(REQUIREMENTS)


@needs_compiler
@pytest.mark.parametrize(
    ("fault", "requirement"),
    [
        pytest.param(fault, requirement, marks=[] if fault in EVERYDAY else [pytest.mark.slow])
        for fault, requirement in FAULTS.items()
    ],
)
def test_a_planted_fault_fails_its_requirement(
    played: Played, fault: int, requirement: str
) -> None:
    found = tried(played, requirement, fault=fault)
    assert found[requirement].result == "failed", found[requirement].detail


@needs_compiler
def test_the_core_keeps_what_the_everyday_faults_break(played: Played) -> None:
    found = tried(played, *(FAULTS[fault] for fault in EVERYDAY))
    assert {result.result for result in found.values()} == {"passed"}, found


@pytest.mark.parametrize("runs_fast", [0.0, 0.02])
def test_the_rate_is_told_from_both_ends_of_a_stream(runs_fast: float, played: Played) -> None:
    identity, at_once = played.identity, 20
    taken = np.arange(0, round(4.0 * identity.sampling_rate), at_once)
    due = (taken + at_once) / identity.sampling_rate / (1.0 + runs_fast)
    # The host hears the middle at once, the rest after a while.
    late = np.where(abs(due - 2.0) < 0.2, 0.0, 0.004)
    counts = np.zeros((at_once, len(identity.channels)), np.int32)
    received = [
        Received(float(at), SampleBlock(1, int(first), None, counts), 0, number % 65536)
        for number, (at, first) in enumerate(zip(due + late, taken, strict=True))
    ]
    link = cast(InstrumentLink, SimpleNamespace(record=lambda seconds: (identity, received, 0)))
    if runs_fast:
        with pytest.raises(Failed, match=r"expected 10000 Hz, got 10200 Hz by the host's clock"):
            rate(link)
    else:
        assert rate(link).startswith("10000 Hz by the host's clock")


@needs_compiler
@pytest.mark.slow
def test_the_core_passes(played: Played) -> None:
    found = tried(played)
    assert {number: each.result for number, each in found.items()} == {
        number: "not-offered" if test is by_hand else "passed"
        for number, (_, test) in REQUIREMENTS.items()
    }, [each for each in found.values() if each.result == "failed"]


@needs_compiler
def test_the_command_says_a_line_a_requirement_and_fails_when_one_does(played: Played) -> None:
    with HostBoard(played, BoardOptions(flags=("-DPFWD_FAULT=9",))) as board:
        done = pfwd("conform", board.url, "--only", "P-7,P-17", "--json")
        lines = pfwd("conform", board.url, "--only", "P-7")
    assert done.returncode == 1
    assert [(each["requirement"], each["result"]) for each in records(done.stdout)] == [
        ("P-3", "passed"),
        ("P-7", "passed"),
        ("P-17", "failed"),
    ]
    assert set(records(done.stdout)[0]) == {"requirement", "title", "result", "detail"}
    assert lines.returncode == 0
    assert "P-7   passed" in lines.stdout


def test_a_port_that_is_not_there_is_one_line() -> None:
    done = pfwd("conform", "socket://127.0.0.1:9")
    assert done.returncode == 3
    assert "expected a connection" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_number_that_is_none_is_refused() -> None:
    done = pfwd("conform", "socket://127.0.0.1:9", "--only", "P-99")
    assert done.returncode != 0
    assert "expected numbers from P-1 to P-42, got P-99" in done.stderr
