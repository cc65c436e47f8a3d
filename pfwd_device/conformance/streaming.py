"""Tests of the samples that an instrument sends: streams, indices, clocks, repeated requests.

A stream is a run of samples between a start and the next; its samples are numbered from 0. The ring
is a buffer in the instrument with the latest samples, which can be requested again. Each test
returns a short description of the behaviour. It raises `Failed` if the requirement is not met, and
`NotSupported` if the instrument lacks the function.
"""

import time
from itertools import pairwise

import numpy as np

from pfwd_device.conformance.instrument_link import (
    LINK_DELAY_S,
    MAX_RESPONSE_TIME_S,
    Failed,
    InstrumentLink,
    NotSupported,
    Received,
    blocks,
    require,
)
from pfwd_device.identity import Identity
from pfwd_device.wire.messages import (
    Hello,
    Resend,
    SampleBlock,
    SamplesGone,
    Start,
    Status,
    Stop,
)

MAX_FRAME_S = 0.005
"""Longest time that the samples of one frame may cover, s: less than the load of a drop lasts."""
MAX_PAUSE_S = 0.1
"""Longest time between two frames of samples, s."""
MAX_CLOCK_DIFFERENCE = 0.01
"""Largest relative difference of two clocks: any two oscillators differ by less."""
REQUEST_DELAY_S = 0.05
"""Time that a request needs to the instrument, during which the ring is overwritten further, s."""
MAX_TESTED_RING_S = 10.0
"""Longest ring that is tested, s."""


def _streaming(link: InstrumentLink) -> Identity:
    identity = link.request(Hello(), Identity)
    if not identity.streams:
        raise NotSupported("the instrument stores drops and sends no samples")
    return identity


def starts(link: InstrumentLink) -> str:
    """Test that `Start` is answered by samples within 1 s."""
    _streaming(link)
    link.request(Stop(), Status)
    began = time.monotonic()
    link.request(Start(), SampleBlock)
    return f"within {time.monotonic() - began:.2f} s"


def new_streams(link: InstrumentLink) -> str:
    """Test that each `Start` begins a stream with a new number, whose samples begin at index 0."""
    _streaming(link)
    # Wait for the end of an earlier stream: its late blocks would be taken for the new one.
    link.request(Stop(), Status, lambda status: not status.sampling)
    numbers: list[int] = []
    for _ in range(3):
        used = set(numbers)
        link.send(Start())
        block = link.wait_for(SampleBlock, accept=lambda block, used=used: block.stream not in used)  # type: ignore[misc]
        if block is None:
            raise Failed("expected a new stream number after Start, got no such samples")
        require(
            block.first_sample == 0,
            f"expected a stream to begin with index 0, got {block.first_sample}",
        )
        numbers.append(block.stream)
    return "three numbers"


def _stream(link: InstrumentLink, seconds: float) -> tuple[Identity, list[Received], int]:
    """Receive a new stream for a time.

    Return the identity, the received messages and the number of samples that the instrument
    discarded meanwhile (overruns).
    """
    identity = _streaming(link)
    link.request(Stop(), Status)
    before = link.request(Stop(), Status).overruns
    first = link.request(Start(), SampleBlock)
    since = len(link.received) - 1
    link.receive(seconds)
    # Blocks of an earlier stream may still arrive.
    received = [
        each
        for each in link.received[since:]
        if not isinstance(each.message, SampleBlock) or each.message.stream == first.stream
    ]
    after = link.request(Stop(), Status, lambda status: not status.sampling).overruns
    return identity, received, after - before


def indices(link: InstrumentLink) -> str:
    """Test that sample indices are consecutive, and skipped samples are counted as overruns."""
    _, received, overruns = _stream(link, 2.0)
    skipped = 0
    lost_frames = 0
    samples = [each for each in received if isinstance(each.message, SampleBlock)]
    for earlier, later in pairwise(samples):
        assert isinstance(earlier.message, SampleBlock)
        assert isinstance(later.message, SampleBlock)
        expected = earlier.message.first_sample + len(earlier.message.counts)
        first = later.message.first_sample
        require(first >= expected, f"expected index {expected} or later, got {first} again")
        if first > expected:
            between = [each for each in received if earlier.at <= each.at <= later.at]
            counters = [each.counter for each in between]
            is_complete = all((b - a) % 65536 == 1 for a, b in pairwise(counters))
            if is_complete:
                skipped += first - expected
            else:
                lost_frames += 1  # the frame counters show that the link lost a frame
    require(
        skipped <= overruns,
        f"expected every skipped sample to be an overrun, got {skipped} and {overruns}",
    )
    return f"{len(samples)} frames, {skipped} samples skipped, {lost_frames} gaps of the link"


def frames(link: InstrumentLink) -> str:
    """Test that samples arrive at least every 0.1 s, at most 5 ms in a frame, for all channels."""
    identity, received, _ = _stream(link, 2.0)
    samples = [each for each in received if isinstance(each.message, SampleBlock)]
    longest = max(len(block.counts) for block in blocks(samples))
    limit = MAX_FRAME_S * identity.sampling_rate
    require(longest <= limit + 1, f"expected up to {limit:g} samples in a frame, got {longest}")
    channels = {block.counts.shape[1] for block in blocks(samples)}
    require(
        channels == {len(identity.channels)},
        f"expected {len(identity.channels)} channels, got {channels}",
    )
    pause = max((b.at - a.at for a, b in pairwise(samples)), default=0.0)
    require(
        pause <= MAX_PAUSE_S + LINK_DELAY_S,
        f"expected samples every {MAX_PAUSE_S:g} s, got a pause of {pause:.2f} s",
    )
    return f"up to {longest} samples a frame"


def rate(link: InstrumentLink) -> str:
    """Test that the sampling rate is the declared one, by the clocks of host and instrument."""
    identity, received, _ = _stream(link, 4.0)
    samples = [each for each in received if isinstance(each.message, SampleBlock)]
    sample_blocks = blocks(samples)
    index = np.array([block.first_sample + len(block.counts) for block in sample_blocks], float)
    host = np.array([each.at for each in samples])
    require(len(samples) > 20, f"expected samples for 4 s, got {len(samples)} frames")
    # Compare the most punctual arrivals of the first and of the last quarter: a late arrival gives
    # a wrong rate, and two arrivals close to each other an inaccurate one.
    lag = host - index / identity.sampling_rate
    quarter = len(lag) // 4
    first, last = int(np.argmin(lag[:quarter])), int(np.argmin(lag[-quarter:])) - quarter
    duration = float(host[last] - host[first])
    require(duration > 0.5, f"expected samples for 4 s, got {duration:.2g} s of them")
    by_host = float((index[last] - index[first]) / (host[last] - host[first]))
    differs = by_host / identity.sampling_rate - 1
    require(
        abs(differs) < MAX_CLOCK_DIFFERENCE,
        f"expected {identity.sampling_rate:g} Hz, got {by_host:.5g} Hz by the host's clock",
    )
    timed = [block for block in sample_blocks if block.clock_us is not None]
    if len(timed) < 10:
        return f"{by_host:.5g} Hz by the host's clock; the samples have no time of the instrument"
    begin = np.array([block.first_sample for block in timed], float)
    clock = np.array([block.clock_us for block in timed], float) / 1e6
    slope, offset = np.polyfit(begin, clock, 1)
    jitter = float(np.abs(clock - slope * begin - offset).max())
    by_clock = 1 / float(slope)
    require(
        abs(by_clock / identity.sampling_rate - 1) < MAX_CLOCK_DIFFERENCE,
        f"expected {identity.sampling_rate:g} Hz, got {by_clock:.5g} Hz by the device clock",
    )
    require(
        jitter < 0.02,
        f"expected device times that increase evenly, got deviations of {jitter * 1e3:.0f} ms",
    )
    drift = (by_clock / by_host - 1) * 1e6
    return f"{by_clock:.5g} Hz, jitter {jitter * 1e3:.1f} ms, clocks {drift:+z.0f} ppm apart"


def clock(link: InstrumentLink) -> str:
    """Test that the clock of the instrument runs evenly and never back."""
    link.request(Hello(), Identity)
    statuses = [
        (each.at, each.message.clock_us / 1e6)
        for each in link.receive(3.0)
        if isinstance(each.message, Status)
    ]
    require(len(statuses) >= 4, f"expected a Status every 0.5 s, got {len(statuses)} within 3 s")
    steps = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(statuses)]
    require(
        all(device >= 0 for _, device in steps),
        "expected a device clock that never runs back, got a step back",
    )
    host, device = (sum(step[k] for step in steps) for k in (0, 1))
    require(
        abs(device - host) < MAX_CLOCK_DIFFERENCE * host + LINK_DELAY_S / 2,
        f"expected the device clock to advance by {host:.2f} s, got {device:.2f} s",
    )
    return f"{device:.2f} s in {host:.2f} s"


def stops(link: InstrumentLink) -> str:
    """Test that `Stop` ends the samples, and that a `Status` reports it."""
    _streaming(link)
    link.request(Start(), SampleBlock)
    link.request(Stop(), Status, lambda status: not status.sampling)
    later = blocks(link.receive(0.5))
    require(not later, f"expected no samples after that Status, got {len(later)} frames")
    return "stops"


def undisturbed(link: InstrumentLink) -> str:
    """Test that a request for the identity does not disturb a running stream."""
    _streaming(link)
    first = link.request(Start(), SampleBlock)
    link.receive(0.3)
    link.request(Hello(), Identity)
    after = blocks(link.receive(0.5))
    link.send(Stop())
    require(bool(after), "expected the stream to continue after Hello, got no samples")
    numbers = {block.stream for block in after}
    require(numbers == {first.stream}, "expected the same stream after Hello, got another stream")
    return "continues"


def _ring(link: InstrumentLink) -> Identity:
    identity = _streaming(link)
    if identity.ring_samples == 0:
        raise NotSupported("the instrument has no ring, from which samples can be requested again")
    return identity


def _samples_by_index(sample_blocks: list[SampleBlock], stream: int) -> dict[int, bytes]:
    table: dict[int, bytes] = {}
    for block in sample_blocks:
        if block.stream == stream:
            for at, row in enumerate(block.counts):
                table.setdefault(block.first_sample + at, row.tobytes())
    return table


def resends(link: InstrumentLink) -> str:
    """Test that samples can be requested again, and are the same with the same indices."""
    identity = _ring(link)
    first = link.request(Start(), SampleBlock)
    first_copy = _samples_by_index(blocks(link.receive(0.6)), first.stream)
    count = min(len(first_copy) // 2, identity.ring_samples // 4, 1000)
    requested = sorted(first_copy)[-2 * count : -count]
    require(count > 10, f"expected more than 10 samples to request again, got {count}")
    since = len(link.received)
    link.send(Resend(first.stream, requested[0], requested[-1] - requested[0] + 1))
    link.receive(MAX_RESPONSE_TIME_S)
    second_copy = {
        block.first_sample + at: row.tobytes()
        for block in blocks(link.received[since:])
        if block.stream == first.stream
        for at, row in enumerate(block.counts)
        if requested[0] <= block.first_sample + at <= requested[-1]
    }
    link.request(Stop(), Status)
    missing = [index for index in requested if index not in second_copy]
    require(
        not missing,
        f"expected {len(requested)} samples again, {len(missing)} of them were not received",
    )
    wrong = [index for index in requested if second_copy[index] != first_copy[index]]
    require(not wrong, f"expected the same samples again, {len(wrong)} of them were different")
    return f"{len(requested)} samples"


def reports_missing(link: InstrumentLink) -> str:
    """Test that a request for samples that the ring does not contain is answered by Gone."""
    _ring(link)
    first = link.request(Start(), SampleBlock)
    for stream, index in ((first.stream, 1 << 40), (first.stream ^ 1, 0)):
        requested = Resend(stream, index, 10)
        gone = link.request(
            requested,
            SamplesGone,
            lambda gone, requested=requested: gone.stream == requested.stream,  # type: ignore[misc]
        )
        require(
            (gone.first_sample, gone.count) == (index, 10),
            f"expected Gone of 10 samples from {index}, got {gone.count} from {gone.first_sample}",
        )
    link.request(Stop(), Status)
    return "reported"


def ring_length(link: InstrumentLink) -> str:
    """Test that the ring is as long as the identity of the instrument reports."""
    identity = _ring(link)
    seconds = identity.ring_samples / identity.sampling_rate
    if seconds > MAX_TESTED_RING_S:
        raise NotSupported(f"a ring of {seconds:.0f} s is too long for this test")
    first = link.request(Start(), SampleBlock)
    link.receive(seconds + 0.3)
    newest = max(
        block.first_sample + len(block.counts)
        for block in blocks(link.received)
        if block.stream == first.stream
    )
    # Request the complete ring. Its length follows from the oldest sample that arrives and the
    # newest sample that was recorded until then.
    oldest = max(0, newest - identity.ring_samples)
    since = len(link.received)
    link.send(Resend(first.stream, oldest, newest - oldest))
    link.receive(MAX_RESPONSE_TIME_S)
    link.request(Stop(), Status)
    reach = 0
    for block in blocks(link.received[since:]):
        if block.stream == first.stream:
            newest = max(newest, block.first_sample)
            reach = max(reach, newest - block.first_sample)
    expected = 0.8 * identity.ring_samples - REQUEST_DELAY_S * identity.sampling_rate
    require(
        reach >= expected,
        f"expected samples from {seconds:.2f} s ago, got some from "
        f"{reach / identity.sampling_rate:.2f} s ago",
    )
    return f"{seconds:.2f} s, {reach / identity.sampling_rate:.2f} s of them received"
