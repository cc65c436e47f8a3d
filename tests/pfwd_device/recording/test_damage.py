"""Damage of single files: seen by check, survived by readers, mended where a second copy is."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pfwd_device.errors import RecordingError
from pfwd_device.jobs import Jobs
from pfwd_device.recording import (
    DropRecord,
    RecoveryReport,
    Storage,
    SurveyWriter,
    check,
    read_survey,
    recover,
)
from pfwd_device.recording.drop_file import drop_digest
from pfwd_device.recording.framing import RecordKind
from tests.campaigns.power_loss import make_record
from tests.pfwd_device.recording.records import a_rebound, scan_bytes

NewSurvey = Callable[..., dict[int, str]]

# Locks, the holder's name and the reserve say nothing of what was recorded.
UNIMPORTANT = {"survey.lock", "publish.lock", "writer.txt", "reserve"}


def content(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in UNIMPORTANT
    }


def mend(folder: Path) -> RecoveryReport:
    return recover(folder, jobs=Jobs(0))


def found(folder: Path) -> dict[int, str]:
    """Digests of the drops that can be read."""
    digests = {}
    for drop in read_survey(folder).drops:
        try:
            record = drop.read()
        except RecordingError:
            continue
        digests[drop.number] = drop_digest(record, 0)
    return digests


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    """A survey of one drop in a few hundred bytes, published, closed."""
    with SurveyWriter.open(tmp_path / "tiny", jobs=Jobs(0), reserve_bytes=0) as writer:
        writer.save_drop(make_record(1, np.random.default_rng(1), 2))
        writer.save_result(1, {"a": 1})
        writer.open_capture("x", {}).write("from", b"abc")
    return tmp_path / "tiny"


def damages(data: bytes, step: int) -> Iterator[bytes]:
    for position in range(0, len(data), step):
        broken = bytearray(data)
        broken[position] ^= 1 << position % 8
        yield bytes(broken)
        yield data[:position]
    yield data + b"\0"
    yield data[:-1]


def test_check_sees_any_damage_of_any_file(tiny: Path) -> None:
    assert check(tiny).ok
    files = content(tiny)
    assert {name.split("/")[0] for name in files} == {
        "journal",
        "acknowledged.txt",
        "drops",
        "results",
        "captures",
    }
    for name, data in files.items():
        for broken in damages(data, 7 if len(data) < 5000 else 997):
            (tiny / name).write_bytes(broken)
            report = check(tiny)
            assert report.damaged, name
            assert not report.ok
        (tiny / name).unlink()
        assert check(tiny).damaged
        (tiny / name).write_bytes(data)
        assert check(tiny).ok


@pytest.mark.slow
def test_check_sees_every_bit_of_the_journal_and_the_ledger(tiny: Path) -> None:
    for name in ("journal/0001.pfwdj", "acknowledged.txt"):
        data = (tiny / name).read_bytes()
        for bit in range(8 * len(data)):
            broken = bytearray(data)
            broken[bit // 8] ^= 1 << bit % 8
            (tiny / name).write_bytes(broken)
            assert check(tiny).damaged
        (tiny / name).write_bytes(data)


@pytest.mark.parametrize("step", [61, pytest.param(5, marks=pytest.mark.slow)])
def test_one_damaged_file_costs_no_published_drop(
    tmp_path: Path, new_survey: NewSurvey, step: int
) -> None:
    original = tmp_path / "survey"
    digests = new_survey(drops=2)
    copy = tmp_path / "copy"
    for name, data in content(original).items():
        # A drop file is whole or not, wherever it was hit.
        for broken in damages(data, 97 * step if name.endswith(".h5") else 5 * step):
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(original, copy)
            (copy / name).write_bytes(broken)
            assert found(copy) == digests, name
            report = mend(copy)
            assert found(copy) == digests, name
            lost = [text for text in report.damaged if "drop" in text and "drops" not in text]  # type: ignore[attr-defined]
            assert lost == [], name
            after = check(copy)
            assert after.damaged == report.damaged, name  # type: ignore[attr-defined]
            assert after.drops_published == 2
            second = mend(copy)
            assert second.actions == ()  # type: ignore[attr-defined]
            if broken:
                kept = b"".join(path.read_bytes() for path in (copy / "damaged").iterdir())
                assert name.startswith("captures") or len(kept) > 0 or _in_place(copy, name, broken)


def _in_place(folder: Path, name: str, broken: bytes) -> bool:
    """Nothing was cut: the damaged bytes still are where they were, or lines were only missing."""
    data = (folder / name).read_bytes()
    return data.startswith(broken) or name.startswith("journal") or broken in data


def test_a_drop_lost_in_both_places_is_named_by_its_number(
    tmp_path: Path, new_survey: NewSurvey
) -> None:
    digests = new_survey(drops=3)
    survey = tmp_path / "survey"
    flip_drop(survey, 2)
    (survey / "drops" / "drop-000002.h5").unlink()
    before = check(survey)
    assert any("drop P 1/2" in text for text in before.damaged)
    report = recover(survey, jobs=Jobs(0))
    assert report.damaged == ("drop P 1/2 is lost",)
    assert (report.drops_acknowledged, report.drops_published) == (3, 2)
    assert not report.ok
    assert found(survey) == {n: d for n, d in digests.items() if n != 2}
    assert read_survey(survey).damage == ("drop P 1/2 is lost",)
    again = check(survey)
    assert "drop P 1/2 is lost" in again.damaged
    assert again.drops_acknowledged == 3
    with SurveyWriter.open(survey, publish=False) as writer:
        assert writer.next_number("P 1") == 4
        with pytest.raises(RecordingError, match="the next free number is 4"):
            writer.save_drop(DropRecord("P 1", make_record(2, np.random.default_rng(2)).drop))
        # The instrument still has it: it is taken anew.
        record = make_record(4, np.random.default_rng(4))
        assert writer.save_drop(record) == 4


def test_a_damaged_drop_is_restored_from_its_file(tmp_path: Path, new_survey: NewSurvey) -> None:
    digests = new_survey(drops=3)
    survey = tmp_path / "survey"
    flip_drop(survey, 3)
    assert {d.number: d.source for d in read_survey(survey).drops} == {
        1: "journal",
        2: "journal",
        3: "file",
    }
    report = recover(survey)  # with the child process
    assert report.recovered == 1
    assert report.ok
    assert "drop 3 restored from its file" in report.actions
    assert {d.source for d in read_survey(survey).drops} == {"journal"}
    assert found(survey) == digests
    assert check(survey).ok
    assert check(survey).recovered == 1


def test_a_survey_of_drop_files_alone_comes_back(tmp_path: Path, new_survey: NewSurvey) -> None:
    digests = new_survey(drops=3)
    survey = tmp_path / "survey"
    identity = read_survey(survey).survey_id
    shutil.rmtree(survey / "journal")
    (survey / "acknowledged.txt").unlink()
    assert found(survey) == digests
    assert recover(survey, jobs=Jobs(0)).recovered == 3
    assert found(survey) == digests
    assert read_survey(survey).survey_id == identity
    assert check(survey).ok


def test_files_that_nobody_listed_are_named(tmp_path: Path, new_survey: NewSurvey) -> None:
    new_survey()
    survey = tmp_path / "survey"
    (survey / "drops" / ".drop-000009.h5.tmp").write_bytes(b"half")
    (survey / "results" / "drop-000002-1.json").write_bytes(b"{}")
    (survey / "drops" / "drop-000009.h5").write_bytes(b"what is this")
    assert check(survey).damaged == (
        "drops/.drop-000009.h5.tmp is not listed in the journal: run pfwd recover",
        "drops/drop-000009.h5 is not listed in the journal: run pfwd recover",
        "results/drop-000002-1.json is not listed in the journal: run pfwd recover",
    )
    mend(survey)
    assert check(survey).ok
    kept = {path.read_bytes() for path in (survey / "damaged").iterdir()}
    assert kept == {b"half", b"what is this"}
    assert [path.name for path in read_survey(survey).drops[1].results] == ["drop-000002-1.json"]


def test_records_of_another_survey_are_not_taken_in(tmp_path: Path, new_survey: NewSurvey) -> None:
    digests = new_survey()
    new_survey(tmp_path / "other", drops=2)
    journal = tmp_path / "survey" / "journal" / "0001.pfwdj"
    foreign = (tmp_path / "other" / "journal" / "0001.pfwdj").read_bytes()
    journal.write_bytes(journal.read_bytes() + foreign)
    assert any("a record of another survey" in text for text in check(tmp_path / "survey").damaged)
    assert found(tmp_path / "survey") == digests
    mend(tmp_path / "survey")
    assert check(tmp_path / "survey").ok


def test_paths_in_a_journal_do_not_lead_out_of_the_survey(
    tmp_path: Path, new_survey: NewSurvey
) -> None:
    from pfwd_device.recording.index import build_index
    from pfwd_device.recording.journal import open_segment
    from pfwd_device.recording.layout import Layout
    from pfwd_device.recording.lock import SurveyLock
    from pfwd_device.recording.record_log import RecordFiles, RecordLog

    new_survey()
    layout, storage = Layout(tmp_path / "survey"), Storage()
    index = build_index(layout)
    assert index.survey is not None
    entries = [entry for _, entry in sorted(index.entries.items())]
    lock = SurveyLock(layout, storage)
    continued = (1, open_segment(layout, 1, storage))
    home = RecordFiles(layout, index.survey, storage, entries=entries, continued=continued)
    log = RecordLog(layout, index.survey, storage, home, lock)
    for path in ("../outside.json", "results/../../outside.json", "/etc/x", "results\\x.json"):
        log.append(RecordKind.FILE, {"path": path, "size": 2, "sha256": "0" * 64, "content": "{}"})
    log.close()
    lock.release()
    mend(tmp_path / "survey")
    assert not (tmp_path / "outside.json").exists()
    assert set(build_index(layout).files) == set(index.files)


@settings(
    deadline=None,
    max_examples=40,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    name=st.sampled_from(["journal/0001.pfwdj", "acknowledged.txt", "drops/drop-000001.h5"]),
    cuts=st.lists(st.tuples(st.floats(0, 1), st.binary(max_size=30)), min_size=1, max_size=4),
)
def test_no_other_exception_ever(
    new_survey: NewSurvey,
    tmp_path_factory: pytest.TempPathFactory,
    name: str,
    cuts: list[tuple[float, bytes]],
) -> None:
    """Bytes written over, or put in, at random places."""
    survey = tmp_path_factory.mktemp("fuzz") / "survey"
    new_survey(survey, drops=1)
    data = (survey / name).read_bytes()
    for place, garbage in cuts:
        at = int(place * len(data))
        data = data[:at] + garbage + data[at + len(garbage) // 2 :]
    (survey / name).write_bytes(data)
    found(survey)
    check(survey)
    mend(survey)
    assert mend(survey).actions == ()  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ["journal/0001.pfwdj", "acknowledged.txt"])
def test_a_file_of_noise_is_read(tmp_path: Path, name: str) -> None:
    survey = tmp_path / "survey"
    (survey / "journal").mkdir(parents=True)
    (survey / name).write_bytes(np.random.default_rng(0).bytes(50_000))
    assert read_survey(survey).points == ()
    assert not check(survey).ok
    mend(survey)
    with SurveyWriter.open(survey, publish=False) as writer:
        assert writer.save_drop(make_record(1, np.random.default_rng(1))) == 1
    kept = [path for path in (survey / "damaged").iterdir() if path.stat().st_size == 50_000]
    assert len(kept) == 1


def flip_drop(survey: Path, number: int) -> None:
    """Flip one bit in the payload of a drop's record."""
    path = survey / "journal" / "0001.pfwdj"
    data = bytearray(path.read_bytes())
    frames, _ = scan_bytes(bytes(data))
    drop = [frame for frame in frames if frame.kind == RecordKind.DROP][number - 1]
    data[drop.offset + drop.length // 2] ^= 4
    path.write_bytes(data)


def test_nothing_in_damaged_is_written_over(tmp_path: Path) -> None:
    from pfwd_device.recording.files import set_aside
    from pfwd_device.recording.layout import Layout

    (tmp_path / "results").mkdir()
    path = tmp_path / "results" / "a.json"
    for data in (b"one", b"two", b"one", b""):
        path.write_bytes(data)
        set_aside(Layout(tmp_path), Storage(), path)
        assert not path.exists()
    kept = {path.name: path.read_bytes() for path in (tmp_path / "damaged").iterdir()}
    assert kept == {"a.json": b"one", "a.json-2": b"two", "a.json-3": b""}


@pytest.mark.parametrize("damaged", [(0,), (1,), (0, 1, 2)])
def test_rebounds_that_only_a_drop_file_holds_come_back(
    tmp_path: Path, new_record: Callable[[int], DropRecord], damaged: tuple[int, ...]
) -> None:
    """A rebound comes after its drop, in a record of its own, and the file is made after both."""
    survey = tmp_path / "survey"
    with SurveyWriter.open(survey, jobs=Jobs(0), reserve_bytes=0) as writer:
        for number in (1, 2):
            writer.save_drop(new_record(number))
        for number, sample in ((1, 7000), (1, 9000), (2, 7000)):
            writer.save_rebound(number, a_rebound(sample))
    before = {drop.number: drop.read().rebounds for drop in read_survey(survey).drops}
    journal = survey / "journal" / "0001.pfwdj"
    data = bytearray(journal.read_bytes())
    rebounds = [frame for frame in scan_bytes(bytes(data))[0] if frame.kind == RecordKind.REBOUND]
    for index in damaged:
        data[rebounds[index].offset + 60] ^= 1
    journal.write_bytes(data)
    assert not check(survey).ok
    report = mend(survey)
    assert report.ok, report.damaged
    assert sum("restored from its file" in text for text in report.actions) == len(damaged)
    assert check(survey).ok
    after = {drop.number: drop.read().rebounds for drop in read_survey(survey).drops}
    for number, expected in before.items():
        assert {one.first_sample for one in after[number]} == {one.first_sample for one in expected}
        assert len(after[number]) == len(expected)
    assert mend(survey).actions == ()


def test_a_rebound_that_nothing_holds_stays_lost(
    tmp_path: Path, new_record: Callable[[int], DropRecord]
) -> None:
    survey = tmp_path / "survey"
    with SurveyWriter.open(survey, publish=False, reserve_bytes=0) as writer:
        writer.save_drop(new_record(1))
        writer.save_rebound(1, a_rebound())
    journal = survey / "journal" / "0001.pfwdj"
    data = bytearray(journal.read_bytes())
    (rebound,) = [frame for frame in scan_bytes(bytes(data))[0] if frame.kind == RecordKind.REBOUND]
    data[rebound.offset + 60] ^= 1
    journal.write_bytes(data)
    report = mend(survey)
    assert [text for text in report.damaged if "(rebound) is lost" in text]
