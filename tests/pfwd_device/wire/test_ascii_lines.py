"""Lines of numbers: what is read, what is damaged, and where a sample belongs."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd_device.errors import SetupError
from pfwd_device.identity import ChannelIdentity, Identity
from pfwd_device.wire.ascii_lines import AsciiDialect, LineLayout
from pfwd_device.wire.messages import Refusal, SampleBlock, Start
from pfwd_plugins.quantities import Measurand
from tests.fuzz.targets import check_stream

STEP = 100  # us, at 10 kHz


def identity(channels: int = 2, rate: float = 10_000.0) -> Identity:
    names = tuple(ChannelIdentity(f"c{i}", Measurand.VELOCITY) for i in range(channels))
    return Identity("1", "m", "f", rate, 16, 2.5, names)


def dialect(columns: tuple[int, ...] = (0, 1), **options: Any) -> AsciiDialect:
    return AsciiDialect(identity(len(columns)), columns, **options)


def lines(times: Any, end: str = "\n") -> bytes:
    """One line for each time; the first value numbers the lines."""
    return "".join(f"{int(time)},{at},{-at}{end}" for at, time in enumerate(times)).encode()


def samples(messages: list[Any]) -> list[tuple[int, int, int]]:
    """Stream, index and first value of every sample."""
    return [
        (block.stream, block.first_sample + at, int(row[0]))
        for block in messages
        if isinstance(block, SampleBlock)
        for at, row in enumerate(block.counts)
    ]


def counts_of(data: bytes, decoder: AsciiDialect) -> list[list[int]]:
    return [
        row for m in decoder.feed(data) if isinstance(m, SampleBlock) for row in m.counts.tolist()
    ]


def test_the_identity_precedes_the_first_block() -> None:
    decoder = dialect()
    messages = decoder.feed(b"# hi\r\nt_us,load,g0\r\n" + lines(range(1000, 2000, 100), "\r\n"))
    who, block = messages
    assert who == identity()
    assert (block.stream, block.first_sample, block.clock_us) == (0, 0, 1000)
    assert block.counts.dtype == np.int32
    assert block.counts.tolist() == [[at, -at] for at in range(10)]
    assert decoder.counters.frames_good == 12
    assert decoder.counters.bytes_discarded == 0
    (block,) = decoder.feed(lines([2000]))
    assert block.first_sample == 10
    assert decoder.encode(Start()) == b""


def test_columns_may_be_exchanged_and_omitted() -> None:
    data = b"0, 1 ,2,\t3,9.5 \n100,4,5,6,nan\n200,4,5,6,-1e3\n300,7,8,9,.5\n"
    decoder = AsciiDialect(identity(), [2, 0], resolution=[1, 1])
    assert counts_of(data, decoder) == [[3, 1], [6, 4], [9, 7]]
    assert decoder.counters.frames_damaged == 1


@pytest.mark.parametrize(
    ("value", "count"),
    [
        ("1.5", 150), ("-0.014", -1), ("-0.016", -2), (".5", 50), ("5.", 500), ("+2", 200),
        ("1e-2", 1), ("2E+1", 2000), ("1e99", 2**31 - 1), ("-1e99", -(2**31)), ("-0.0", 0),
        ("21474836.47", 2**31 - 1), ("21474836.48", 2**31 - 1), ("-21474836.48", -(2**31)),
    ],
)  # fmt: skip
def test_decimals_become_counts(value: str, count: int) -> None:
    data = f"0,{value}\n100,{value}\n".encode()
    assert counts_of(data, dialect((0,), resolution=[0.01])) == [[count], [count]]


@pytest.mark.parametrize(
    "value",
    [
        "nan", "inf", "-Infinity", "1_0", "0x10", "1e", "1e100", "--5", "1-2", "1 2", "", " ",
        "1.2.3", "9" * 16, "1." + "0" * 16,
        "١٢", "１", "²", "1\x00", "1\x0b", "\x1b[0m1", '"1"', "1;", "1,",
        "True", "e5", ".", "1 e5",
    ],
)  # fmt: skip
@pytest.mark.parametrize("resolution", [None, [1.0]])
def test_a_line_without_a_number_is_damaged(value: str, resolution: list[float] | None) -> None:
    data = f"0,1\n100,{value}\n200,3\n300,4\n".encode()
    decoder = dialect((0,), resolution=resolution)
    assert samples(decoder.feed(data)) == [(0, 0, 1), (0, 2, 3), (0, 3, 4)]
    assert decoder.counters.frames_damaged == 1
    assert decoder.counters.bytes_discarded == len(f"100,{value}\n".encode())


@pytest.mark.parametrize("value", ["1.5", "1e3", "1."])
def test_counts_are_integers(value: str) -> None:
    assert counts_of(f"0,1\n100,{value}\n200,3\n300,4\n".encode(), dialect((0,))) == [[1], [3], [4]]
    assert counts_of(b"0,9999999999\n100,-9999999999\n", dialect((0,))) == [[2**31 - 1], [-(2**31)]]


@pytest.mark.parametrize("time", ["-100", "+100", "100.0", "1e2", "9" * 16, "", "nan"])
def test_a_time_is_an_integer(time: str) -> None:
    decoder = dialect((0,))
    assert samples(decoder.feed(f"0,0\n{time},1\n200,2\n300,3\n".encode())) == [
        (0, 0, 0), (0, 2, 2), (0, 3, 3),
    ]  # fmt: skip
    assert decoder.counters.frames_damaged == 1


def test_a_line_that_began_before_the_connection_is_no_sample() -> None:
    text = lines(range(123_000, 124_000, STEP))
    for cut in range(text.index(b"\n") + 1):
        received = samples(dialect().feed(text[cut:]))
        assert [value for *_, value in received] in (list(range(10)), list(range(1, 10)))
        assert [index for _, index, _ in received] == list(range(len(received)))


def test_a_gap_is_located_to_the_sample() -> None:
    times = np.delete(np.arange(0, 100_000, STEP), [5, 6, 7, 300, *range(500, 900)])
    indices = [index for _, index, _ in samples(dialect().feed(lines(times)))]
    assert indices == (times // STEP).tolist()


@pytest.mark.parametrize("jitter", [0.1, 0.24])
@pytest.mark.parametrize("rate", [10_000.0, 3000.0, 44_100.0])
def test_jitter_is_tolerated(jitter: float, rate: float) -> None:
    generator = np.random.default_rng(4)
    steps = np.delete(np.arange(3000), [100, 101, 2000])
    times = (steps + 5 + generator.uniform(-jitter, jitter, steps.size)) * 1e6 / rate
    decoder = AsciiDialect(identity(2, rate), [0, 1])
    index = [index for _, index, _ in samples(decoder.feed(lines(np.round(times))))]
    assert index == steps.tolist()


def test_a_clock_that_runs_too_fast_makes_no_gap() -> None:
    times = np.round(np.arange(50_000) * STEP * 1.0005)
    decoder = dialect()
    assert [index for _, index, _ in samples(decoder.feed(lines(times)))] == list(range(50_000))
    assert decoder.counters.frames_damaged == 0


def test_late_lines_are_no_gap() -> None:
    times = np.arange(0, 5000, STEP)
    times[[10, 20, 21, 30]] += [80, 40, 40, 95]
    assert [i for _, i, _ in samples(dialect().feed(lines(times)))] == list(range(50))


@pytest.mark.parametrize("wrong", [0, 1900, 2600, 10**12])  # 1900: a time that was there
def test_a_wrong_time_damages_its_line_only(wrong: int) -> None:
    times = list(range(1000, 3000, STEP))
    times[10] = wrong
    decoder = dialect()
    received = samples(decoder.feed(lines(times)))
    assert received == [(0, at, at) for at in range(20) if at != 10]
    assert decoder.counters.frames_damaged == 1


def test_a_restart_begins_a_stream() -> None:
    times = [5_000_000, 5_000_100, 5_000_200, 40, 140, 240, 0, 100]
    received = samples(dialect(first_stream=7).feed(lines(times)))
    assert [place[0] for place in received] == [7, 7, 7, 8, 8, 8, 9, 9]
    assert [place[1] for place in received] == [0, 1, 2, 0, 1, 2, 0, 1]
    assert samples(dialect(first_stream=2**32 - 1).feed(lines(times)))[3][0] == 0


def test_a_clock_of_32_bits_wraps() -> None:
    times = np.arange(2**32 - 1000, 2**32 + 1000, STEP)
    messages = dialect().feed(lines(times % 2**32))
    (block,) = messages[1:]
    assert len(block.counts) == 20
    gap = np.delete(times, [8, 9, 10, 11, 12])
    indices = [index for _, index, _ in samples(dialect().feed(lines(gap % 2**32)))]
    assert indices == [*range(8), *range(13, 20)]
    # The clock goes on above 32 bits; so does one of 64 bits.
    for stream in (lines(gap % 2**32), lines(gap)):
        clocks = [getattr(m, "clock_us", None) for m in dialect().feed(stream)[1:]]
        assert clocks == [2**32 - 1000, 2**32 + 300]


def test_an_hour_of_silence_ends_the_stream() -> None:
    times = [0, 100, 200, 3_700_000_000, 3_700_000_100]
    assert [place[:2] for place in samples(dialect().feed(lines(times)))] == [
        (0, 0), (0, 1), (0, 2), (1, 0), (1, 1),
    ]  # fmt: skip


def test_a_cut_link_leaves_a_gap() -> None:
    decoder = dialect()
    decoder.feed(lines(range(0, 1000, STEP)) + b"1000,1")
    decoder.reset()
    assert decoder.counters.bytes_discarded == 6
    messages = decoder.feed(b"00,77,77\n" + lines(range(500_000, 500_500, STEP)))
    assert messages[0] == identity()
    assert samples(messages) == [(0, 5000 + at, at) for at in range(5)]
    decoder.reset()
    messages = decoder.feed(lines(range(0, 500, STEP)))  # it was restarted in the meantime
    assert messages[0] == identity()
    assert samples(messages) == [(1, at, at) for at in range(5)]


def test_a_lost_line_feed_costs_two_lines() -> None:
    data = lines(range(0, 1000, STEP)).replace(b"-3\n", b"-3", 1)
    decoder = dialect()
    assert [index for _, index, _ in samples(decoder.feed(data))] == [0, 1, 2, 5, 6, 7, 8, 9]
    assert decoder.counters.frames_damaged == 1


def test_three_lines_of_another_width_are_believed() -> None:
    narrow, wide = b"%d,1,2\n", b"%d,1,2,3\n"
    data = b"".join(narrow % (at * STEP) for at in range(5))
    data += b"".join(wide % (at * STEP) for at in range(5, 15))
    decoder = dialect()
    assert [index for _, index, _ in samples(decoder.feed(data))] == [*range(5), *range(7, 15)]
    assert decoder.counters.frames_damaged == 2


def test_a_wrong_sampling_rate_is_reported_once() -> None:
    decoder = dialect()
    messages = decoder.feed(lines(np.arange(0, 500_000, 110)))
    refusals = [message for message in messages if isinstance(message, Refusal)]
    assert ["got 9090.9 Hz" in refusal.text for refusal in refusals] == [True]
    sound = dialect().feed(lines(np.arange(0, 500_000, 100)))
    assert Refusal not in map(type, sound)


def test_a_line_has_up_to_512_bytes() -> None:
    for spaces, damaged in ((507, 0), (508, 1)):
        data = b"0,0,0\n" + b"100,1," + b" " * (spaces - 2) + b"1\n" + lines([200, 300])
        for piece in (1, len(data)):
            decoder = dialect()
            for at in range(0, len(data), piece):
                decoder.feed(data[at : at + piece])
            assert decoder.counters.frames_damaged == damaged


@pytest.mark.parametrize("data", [b"", b"\n", b"\r\n \t\r\n", b"#" + b"x" * 511 + b"\n"])
def test_empty_lines_are_no_damage(data: bytes) -> None:
    decoder = dialect()
    assert decoder.feed(data) == []
    assert decoder.counters.frames_damaged == 0


@given(
    st.lists(
        st.tuples(st.integers(0, 40), st.sampled_from([b"", b"x", b"\n", b"9", b",", b"-"])),
        max_size=6,
    ),
    st.integers(0, 3),
)
@settings(max_examples=150, deadline=None)
def test_the_result_does_not_depend_on_cuts(damage: list[tuple[int, bytes]], ends: int) -> None:
    data = lines(range(0, 4000, STEP), "\r\n" if ends & 1 else "\n")
    for at, piece in damage:
        data = data[: at * 9] + piece + data[at * 9 + (ends >> 1) :]
    check_stream(dialect, data, 1100)


@pytest.mark.parametrize(
    ("columns", "options", "match"),
    [
        ((0,), {}, r"columns: expected 2 numbers, one for each channel, got \(0,\)"),
        ((0, 0), {}, "columns: expected different numbers from 0 to 63"),
        ((0, -1), {}, "columns: expected different numbers"),
        ((0, 64), {}, "columns: expected different numbers from 0 to 63"),
        ((0, 1), {"resolution": [1.0]}, "resolution: expected 2 values, one for each channel"),
        ((0, 1), {"resolution": [1.0, 0.0]}, "resolution: expected values from 1e-30 to 1e30"),
        ((0, 1), {"resolution": [1.0, float("nan")]}, "resolution: expected values"),
    ],
)
def test_wrong_columns_are_refused(
    columns: tuple[int, ...], options: dict[str, Any], match: str
) -> None:
    with pytest.raises(SetupError, match=match):
        AsciiDialect(identity(), columns, **options)


def test_a_simulation_at_another_speed_is_no_real_time() -> None:
    for start, real_time in ((b"# anything\n", True), (b"# not in real time\r\n", False)):
        messages = dialect().feed(start + lines(range(0, 1000, 100)))
        assert messages[0].real_time is real_time


TWO_COLUMNS = Identity(
    "7", "lines", "", 1000.0, 24, 2.5,
    (ChannelIdentity("load", Measurand.LOAD), ChannelIdentity("plate", Measurand.VELOCITY)),
)  # fmt: skip


def dialect_with(place: int | None, bits: int = 32) -> AsciiDialect:
    layout = LineLayout(separator=" ", place=place, time_unit=None, counter_bits=bits)
    return AsciiDialect(TWO_COLUMNS, (0, 1), layout=layout)


@pytest.mark.parametrize("bits", [8, 16, 31, 32])
def test_a_wrong_number_moves_no_sample(bits: int) -> None:
    rng = np.random.default_rng(bits)
    first = (1 << bits) - 150
    lines = [b"%d %d 5\n" % ((first + i) % (1 << bits), i) for i in range(300)]
    wrong = rng.choice(np.arange(2, 298, 5), 30, replace=False)
    for at in wrong:
        lines[at] = b"%d %d 5\n" % (rng.integers(1 << bits), at)
    received = samples(dialect_with(1, bits).feed(b"".join(lines)))
    assert {(stream, index - value) for stream, index, value in received} == {(0, 0)}
    assert len(received) >= 270


def test_lines_that_lost_their_end_are_discarded_with_any_separator() -> None:
    lines = [b"%d %d 5\n" % (i, i) for i in range(20)]
    data = b"".join(lines[:7]) + lines[7].replace(b"\n", b" ") + b"".join(lines[8:])
    values = [value for _, _, value in samples(dialect_with(1).feed(data))]
    assert values == [*range(7), *range(9, 20)]


@pytest.mark.parametrize(("place", "bits", "streams"), [(1, 32, 1), (1, 16, 2), (None, 32, 2)])
def test_samples_behind_a_lost_connection_are_a_new_run_unless_counted(
    place: int | None, bits: int, streams: int
) -> None:
    dialect = dialect_with(place, bits)
    head = b"" if place is None else b"%d "
    lines = [(head % i if head else b"") + b"%d 5\n" % i for i in range(40)]
    received = samples(dialect.feed(b"".join(lines[:20])))
    dialect.reset()
    received += samples(dialect.feed(b"".join(lines[30:])))
    assert len({stream for stream, _, _ in received}) == streams
    if streams == 1:
        assert {index - value for _, index, value in received} == {0}
