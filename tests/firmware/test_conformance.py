"""`pfwd conform` passes the core, and fails it with each planted fault."""

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
from tests.firmware.test_host_board import QUICK
from tests.tui.console import pfwd, records

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "protocol.md"
FAULTS = {
    1: "P-3",  # wrong CRC of all messages
    2: "P-10",  # repeated samples
    3: "P-21",  # shunt that is never switched off
    4: "P-15",  # a Status every two seconds
    5: "P-33",  # acknowledged drops are not erased
    6: "P-29",  # wrong CRC of the drop
    7: "P-29",  # blocks from 1 on
    8: "P-34",  # other indices in repeated samples
    9: "P-17",  # no answer to an unknown message
    10: "P-32",  # a sent drop is erased
    11: "P-9",  # former stream number
    12: "P-7",  # every rate is accepted
    13: "P-4",  # every version is accepted
    14: "P-12",  # clock that differs from the samples
    15: "P-2",  # frames are not counted
    16: "P-18",  # no frame is detected after noise
    17: "P-28",  # half of the samples before the trigger
    18: "P-16",  # stops at a Hello
    19: "P-41",  # calibration is accepted while sampling
}
QUICK_FAULTS = {9, 12, 13, 19}
"""Faults that are detected within a second."""


@pytest.fixture(scope="module")
def played() -> Played:
    return play_scenario(QUICK, drops=60, seed=3)


def conformance(
    played: Played, *only: str, fault: int = 0, memory: int = 131_072
) -> dict[str, Result]:
    flags = (f"-DPFWD_FAULT={fault}",) if fault else ()
    with TemporaryDirectory() as folder:  # permanent memory for the calibration
        options = BoardOptions(flags=flags, memory=memory, store=Path(folder) / "store")
        with HostBoard(played, options) as board:
            results = list(conform(lambda: open_transport(board.url), only=only, drop_wait=10.0))
    return {result.requirement: result for result in results}


def test_the_document_lists_every_requirement() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    rows = re.findall(r"^\| (P-\d+) \| (.*) \|$", text, re.MULTILINE)
    assert dict(rows) == {number: sentence for number, (sentence, _) in REQUIREMENTS.items()}
    assert len(rows) == len(REQUIREMENTS)


@needs_compiler
@pytest.mark.parametrize(
    ("fault", "requirement"),
    [
        pytest.param(fault, requirement, marks=[] if fault in QUICK_FAULTS else [pytest.mark.slow])
        for fault, requirement in FAULTS.items()
    ],
)
def test_a_planted_fault_fails_its_requirement(
    played: Played, fault: int, requirement: str
) -> None:
    results = conformance(played, requirement, fault=fault)
    assert results[requirement].result == "failed", results[requirement].detail


@needs_compiler
def test_the_core_meets_the_requirements_of_the_quick_faults(played: Played) -> None:
    results = conformance(played, *(FAULTS[fault] for fault in QUICK_FAULTS))
    assert {result.result for result in results.values()} == {"passed"}, results


@pytest.mark.parametrize("excess", [0.0, 0.02])
def test_the_rate_is_measured_between_the_ends_of_a_stream(excess: float, played: Played) -> None:
    identity, size = played.identity, 20
    firsts = np.arange(0, round(4.0 * identity.sampling_rate), size)
    due = (firsts + size) / identity.sampling_rate / (1.0 + excess)
    # The middle arrives at once, the other blocks after some time.
    late = np.where(abs(due - 2.0) < 0.2, 0.0, 0.004)
    counts = np.zeros((size, len(identity.channels)), np.int32)
    received = [
        Received(float(at), SampleBlock(1, int(first), None, counts), 0, number % 65536)
        for number, (at, first) in enumerate(zip(due + late, firsts, strict=True))
    ]
    link = cast(InstrumentLink, SimpleNamespace(record=lambda seconds: (identity, received, 0)))
    if excess:
        with pytest.raises(Failed, match=r"expected 10000 Hz, got 10200 Hz by the host's clock"):
            rate(link)
    else:
        assert rate(link).startswith("10000 Hz by the host's clock")


@needs_compiler
@pytest.mark.slow
def test_the_core_passes(played: Played) -> None:
    results = conformance(played)
    assert {number: each.result for number, each in results.items()} == {
        number: "not-offered" if test is by_hand else "passed"
        for number, (_, test) in REQUIREMENTS.items()
    }, [each for each in results.values() if each.result == "failed"]


@needs_compiler
def test_the_command_prints_a_line_for_each_requirement_and_fails(played: Played) -> None:
    with HostBoard(played, BoardOptions(flags=("-DPFWD_FAULT=9",))) as board:
        run = pfwd("conform", board.url, "--only", "P-7,P-17", "--json")
        lines = pfwd("conform", board.url, "--only", "P-7")
    assert run.status == 1
    assert [(each["requirement"], each["result"]) for each in records(run.out)] == [
        ("P-3", "passed"),
        ("P-7", "passed"),
        ("P-17", "failed"),
    ]
    assert set(records(run.out)[0]) == {"requirement", "title", "result", "detail"}
    assert lines.status == 0
    assert "P-7   passed" in lines.out
