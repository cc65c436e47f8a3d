"""Storage of calibrations in an instrument."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from pfwd_device.conformance import conform
from pfwd_device.conformance.storing import calibration_of, store_calibration
from pfwd_device.errors import DeviceRefused
from pfwd_device.transport.opening import open_transport
from simulators.firmware import BoardOptions, HostBoard, Played, play_scenario
from simulators.instrument import serve
from tests.firmware.compiled import needs_compiler
from tests.firmware.test_host_board import QUICK


@pytest.fixture(scope="module")
def played() -> Played:
    return play_scenario(QUICK, drops=1, seed=3)


@needs_compiler
def test_a_calibration_survives_the_process_and_the_conformance_test(
    tmp_path: Path, played: Played
) -> None:
    options = BoardOptions(store=tmp_path / "store")
    with HostBoard(played, options) as board:
        port = partial(open_transport, board.url)
        identity = store_calibration(port, [])
        calibrations = [
            replace(
                calibration_of(identity, 0),
                sensitivity=4.5e-4,
                calibrated=20_260_131,
                serial_number="SERIES-7",
            ),
            replace(calibration_of(identity, 1), natural_frequency=4.4, damping=0.61),
        ]
        stored = store_calibration(port, calibrations)
        assert stored.serial_number == "SERIES-7"
        assert [calibration_of(stored, at) for at in (0, 1)] == [
            replace(each, serial_number="") for each in calibrations
        ]
        board.kill()
    with HostBoard(played, options) as board:
        port = partial(open_transport, board.url)
        assert store_calibration(port, []) == stored
        results = [each.result for each in conform(port, only=("P-40", "P-41"))]
        assert set(results) == {"passed"}
        assert store_calibration(port, []) == stored  # restored after the test


@needs_compiler
def test_an_instrument_without_permanent_memory_refuses_a_calibration(played: Played) -> None:
    with HostBoard(played, BoardOptions()) as board:
        port = partial(open_transport, board.url)
        calibration = calibration_of(store_calibration(port, []), 0)
        with pytest.raises(DeviceRefused, match=r"keeps no calibration; the instrument has no"):
            store_calibration(port, [calibration])
        results = {each.requirement: each.result for each in conform(port, only=("P-40",))}
    assert results["P-40"] == "not-offered"


def test_the_simulator_refuses_an_invalid_calibration() -> None:
    with serve("default") as instrument:
        port = partial(open_transport, instrument.url)
        calibration = calibration_of(store_calibration(port, []), 0)
        with pytest.raises(DeviceRefused) as refused:
            store_calibration(port, [replace(calibration, sensitivity=0.0)])
        assert "sensitivity" in str(refused.value)
        stored = store_calibration(port, [replace(calibration, zero=0.25)])
    assert stored.channels[0].zero == 0.25


def test_the_documented_code_stores_a_calibration() -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "build-an-instrument.md").read_text(
        encoding="utf-8"
    )
    (code,) = [part for part in text.split("```python\n")[1:] if "store_calibration" in part]
    code = code.split("```")[0]
    with serve("default") as instrument:
        exec(
            compile(code.replace("/dev/ttyACM0", instrument.url), "build-an-instrument.md", "exec"),
            {"print": lambda identity: None},
        )
        assert store_calibration(partial(open_transport, instrument.url), []).serial_number == (
            "PFWD-0002"
        )
