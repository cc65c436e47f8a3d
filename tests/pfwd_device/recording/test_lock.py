"""One writer, any number of readers."""

import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pfwd_device.errors import SurveyLocked
from pfwd_device.recording import SurveyWriter, check, read_survey, recover
from tests.campaigns.power_loss import make_record

TOP = Path(__file__).resolve().parents[3]

READER = """
import sys
from pfwd_device.recording import check, read_survey
last = looks = 0
while last < 60:
    survey = read_survey(sys.argv[1])
    drops = survey.drops
    assert len(drops) >= last, (len(drops), last)
    assert survey.damage == (), survey.damage
    if drops:
        assert drops[-1].read().point == drops[-1].point
        report = check(sys.argv[1])
        assert report.ok, report.damaged
    last = len(drops)
    looks += 1
print(looks)
"""


def test_a_second_writer_learns_who_is_first(tmp_path: Path) -> None:
    with SurveyWriter.open(tmp_path, publish=False, reserve_bytes=0):
        for action in (SurveyWriter.open, recover):
            with pytest.raises(
                SurveyLocked, match=rf"got another: pid {os.getpid()}, host .*since"
            ):
                action(tmp_path)
    with SurveyWriter.open(tmp_path, publish=False):
        pass


def test_a_stale_name_locks_nothing(tmp_path: Path, new_survey: Callable[..., object]) -> None:
    new_survey()
    (tmp_path / "survey" / "writer.txt").write_text("pid 1\nhost other\nsince ever\n")
    with SurveyWriter.open(tmp_path / "survey", publish=False) as writer:
        assert writer.drops_acknowledged == 3


def test_a_hostile_name_is_made_harmless(tmp_path: Path) -> None:
    with SurveyWriter.open(tmp_path, publish=False, reserve_bytes=0):
        (tmp_path / "writer.txt").write_bytes(b"pid \x1b]0;OWNED\x07" + b"x" * 5000)
        with pytest.raises(SurveyLocked) as caught:
            SurveyWriter.open(tmp_path)
        assert "\x1b" not in str(caught.value)
        assert len(str(caught.value)) < 600
        (tmp_path / "writer.txt").unlink()
        with pytest.raises(SurveyLocked, match="its name is unknown"):
            SurveyWriter.open(tmp_path)


def test_a_check_meanwhile_names_no_damage(tmp_path: Path) -> None:
    with SurveyWriter.open(tmp_path, publish=False, reserve_bytes=0) as writer:
        writer.save_drop(make_record(1, np.random.default_rng(1)))
        report = check(tmp_path)
        assert report.ok
        assert "a program is writing the survey" in report.notes
        writer.save_drop(make_record(2, np.random.default_rng(2)))


def test_a_line_that_is_being_written_is_no_damage(tmp_path: Path) -> None:
    with SurveyWriter.open(tmp_path, publish=False, reserve_bytes=0) as writer:
        writer.save_drop(make_record(1, np.random.default_rng(1)))
        with (tmp_path / "acknowledged.txt").open("ab") as stream:
            stream.write(b"4 2 1")
        report = check(tmp_path)
        assert report.ok
        assert any("acknowledged.txt, line" in note for note in report.notes)
    assert not check(tmp_path).ok


def test_recovery_waits_for_the_publisher_of_a_killed_program(
    tmp_path: Path, new_survey: Callable[..., object]
) -> None:
    new_survey()
    code = (
        "import sys, time; from filelock import FileLock; lock = FileLock(sys.argv[1]); "
        "lock.acquire(); print('held', flush=True); time.sleep(0.5)"
    )
    lock = str(tmp_path / "survey" / "publish.lock")
    with subprocess.Popen(
        [sys.executable, "-c", code, lock], stdout=subprocess.PIPE, text=True
    ) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        begun = time.monotonic()
        assert recover(tmp_path / "survey").ok
        assert time.monotonic() - begun > 0.3


def test_two_programs_read_while_one_writes(tmp_path: Path) -> None:
    with SurveyWriter.open(tmp_path / "survey", reserve_bytes=0) as writer:
        readers = [
            subprocess.Popen(
                [sys.executable, "-c", READER, str(tmp_path / "survey")],
                cwd=TOP,
                stdout=subprocess.PIPE,
                text=True,
            )
            for _ in range(2)
        ]
        for number in range(1, 61):
            saved = writer.save_drop(make_record(number, np.random.default_rng(number)))
            writer.publish(saved)
            time.sleep(0.02)
        looks = [reader.communicate(timeout=60)[0] for reader in readers]
    assert [reader.returncode for reader in readers] == [0, 0]
    assert all(int(text) >= 3 for text in looks)
    assert len(read_survey(tmp_path / "survey").drops) == 60
