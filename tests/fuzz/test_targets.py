"""The fuzzer's targets on what hypothesis makes up: every day, without a fuzzer."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tests.fuzz.outside_targets  # noqa: F401  (it enters its targets)
from tests.fuzz import foreign_targets as foreign
from tests.fuzz.targets import TARGETS, Target, peak_memory
from tests.pfwd_device.wire import by_hand

EVERY = [(group, name) for group, targets in TARGETS.items() for name in targets]
# Bytes that mean something, so that more than the first check is met.
WORDS = [
    b"\0",
    b"\n",
    b"\r\n",
    b",",
    b"1000,1,2\n",
    b"1100,-3,4.5\n",
    b"t_us,a,b\n",
    b"#",
    b"nan",
    b"-",
]
FRAMES = [by_hand.frame(*example) for example in by_hand.EXAMPLES.values()]
PIECES = st.one_of(st.sampled_from(WORDS), st.sampled_from(FRAMES), st.binary(max_size=40))
INPUTS = st.one_of(
    st.binary(max_size=600), st.lists(PIECES, max_size=25).map(b"".join), st.just(by_hand.IDENTITY)
)


@pytest.mark.parametrize(("group", "name"), EVERY)
@given(data=INPUTS)
@settings(max_examples=60, deadline=None)
def test_target_holds_on_any_bytes(group: str, name: str, data: bytes) -> None:
    TARGETS[group][name](data)


@pytest.mark.parametrize(
    ("data", "name", "options"),
    [
        *(
            (foreign.project(database), "a.prjz", {})
            for database in (foreign.ACQUIRED, foreign.VIEWED)
        ),
        (foreign.zipped({"database.xml": foreign.DATA_SET}), "a.dynz", {}),
        (foreign.THY, "a.thy", {"header": foreign.CENTRE_ONLY}),
        (foreign.DAT, "a.dat", {"header": foreign.HEADER}),
        (foreign.TEXT, "a.txt", {"map_": foreign.MAP}),
    ],
)
def test_the_unchanged_files_of_the_targets_are_read(
    data: bytes, name: str, options: dict[str, bytes]
) -> None:
    assert foreign.read_or_refused(data, name, **options)


@pytest.mark.parametrize(("group", "name"), EVERY)
def test_target_holds_on_long_noise(group: str, name: str) -> None:
    generator = random.Random(3)
    target: Target = TARGETS[group][name]
    target(generator.randbytes(20_000))
    target(bytes(generator.choices(b"0123456789,-.\n \r#et_us", k=20_000)))
    target(b"\x07" * 20_000)


def test_memory_is_bounded_by_the_input() -> None:
    noise = b"\x07" * 1_000_000
    for target in TARGETS["wire"].values():
        assert peak_memory(target, noise) < 40 * len(noise)
