"""The picture has a panel for each kind of size, with every curve and its limit."""

from matplotlib.figure import Figure
from rsmcm.apps.experiments.scale.curve import Curve, Measured
from rsmcm.apps.experiments.scale.picture import draw, size


def test_picture() -> None:
    points = [Measured(n, 1e-3 * n, (1e-3 * n, 1e-3 * n), 1e-4 * n) for n in (1, 10, 100)]
    found = [Curve(f"{unit} {name}", unit, points) for unit in "abcde" for name in ("one", "two")]
    canvas = Figure(figsize=size(found))
    draw(canvas, found)
    shown = [axes for axes in canvas.axes if axes.axison]
    assert [axes.get_xlabel() for axes in shown] == list("abcde")
    for axes in shown:
        solid, dashed = (
            [line for line in axes.lines if line.get_linestyle() == style] for style in ("-", "--")
        )
        assert len(solid) == len(dashed) == 2
        assert list(solid[0].get_ydata()) == [1.0, 10.0, 100.0]
        assert list(dashed[0].get_ydata()) == [0.1, 1.0, 10.0]
