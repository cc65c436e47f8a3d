"""The slip of a point: one page with a QR code that another program reads."""

import datetime
import hashlib
import re
from dataclasses import replace
from pathlib import Path
from typing import TypeGuard

import numpy as np
import pytest
import zxingcpp
from pypdf import PdfReader

from pfwd.analysis.results import DropResult
from pfwd.errors import OptionError
from pfwd.files.editing import Edit, edit_survey
from pfwd.report.blocks import Block, Pairs, Paragraph, Picture, Table
from pfwd.report.composing import compose
from pfwd.report.fonts import Letters
from pfwd.report.gathering import ReportOptions, gather
from pfwd.report.report import write_report
from pfwd.report.slip_blocks import checksum_of, slip_blocks
from pfwd.report.texts import load_texts
from pfwd_device.recording import SurveyWriter, read_survey
from tests.pfwd.report.surveys import EN, drawn, half_sine_drop, result_of
from tests.records import complete

pytestmark = pytest.mark.usefixtures("without_curves")


def is_warning(block: Block) -> TypeGuard[Paragraph]:
    return isinstance(block, Paragraph) and block.style == "small warning"


def test_the_code_holds_point_time_and_checksum(survey: Path) -> None:
    options = ReportOptions(point="B", slip=True, signed="Jo Döe")
    report = gather(survey, options)
    blocks = slip_blocks(report, EN, Letters(), options)
    picture = [block for block in blocks if isinstance(block, Picture)][-1]
    canvas = drawn(picture, dpi=200).canvas
    canvas.draw()
    (code,) = zxingcpp.read_barcodes(np.asarray(canvas.buffer_rgba())[..., :3])  # type: ignore[attr-defined]
    lines = dict(line.split(": ", 1) for line in code.text.split("\n"))

    drops = [drop for drop in read_survey(survey).drops if drop.point == "B"]
    listed = "".join(
        f"{hashlib.sha256(drop.file.read_bytes()).hexdigest()}  {drop.file.name}\n"
        for drop in drops
        if drop.file is not None
    )
    assert len(drops) == listed.count("\n") == 4
    assert lines["point"] == "B"
    assert lines["sha256"] == hashlib.sha256(listed.encode()).hexdigest() == checksum_of(report)
    assert lines["time"] == report.points[0].drops[1].metadata.get("time_local", "")
    last = blocks[-1]
    assert isinstance(last, Pairs)
    assert last.rows[0][1] == lines["sha256"]
    assert "Jo Döe" in picture.alternative
    elsewhere = gather(survey, ReportOptions(point="A"))
    assert checksum_of(elsewhere) != checksum_of(report)


def test_the_table_has_all_drops(survey: Path) -> None:
    options = ReportOptions(point="A", slip=True)
    blocks = slip_blocks(gather(survey, options), EN, Letters(), options)
    table = [block for block in blocks if isinstance(block, Table)][-1]
    assert [row[:3] for row in table.rows] == [
        ("1", "seating", "no"),
        *((str(number), "measured", "yes") for number in (2, 3, 4)),
    ]
    assert table.rows[1][3:5] == ("8.00", "0.500")
    assert table.columns[-1] == "Equivalent modulus, MPa"
    facts = dict(next(block for block in blocks if isinstance(block, Pairs)).rows)
    assert facts["Modulus E"].startswith("45.3")
    assert [row[-1] for row in table.rows] == ["45.1", "45.2", "45.3", "45.4"]


def test_settlement_its_ratio_and_coordinates_are_on_the_slip(survey: Path) -> None:
    options = ReportOptions(point="A", slip=True, procedure="tp-bf-stb-b8.3", language="de")
    report = gather(survey, options)
    place = {"latitude": 48.624762, "longitude": 2.414874, "source": "declared"}
    report = replace(report, points=(replace(report.points[0], place=place),))
    blocks = slip_blocks(report, load_texts("de"), Letters(), options)
    facts = dict(next(block for block in blocks if isinstance(block, Pairs)).rows)
    assert facts["s\N{COMBINING MACRON}"] == "0,500 mm"
    assert facts["s/v"].endswith("\N{NO-BREAK SPACE}ms")
    assert facts["Lage"].startswith("48.624762, 2.414874")
    table = [block for block in blocks if isinstance(block, Table)][-1]
    assert table.columns[-1] == "E_vd, MPa"
    assert table.rows[3][-1] == "45,0"  # 1.5 * 0.15 m * 0.1 MPa / 0.5 mm


def test_the_target_of_a_slip_counts_and_that_of_the_survey_is_named(survey: Path) -> None:
    edit_survey(survey, [Edit("target", 60e6)], point="A")
    options = ReportOptions(point="A", slip=True, target=40e6)
    report = gather(survey, options)
    assert report.points[0].progress.target == 40e6
    texts = [b.text for b in slip_blocks(report, EN, Letters(), options) if is_warning(b)]
    assert f"A: {EN.say('target_of_slip', target='≥ 60 MPa')}" in texts
    plain = gather(survey, ReportOptions(point="A", target=40e6))
    assert plain.points[0].progress.target == 60e6
    same = gather(survey, ReportOptions(point="A", slip=True, target=60e6))
    assert not [b for b in slip_blocks(same, EN, Letters(), options) if is_warning(b)]


@pytest.mark.parametrize("of_point", [True, False])
def test_a_target_that_was_changed_after_the_drops_is_stated(survey: Path, of_point: bool) -> None:
    def declare(target: float) -> None:
        with SurveyWriter.open(survey, publish=False) as writer:
            if of_point:
                writer.edit("target", target, point="A")
            else:
                writer.note_event("job", {"target": target})

    declare(40e6)
    record = read_survey(survey).drops[0].read()
    time = {"time_utc": datetime.datetime.now(datetime.UTC).isoformat()}
    with SurveyWriter.open(survey, publish=False) as writer:
        drop = half_sine_drop(9, 8009.0)
        number = writer.save_drop(replace(record, drop=drop, metadata=time))
        writer.publish(number)
        writer.save_result(number, complete(DropResult, result_of(9)))
    options = ReportOptions(point="A", slip=True)
    assert not gather(survey, options).target_changes
    declare(30e6)
    edit_survey(survey, [Edit("note", "wet")], point="A")
    for report in (gather(survey, options), gather(survey)):
        blocks = slip_blocks(report, EN, Letters(), options)
        (warning,) = [block.text for block in blocks if is_warning(block)]
        assert re.fullmatch(
            r"A: the target was changed at .{16} UTC, after the drops; until then it was ≥ 40 MPa",
            warning,
        )
        assert warning in [b.text for b in compose(report, EN, Letters()) if is_warning(b)]


def test_a_slip_is_a_single_page(survey: Path, tmp_path: Path) -> None:
    file = tmp_path / "slip.pdf"
    options = ReportOptions(point="A", slip=True, target=40e6, language="de")
    write_report(survey, file, options)
    (page,) = PdfReader(file).pages
    text = page.extract_text()
    assert load_texts("de")["slip"] in text
    assert "✓" in text


def test_wrong_usage_is_refused(survey: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="--slip: expected --point P"):
        ReportOptions(slip=True)
    with pytest.raises(OptionError, match="--signed: expected --slip"):
        ReportOptions(point="A", signed="Jo")
    with pytest.raises(OptionError, match="--point: expected one of the points A, B"):
        gather(survey, ReportOptions(point="C"))
    options = ReportOptions(point="A", slip=True, template="form.xlsx")
    with pytest.raises(OptionError, match=r"--slip: expected --output with \.html or \.pdf"):
        write_report(survey, tmp_path / "slip.xlsx", options)
