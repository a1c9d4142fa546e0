"""Plots of one page are apart."""

import re

from matplotlib.figure import Figure
from rsmcm.apps.reports import plots


def test_plots_of_one_page_share_no_names() -> None:
    def draw(canvas: Figure) -> None:
        canvas.subplots().plot([1, 2, 3], marker="o")

    first, second = (set(re.findall(r' id="([^"]+)"', plots.figure(draw, (3, 2), name))) for name in "ab")
    assert first
    assert not first & second
