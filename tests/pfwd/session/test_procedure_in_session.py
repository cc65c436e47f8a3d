"""A procedure in a measuring session: which drops are seating, what is kept of it, the position."""

from pathlib import Path
from typing import Any

import pytest

from pfwd.analysis.screening.drops import screen_point
from pfwd.errors import OptionError, TraceError
from pfwd.files.reading import read_points
from pfwd.procedures import find_procedure
from pfwd.session.events import DropSaved
from pfwd.session.replay import capture_feed
from pfwd.session.setup_file import (
    MeasuringSetup,
    parse_setup,
    read_setup_file,
    with_procedure,
)
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.scripted_feed import Log, connected
from tests.pfwd.session.measured import drops, record

PEAKS = (8000.0, 900.0, 8000.0, 8000.0, 8000.0, 8000.0)
"""N; the second one is a knock."""

PROFILE = """
pfwd-procedure = 1
name = "two"
title = "Two and one"
source = "contract"
quantity = "modulus"
[drops]
seating = { value = 2, source = "contract", verified = true }
measured = { value = 1, source = "contract", verified = true }
"""


class Place:
    """A receiver that stands still."""

    def record(self) -> dict[str, Any]:
        return {"latitude": 48.0, "longitude": 11.0, "source": "nmea", "hdop": 0.9}


def measured(tmp_path: Path, setup: MeasuringSetup, **plan: Any) -> tuple[Path, list[str]]:
    log = record(tmp_path / "survey", connected(), drops(*PEAKS), setup=setup, **plan)
    return tmp_path / "survey", statuses(log)


def statuses(log: Log) -> list[str]:
    return [event.saved.screening.status for event in log.of(DropSaved)]


def test_a_rejected_drop_does_not_count_as_seating(tmp_path: Path) -> None:
    setup = with_procedure(MeasuringSetup(), find_procedure("mndot"))
    folder, kinds = measured(tmp_path, setup)
    assert kinds == ["seating", "rejected", "seating", "seating", "measured", "measured"]
    (point,) = read_points(folder)  # the same when the survey is read again
    assert [screening.status for screening in screen_point(point)] == kinds
    parts = [drops(*PEAKS[:2], run=1)], [drops(*PEAKS[2:], run=2)]
    continued = [record(tmp_path / "c", connected(), *part, setup=setup) for part in parts]
    assert [status for log in continued for status in statuses(log)] == kinds


def test_without_a_procedure_the_numbers_count_as_ever(tmp_path: Path) -> None:
    _, kinds = measured(tmp_path, parse_setup("seating_drops = 3", "setup"))
    assert kinds == ["seating", "rejected", "seating", "measured", "measured", "measured"]


def test_the_survey_stores_the_text_of_the_procedure(tmp_path: Path) -> None:
    (tmp_path / "two.toml").write_text(PROFILE, encoding="utf-8")
    (tmp_path / "setup.toml").write_text('[procedure]\nfile = "two.toml"\n', encoding="utf-8")
    setup = read_setup_file(tmp_path / "setup.toml")
    folder, kinds = measured(tmp_path, setup)
    assert kinds[:4] == ["seating", "rejected", "seating", "measured"]
    survey = read_survey(folder)
    (text,) = [each["details"]["text"] for each in survey.events if each["event"] == "procedure"]
    assert text == PROFILE
    assert survey.drops[0].read().declared["procedure"] == "two"


def test_a_drop_keeps_where_and_when_it_fell(tmp_path: Path) -> None:
    folder, _ = measured(tmp_path, MeasuringSetup(), position=Place())
    metadata = read_survey(folder).drops[0].read().metadata
    assert metadata["position"]["hdop"] == 0.9
    assert metadata["time_local"][-6] in "+-", "local time with the offset of its zone"


def test_the_text_of_a_procedure_stands_in_for_its_file() -> None:
    setup = parse_setup('[procedure]\nfile = "gone.toml"\n', "recorded", PROFILE)
    assert (setup.procedure.name, setup.declared["seating_drops"]) == ("two", 2)


def test_a_capture_is_replayed_by_the_procedure_of_the_command_line(tmp_path: Path) -> None:
    header = {"url": "x", "dialect": "pfwd", "setup_text": "", "procedure_text": PROFILE}
    with SurveyWriter.open(tmp_path / "survey", publish=False) as writer:
        path = writer.open_capture("link", header).path
        # Nothing came: what counts is how it would be read.
    _, setup, _ = capture_feed(path)
    assert (setup.procedure.name, setup.declared["seating_drops"]) == ("two", 2)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[procedure]\nname = "mndott"', "procedure: expected one of astm-e2583"),
        ('[procedure]\nname = "mndot"\nfile = "x.toml"', "got name and file"),
        ("[procedure]\n", "either name or file, got none"),
        ('[procedure]\nnmae = "mndot"', "a known key, got 'nmae'; did you mean name"),
        ('[procedure]\nname = "mndot"\nenforce_unverified = 1', "true or false, got 1"),
        ("procedure = 3", "a name or a table .procedure., got 3"),
        ('seating_drops = 2\nprocedure = "mndot"', "seating_drops: expected 3, .* got 2"),
        ('[procedure]\nfile = "no-such.toml"', "a readable TOML file"),
    ],
)
def test_a_faulty_procedure_in_the_setup_is_refused(text: str, message: str) -> None:
    with pytest.raises(TraceError, match=message):
        parse_setup(text, "setup.toml")


def test_equal_numbers_of_setup_and_procedure_are_accepted() -> None:
    assert parse_setup('seating_drops = 3\nprocedure = "mndot"', "s").procedure.name == "mndot"


def test_on_the_command_line_a_contradiction_is_wrong_usage() -> None:
    with pytest.raises(OptionError, match="--procedure: seating_drops: expected 3"):
        with_procedure(parse_setup("seating_drops = 1", "s"), find_procedure("mndot"))


def test_unverified_numbers_do_not_replace_the_setup() -> None:
    setup = parse_setup('seating_drops = 1\nprocedure = "astm-e2583"', "setup.toml")
    assert setup.declared["seating_drops"] == 1
