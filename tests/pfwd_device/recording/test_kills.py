"""Real processes, killed; real limits of the system.

A limit on files, a small disk to mount and SIGINT are POSIX's. Kills run everywhere, and a disk
that is full, fails or forgets is played on every platform by test_faults.py.
"""

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pfwd_device.recording import check, read_survey
from pfwd_device.recording.drop_file import drop_digest
from tests.campaigns.power_loss import lost_drops
from tests.pfwd_device.recording.records import open_survey, record_of

TOP = Path(__file__).resolve().parents[3]

WRITER = """
import signal
import sys
import numpy as np
from tests.campaigns.power_loss import make_record
from pfwd_device.recording import SurveyWriter
# A run in the background would ignore it.
signal.signal(signal.SIGINT, signal.default_int_handler)
with SurveyWriter.open(sys.argv[1], publish=sys.argv[2] == "publish") as writer:
    print("open", flush=True)
    number = writer.drops_acknowledged
    while True:
        number += 1
        saved = writer.save_drop(make_record(number, np.random.default_rng(number), 4096))
        writer.publish(saved)
        print(saved, flush=True)
"""


def digests(count: int) -> dict[int, str]:

    return {number: drop_digest(record_of(number, 4096), 0) for number in range(1, count + 1)}


def start(code: str, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments], cwd=TOP, stdout=subprocess.PIPE, text=True
    )


def run_and_kill(survey: Path, drops: int, delay: float, publish: bool) -> int:
    """The last drop that was acknowledged before the kill, a time after so many drops."""
    with start(WRITER, str(survey), "publish" if publish else "no") as child:
        assert child.stdout.readline() == "open\n"
        lines = [child.stdout.readline() for _ in range(drops)]
        time.sleep(delay)
        child.kill()
        lines += child.stdout.read().split()
    return int(lines[-1]) if lines else 0


@pytest.mark.parametrize("kills", [3, pytest.param(100, marks=pytest.mark.slow)])
def test_a_killed_program_loses_no_drop(tmp_path: Path, kills: int) -> None:
    chance = random.Random(kills)
    acknowledged = 0
    for kill in range(kills):
        last = run_and_kill(tmp_path / "survey", kill % 3, chance.uniform(0.0, 0.05), kill % 2 == 0)
        # A drop may be safe whose number was not printed any more.
        acknowledged = max(acknowledged, last)
        survey = read_survey(tmp_path / "survey")
        assert len(survey.drops) >= acknowledged
        assert survey.damage == ()
    assert acknowledged >= kills
    assert lost_drops(tmp_path, acknowledged, digests(acknowledged)) == []
    report = check(tmp_path / "survey")
    assert report.ok
    assert report.notes == ()
    assert report.drops_published == report.drops_acknowledged


LIMITED = """
import resource, signal, sys
import numpy as np
from tests.campaigns.power_loss import make_record
from pfwd_device.errors import StorageFull
from pfwd_device.recording import SurveyWriter
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
with SurveyWriter.open(sys.argv[1], publish=False, reserve_bytes=100_000) as writer:
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), hard))
    full = 0
    number = 1
    while number <= 30:
        try:
            record = make_record(number, np.random.default_rng(number), 4096)
            print(writer.save_drop(record), flush=True)
            number += 1
        except StorageFull as err:
            assert "expected free space on the disk, got 'File too large'" in str(err), err
            full += 1
            if full == 3:  # space is freed, and the work goes on
                resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))
    assert full == 3
"""


@pytest.mark.posix
def test_the_longest_file_of_the_system_is_survived(tmp_path: Path) -> None:
    with start(LIMITED, str(tmp_path / "survey"), "700007") as child:
        lines = child.stdout.read().split()
    assert child.returncode == 0
    assert lines == [str(number) for number in range(1, 31)]
    assert check(tmp_path / "survey").ok
    assert lost_drops(tmp_path, 30, digests(30)) == []


@pytest.mark.posix
def test_a_full_disk_is_survived(tmp_path: Path) -> None:
    """A tmpfs of 2 MB; needs the right to mount."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk)]
    try:
        mounted = subprocess.run(mount, capture_output=True, timeout=10).returncode == 0
    except (OSError, subprocess.TimeoutExpired):
        mounted = False
    if not mounted:
        pytest.skip("mounting a small disk is not allowed here")
    try:
        fill_and_free(disk)
    finally:
        subprocess.run(["umount", str(disk)], check=True, timeout=10)


def fill_and_free(disk: Path) -> None:

    from pfwd_device.errors import StorageFull

    ballast = disk / "ballast"
    ballast.write_bytes(bytes(700_000))
    refused = 0
    number = 1
    with open_survey(disk / "survey", reserve_bytes=300_000, publish=True) as writer:
        while number <= 12:
            record = record_of(number, 4096)
            try:
                assert writer.save_drop(record) == number
                writer.publish(number)
                number += 1
            except StorageFull:
                refused += 1
                assert refused < 50
                if refused == 2:
                    assert not (disk / "survey" / "reserve").exists()
                    ballast.unlink()
                if refused > 2:
                    break
    assert refused >= 2
    assert number > 4
    assert lost_drops(disk, number - 1, digests(number - 1)) == []


@pytest.mark.posix
def test_an_interrupt_ends_the_writer_in_order(tmp_path: Path) -> None:
    with start(WRITER, str(tmp_path / "survey"), "publish") as child:
        for _ in range(4):
            child.stdout.readline()
        child.send_signal(signal.SIGINT)
        child.stdout.read()
    report = check(tmp_path / "survey")
    assert report.closed
    assert report.ok
    assert report.drops_published == report.drops_acknowledged
