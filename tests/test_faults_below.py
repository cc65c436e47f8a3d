"""The campaign below all code notices: its judge, its library in C, and bugs put in on purpose."""

import dataclasses
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from tests.campaigns.below import replacements, sweep
from tests.campaigns.below.campaign import run
from tests.campaigns.below.driver import LONGEST
from tests.campaigns.below.judge import ACKNOWLEDGED, REPLACED, WARNED, Outcome, Said, judge
from tests.campaigns.below.quick import Driver, driver, trial
from tests.campaigns.below.shim import (
    CALLS,
    FOR_EVER,
    KINDS,
    SHARE,
    Fault,
    compile_shim,
    environment,
    read_state,
    why_not,
)

REASON = why_not()
# These plant faults under the C library by a preloaded shim: that takes Linux and a C compiler. A
# machine without says which it lacks; nothing that a user runs depends on it.
below = pytest.mark.skipif(REASON is not None, reason=str(REASON))


def saved(*numbers: int) -> list[Said]:
    return [Said(ACKNOWLEDGED, f"drop 1/{number}") for number in numbers]


def names(*numbers: int) -> list[str]:
    return [f"drop 1/{number}" for number in numbers]


WARNING = Said(WARNED, "NOT SAFE: drop 1/1")
OTHERS = Said(REPLACED, "")


class TestJudge:
    def test_all_found_is_good(self) -> None:
        assert judge(Outcome(said=saved(1, 2), found=names(1, 2), whole=True)).good

    def test_more_found_than_acknowledged_is_good(self) -> None:
        # Saved, and killed before it was said.
        assert judge(Outcome(said=saved(1), found=names(1, 2), whole=True)).good

    def test_a_loss_without_a_word(self) -> None:
        verdict = judge(Outcome(said=saved(1, 2), found=names(2), whole=False))
        assert verdict.faults == ("lost",)
        assert verdict.lost == ("drop 1/1",)

    def test_a_loss_that_is_called_whole(self) -> None:
        verdict = judge(Outcome(said=[*saved(1), WARNING], found=[], whole=True))
        assert verdict.faults == ("called whole",)

    def test_a_note_counts_like_a_drop(self) -> None:
        said = [*saved(1), Said(ACKNOWLEDGED, "note 1")]
        assert judge(Outcome(said=said, found=names(1), whole=False)).lost == ("note 1",)

    def test_a_warning_has_to_come_before_the_next_drop(self) -> None:
        assert judge(Outcome(said=[*saved(1), WARNING, *saved(2)], found=names(2))).good
        late = Outcome(said=[*saved(1, 2), WARNING], found=names(2))
        assert judge(late).faults == ("lost",)

    def test_after_a_replacement_the_drop_in_flight_may_still_come(self) -> None:
        early = [*saved(1, 2), OTHERS, *saved(3), WARNING, *saved(4)]
        assert judge(Outcome(said=early, found=names(4))).good
        late = [*saved(1, 2), OTHERS, *saved(3, 4), WARNING]
        assert judge(Outcome(said=late, found=names(4))).faults == ("lost",)

    def test_what_was_acknowledged_after_a_replacement_has_no_such_grace(self) -> None:
        said = [*saved(1), OTHERS, *saved(2, 3), WARNING, *saved(4)]
        assert "drop 1/2" in judge(Outcome(said=said, found=names(1, 3, 4))).details[0]
        assert judge(Outcome(said=said, found=names(1, 2, 4))).good

    def test_the_end_of_the_program_is_time_enough_to_warn(self) -> None:
        said = [*saved(1, 2), OTHERS]
        assert judge(Outcome(said=said, found=names(2))).faults == ("lost",)
        assert judge(Outcome(said=said, found=names(2), killed=True, status=-9)).good

    def test_twice(self) -> None:
        assert judge(Outcome(said=saved(1), found=names(1, 1))).faults == ("twice",)

    def test_not_whole_although_nothing_is_missing(self) -> None:
        outcome = Outcome(said=saved(1), found=names(1), whole=False)
        assert judge(outcome).faults == ("not whole",)
        assert judge(dataclasses.replace(outcome, gone=True)).good

    def test_a_survey_that_cannot_be_read(self) -> None:
        outcome = Outcome(said=saved(1), found=names(1), refusal="no survey")
        assert judge(outcome).faults == ("unreadable",)
        assert judge(dataclasses.replace(outcome, gone=True)).good
        assert judge(Outcome(refusal="no survey")).good

    @pytest.mark.parametrize(
        ("outcome", "fault"),
        [
            (Outcome(status=None), "hang"),
            (Outcome(later_statuses=(0, -1)), "hang"),
            (Outcome(status=-11), "status"),
            (Outcome(later_statuses=(0, 4)), "status"),
            (Outcome(output="Traceback (most recent call last):\n  ...\nOSError: x"), "traceback"),
            (Outcome(output="pfwd: log: an error nobody foresaw, please"), "traceback"),
            (Outcome(output="escaped: OSError: x"), "escaped"),
            (Outcome(said=[WARNING], harmless=True), "warned without need"),
        ],
    )
    def test_how_a_program_may_not_end(self, outcome: Outcome, fault: str) -> None:
        assert judge(outcome).faults == (fault,)

    def test_a_kill_is_no_status_of_the_program(self) -> None:
        assert judge(Outcome(status=-9, killed=True)).good


COUNTS = {("write", "journal"): 20, ("fdatasync", "journal"): 20, ("stat", "folder"): 3}


class TestSweep:
    def test_every_call_comes_once_before_others_are_drawn(self) -> None:
        rng = np.random.default_rng(0)
        found = sweep.faults(COUNTS, 400, rng)
        single = [fault for fault in found if len(fault.calls) == 1]
        assert {(fault.calls[0], fault.kinds[0]) for fault in found[:6]} >= {("stat", "folder")}
        assert len({(fault.calls[0], fault.at) for fault in single}) == 43
        for fault in single:
            assert 1 <= fault.at <= COUNTS[fault.calls[0], fault.kinds[0]]
        assert {fault.mode for fault in found} == {"error", "torn", "short", "done", "forget"}
        assert {1, FOR_EVER} < {fault.times for fault in found}

    def test_the_same_seed_gives_the_same_faults(self) -> None:
        first, second = (sweep.faults(COUNTS, 50, np.random.default_rng(7)) for _ in range(2))
        assert first == second


def run_below(library: Path, folder: Path, fault: Fault, code: str) -> list[str]:
    """What a few lines of Python say whose files in the folder fail."""
    state = folder.parent / "state"
    state.unlink(missing_ok=True)  # of the run before, whose calls would be counted on
    armed = fault.text((folder,), state, folder.parent / "fired")
    done = subprocess.run(
        [sys.executable, "-c", code, str(folder)],
        capture_output=True,
        text=True,
        check=True,
        env=environment(library, armed),
    )
    return done.stdout.split()


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if REASON is not None:
        pytest.skip(REASON)
    return compile_shim(tmp_path_factory.mktemp("library"))


@pytest.fixture
def files(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path.resolve() / "survey"
    (folder / "journal").mkdir(parents=True)
    yield folder
    assert (tmp_path / "fired").exists()


WRITE = """
import errno, os, sys
path = sys.argv[1] + "/journal/0001.pfwdj"
fd = os.open(path, os.O_RDWR | os.O_CREAT)
for n in range(4):
    try:
        print(os.pwrite(fd, bytes(10), 10 * n))
        os.fdatasync(fd)
    except OSError as err:
        print(errno.errorcode[err.errno], os.path.getsize(path))
"""


@below
class TestLibrary:
    @pytest.mark.parametrize("call", ["write", "fdatasync"])
    def test_the_nth_call_fails_and_the_others_do_not(
        self, library: Path, files: Path, call: str
    ) -> None:
        said = run_below(library, files, Fault((call,), ("journal",), 3), WRITE)
        expected = {
            "write": ["10", "10", "EIO", "20", "10"],
            "fdatasync": ["10", "10", "10", "EIO", "30", "10"],
        }
        assert said == expected[call]
        counted = read_state(files.parent / "state")
        assert (counted.fired, counted.counts["write", "journal"]) == (1, 4)
        assert f" {call} journal 3 " in (files.parent / "fired").read_text()

    def test_for_ever(self, library: Path, files: Path) -> None:
        fault = Fault(("write",), ("journal",), 2, FOR_EVER, "ENOSPC")
        assert run_below(library, files, fault, WRITE) == ["10", *["ENOSPC", "10"] * 3]

    def test_torn_and_short_writes(self, library: Path, files: Path) -> None:
        torn = Fault(("write",), ("journal",), 2, mode="torn", amount=4)
        assert run_below(library, files, torn, WRITE)[:3] == ["10", "EIO", "14"]
        short = Fault(("write",), ("journal",), 2, mode="short", amount=SHARE + 500)
        assert run_below(library, files, short, WRITE)[:3] == ["10", "5", "10"]

    def test_a_sync_that_fails_forgets_what_was_not_synced(
        self, library: Path, files: Path
    ) -> None:
        fault = Fault(("fdatasync",), ("journal",), 3, mode="forget")
        said = run_below(library, files, fault, WRITE.replace("bytes(10)", "b'0123456789'"))
        assert said[3:5] == ["EIO", "30"]
        content = (files / "journal" / "0001.pfwdj").read_bytes()
        assert content == b"0123456789" * 2 + bytes(10) + b"0123456789"

    def test_done_and_yet_refused(self, library: Path, files: Path) -> None:
        (files / "a").touch()
        code = (
            "import os, sys\nos.chdir(sys.argv[1])\n"
            "try: os.replace('a', 'acknowledged.txt')\nexcept OSError as err: print(err.errno)\n"
            "print(*os.listdir())"
        )
        fault = Fault(("rename",), ("ledger",), 1, error="ESTALE", mode="done")
        said = run_below(library, files, fault, code)
        assert set(said) == {"116", "acknowledged.txt", "journal"}

    @pytest.mark.parametrize(
        ("call", "code"),
        [
            ("open", "os.open(f, os.O_RDONLY)"),
            ("create", "os.open(f + 'x', os.O_RDWR | os.O_CREAT)"),
            ("read", "open(f, 'rb', 0).read(1)"),
            ("fsync", "os.fsync(os.open(f, os.O_RDWR))"),
            ("truncate", "os.ftruncate(os.open(f, os.O_RDWR), 0)"),
            ("rename", "os.replace(f, f + 'x')"),
            ("link", "os.link(f, f + 'x')"),
            ("unlink", "os.unlink(f)"),
            ("mkdir", "os.mkdir(f + 'x')"),
            ("stat", "os.stat(f)"),
            ("fstat", "os.fstat(os.open(f, os.O_RDWR))"),
            ("lock", "fcntl.flock(os.open(f, os.O_RDWR), fcntl.LOCK_EX)"),
            ("list", "os.listdir(sys.argv[1] + '/journal')"),
            ("close", "os.close(os.open(f, os.O_RDWR))"),
            ("space", "os.statvfs(f)"),
        ],
    )
    def test_every_call_can_fail(self, library: Path, files: Path, call: str, code: str) -> None:
        (files / "journal" / "1").write_bytes(b"content")
        kinds = ("folder",) if call == "list" else ("journal",)
        code = (
            "import errno, fcntl, os, sys\nf = sys.argv[1] + '/journal/1'\n"
            f"try: {code}\nexcept OSError as err: print(errno.errorcode[err.errno])"
        )
        fault = Fault((call,), kinds, 1, error="EDQUOT")
        assert run_below(library, files, fault, code) == ["EDQUOT"]

    def test_all_calls_are_tried(self) -> None:
        tried = {mark.args[1][n][0] for mark in _marks() for n in range(len(mark.args[1]))}
        assert tried | {"write", "fdatasync"} == set(CALLS)


def _marks() -> list[pytest.Mark]:
    marks: list[pytest.Mark] = TestLibrary.test_every_call_can_fail.pytestmark  # type: ignore[attr-defined]
    return marks


@below
def test_files_elsewhere_are_left_alone(library: Path, tmp_path: Path) -> None:
    fault = Fault(CALLS, KINDS, 1, FOR_EVER)
    armed = fault.text((tmp_path / "survey",), tmp_path / "state", tmp_path / "fired")
    code = f"open({str(tmp_path / 'survey-2')!r}, 'w').write('x')"
    subprocess.run([sys.executable, "-c", code], check=True, env=environment(library, armed))
    assert read_state(tmp_path / "state").fired == 0


PLANTED = [
    ("ignore-sync-errors", Fault(("fdatasync",), ("journal",), 8, 2, mode="forget")),
    ("ignore-journal-sync", Fault(("fdatasync",), ("journal",), 8, 2, mode="forget")),
    ("acknowledge-refused", Fault(("write",), ("journal",), 20, FOR_EVER, "ENOSPC")),
]


@below
@pytest.mark.parametrize(("bug", "fault"), PLANTED, ids=[bug for bug, _ in PLANTED])
def test_a_planted_bug_is_noticed(library: Path, tmp_path: Path, bug: str, fault: Fault) -> None:
    for planted in ("", bug):
        folder = tmp_path.resolve() / (planted or "none")
        folder.mkdir()
        with driver(library, planted) as process:
            outcome, counted = trial(process, folder, fault, "close", 0)
        assert counted.fired > 0
        verdict = judge(outcome)
        assert ("lost" in verdict.faults) == bool(planted), verdict


@below
def test_a_driver_that_hangs_is_told(
    library: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PFWD_BELOW_LONGEST", "0.5")
    assert LONGEST > 1.0
    process = Driver(library)
    slow = Fault(("fdatasync",), ("journal",), 1, mode="slow", amount=20_000)
    outcome, _ = trial(process, tmp_path, slow, "close", 0)
    process.close()
    assert "hang" in judge(outcome).faults


OTHERS_NEEDED = {"second logger", *replacements.NEED_MOUNT}
"""These need a disk or an instrument; the campaign itself fails when they cannot be made."""


@below
@pytest.mark.parametrize("name", sorted(set(replacements.REPLACEMENTS) - OTHERS_NEEDED))
def test_a_replacement_can_be_made(name: str, tmp_path: Path) -> None:
    survey = tmp_path / "work" / "survey"
    for path in ("journal/0001.pfwdj", "acknowledged.txt", "survey.lock", "drops/1.h5", "log/a"):
        (survey / path).parent.mkdir(parents=True, exist_ok=True)
        (survey / path).write_bytes(path.encode() * 20)
    older = tmp_path / "older"
    (older / "journal").mkdir(parents=True)
    (older / "journal" / "0001.pfwdj").write_bytes(b"old")
    rng = np.random.default_rng(0)
    scene = replacements.Scene(tmp_path, survey, older, rng, "no url")
    before = _state_of(survey)
    replacements.REPLACEMENTS[name].do(scene)
    changed = _state_of(survey) != before
    for undo in scene.undo:
        undo()
    assert changed != replacements.REPLACEMENTS[name].harmless


def _state_of(folder: Path) -> object:
    paths = [folder.parent, folder, *sorted(folder.rglob("*"))] if folder.exists() else []
    found = [(path, path.stat(), _content(path)) for path in paths]
    return [(path, said.st_ino, said.st_size, said.st_mode, data) for path, said, data in found]


def _content(path: Path) -> bytes | None:
    try:
        return path.read_bytes() if path.is_file() else None
    except PermissionError:
        return None


def test_where_it_cannot_be_done_it_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("tests.campaigns.below.campaign.why_not", lambda: "expected Linux")
    assert run(["--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"skipped": "expected Linux"}
