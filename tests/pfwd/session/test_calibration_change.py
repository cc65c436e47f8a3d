"""An instrument that is calibrated otherwise than for its drops before is not recorded unasked."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pfwd.errors import OptionError
from pfwd.session.calibration_change import calibration_changes
from pfwd.session.events import CalibrationChanged, DropSaved, InstrumentReady
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.scripted_feed import (
    GEOPHONE,
    IDENTITY,
    LOAD,
    Log,
    ScriptedFeed,
    connected,
    lost,
    run,
)
from tests.pfwd.session.measured import drops, record
from tests.pfwd.session.test_kept_in_session import armed, buffered

TURNED = replace(
    IDENTITY, channels=(LOAD, replace(GEOPHONE, sensitivity=-2 * GEOPHONE.sensitivity))
)
CHANGE = "sensitivity of g0 is -1.90734863 V per m/s, was 0.953674316 V per m/s"
DROP, LATER = drops(8e3), drops(8e3, run=8)


def changes(folder: Path) -> list[object]:
    events = read_survey(folder).events
    return [event["details"] for event in events if event["event"] == "calibration changed"]


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    """A survey with a drop of the instrument before its calibration changed."""
    record(tmp_path / "survey", connected(), DROP)
    return tmp_path / "survey"


def test_a_change_is_refused_in_the_same_survey_after_a_restart(survey: Path) -> None:
    record(survey, connected(), LATER[:1])  # the same calibration is accepted
    with pytest.raises(OptionError, match="--accept-calibration") as refused:
        record(survey, connected(TURNED), LATER)
    assert CHANGE in str(refused.value)
    assert len(read_survey(survey).drops) == 1
    assert changes(survey) == []


def test_a_change_is_refused_after_a_loss_within_a_session(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="sensitivity of g0"):
        record(tmp_path / "s", connected(), DROP, lost(), connected(TURNED, again=True))
    assert len(read_survey(tmp_path / "s").drops) == 1, "what was measured before is safe"


def test_a_change_that_was_accepted_beforehand_is_recorded(survey: Path) -> None:
    log = Log()
    for _ in range(2):  # the second time it is that of the last drop
        record(survey, connected(TURNED), LATER, log=log, changed_calibration="accept")
    assert len(read_survey(survey).drops) == 2
    (event,) = log.of(CalibrationChanged)
    assert CHANGE in event.text
    assert changes(survey) == [{"serial_number": "T-1", "changes": [CHANGE]}]
    record(survey, connected(TURNED), LATER[:1], log=log)


def test_no_sample_is_recorded_until_the_operator_accepts_a_change(survey: Path) -> None:
    log = Log()
    with SurveyWriter.open(survey, publish=False) as writer:
        sure: list[object] = []

        def accept() -> None:
            sure.append(len(log.of(DropSaved)))
            assert writer.drops_acknowledged == 1
            (event,) = log.of(CalibrationChanged)
            feed.session.ask(lambda session: session.accept_calibration(event))

        feed = ScriptedFeed(
            connected(TURNED), LATER, armed(), buffered(), accept, lost(),
            connected(TURNED, again=True), armed(), buffered(first=9000),
        )  # fmt: skip
        run(feed, log, writer, changed_calibration="ask")
    assert sure == [0]
    assert feed.acknowledged == [(9, 500), (9, 9000)]
    identities = [drop.read().metadata["identity"] for drop in read_survey(survey).drops]
    assert len(identities) == 3, "drops of the instrument's memory are recorded, no streamed ones"
    assert len({identity["channels"][1]["sensitivity"] for identity in identities}) == 2
    assert len(log.of(CalibrationChanged)) == 1, "after a loss it is not asked for the same again"
    assert len(log.of(InstrumentReady)) == 2
    assert changes(survey) == [{"serial_number": "T-1", "changes": [CHANGE]}]


def test_a_change_is_reported_after_each_connection(survey: Path) -> None:
    parts = (connected(TURNED), lost(), connected(TURNED, again=True))
    log = record(survey, *parts, changed_calibration="ask")
    assert [event.waits for event in log.of(CalibrationChanged)] == [True, True]


def test_each_instrument_is_compared_with_its_last_drop(survey: Path) -> None:
    record(survey, connected(replace(TURNED, serial_number="T-2")), LATER)
    record(survey, connected())
    assert len(read_survey(survey).drops) == 2


@pytest.mark.parametrize(
    ("identity", "load", "geophone", "text"),
    [
        ({"adc_range": 4.0}, {}, {}, "range of the converter is 4 V, was 8 V"),
        ({"adc_bits": 16}, {}, {}, "converter has 16 bits, had 24"),
        ({"channels": (LOAD,)}, {}, {}, "channels are 1, were 2"),
        ({}, {}, {"name": "g1"}, "channel 'g1' replaces 'g0'"),
        ({}, {"zero": 0.25}, {}, "zero of load is 0.25 V, was 0 V"),
        ({}, {}, {"damping": 0.7}, "damping ratio of g0 is 0.7, was 0.6"),
        ({}, {}, {"delay": 5e-5}, "delay of g0 is 5e-05 s, was 0 s"),
        ({}, {"adc_range": 5.0}, {}, "range of load is 5 V, was not declared"),
    ],
)
def test_each_change_is_named(
    identity: dict[str, Any], load: dict[str, Any], geophone: dict[str, Any], text: str
) -> None:
    channels = replace(LOAD, **load), replace(GEOPHONE, **geophone)
    changed = replace(IDENTITY, **{"channels": channels} | identity)
    assert calibration_changes(IDENTITY, changed) == (text,)


def test_settings_without_effect_on_values_are_no_change() -> None:
    changed = replace(IDENTITY, firmware="2.0", sampling_rate=5000.0, plate_mass=11.0)
    assert calibration_changes(IDENTITY, changed) == ()
