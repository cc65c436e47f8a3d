"""The command ``pfwd edit``, called in this process."""

import gc
from pathlib import Path
from typing import Any

import pytest

from pfwd.files import editing
from tests.tui.console import pfwd
from tests.tui.surveys import write_small_survey
from tui.cli import main


def test_no_cycles_are_collected_while_a_survey_is_read_and_edited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The collection takes a tenth of the time of a note in a survey of 10,000 drops."""
    is_enabled: list[bool] = []
    overview = editing.overview_of

    def noted(survey: Any) -> Any:
        is_enabled.append(gc.isenabled())
        return overview(survey)

    monkeypatch.setattr(editing, "overview_of", noted)
    survey = write_small_survey(tmp_path / "s", "P")
    assert main(["edit", str(survey), "--note", "wet"]) == 0
    assert (is_enabled, gc.isenabled()) == ([False], True)
    assert "note: wet" in capsys.readouterr().out


def test_a_target_is_in_the_unit_of_the_survey_s_procedure(tmp_path: Path) -> None:
    survey = write_small_survey(tmp_path / "s", "P")
    assert "target 45 MPa" in pfwd("edit", survey, "--target", "45").out
    assert pfwd("job", survey, "--procedure", "mndot").status == 0
    assert '"target_pa": 0.0006' in pfwd("edit", survey, "--target", "0.6", "--json").out
    assert "judges a deflection in mm" in pfwd("edit", survey, "--target", "45").refusal
