"""Failing disks, kills at every call and power cuts; and that these checks notice a planted bug."""

import contextlib
import errno
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pfwd_device.errors import RecordingError
from pfwd_device.jobs import Jobs
from pfwd_device.recording import check, read_survey, recover
from pfwd_device.recording.drop_file import drop_digest
from pfwd_device.recording.framing import RecordKind
from tests.campaigns import noted_disk, power_loss
from tests.campaigns.noted_disk import Disk, NoDirectorySync, NoSync, NotingStorage
from tests.campaigns.power_loss import (
    Recorded,
    make_record,
    record_run,
    replay_kills,
    replay_power_cuts,
)
from tests.pfwd_device.recording.records import (
    interrupted_recoveries,
    journal_of,
    make_survey,
    open_survey,
    record_of,
    scan_bytes,
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Forty drops, with a disk that now and then is full or fails."""
    return record_run(tmp_path_factory.mktemp("run"), 40, seed=3)


@pytest.mark.parametrize("every", [23, pytest.param(1, marks=pytest.mark.slow)])
def test_no_drop_is_lost_by_a_kill_between_calls(run: Recorded, every: int) -> None:
    outcome = replay_kills(run, every, first=5)
    assert outcome.states > 25
    assert (outcome.losing, outcome.unreadable) == (0, 0)


def test_no_drop_is_lost_by_a_power_cut(run: Recorded) -> None:
    outcome = replay_power_cuts(run, 20, seed=11)
    assert (outcome.states, outcome.losing, outcome.unreadable) == (20, 0, 0)


@pytest.mark.parametrize("planted", [NoSync, NoDirectorySync])
def test_a_forgotten_sync_is_noticed(tmp_path: Path, planted: type[NotingStorage]) -> None:
    broken = record_run(tmp_path, 10, 3, storage_type=planted, faults=False, publish=False)
    outcome = replay_power_cuts(broken, 20, seed=1)
    assert outcome.losing + outcome.unreadable >= 5


States = set[tuple[int, frozenset[tuple[str, bytes | None]]]]


def assert_cut_is_harmless(
    disk: Disk, acknowledged: int, digests: dict[int, str], path: Path, states: States
) -> None:
    """Several power cuts now; recovery finds nothing missing either.

    A disk that was recovered from already (`seen`), because nothing was under way or the next call
    changed nothing on it, gives the same answer again.
    """
    for seed in range(6):
        state = disk.power_cut(np.random.default_rng(seed))
        key = acknowledged, frozenset(state.items())
        if key in states:
            continue
        states.add(key)
        path.mkdir()
        noted_disk.put(state, path)
        assert power_loss.lost_drops(path, acknowledged, digests) == []
        shutil.rmtree(path)


# In order: the journal's sync, the ledger's, that of a new ledger's draft, that of its name.
@pytest.mark.parametrize("fails", ["01", "0111", "011001", "0101101"])
def test_a_drop_refused_late_is_not_called_lost(tmp_path: Path, survey: Path, fails: str) -> None:
    """Its line may have reached the ledger; then its record must be there, and no other's."""
    armed: list[str] = []

    def fault(call: str, _: int) -> OSError | None:
        if not armed or not call.startswith("sync") or armed.pop(0) == "0":
            return None
        return OSError(errno.EIO, "input/output error")

    storage = NotingStorage(tmp_path, fault)
    rng = np.random.default_rng(0)
    record = make_record(1, rng)
    digests = {1: drop_digest(record, 0)}
    with open_survey(survey, storage=storage) as writer:
        writer.save_drop(record)
        storage.mark(1)
        start = len(storage.notes)
        armed += fails
        while 2 not in digests:
            record = make_record(2, rng)  # another one, after one that was given up
            with contextlib.suppress(RecordingError):
                digests[writer.save_drop(record)] = drop_digest(record, 0)
        storage.mark(2)
    assert not armed
    states: States = set()
    for index, acknowledged, disk in power_loss.follow(storage.notes):
        if index >= start:
            assert_cut_is_harmless(disk, acknowledged, digests, tmp_path / "cut", states)


def test_unsynced_records_of_a_killed_program_are_synced_first(tmp_path: Path) -> None:
    """A record is written, the program is killed, the next one goes on, and the power goes."""
    storage = NotingStorage(tmp_path)
    rng = np.random.default_rng(0)
    first, second = make_record(1, rng), make_record(2, rng)
    with open_survey(tmp_path / "survey", storage=storage) as writer:
        writer.save_drop(first)
        storage.mark(1)
        start = len(storage.notes)
        writer.save_drop(second)
    written = start + 1
    assert storage.notes[start][:2] == ("write", "survey/journal/0001.pfwdj")
    *_, (_, _, disk) = power_loss.follow(storage.notes[:written])
    (tmp_path / "next").mkdir()
    noted_disk.put(disk.killed(), tmp_path / "next")
    after = NotingStorage(tmp_path / "next")
    recover(tmp_path / "next" / "survey", after, jobs=Jobs(0))
    digests = {1: drop_digest(first, 0), 2: drop_digest(second, 0)}
    states: States = set()
    for note in after.notes:
        disk.follow(note)
        assert_cut_is_harmless(disk, 1, digests, tmp_path / "cut", states)


@pytest.mark.parametrize("every", [7, pytest.param(1, marks=pytest.mark.slow)])
def test_an_interrupted_recovery_is_repeated(tmp_path: Path, every: int) -> None:
    """Torn end, damaged record, damaged ledger, missing and damaged files; then the power goes."""
    survey = tmp_path / "run" / "survey"
    digests = make_survey(survey, drops=6)
    journal = journal_of(survey)
    data = bytearray(journal.read_bytes())
    drops = [frame for frame in scan_bytes(bytes(data))[0] if frame.kind == RecordKind.DROP]
    data[drops[2].offset + 200] ^= 1
    journal.write_bytes(data + b"torn" * 300)
    ledger = (survey / "acknowledged.txt").read_bytes()
    (survey / "acknowledged.txt").write_bytes(ledger[:400] + b"#" + ledger[401:-30])
    (survey / "drops" / "drop-000001.h5").unlink()
    (survey / "drops" / "drop-000002.h5").write_bytes(b"HDF")
    for path in survey.glob("*lock"):
        path.unlink()
    for folder in interrupted_recoveries(tmp_path / "run", every):
        assert power_loss.lost_drops(folder, 6, digests) == []


def test_the_checker_compares_content(run: Recorded, tmp_path: Path) -> None:
    disk = Disk()
    for note in run.notes:
        disk.follow(note)
    noted_disk.put(disk.killed(), tmp_path)
    assert power_loss.lost_drops(tmp_path, 40, run.digests) == []
    wrong = run.digests | {7: "0" * 64}
    assert power_loss.lost_drops(tmp_path, 40, wrong) == [7]


CALLS = ["write ENOSPC", "write EIO", "write EFBIG", "sync EIO", "sync ENOSPC", "truncate EIO"]
CALLS += ["open ENOSPC", "sync_directory EIO", "replace EIO", "unlink EIO"]
FAULTS = st.tuples(st.integers(0, 120), st.sampled_from(CALLS), st.integers(1, 6))


@pytest.mark.parametrize("examples", [15, pytest.param(300, marks=pytest.mark.slow)])
def test_drops_survive_any_failure(tmp_path_factory: pytest.TempPathFactory, examples: int) -> None:
    @settings(max_examples=examples, deadline=None)
    @given(
        faults=st.lists(FAULTS, max_size=5),
        short=st.sampled_from([200, 1000, None]),
        step=st.integers(60, 150),
    )
    def check_any(faults: Any, short: int | None, step: int) -> None:
        check_faults(tmp_path_factory.mktemp("faults"), faults, short, step)

    check_any()


def check_faults(folder: Path, faults: Any, short: int | None, step: int) -> None:
    """Faults at any call, each lasting a few calls; every write may be short."""

    def fault(call: str, number: int) -> OSError | int | None:
        for begin, failure, length in faults:
            name, code = failure.split()
            if name == call and begin <= number < begin + length:
                return OSError(getattr(errno, code), "planted")
        return short if call == "write" else None

    storage = NotingStorage(folder, fault)
    rng = np.random.default_rng(0)
    digests: dict[int, str] = {}
    unsure: set[int] = set()
    acknowledged = 0
    for _ in range(3):  # the program is started again after whatever happened
        try:
            writer = open_survey(folder / "survey", storage=storage, reserve_bytes=1024)
        except RecordingError:
            continue
        with writer:
            # A drop that was given up may be there all the same, as it was.
            assert acknowledged <= writer.drops_acknowledged <= acknowledged + len(unsure)
            acknowledged = writer.drops_acknowledged
            storage.mark(acknowledged)
            unsure.clear()
            for _ in range(3):
                record = make_record(acknowledged + 1, rng, 24)
                digests[acknowledged + 1] = drop_digest(record, 0)
                unsure.add(acknowledged + 1)
                for _ in range(4):
                    try:
                        number = writer.save_drop(record)
                    except RecordingError:
                        continue
                    acknowledged += 1
                    assert number == acknowledged
                    unsure.clear()
                    storage.mark(acknowledged)
                    break
    recorded = Recorded(storage.notes, digests, 0)
    if acknowledged:
        assert len(read_survey(folder / "survey").drops) - acknowledged in (0, len(unsure))
    kills = replay_kills(recorded, step, step // 2)
    cuts = replay_power_cuts(recorded, 2, seed=step)
    assert (kills.losing, kills.unreadable, cuts.losing, cuts.unreadable) == (0, 0, 0, 0)


def test_the_reserve_saves_the_drop_in_hand(tmp_path: Path) -> None:
    """A disk that is full but for the reserve."""
    full = False

    def fault(call: str, _: int) -> OSError | int | None:
        if full and call == "write" and (tmp_path / "survey" / "reserve").exists():
            return OSError(errno.ENOSPC, "no space")
        return None

    storage = NotingStorage(tmp_path, fault)
    with open_survey(tmp_path / "survey", storage=storage, reserve_bytes=1024) as writer:
        full = True
        assert writer.save_drop(record_of(1)) == 1
    assert not (tmp_path / "survey" / "reserve").exists()
    assert check(tmp_path / "survey").ok


@pytest.mark.parametrize("call", ["write", "sync"])
def test_a_failed_start_can_be_repeated(tmp_path: Path, call: str) -> None:
    failed = 0
    for first in range(40):
        failing = [call]

        def fault(name: str, number: int, first: int = first, failing: Any = failing) -> Any:
            is_due = name in failing and number >= first
            return OSError(errno.EIO, "planted") if is_due else None

        folder = tmp_path / str(first)
        folder.mkdir()
        storage = NotingStorage(folder, fault)
        try:
            open_survey(folder / "survey", storage=storage).close()
        except RecordingError:
            failed += 1
        failing.clear()
        with open_survey(folder / "survey", storage=storage) as writer:
            assert writer.save_drop(record_of(1)) == 1
    assert 1 < failed < 40


def test_a_failed_sync_is_not_retried(tmp_path: Path, survey: Path) -> None:
    fail = 0

    def fault(call: str, _: int) -> OSError | int | None:
        nonlocal fail
        if fail and call == "sync":
            fail -= 1
            return OSError(errno.EIO, "planted")
        return None

    storage = NotingStorage(tmp_path, fault)
    with open_survey(survey, storage=storage) as writer:
        writer.save_drop(record_of(1))
        fail = 1
        assert writer.save_drop(record_of(2)) == 2
        fail = 2
        with pytest.raises(RecordingError, match="expected a disk that can be written"):
            writer.save_drop(record_of(3))
        assert writer.save_drop(record_of(3)) == 3
    assert len(list((survey / "journal").iterdir())) == 4
    assert check(survey).ok
    assert [drop.number for drop in read_survey(survey).drops] == [1, 2, 3]


class BrokenLedger(NotingStorage):
    """Refuses lines of the ledger as often as `failures` says."""

    failures = 0

    def pwrite(self, descriptor: int, data: memoryview, offset: int) -> int:
        if self.failures and self._paths[descriptor].name == "acknowledged.txt":
            self.failures -= 1
            raise OSError(errno.EIO, "planted")
        return super().pwrite(descriptor, data, offset)


def test_a_refused_line_leaves_no_record(tmp_path: Path, survey: Path) -> None:
    storage = BrokenLedger(tmp_path)
    with open_survey(survey, storage=storage) as writer:
        writer.save_drop(record_of(1))
        size = (journal_of(survey)).stat().st_size
        storage.failures = 1
        with pytest.raises(RecordingError, match="got 'planted'"):
            writer.save_drop(record_of(2))
        assert (journal_of(survey)).stat().st_size == size
        assert writer.drops_acknowledged == 1
        assert writer.save_drop(record_of(2)) == 2
    lines = (survey / "acknowledged.txt").read_bytes().splitlines()[1:]
    assert [int(line.split()[0]) for line in lines] == list(range(1, len(lines) + 1))
    assert check(survey).ok


@pytest.mark.parametrize("call", ["write", "sync"])
@pytest.mark.parametrize("later", range(3))
def test_an_interrupt_leaves_journal_and_ledger_intact(
    tmp_path: Path, survey: Path, call: str, later: int
) -> None:
    remaining: list[int] = []

    def fault(name: str, _: int) -> OSError | int | None:
        if remaining and name == call:
            remaining[0] -= 1
            if remaining[0] < 0:
                remaining.clear()
                raise KeyboardInterrupt
        return None

    storage = NotingStorage(tmp_path, fault)
    with open_survey(survey, storage=storage) as writer:
        writer.save_drop(record_of(1))
        remaining.append(later)
        for _ in range(2):
            try:
                writer.save_drop(record_of(2))
                writer.save_check({"zero": 0})
            except KeyboardInterrupt:
                continue
        assert writer.save_drop(record_of(3)) == 3
    assert check(survey).damaged == ()
    assert [drop.number for drop in read_survey(survey).drops] == [1, 2, 3]


def test_a_new_file_and_a_new_folder_survive_power_cuts(tmp_path: Path) -> None:
    storage = NotingStorage(tmp_path)
    storage.write_file(tmp_path / "a.json", b"x" * 2000)
    storage.write_file(tmp_path / "a.json", b"y" * 2000)
    disk = Disk()
    for note in storage.notes:
        disk.follow(note)
    states = [disk.power_cut(np.random.default_rng(seed)) for seed in range(20)]
    assert states == [{"a.json": b"y" * 2000}] * 20
    storage = NotingStorage(tmp_path)
    storage.make_folder(tmp_path / "a" / "b")
    disk = Disk()
    for note in storage.notes:
        disk.follow(note)
    assert disk.power_cut(np.random.default_rng(0)) == {"a": None, "a/b": None}
