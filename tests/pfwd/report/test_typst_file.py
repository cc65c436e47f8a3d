"""The pages of a PDF, read back by programs that did not write them."""

import io
import os
import re
import shutil
import socket
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pypdf
import pytest
from matplotlib.figure import Figure

from pfwd.analysis.results import DropResult
from pfwd.errors import OptionError
from pfwd.report.blocks import (
    Block,
    Heading,
    Mark,
    Pairs,
    Paragraph,
    Picture,
    Table,
    Together,
)
from pfwd.report.fonts import Letters, chinese_family
from pfwd.report.formatting import symbol_title
from pfwd.report.pictures_as_svg import svg_of
from pfwd.report.provenance_blocks import result_values
from pfwd.report.report import ReportOptions, write_report
from pfwd.report.texts import load_texts
from pfwd.report.typst_file import render_pdf
from tests.records import known

MARGIN, PAGE_WIDTH = 42.5, 595.28
"""Points."""


def render(*blocks: Block, language: str = "en", template: Path | None = None) -> bytes:
    first = Heading("Title", 1)
    return render_pdf((first, *blocks), load_texts(language), "Title", Letters(), template)


def rising_line(label: str) -> Picture:
    """Return a picture with a label on its axis."""

    def draw(figure: Figure) -> None:
        figure.subplots().plot([0, 1])
        figure.axes[0].set_xlabel(label)

    return Picture(draw, 60.0, "caption", "a rising line")


def text_of_pages(pdf: bytes) -> list[str]:
    return [page.extract_text() for page in pypdf.PdfReader(io.BytesIO(pdf)).pages]


def words_within(pdf: bytes, folder: Path) -> Sequence[tuple[float, float, str]]:
    if shutil.which("pdftotext") is None:
        pytest.skip("no pdftotext on this computer")
    (folder / "page.pdf").write_bytes(pdf)
    command = ["pdftotext", "-bbox", str(folder / "page.pdf"), "-"]
    page = subprocess.run(command, capture_output=True, check=True, text=True).stdout
    boxes = re.findall(r'<word xMin="([\d.]+)".*? xMax="([\d.]+)".*?>(.*?)</word>', page)
    return [(float(start), float(right), word) for start, right, word in boxes]


@pytest.mark.parametrize("lines", range(58, 66))
def test_a_label_of_two_lines_stays_with_its_value(lines: int) -> None:
    label = "Last check of the instrument's load cell, which is a long label"
    paragraphs = [Paragraph(f"line {number}", "note") for number in range(lines)]
    last = text_of_pages(render(*paragraphs, Pairs(((label, "zero -20 N"),))))[-1]
    assert "zero -20 N" in last
    assert all(word in last for word in label.split())


def test_bold_verdicts_stay_within_the_page(tmp_path: Path) -> None:
    """A table as full as it can be, its last column in bold letters."""
    long = "rigid-rough plate of 0.15 m on a layer"
    row = (long, long, long, "≥ 45 MPa", Mark("fail", "nicht erfüllt"))
    table = Table(("Point", "Basis", "Model", "Target", "Verdict"), (row,) * 3, ())
    words = words_within(render(table), tmp_path)
    assert sum(word == "erfüllt" for _, _, word in words) == 3
    assert max(right for _, right, _ in words) <= PAGE_WIDTH - MARGIN + 1


def test_a_word_without_blanks_stays_within_the_page(tmp_path: Path) -> None:
    words = words_within(render(Paragraph("f" * 400), Pairs((("file", "/x" * 200),))), tmp_path)
    assert sum(word.count("f") for _, _, word in words if set(word) == {"f"}) == 400
    assert max(right for _, right, _ in words) <= PAGE_WIDTH - MARGIN + 1


def test_blocks_that_belong_together_start_a_page_where_they_do_not_fit() -> None:
    paragraphs = [Paragraph(f"line {number}", "note") for number in range(40)]
    together = Together((Heading("Part"), *(Paragraph(f"part {n}") for n in range(30))))
    first, second = text_of_pages(render(*paragraphs, together))
    assert "part" not in first
    assert "Part" in second
    assert "part 29" in second


def test_the_file_is_tagged_archived_and_accessible() -> None:
    pdf = render(rising_line("x"), language="de")
    reader = pypdf.PdfReader(io.BytesIO(pdf))
    assert known(reader.metadata).title == "Title"
    root = reader.root_object
    assert root["/Lang"] == "de"
    assert root["/MarkInfo"]["/Marked"]  # type: ignore[index]
    metadata = root["/Metadata"].get_object().get_data().decode()  # type: ignore[union-attr]
    assert "<pdfaid:part>2</pdfaid:part>" in metadata
    assert "<pdfaid:conformance>A</pdfaid:conformance>" in metadata
    assert "<pdfuaid:part>1</pdfuaid:part>" in metadata
    fonts = [
        descendant.get_object()["/FontDescriptor"]
        for page in reader.pages
        for font in page["/Resources"]["/Font"].values()  # type: ignore[index]
        for descendant in font["/DescendantFonts"]
    ]
    assert fonts
    assert all("/FontFile2" in font for font in fonts), "embedded TrueType"


def test_texts_of_a_survey_are_not_markup() -> None:
    hostile = '#panic("x") $x$ *b* @ref <label> // no\\ [ ] " \N{REPLACEMENT CHARACTER}'
    (text,) = text_of_pages(render(Paragraph(hostile), Pairs(((hostile, hostile),))))
    assert text.count('#panic("x") $x$ *b* @ref') == 2 or text.count("#panic") == 3


def test_a_template_of_an_agency_gets_the_same_data(survey: Path, tmp_path: Path) -> None:
    page = Path(__file__).parents[3] / "docs" / "reports.md"
    (example,) = re.findall(r"```typst\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    template = tmp_path / "agency.typ"
    template.write_text(example, encoding="utf-8")
    target = tmp_path / "agency.pdf"
    report = write_report(survey, target, ReportOptions(template=str(template)))
    text = "\n".join(text_of_pages(target.read_bytes()))
    assert "Road agency" in text
    assert report.title in text
    assert all(point.shown_name in text for point in report.points)


def refusal_of(template: Path, source: str) -> str:
    template.write_text(source, encoding="utf-8")
    with pytest.raises(OptionError) as refusal:
        render(template=template)
    return str(refusal.value)


@pytest.fixture
def template(tmp_path: Path) -> Path:
    (tmp_path / "agency").mkdir()
    return tmp_path / "agency" / "t.typ"


@pytest.mark.skipif(os.name == "nt", reason="needs links and pipes")
def test_a_template_reads_the_files_of_its_folder_alone(template: Path, tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("secret")
    (template.parent / "link").symlink_to(tmp_path / "secret")
    (template.parent / "folder").symlink_to(tmp_path)
    os.mkfifo(template.parent / "pipe")
    for path in ("../secret", f"{tmp_path}/secret", "link", "folder/secret", "pipe"):
        message = refusal_of(template, f'#read("{path}")')
        assert re.search("not found|escape the project root", message), path


def test_a_template_gets_packages_of_its_folder_only(
    template: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = template.parent / "preview" / "own" / "1.0.0"
    package.mkdir(parents=True)
    manifest = '[package]\nname = "own"\nversion = "1.0.0"\nentrypoint = "lib.typ"\n'
    (package / "typst.toml").write_text(manifest)
    (package / "lib.typ").write_text("#let own = [from a package]")
    begin = '#set document(title: "T")\n#import "@preview/'
    template.write_text(begin + 'own:1.0.0": own\n#own')
    assert "from a package" in text_of_pages(render(template=template))[0]
    # Typst would send its request to this proxy, or to the server itself.
    with socket.create_server(("127.0.0.1", 0)) as proxy:
        proxy.setblocking(False)
        monkeypatch.setenv("HTTPS_PROXY", f"http://127.0.0.1:{proxy.getsockname()[1]}")
        assert "failed to download" in refusal_of(template, begin + 'other:1.0.0": own')
        with pytest.raises(BlockingIOError):
            proxy.accept()


def test_a_template_is_ended_after_a_time(template: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pfwd.report.typst_process.MAX_RENDER_S", 1.0)
    endless = "#for a in range(1000000) { for b in range(1000000) { } }"
    assert "in at most 0.0167 minutes and 4 GB, got a longer time" in refusal_of(template, endless)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not limit the memory")
def test_the_memory_of_a_template_is_limited(template: Path) -> None:
    assert "lack of memory" in refusal_of(template, "#let numbers = range(1000000000)")


def test_a_folder_with_excess_files_is_not_copied(
    template: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pfwd.report.typst_process.MAX_TEMPLATE_FILES", 1)
    (template.parent / "other").touch()
    assert "move the template into a folder of its own" in refusal_of(template, "text")


def test_a_template_that_cannot_be_rendered_is_refused(survey: Path, tmp_path: Path) -> None:
    template = tmp_path / "broken.typ"
    template.write_text("#unknown-name", encoding="utf-8")
    target = tmp_path / "report.pdf"
    with pytest.raises(OptionError, match=r"--template .*broken.typ.*unknown variable"):
        write_report(survey, target, ReportOptions(template=str(template)))
    assert not target.exists()
    with pytest.raises(OptionError, match="no such file"):
        write_report(survey, target, ReportOptions(template=str(tmp_path / "none.typ")))


def test_hundreds_of_points_have_their_values_in_the_pdf() -> None:
    result = DropResult(modulus_pa=45e6, contact_residual_rms_over_peak=0.5)
    names = [f"km-12+400-lane-left-point-{number}" for number in range(413)]
    rows = tuple(result_values(result).items())
    pages = pypdf.PdfReader(io.BytesIO(render(*(Table((n, "4"), rows, (1,)) for n in names)))).pages
    last = pages[-1].extract_text()
    assert names[-1] in last
    assert "modulus_pa 45000000" in last.replace("\n", " ")


def test_the_title_of_a_symbol_stays_on_a_line() -> None:
    titles = (symbol_title("v", "mm/s"), symbol_title("s/v", "ms"))
    long = "a cell that needs more than its share of the width of the page" * 3
    (page,) = text_of_pages(render(Table((*titles, "Text"), (("1", "2", long),) * 3)))
    lines = page.replace("\N{NO-BREAK SPACE}", " ").splitlines()
    assert any("v, mm/s s/v, ms Text" in line for line in lines)


def test_letters_of_pictures_are_text_with_an_embedded_font() -> None:
    pdf = render(rising_line("time after the trigger & <more>"))
    (page,) = text_of_pages(pdf)
    assert "time after the trigger & <more>" in page
    assert "0.8" in page
    fonts = pypdf.PdfReader(io.BytesIO(pdf)).pages[0]["/Resources"]["/Font"]  # type: ignore[index]
    descendants = [font.get_object()["/DescendantFonts"][0] for font in fonts.values()]
    assert {font.get_object()["/Subtype"] for font in descendants} == {"/CIDFontType2"}  # TrueType


def test_chinese_letters_of_pictures_are_of_the_chinese_font() -> None:
    if chinese_family() is None:
        pytest.skip("no font with Chinese letters on this computer")

    picture = rising_line("峰值荷载 kN")
    svg = svg_of(picture, letters_as_text=True)
    (chinese,) = [text for text in svg.splitlines() if "峰值荷载" in text]
    (latin,) = [text for text in svg.splitlines() if ">0.6<" in text and "text-anchor: end" in text]
    assert f"font-family: '{chinese_family()}', 'DejaVu Sans'" in chinese
    assert f"font-family: 'DejaVu Sans', '{chinese_family()}'" in latin
    (page,) = text_of_pages(render(picture, language="zh"))
    assert "峰值荷载 kN" in page
