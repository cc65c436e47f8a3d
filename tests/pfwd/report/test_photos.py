"""Photos of points in a report."""

import io
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from pfwd.files.photos import store_photo
from pfwd.report.drawing import draw_photos
from pfwd.report.gathering import ReportOptions, gather_stored
from pfwd.report.point_blocks import photo_blocks
from pfwd.report.report import write_report
from tests.pfwd.report.surveys import EN


def photo(colour: str, orientation: int = 1) -> bytes:
    """A photo, 40 x 20 pixels as it is stored; its left half is black."""
    image = Image.new("RGB", (40, 20), colour)
    image.paste("black", (0, 0, 20, 20))
    exif = Image.Exif()
    exif[0x0112] = orientation
    stream = io.BytesIO()
    image.save(stream, "PNG", exif=exif)
    return stream.getvalue()


def test_the_report_of_a_point_has_its_photos(survey: Path, tmp_path: Path) -> None:
    name = gather_stored(survey).points[0].name
    store_photo(survey, name, photo("red"))
    store_photo(survey, name, photo("blue"))
    write_report(survey, tmp_path / "r.html", ReportOptions(point=name))
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert text.count("<figcaption>Photos</figcaption>") == 1
    write_report(survey, tmp_path / "r.pdf", ReportOptions(point=name))
    assert (tmp_path / "r.pdf").read_bytes().startswith(b"%PDF")


def test_the_first_four_photos_are_drawn_and_all_counted(survey: Path) -> None:
    point = gather_stored(survey).points[0]
    assert photo_blocks(point, str(survey), EN) == []
    for count in range(6):
        store_photo(survey, point.name, photo(f"#{count}0{count}0{count}0"))
    (block,) = photo_blocks(point, str(survey), EN)
    figure = Figure()
    block.draw(figure)
    assert len(figure.axes) == 4
    assert block.caption == "Photos: 6"


@pytest.mark.parametrize("name", [None, "copied by hand.png"])
def test_a_damaged_photo_is_skipped_with_a_remark(
    survey: Path, tmp_path: Path, name: str | None
) -> None:
    point = gather_stored(survey).points[0].name
    damaged, sound = (store_photo(survey, point, photo(colour)) for colour in ("red", "blue"))
    if name is None:
        damaged.write_bytes(sound.read_bytes())  # another picture
    else:
        (damaged.parent / "also.png").write_bytes(sound.read_bytes())
        damaged = damaged.replace(damaged.parent / name)
        damaged.write_bytes(damaged.read_bytes()[:60])
    report = write_report(survey, tmp_path / "r.html")
    text = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert text.count(f"The photo {damaged.name} is damaged or was changed, and is left out.") == 1
    _, block = photo_blocks(report.points[0], str(survey), EN)
    figure = Figure()
    block.draw(figure)
    assert len(figure.axes) == (1 if name is None else 2)


@pytest.mark.parametrize(("orientation", "size"), [(1, (40, 20)), (6, (20, 40))])
def test_a_photo_is_drawn_the_right_way_up(
    orientation: int, size: tuple[int, int], tmp_path: Path
) -> None:
    file = tmp_path / "p.png"
    file.write_bytes(photo("red", orientation))
    figure = Figure()
    draw_photos(figure, [file])
    (drawn,) = figure.axes[0].images
    pixels = np.asarray(drawn.get_array())
    assert pixels.shape[:2] == (size[1], size[0])
    # Orientation 6: the stored left side is up.
    assert pixels[0, 0].tolist() == [0, 0, 0]
    assert pixels[-1, -1].tolist() == [255, 0, 0]


def test_a_picture_that_pillow_calls_too_large_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    figure = Figure()
    draw_photos(figure, [store_photo(tmp_path, "P1", photo("red"))])
    assert len(figure.axes[0].images) == 1
