"""Drops and samples that the simulated instrument stores."""

import numpy as np

from pfwd_device.conformance import conform
from pfwd_device.transport.opening import open_transport
from pfwd_device.wire.binary import BinaryDialect, encode_message
from pfwd_device.wire.messages import (
    Acknowledge,
    Arm,
    Armed,
    Configure,
    DropBlock,
    DropOffer,
    Fetch,
    Hello,
    HostMessage,
    InstrumentMessage,
    Released,
    Resend,
    SampleBlock,
    SamplesGone,
    Start,
    Status,
    Trigger,
)
from simulators.instrument import serve
from simulators.instrument.device import PortlessInstrument
from simulators.instrument.memory import OLDEST_FIRST_OFFERS, DropBuffer, WaitingDrop
from simulators.instrument.scenario import load_scenario
from tests.simulators.instrument_wire import of_kind

QUICK = {"first": 0.5, "interval": 2.0, "bounces": [0, 0]}
TRIGGER = Trigger(True, 0, 4194, 3, 200, 1000, 15_000)


class Host:
    """Host of an instrument without a port."""

    def __init__(self, instrument: PortlessInstrument) -> None:
        self.instrument, self.dialect = instrument, BinaryDialect()
        instrument.connect()

    def send(self, *messages: HostMessage) -> list[InstrumentMessage]:
        for message in messages:
            self.instrument.receive(encode_message(message, 0))
        return self.receive(0.0)

    def receive(self, seconds: float) -> list[InstrumentMessage]:
        self.instrument.advance(seconds)
        data = bytes(self.instrument.output)
        self.instrument.sent(len(data))
        return self.dialect.feed(data)


def test_a_drop_waits_over_a_pulled_cable_and_a_reset_until_it_is_acknowledged() -> None:
    scenario = {
        "base": "buffered",
        "drops": QUICK,
        "faults": [{"kind": "reset", "at_s": 1.2}],
    }
    instrument = PortlessInstrument(load_scenario(scenario), seed=1, drops=1)
    host = Host(instrument)
    assert of_kind(host.send(Hello(), Arm(TRIGGER)), Armed) == [Armed(TRIGGER)]
    instrument.disconnect()  # the drop falls while nobody is there
    instrument.advance(1.0)
    host = Host(instrument)
    offer = of_kind(host.send(Hello()), DropOffer)[-1]
    assert (offer.trigger, offer.samples, offer.earlier) == (200, 1200, False)
    host.receive(1.0)
    repeated = of_kind(host.send(Hello()), DropOffer)[-1]
    assert (repeated.crc, repeated.earlier, repeated.clock_us) == (offer.crc, True, None)
    name = offer.stream, offer.first_sample
    blocks = of_kind(host.send(Fetch(*name)), DropBlock)
    assert len(blocks) == offer.blocks
    assert of_kind(host.send(Acknowledge(*name)), Released) == [Released(*name)]
    instrument.status()
    messages = host.receive(0.0)
    (status,) = of_kind(messages, Status)
    assert (status.drops_waiting, of_kind(messages, DropOffer)) == (0, [])


def test_a_drop_whose_recording_configure_ends_counts_as_lost() -> None:
    scenario = {"base": "buffered", "drops": QUICK}
    host = Host(PortlessInstrument(load_scenario(scenario), seed=1, drops=1))
    host.send(Hello(), Arm(TRIGGER))
    host.receive(0.58)  # the trigger is at 0.53 s, the end of the drop at 0.63 s
    host.send(Configure(5e3), Arm(TRIGGER))
    host.instrument.status()
    (status,) = of_kind(host.receive(0.0), Status)
    assert (status.drops_waiting, status.drops_lost) == (0, 1)


def waiting(*names: int) -> DropBuffer:
    buffer = DropBuffer(8, np.zeros(2, np.int32))
    for order, name in enumerate(names):
        offer = DropOffer(1, name, None, 1, 2, 2, 2, order, 1000.0)
        buffer.waiting.append(WaitingDrop(offer, bytes(12)))
    return buffer


def test_an_unfetched_drop_does_not_block_later_drops() -> None:
    buffer = waiting(10, 20, 30)

    def offers(count: int) -> list[int]:
        offered = [buffer.next_offer() for _ in range(count)]
        return [offer.first_sample for offer in offered if offer is not None]

    assert offers(12) == [10] * OLDEST_FIRST_OFFERS + [20, 30, 10, 20]
    buffer.release(1, 20)  # the oldest still waits: the others go on in turn
    assert set(offers(2)) == {10, 30}
    buffer.release(1, 10)
    assert offers(9) == [30] * 9
    buffer.release(1, 30)
    assert offers(1) == []


def test_of_equal_names_the_oldest_drop_is_offered_and_erased() -> None:
    buffer = waiting(10, 10, 20, 10)
    crcs = [offer.crc for _ in range(12) if (offer := buffer.next_offer()) is not None]
    assert crcs == [0] * OLDEST_FIRST_OFFERS + [2, 0, 2, 0]
    for name in (10, 99):
        buffer.release(1, name)
        assert [drop.offer.crc for drop in buffer.waiting] == [1, 2, 3], "one is erased"


def test_samples_in_the_ring_are_sent_again_on_request() -> None:
    scenario = {"link": {"ring": 0.2}}
    host = Host(PortlessInstrument(load_scenario(scenario)))
    host.send(Hello(), Start())
    (streamed,) = of_kind(host.receive(0.5), SampleBlock)
    response = host.send(Resend(streamed.stream, 0, len(streamed.counts)))
    (lost,) = of_kind(response, SamplesGone)
    (resent,) = of_kind(response, SampleBlock)
    assert (lost.first_sample, lost.count) == (0, resent.first_sample)
    assert 2000 <= len(resent.counts) <= 2050
    np.testing.assert_array_equal(resent.counts, streamed.counts[resent.first_sample :])


def test_quick_requirements_of_the_protocol_are_met() -> None:
    numbers = ("P-4", "P-7", "P-17", "P-24", "P-25", "P-40", "P-41")
    with serve("buffered") as instrument:
        outcomes = list(conform(lambda: open_transport(instrument.url), only=numbers))
    assert {each.result for each in outcomes} == {"passed"}, outcomes


def test_every_drop_of_a_quick_series_is_stored_without_its_bounces() -> None:
    drops = {"first": 0.8, "interval": 1.4, "quiet": 2.5, "bounces": [1, 2]}
    instrument = PortlessInstrument(load_scenario({"base": "buffered", "drops": drops}), drops=6)
    host = Host(instrument)
    host.send(Hello(), Arm(TRIGGER))
    triggers: list[int] = []
    for _ in range(22):
        for offer in of_kind(host.receive(0.5), DropOffer):
            triggers.append(offer.first_sample + offer.trigger)
            host.send(Acknowledge(offer.stream, offer.first_sample))
    triggers = sorted(set(triggers))
    assert len(triggers) == 6
    # 1.4 s at 10 kHz, with a jitter of 50 ms each.
    assert np.diff(triggers).min() > 13_000
    assert np.diff(triggers).max() < 15_000
