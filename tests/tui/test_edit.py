"""The command ``pfwd edit``, called in this process."""

import gc
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfwd.files import editing
from pfwd_device import Drop
from pfwd_device.recording import DropRecord, SurveyWriter
from tui.cli import main


def test_nobody_looks_for_cycles_while_a_survey_is_read_and_edited(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """They are a tenth of what a note on one of 10,000 drops costs."""
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        drop = Drop(1, np.arange(4.0), np.zeros(4), ())
        writer.save_drop(DropRecord("P", drop))
    seen: list[bool] = []
    overview = editing.overview_of

    def noted(survey: Any) -> Any:
        seen.append(gc.isenabled())
        return overview(survey)

    monkeypatch.setattr(editing, "overview_of", noted)
    assert main(["edit", str(tmp_path / "s"), "--note", "wet"]) == 0
    assert (seen, gc.isenabled()) == ([False], True)
    assert "note: wet" in capsys.readouterr().out


def test_a_target_is_in_the_unit_of_the_survey_s_procedure(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with SurveyWriter.open(tmp_path / "s", publish=False) as writer:
        writer.save_drop(DropRecord("P", Drop(1, np.arange(4.0), np.zeros(4), ())))
    survey = str(tmp_path / "s")
    assert main(["edit", survey, "--target", "45"]) == 0
    assert "target 45 MPa" in capsys.readouterr().out
    assert main(["job", survey, "--procedure", "mndot"]) == 0
    assert main(["edit", survey, "--target", "0.6", "--json"]) == 0
    assert '"target_pa": 0.0006' in capsys.readouterr().out
    assert main(["edit", survey, "--target", "45"]) == 2
    assert "procedure mndot judges a deflection in mm" in capsys.readouterr().err
    assert main(["edit", survey, "--target", "0"]) == 2
    assert "expected a number > 0, in mm" in capsys.readouterr().err
