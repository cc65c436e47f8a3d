"""One writer, any number of readers."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from pfwd_device.errors import SurveyLocked
from pfwd_device.recording import SurveyWriter, check, read_survey, recover
from tests.pfwd_device.recording.records import make_survey, open_survey, record_of

TOP = Path(__file__).resolve().parents[3]

N_READ_DROPS = 20
READER = f"""
import sys
from pfwd_device.recording import check, read_survey
last = 0
while last < {N_READ_DROPS}:
    survey = read_survey(sys.argv[1])
    drops = survey.drops
    assert len(drops) >= last, (len(drops), last)
    assert survey.damage == (), survey.damage
    if drops:
        assert drops[-1].read().point == drops[-1].point
        report = check(sys.argv[1])
        assert report.ok, report.damaged
    last = len(drops)
    print(last, flush=True)
"""


def test_a_second_writer_learns_who_is_first(tmp_path: Path) -> None:
    with open_survey(tmp_path):
        for action in (SurveyWriter.open, recover):
            with pytest.raises(SurveyLocked, match=f"pid {os.getpid()}, host .*since"):
                action(tmp_path)
    with open_survey(tmp_path):
        pass


def test_a_stale_name_does_not_lock(tmp_path: Path) -> None:
    make_survey(tmp_path / "survey")
    (tmp_path / "survey" / "writer.txt").write_text("pid 1\nhost other\nsince ever\n")
    with open_survey(tmp_path / "survey") as writer:
        assert writer.drops_acknowledged == 3


def test_a_hostile_name_is_made_harmless(tmp_path: Path) -> None:
    with open_survey(tmp_path):
        (tmp_path / "writer.txt").write_bytes(b"pid \x1b]0;OWNED\x07" + b"x" * 5000)
        with pytest.raises(SurveyLocked) as caught:
            SurveyWriter.open(tmp_path)
        assert "\x1b" not in str(caught.value)
        assert len(str(caught.value)) < 600
        (tmp_path / "writer.txt").unlink()
        with pytest.raises(SurveyLocked, match="its name is unknown"):
            SurveyWriter.open(tmp_path)


def test_a_line_that_is_being_written_is_no_damage(tmp_path: Path) -> None:
    with open_survey(tmp_path) as writer:
        writer.save_drop(record_of(1))
        with (tmp_path / "acknowledged.txt").open("ab") as stream:
            stream.write(b"4 2 1")
        report = check(tmp_path)
        assert report.ok
        assert "a program is writing the survey" in report.notes
        assert any("acknowledged.txt, line" in note for note in report.notes)
    assert not check(tmp_path).ok


def test_recovery_waits_for_an_old_publisher(tmp_path: Path) -> None:
    make_survey(tmp_path / "survey")
    code = (
        "import sys, time; from filelock import FileLock; lock = FileLock(sys.argv[1]); "
        "lock.acquire(); print('held', flush=True); sys.stdin.readline()"
    )
    lock = str(tmp_path / "survey" / "publish.lock")
    command = [sys.executable, "-c", code, lock]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as holder, ThreadPoolExecutor() as pool:
        holder.stdout.readline()
        recovery = pool.submit(recover, tmp_path / "survey")
        with pytest.raises(TimeoutError):
            recovery.result(0.3)
        holder.communicate("\n")
        assert recovery.result(60).ok


def test_two_programs_read_during_writing(tmp_path: Path) -> None:
    """Each program reads at least once after every drop."""
    with SurveyWriter.open(tmp_path / "survey", reserve_bytes=0) as writer:
        command = [sys.executable, "-c", READER, str(tmp_path / "survey")]
        readers = [
            subprocess.Popen(command, cwd=TOP, stdout=subprocess.PIPE, text=True) for _ in range(2)
        ]
        for number in range(1, N_READ_DROPS + 1):
            writer.publish(writer.save_drop(record_of(number)))
            for reader in readers:
                reader.stdout.readline()
        for reader in readers:
            reader.communicate(timeout=60)
    assert [reader.returncode for reader in readers] == [0, 0]
    assert len(read_survey(tmp_path / "survey").drops) == N_READ_DROPS
