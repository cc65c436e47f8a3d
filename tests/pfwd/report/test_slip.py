"""The slip of a point: one page with a QR code that another program reads."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
import zxingcpp
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from pypdf import PdfReader

from pfwd.errors import OptionError
from pfwd.report.blocks import Pairs, Picture, Table
from pfwd.report.fonts import Letters
from pfwd.report.gathering import ReportOptions, gather
from pfwd.report.report import write_report
from pfwd.report.slip_blocks import checksum_of, slip_blocks
from pfwd.report.texts import load_texts
from pfwd_device.recording import read_survey

EN = load_texts("en")


def image_of(picture: Picture) -> np.ndarray:
    figure = Figure(figsize=(180 / 25.4, picture.height / 25.4), dpi=200)
    canvas = FigureCanvasAgg(figure)
    picture.draw(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3]


def test_the_code_holds_point_time_and_checksum(survey: Path) -> None:
    options = ReportOptions(point="B", slip=True, signed="Jo Döe")
    report = gather(survey, options)
    blocks = slip_blocks(report, EN, Letters(), options)
    picture = [block for block in blocks if isinstance(block, Picture)][-1]
    (code,) = zxingcpp.read_barcodes(image_of(picture))
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


def test_another_content_has_another_checksum(survey: Path) -> None:
    first, second = (gather(survey, ReportOptions(point=point)) for point in ("A", "B"))
    assert [len(report.points) for report in (first, second)] == [1, 1]
    assert checksum_of(first) != checksum_of(second)


def test_the_table_has_all_drops(survey: Path) -> None:
    options = ReportOptions(point="A", slip=True)
    blocks = slip_blocks(gather(survey, options), EN, Letters(), options)
    table = [block for block in blocks if isinstance(block, Table)][-1]
    assert [row[:3] for row in table.rows] == [
        ("1", "seating", "no"),
        *((str(number), "measured", "yes") for number in (2, 3, 4)),
    ]
    assert table.rows[1][3:5] == ("8.00", "0.500")


@pytest.mark.parametrize("language", ["en", "de"])
def test_a_slip_has_one_page(survey: Path, tmp_path: Path, language: str) -> None:
    file = tmp_path / "slip.pdf"
    options = ReportOptions(point="A", slip=True, target=40e6, language=language)
    write_report(survey, file, options)
    (page,) = PdfReader(file).pages
    text = page.extract_text()
    assert load_texts(language)["slip"] in text
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
