"""The plots of inverted drops."""

import dataclasses
import itertools

from matplotlib.backends.backend_agg import FigureCanvasAgg

from pfwd.analysis.plots import _figure
from tests.tui.results import result
from tests.tui.screen.scripted import curves


def test_labels_of_the_axes_do_not_overlap() -> None:
    figure = _figure([dataclasses.replace(result(), history=curves(), file="a", drop=1)])
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.draw(renderer)  # type: ignore[no-untyped-call]
    boxes = [axis.yaxis.label.get_window_extent(renderer) for axis in figure.axes]
    assert [axis.get_ylabel() for axis in figure.axes] == [
        "load, kN",
        "deflection, µm",
        "residual, µm",
    ]
    for above, below in itertools.pairwise(boxes):
        assert above.y0 > below.y1
