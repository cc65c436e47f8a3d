"""The mock instrument as a state machine: no port, no clock."""

import struct
from typing import Any

import numpy as np
import pytest

from pfwd_device.wire.binary import encode_message
from pfwd_device.wire.framing import encode_frame
from pfwd_device.wire.identity_layout import read_identity
from pfwd_device.wire.messages import Configure, Hello, HostMessage, Shunt, Start, Stop
from simulators.instrument.device import PortlessInstrument
from simulators.instrument.scenario import load_scenario
from tests.simulators.instrument_wire import (
    END,
    EVENT,
    IDENTITY,
    SAMPLES,
    SHUNT_OFF,
    SHUNT_ON,
    STATUS,
    blocks,
    drain,
    events,
    frames,
    record,
    refusals,
    send,
    started,
    statuses,
)

# Messages of the host


def test_hello_is_answered_by_the_identity() -> None:
    instrument = PortlessInstrument(load_scenario("default"))
    (frame,) = frames(send(instrument, Hello()))
    assert frame.type == IDENTITY
    assert len(frame.payload) == 204
    assert frame.payload.startswith(b"\x02\x09PFWD-0042\x0eSimulated PFWD\x051.0.0")
    assert struct.unpack("<dBddd", frame.payload[32:65]) == (10e3, 18, 5.0, 0.15, 10.6)
    # A host with several versions, and an instrument that stores drops.
    (frame,) = frames(send(PortlessInstrument(load_scenario("buffered")), Hello(1, 9)))
    assert frame.payload[0] == 2
    # ring, longest drop, drops that may wait, lasting without a stream
    assert struct.unpack("<IIHB", frame.payload[-11:]) == (20_000, 4000, 4, 1)


@pytest.mark.parametrize(("requested", "rate"), [(1.0, 1e3), (15_001, 20e3)])
def test_the_nearest_rate_is_set(requested: float, rate: float) -> None:
    instrument = PortlessInstrument(load_scenario("default"))
    (frame,) = frames(send(instrument, Configure(requested)))
    assert struct.unpack("<d", frame.payload[32:40]) == (rate,)
    send(instrument, Start())
    instrument.advance(0.5)
    assert blocks(drain(instrument))[-1].end == pytest.approx(0.5 * rate, abs=0.021 * rate)


def test_the_shunt_shifts_the_load_alone_and_is_flagged() -> None:
    instrument = started()
    instrument.advance(0.1)
    before = blocks(drain(instrument))
    assert [kind for kind, _, _ in events(send(instrument, Shunt(True)))] == [SHUNT_ON]
    instrument.advance(0.1)
    during = blocks(drain(instrument))
    assert [kind for kind, _, _ in events(send(instrument, Shunt(False)))] == [SHUNT_OFF]
    assert not any(b.shunt for b in before)
    assert all(b.shunt for b in during)
    shift = np.mean(during[0].counts, axis=0) - np.mean(before[0].counts, axis=0)
    assert shift[0] == pytest.approx(5000 * 4e-4 / 5.0 * 2**17, rel=1e-3)
    assert abs(shift[1]) < 30


def test_the_shunt_goes_off_by_itself() -> None:
    instrument = started(overruns=False)
    send(instrument, Shunt(True))
    instrument.advance(12.0)
    data = drain(instrument)
    assert [kind for kind, _, _ in events(data)] == [SHUNT_OFF]
    assert [b.first for b in blocks(data) if b.shunt][-1] == 99_950
    idle = PortlessInstrument(load_scenario("default"))
    send(idle, Shunt(True))
    idle.advance(11.0)
    assert [kind for kind, _, _ in events(drain(idle))] == [SHUNT_OFF]


def test_start_after_stop_begins_a_new_stream() -> None:
    instrument = started()
    instrument.advance(1.0)
    first = blocks(drain(instrument))
    ((_, _, _, _, flags),) = statuses(send(instrument, Stop()))
    assert flags == 0
    instrument.advance(1.0)
    assert drain(instrument) == b""
    send(instrument, Start())
    instrument.advance(1.0)
    second = blocks(drain(instrument))
    assert first[0].first == second[0].first == 0
    assert {b.stream for b in first} != {b.stream for b in second}
    assert first[0].clock == 0
    assert second[0].clock == 2_000_000


NO_SHUNT = {"device": {"channels": [{"name": "load", "role": "load"}]}}


@pytest.mark.parametrize(
    ("tables", "messages", "code"),
    [
        ("default", [Hello(3, 9)], 1),
        ("default", [Hello(1, 1)], 1),
        ("default", [Configure(0.0)], 3),
        ("default", [Configure(float("nan"))], 3),
        ("default", [Configure(50_001.0)], 3),
        (NO_SHUNT, [Shunt(True)], 3),
        ("default", [Start(), Configure(5e3)], 4),
    ],
)
def test_a_request_that_cannot_be_met_is_refused_with_its_code(
    tables: Any, messages: list[HostMessage], code: int
) -> None:
    instrument = PortlessInstrument(load_scenario(tables))
    assert refusals(send(instrument, *messages)) == [code]


def test_an_unknown_message_is_refused() -> None:
    instrument = PortlessInstrument(load_scenario("default"))
    instrument.receive(encode_frame(0x7F, 0, b""))
    assert refusals(drain(instrument)) == [2]


# Blocks and clock


def test_blocks_are_contiguous_and_state_the_clock() -> None:
    instrument = started()
    for _ in range(50):
        instrument.advance(0.0137)
    sent = blocks(drain(instrument))
    assert [b.first for b in sent] == list(range(0, 50 * len(sent), 50))
    assert [b.clock for b in sent] == [100 * b.first for b in sent]
    assert len(sent) == int(50 * 0.0137 / 0.005)
    assert len({b.stream for b in sent}) == 1


def test_the_same_seed_gives_the_same_bytes_and_the_record_does_not_depend_on_blocks() -> None:
    def output(seed: int, samples: int) -> bytes:
        tables = {"base": "typical", "link": {"block_samples": samples}}
        return record(tables, 4.0, seed=seed, overruns=False)

    assert output(1, 200) == output(1, 200)
    assert output(1, 200) != output(2, 200)
    whole, cut = (np.concatenate([b.counts for b in blocks(output(1, n))]) for n in (200, 37))
    np.testing.assert_array_equal(cut, whole[: len(cut)])


def test_blocks_have_the_drift_and_the_jump_of_the_clock() -> None:
    tables = {
        "base": "default",
        "device": {"clock_drift_ppm": 1000.0, "clock_start_us": 7},
        "faults": [{"kind": "clock-jump", "at_s": 1.0, "seconds": -0.25}],
    }
    clock = {b.first: b.clock for b in blocks(record(tables, 2.0, overruns=False))}
    assert clock[0] == 7
    assert clock[5000] == 7 + 500_500
    assert clock[10_000] == 7 + 1_001_000 - 250_000


# The end


def test_the_record_ends_after_the_last_drop_and_the_quiet_time() -> None:
    tables = {"base": "default", "drops": {"bounces": [0, 0], "jitter": 0.0, "interval": 2.0}}
    instrument = started(tables, drops=2, overruns=False)
    instrument.advance(20.0)
    data = drain(instrument)
    assert instrument.ended
    assert not instrument.sampling
    assert blocks(data)[-1].end == 80_000  # 3 s, one interval of 2 s, 3 s of quiet
    assert events(data) == [(END, 8_000_000, "")]
    assert frames(data)[-1].type == EVENT
    load = np.concatenate([b.counts[:, 0] for b in blocks(data)])
    touches = [entry["touch_sample"] for entry in instrument.truth()]
    assert touches == [30_000, 50_000]
    assert [int(np.argmax(load[t - 10 : t + 1000])) // 200 for t in touches] == [0, 0]
    assert refusals(send(instrument, Start())) == [4]


def test_a_host_that_stops_after_the_last_drop_need_not_wait_for_the_quiet() -> None:
    instrument = started(drops=1)
    instrument.advance(3.5)
    assert [kind for kind, _, _ in events(send(instrument, Stop()))][-1] == END
    assert instrument.ended
    disconnected = started(drops=1)
    disconnected.advance(3.5)
    disconnected.disconnect()
    assert disconnected.ended


def test_remaining_drops_occur_in_the_next_stream() -> None:
    instrument = started(drops=3)
    instrument.advance(5.0)
    instrument.disconnect()
    assert not instrument.sampling
    assert drain(instrument) == b""
    instrument.connect()
    send(instrument, Start())
    for _ in range(30):
        instrument.advance(0.5)
        drain(instrument)
    assert [entry["drop"] for entry in instrument.truth()] == [1, 2, 3]
    assert instrument.truth()[1]["touch_s"] == pytest.approx(3.0, abs=0.05)
    assert len({entry["stream"] for entry in instrument.truth()}) == 2


# Overruns


def test_an_unread_instrument_counts_its_overruns() -> None:
    instrument = started()
    instrument.advance(5.0)
    instrument.status()
    sent = blocks(data := drain(instrument))
    received = sum(len(b.counts) for b in sent)
    ((_, _, _, overruns, _),) = statuses(data)
    assert received == pytest.approx(10_000, rel=0.05)  # 1 s
    assert received + overruns == 50_000
    instrument.advance(0.1)
    assert blocks(drain(instrument))[0].first == 50_000
    assert blocks(record(seconds=5.0, overruns=False))[-1].end == 50_000


# Secrecy of the simulated ground


def test_the_truth_is_available_and_never_sent() -> None:
    def conversation(name: str) -> tuple[bytes, PortlessInstrument]:
        instrument = PortlessInstrument(load_scenario(name), drops=1, overruns=False)
        instrument.connect()
        data = send(instrument, Hello(), Start())
        instrument.advance(10.0)
        instrument.status()
        return data + drain(instrument), instrument

    (soft, instrument), (hard, _) = conversation("soft"), conversation("stiff")
    (entry,) = instrument.truth()
    assert entry["modulus_pa"] == pytest.approx(0.85 * 15e6)
    assert entry["bedrock_depth_m"] is None
    assert entry["seating"]
    # Besides samples (and how long they go on) nothing depends on the soil.
    payloads = [
        [f.payload for f in frames(data) if f.type not in (SAMPLES, STATUS, EVENT)]
        for data in (soft, hard)
    ]
    assert payloads[0] == payloads[1]


# ASCII


def lines(data: bytes) -> Any:
    return np.array([line.split(b",") for line in data.decode().encode().split()], dtype=np.int64)


def test_ascii_streams_without_a_command_and_ignores_commands() -> None:
    instrument = PortlessInstrument(load_scenario("ascii"), drops=1)
    instrument.advance(1.0)
    assert drain(instrument) == b""  # not connected
    instrument.connect()
    instrument.advance(0.5)
    instrument.status()
    instrument.receive(encode_message(Stop(), 0))
    data = drain(instrument)
    assert data.startswith(b"1000000,")
    assert data.endswith(b"\n")
    assert b"\r" not in data
    table = lines(data)
    assert table.shape == (5000, 3)
    assert np.all(np.diff(table[:, 0]) == 100)
    binary = np.concatenate([b.counts for b in blocks(record("default", 0.5))])
    np.testing.assert_array_equal(table[:, 1:], binary)


def test_the_ascii_clock_wraps_after_32_bits() -> None:
    start = 2**32 - 20_050
    tables = {"base": "ascii", "device": {"clock_start_us": start}}
    instrument = PortlessInstrument(load_scenario(tables))
    instrument.connect()
    instrument.advance(0.1)
    time = lines(drain(instrument))[:, 0]
    assert time[0] == start
    assert list(time[199:203]) == [2**32 - 150, 2**32 - 50, 50, 150]


def test_an_instrument_that_is_not_in_real_time_declares_it() -> None:
    instrument = PortlessInstrument(load_scenario("default"), overruns=False)
    (frame,) = frames(send(instrument, Hello()))
    assert not read_identity(frame.payload).real_time
    ascii_instrument = PortlessInstrument(load_scenario("ascii"), overruns=False)
    ascii_instrument.connect()
    assert drain(ascii_instrument) == b"# not in real time\n"
