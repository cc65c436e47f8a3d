"""Samples: streams, indices, clocks, and samples that are sent again."""

import time
from itertools import pairwise

import numpy as np

from pfwd_device.conformance.talk import (
    ANSWER_TIME,
    ON_THE_WAY,
    Failed,
    Heard,
    NotOffered,
    Talk,
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

LONGEST_FRAME = 0.005
"""s of samples in a frame: the load of a drop lasts longer."""
LONGEST_PAUSE = 0.1
"""s between two frames of samples."""
CLOCKS_DIFFER = 0.01
"""Any two oscillators differ by less."""
IN_FLIGHT = 0.05
"""s of samples that an instrument takes while it reads a request."""
LONGEST_RING = 10.0
"""s; a longer ring is not waited for."""


def _streaming(talk: Talk) -> Identity:
    identity = talk.answer(Hello(), Identity)
    if not identity.streams:
        raise NotOffered("it keeps drops and streams no samples")
    return identity


def starts(talk: Talk) -> str:
    """P-8."""
    _streaming(talk)
    talk.answer(Stop(), Status)
    began = time.monotonic()
    talk.answer(Start(), SampleBlock)
    return f"within {time.monotonic() - began:.2f} s"


def new_streams(talk: Talk) -> str:
    """P-9."""
    _streaming(talk)
    # What an earlier stream still had on its way would be taken for a new one.
    talk.answer(Stop(), Status, lambda status: not status.sampling)
    numbers: list[int] = []
    for _ in range(3):
        known = set(numbers)
        talk.say(Start())
        block = talk.until(SampleBlock, which=lambda block, known=known: block.stream not in known)  # type: ignore[misc]
        if block is None:
            raise Failed("expected another stream number after Start, got the same")
        require(
            block.first_sample == 0,
            f"expected a stream to begin with index 0, got {block.first_sample}",
        )
        numbers.append(block.stream)
    return "three numbers"


def _stream(talk: Talk, seconds: float) -> tuple[Identity, list[Heard], int]:
    """A new stream listened to for a while; what was heard, and how many overruns meanwhile."""
    identity = _streaming(talk)
    talk.answer(Stop(), Status)
    before = talk.answer(Stop(), Status).overruns
    first = talk.answer(Start(), SampleBlock)
    since = len(talk.heard) - 1
    talk.listen(seconds)
    # What came in order of the counter; the rest of the last frame may be on its way.
    heard = [
        each
        for each in talk.heard[since:]
        if not isinstance(each.message, SampleBlock) or each.message.stream == first.stream
    ]
    after = talk.answer(Stop(), Status, lambda status: not status.sampling).overruns
    return identity, heard, after - before


def indices(talk: Talk) -> str:
    """P-10."""
    _, heard, overruns = _stream(talk, 2.0)
    left_out = 0
    lost_frames = 0
    samples = [each for each in heard if isinstance(each.message, SampleBlock)]
    for earlier, later in pairwise(samples):
        assert isinstance(earlier.message, SampleBlock)
        assert isinstance(later.message, SampleBlock)
        expected = earlier.message.first_sample + len(earlier.message.counts)
        first = later.message.first_sample
        require(first >= expected, f"expected index {expected} or later, got {first} again")
        if first > expected:
            between = [each for each in heard if earlier.at <= each.at <= later.at]
            counters = [each.counter for each in between]
            whole = all((b - a) % 65536 == 1 for a, b in pairwise(counters))
            if whole:
                left_out += first - expected
            else:
                lost_frames += 1  # on the way: not the instrument's
    require(
        left_out <= overruns,
        f"expected every sample left out to be an overrun, got {left_out} and {overruns}",
    )
    return f"{len(samples)} frames, {left_out} samples left out, {lost_frames} gaps of the link"


def frames(talk: Talk) -> str:
    """P-11."""
    identity, heard, _ = _stream(talk, 2.0)
    samples = [each for each in heard if isinstance(each.message, SampleBlock)]
    longest = max(len(block.counts) for block in blocks(samples))
    most = LONGEST_FRAME * identity.sampling_rate
    require(longest <= most + 1, f"expected up to {most:g} samples in a frame, got {longest}")
    channels = {block.counts.shape[1] for block in blocks(samples)}
    require(
        channels == {len(identity.channels)},
        f"expected {len(identity.channels)} channels, got {channels}",
    )
    pause = max((b.at - a.at for a, b in pairwise(samples)), default=0.0)
    require(
        pause <= LONGEST_PAUSE + ON_THE_WAY,
        f"expected samples every {LONGEST_PAUSE:g} s, got a pause of {pause:.2f} s",
    )
    return f"up to {longest} samples a frame"


def rate(talk: Talk) -> str:
    """P-12."""
    identity, heard, _ = _stream(talk, 4.0)
    samples = [each for each in heard if isinstance(each.message, SampleBlock)]
    taken = blocks(samples)
    index = np.array([block.first_sample + len(block.counts) for block in taken], float)
    host = np.array([each.at for each in samples])
    require(len(samples) > 20, f"expected samples for 4 s, got {len(samples)} frames")
    # The fastest arrivals of the first and of the last quarter: what came late says nothing of the
    # converter, and what came in the middle is too near to either.
    lag = host - index / identity.sampling_rate
    quarter = len(lag) // 4
    first, last = int(np.argmin(lag[:quarter])), int(np.argmin(lag[-quarter:])) - quarter
    apart = float(host[last] - host[first])
    require(apart > 0.5, f"expected samples for 4 s, got {apart:.2g} s between first and last ones")
    by_host = float((index[last] - index[first]) / (host[last] - host[first]))
    differs = by_host / identity.sampling_rate - 1
    require(
        abs(differs) < CLOCKS_DIFFER,
        f"expected {identity.sampling_rate:g} Hz, got {by_host:.5g} Hz by the host's clock",
    )
    timed = [block for block in taken if block.clock_us is not None]
    if len(timed) < 10:
        return f"{by_host:.5g} Hz by the host's clock; frames carry no clock"
    begin = np.array([block.first_sample for block in timed], float)
    clock = np.array([block.clock_us for block in timed], float) / 1e6
    slope, offset = np.polyfit(begin, clock, 1)
    jitter = float(np.abs(clock - slope * begin - offset).max())
    by_clock = 1 / float(slope)
    require(
        abs(by_clock / identity.sampling_rate - 1) < CLOCKS_DIFFER,
        f"expected {identity.sampling_rate:g} Hz, got {by_clock:.5g} Hz by the device clock",
    )
    require(jitter < 0.02, f"expected clocks on a line, got {jitter * 1e3:.0f} ms off it")
    drift = (by_clock / by_host - 1) * 1e6
    return f"{by_clock:.5g} Hz, jitter {jitter * 1e3:.1f} ms, clocks {drift:+.0f} ppm apart"


def clock(talk: Talk) -> str:
    """P-13."""
    talk.answer(Hello(), Identity)
    said = [
        (each.at, each.message.clock_us / 1e6)
        for each in talk.listen(3.0)
        if isinstance(each.message, Status)
    ]
    require(len(said) >= 4, f"expected a Status every 0.5 s, got {len(said)} within 3 s")
    steps = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(said)]
    require(all(device >= 0 for _, device in steps), "expected a clock that goes on, got one back")
    host, device = (sum(step[k] for step in steps) for k in (0, 1))
    require(
        abs(device - host) < CLOCKS_DIFFER * host + ON_THE_WAY / 2,
        f"expected the clock to go on by {host:.2f} s, got {device:.2f} s",
    )
    return f"{device:.2f} s in {host:.2f} s"


def stops(talk: Talk) -> str:
    """P-14."""
    _streaming(talk)
    talk.answer(Start(), SampleBlock)
    talk.answer(Stop(), Status, lambda status: not status.sampling)
    later = blocks(talk.listen(0.5))
    require(not later, f"expected no samples after that Status, got {len(later)} frames")
    return "stops"


def undisturbed(talk: Talk) -> str:
    """P-16."""
    _streaming(talk)
    first = talk.answer(Start(), SampleBlock)
    talk.listen(0.3)
    talk.answer(Hello(), Identity)
    after = blocks(talk.listen(0.5))
    talk.say(Stop())
    require(bool(after), "expected the stream to go on after Hello, got no samples")
    numbers = {block.stream for block in after}
    require(numbers == {first.stream}, "expected the same stream after Hello, got another")
    return "goes on"


def _ring(talk: Talk) -> Identity:
    identity = _streaming(talk)
    if identity.protocol_version < 2 or identity.ring_samples == 0:
        raise NotOffered("it has no ring")
    return identity


def _collected(found: list[SampleBlock], stream: int) -> dict[int, bytes]:
    table: dict[int, bytes] = {}
    for block in found:
        if block.stream == stream:
            for at, row in enumerate(block.counts):
                table.setdefault(block.first_sample + at, row.tobytes())
    return table


def sent_again(talk: Talk) -> str:
    """P-34."""
    identity = _ring(talk)
    first = talk.answer(Start(), SampleBlock)
    seen = _collected(blocks(talk.listen(0.6)), first.stream)
    count = min(len(seen) // 2, identity.ring_samples // 4, 1000)
    wanted = sorted(seen)[-2 * count : -count]
    require(count > 10, "expected samples to ask for again, got too few")
    since = len(talk.heard)
    talk.say(Resend(first.stream, wanted[0], wanted[-1] - wanted[0] + 1))
    talk.listen(ANSWER_TIME)
    again = {
        block.first_sample + at: row.tobytes()
        for block in blocks(talk.heard[since:])
        if block.stream == first.stream
        for at, row in enumerate(block.counts)
        if wanted[0] <= block.first_sample + at <= wanted[-1]
    }
    talk.answer(Stop(), Status)
    missing = [index for index in wanted if index not in again]
    require(not missing, f"expected {len(wanted)} samples again, {len(missing)} did not come")
    wrong = [index for index in wanted if again[index] != seen[index]]
    require(not wrong, f"expected the same samples again, {len(wrong)} were others")
    return f"{len(wanted)} samples"


def gone(talk: Talk) -> str:
    """P-35."""
    _ring(talk)
    first = talk.answer(Start(), SampleBlock)
    for stream, index in ((first.stream, 1 << 40), (first.stream ^ 1, 0)):
        wanted = Resend(stream, index, 10)
        said = talk.answer(
            wanted,
            SamplesGone,
            lambda gone, wanted=wanted: gone.stream == wanted.stream,  # type: ignore[misc]
        )
        require(
            (said.first_sample, said.count) == (index, 10),
            f"expected Gone of 10 from {index}, got {said.count} from {said.first_sample}",
        )
    talk.answer(Stop(), Status)
    return "said"


def ring_length(talk: Talk) -> str:
    """P-36."""
    identity = _ring(talk)
    seconds = identity.ring_samples / identity.sampling_rate
    if seconds > LONGEST_RING:
        raise NotOffered(f"a ring of {seconds:.0f} s is not waited for")
    first = talk.answer(Start(), SampleBlock)
    talk.listen(seconds + 0.3)
    newest = max(
        block.first_sample + len(block.counts)
        for block in blocks(talk.heard)
        if block.stream == first.stream
    )
    # All of it is asked for; how far back it reaches is told by what came beside it.
    first_wanted = max(0, newest - identity.ring_samples)
    since = len(talk.heard)
    talk.say(Resend(first.stream, first_wanted, newest - first_wanted))
    talk.listen(ANSWER_TIME)
    talk.answer(Stop(), Status)
    reach = 0
    for block in blocks(talk.heard[since:]):
        if block.stream == first.stream:
            newest = max(newest, block.first_sample)
            reach = max(reach, newest - block.first_sample)
    expected = 0.8 * identity.ring_samples - IN_FLIGHT * identity.sampling_rate
    require(
        reach >= expected,
        f"expected samples from {seconds:.2f} s ago, got some from "
        f"{reach / identity.sampling_rate:.2f} s ago",
    )
    return f"{seconds:.2f} s, {reach / identity.sampling_rate:.2f} s of them seen"
