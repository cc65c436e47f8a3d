"""An instrument that is calibrated otherwise than for its drops before is not recorded unasked."""

from dataclasses import replace
from pathlib import Path

import pytest

from pfwd.errors import OptionError
from pfwd.session.calibration_change import calibration_changes
from pfwd.session.events import CalibrationChanged, DropSaved, InstrumentReady
from pfwd.session.plan import Ending, SessionPlan
from pfwd.session.session import Session
from pfwd_device.identity import Identity
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.scripted_feed import (
    GEOPHONE,
    IDENTITY,
    LOAD,
    Log,
    ScriptedFeed,
    began,
    connected,
    lost,
    pieces,
    stream,
)
from tests.pfwd.session.test_kept_in_session import armed, kept

TURNED = replace(
    IDENTITY, channels=(LOAD, replace(GEOPHONE, sensitivity=-2 * GEOPHONE.sensitivity))
)
CHANGE = "sensitivity of g0 is -1.90734863 V per m/s, was 0.953674316 V per m/s"
DROP = pieces(stream(4.0, [(1.0, 8000.0)]))


def session(folder: Path, *parts: object, log: Log, **plan: object) -> Ending:
    with SurveyWriter.open(folder, publish=False) as writer:
        feed = ScriptedFeed(*parts)
        return Session(feed, log, SessionPlan(options=None, **plan), writer).run()  # type: ignore[arg-type]


def changes(folder: Path) -> list[object]:
    events = read_survey(folder).events
    return [event["details"] for event in events if event["event"] == "calibration changed"]


def test_it_is_refused_in_the_same_survey_after_a_restart(tmp_path: Path) -> None:
    survey, log = tmp_path / "survey", Log()
    session(survey, connected(), began(7), DROP, log=log)
    session(survey, connected(), began(8), log=log)  # the same one is welcome
    with pytest.raises(OptionError, match="--accept-calibration") as refused:
        session(survey, connected(TURNED), began(9), pieces(stream(4.0, [(1.0, 8e3)]), 9), log=log)
    assert f"calibration of T-1 changed since its last drop in this survey: {CHANGE}" in str(
        refused.value
    )
    assert len(read_survey(survey).drops) == 1
    assert changes(survey) == []


def test_it_is_refused_after_a_loss_within_a_session(tmp_path: Path) -> None:
    survey, log = tmp_path / "survey", Log()
    again = connected(TURNED, again=True)
    with pytest.raises(OptionError, match="sensitivity of g0"):
        session(survey, connected(), began(7), DROP, lost(), again, log=log)
    assert len(read_survey(survey).drops) == 1, "what was measured before is safe"


def test_it_is_recorded_where_it_was_accepted_beforehand(tmp_path: Path) -> None:
    survey, log = tmp_path / "survey", Log()
    session(survey, connected(), began(7), DROP, log=log)
    later = pieces(stream(4.0, [(1.0, 8000.0)]), 8)
    for _ in range(2):  # the second time it is that of the last drop
        session(survey, connected(TURNED), began(8), later, log=log, changed_calibration="accept")
    assert len(read_survey(survey).drops) == 2
    text = f"calibration of T-1 changed since its last drop in this survey: {CHANGE}"
    assert log.of(CalibrationChanged) == [CalibrationChanged(text)]
    assert changes(survey) == [{"serial_number": "T-1", "changes": [CHANGE]}]
    session(survey, connected(TURNED), began(8), log=log)


def test_nothing_is_recorded_until_the_operator_accepts_it(tmp_path: Path) -> None:
    survey, log = tmp_path / "survey", Log()
    session(survey, connected(), began(7), DROP, log=log)
    log.clear()
    with SurveyWriter.open(survey, publish=False) as writer:
        later = pieces(stream(4.0, [(1.0, 8000.0)]), 8)
        sure: list[object] = []

        def accept() -> None:
            sure.append(len(log.of(DropSaved)))
            assert writer.drops_acknowledged == 1
            (event,) = log.of(CalibrationChanged)
            measuring.ask(lambda session: session.accept_calibration(event))

        feed = ScriptedFeed(
            connected(TURNED), began(8), later, armed(), kept(), accept, lost(),
            connected(TURNED, again=True), armed(), kept(first=9000),
        )  # fmt: skip
        measuring = Session(feed, log, SessionPlan(options=None, changed_calibration="ask"), writer)
        assert measuring.run() is Ending.DONE
    assert sure == [0]
    assert feed.acknowledged == [(9, 500), (9, 9000)]
    drops = read_survey(survey).drops
    assert len(drops) == 3, "what the instrument kept meanwhile is recorded, what it streamed not"
    sensitivities = {
        drop.read().metadata["identity"]["channels"][1]["sensitivity"] for drop in drops
    }
    assert len(sensitivities) == 2
    assert len(log.of(CalibrationChanged)) == 1, "after a loss it is not asked for the same again"
    assert len(log.of(InstrumentReady)) == 2
    assert changes(survey) == [{"serial_number": "T-1", "changes": [CHANGE]}]


def test_an_instrument_that_goes_before_the_answer_is_asked_for_again(tmp_path: Path) -> None:
    survey, log = tmp_path / "survey", Log()
    session(survey, connected(), began(7), DROP, log=log)
    parts = (connected(TURNED), lost(), connected(TURNED, again=True))
    session(survey, *parts, log=log, changed_calibration="ask")
    assert [event.waits for event in log.of(CalibrationChanged)] == [True, True]


def test_another_instrument_is_compared_with_its_own_drops(tmp_path: Path) -> None:
    survey, log = tmp_path / "survey", Log()
    other = replace(TURNED, serial_number="T-2")
    session(survey, connected(), began(7), DROP, log=log)
    session(survey, connected(other), began(8), pieces(stream(4.0, [(1.0, 8e3)]), 8), log=log)
    session(survey, connected(), log=log)
    assert len(read_survey(survey).drops) == 2


@pytest.mark.parametrize(
    ("other", "text"),
    [
        (replace(IDENTITY, adc_range=4.0), "range of the converter is 4 V, was 8 V"),
        (replace(IDENTITY, adc_bits=16), "converter has 16 bits, had 24"),
        (replace(IDENTITY, channels=(LOAD,)), "channels are 1, were 2"),
        (
            replace(IDENTITY, channels=(LOAD, replace(GEOPHONE, name="g1"))),
            "channel 'g1' replaces 'g0'",
        ),
        (
            replace(IDENTITY, channels=(replace(LOAD, zero=0.25), GEOPHONE)),
            "zero of load is 0.25 V, was 0 V",
        ),
        (
            replace(IDENTITY, channels=(LOAD, replace(GEOPHONE, damping=0.7))),
            "damping ratio of g0 is 0.7, was 0.6",
        ),
        (
            replace(IDENTITY, channels=(LOAD, replace(GEOPHONE, delay=5e-5))),
            "delay of g0 is 5e-05 s, was 0 s",
        ),
        (
            replace(IDENTITY, channels=(replace(LOAD, adc_range=5.0), GEOPHONE)),
            "range of load is 5 V, was not declared",
        ),
    ],
)
def test_each_change_is_named(other: Identity, text: str) -> None:
    assert calibration_changes(IDENTITY, other) == (text,)


def test_what_does_not_change_a_value_is_no_change() -> None:
    other = replace(IDENTITY, firmware="2.0", sampling_rate=5000.0, plate_mass=11.0)
    assert calibration_changes(IDENTITY, other) == ()
