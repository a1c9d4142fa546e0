"""Figs. 9 and 10 of the RSMCM paper: a synthetic cylinder whose points are lost, found again and drift."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...chains.reconstruction import Coherence, reconstruct
from ...inference.sfm.affine_camera import affine_alignment
from ...inference.sfm.factor_analysis.factorisation import factorise, predicted
from ..evaluation.structure import REJECTED, StructureScores, score_structure
from ..scenes import Cylinder, cylinder
from .expectations import Expectation, over_seeds
from .experiment import Findings, Plot, by_seed
from .record import Table

Numbers = NDArray[np.float64]

SEEDS = range(20)
LOOSE = (0.0, 0.03, 0.06, 0.1, 0.12)
DRIFT = (0.0, 0.1, 0.2, 0.3)
DRIFT_AT = (0.0, 0.12)
"""P(loose) of the upper panels of Fig. 10."""
LOOSE_AT = (0.0, 0.2)
"""P(drift) of the lower panels."""
FIG_9 = (0.1, 0.3)
"""P(loose) and P(drift) of Fig. 9."""
REGAIN = 0.5
PX = 100.0
"""px per radius of the cylinder: noise is then 1 px, and drift 10 px."""
EM_ITERATIONS = 300

LOSSY = 0.1
"""P(loose) from which single chains are said to fail."""
EQUAL = 1.02
"""Ratio up to which errors pass for equal: EM stops a little before the optimum."""
CHANCES = ("P(loose)", "P(drift)", "P(regain)")

SINGLE = "factor analysis"
SINGLE_COHERENT = "factor analysis, coherent"
DUAL = "dual-chain"
DUAL_COHERENT = "dual-chain, coherent"
ORACLE = "oracle"
METHODS = {
    SINGLE: "#9a9a9a",
    SINGLE_COHERENT: "#c98a2b",
    DUAL: "#6fa8dc",
    DUAL_COHERENT: "#1f5fa8",
    ORACLE: "#3a9a5b",
}
"""Names and colours."""


@dataclass(frozen=True)
class Cell:
    """Chances with which sequences are made; `regain` is `None` where it is the same as `loose`."""

    loose: float
    drift: float
    regain: float | None

    @property
    def named(self) -> tuple[str, str, str]:
        """For tables."""
        return f"{self.loose:g}", f"{self.drift:g}", "P(loose)" if self.regain is None else f"{self.regain:g}"

    def sequence(self, seed: int) -> Cylinder:
        """The sequence of a seed."""
        regain = self.loose if self.regain is None else self.regain
        return cylinder(p_loose=self.loose, p_drift=self.drift, p_regain=regain, seed=seed)


@dataclass(frozen=True, eq=False)
class Recovered:
    """What a method makes of a sequence, in radii."""

    positions: Numbers
    shape: Numbers
    point_of_track: NDArray[np.int64]


def cells() -> list[Cell]:
    """All that the four panels show, at both values of P(regain); where nothing is lost, there is but one."""
    chances = {(loose, drift) for loose in DRIFT_AT for drift in DRIFT}
    chances |= {(loose, drift) for loose in LOOSE for drift in LOOSE_AT}
    return [
        Cell(loose, drift, regain)
        for regain in (REGAIN, None)
        for loose, drift in sorted(chances)
        if loose > 0 or regain is not None
    ]


def recover(truth: Cylinder) -> dict[str, Recovered]:
    """Run all methods on a sequence."""
    tracks = truth.tracks()
    return {
        SINGLE: _factor_analysis(tracks, coherent=False),
        SINGLE_COHERENT: _factor_analysis(tracks, coherent=True),
        DUAL: _dual_chain(tracks, "none"),
        DUAL_COHERENT: _dual_chain(tracks, "second-order"),
        ORACLE: _oracle(truth),
    }


def _factor_analysis(tracks: Numbers, coherent: bool) -> Recovered:
    """Every track a point of its own, EM from the mean-filled matrix, as published."""
    found = factorise(PX * tracks, coherence=coherent, start="svd", polish=False, iterations=EM_ITERATIONS)
    return Recovered(predicted(found)[0] / PX, found.shape, np.arange(tracks.shape[1]))


def _dual_chain(tracks: Numbers, coherence: Coherence) -> Recovered:
    found = reconstruct(PX * tracks, coherence=coherence, camera="affine")
    return Recovered(found.positions / PX, found.shape, found.point_of_track)


def _oracle(truth: Cylinder) -> Recovered:
    """Factor analysis that is given which tracks belong together."""
    found = factorise(PX * truth.observed, coherence=True)
    return Recovered(predicted(found)[0] / PX, found.shape, truth.point_of_track)


def scores(cell: Cell, seed: int) -> dict[str, StructureScores]:
    """Errors of all methods on one sequence."""
    truth = cell.sequence(seed)
    return {
        name: score_structure(found.positions, found.shape, found.point_of_track, truth)
        for name, found in recover(truth).items()
    }


Measured = Mapping[str, Sequence[StructureScores]]
"""By method, one for each seed."""

MEASURES = {
    "reprojection_error": "reprojection error",
    "shape_error": "shape error",
    "n_points": "points",
    "n_spurious": "spurious",
    "n_missing": "missing",
    "n_rejected": "rejected tracks",
    "purity": "pure",
}
"""Fields of the scores, and how tables call them."""


def turning_cylinder() -> Findings:
    """Figs. 9 and 10, with what is wanted of them."""
    everything = by_seed("cylinder", scores, cells(), SEEDS)
    errors = [
        [*cell.named, *(_in_words(values[name], "reprojection_error") for name in METHODS)]
        for cell, values in everything.items()
    ]
    every_measure = [
        [*cell.named, name, *(_in_words(values[name], measure) for measure in MEASURES)]
        for cell, values in everything.items()
        for name in METHODS
    ]
    example = Cell(*FIG_9, REGAIN).sequence(0)
    shapes = recover(example)
    fig_10 = (
        f"Fig. 10: reprojection error in radii, median and quartiles of {len(SEEDS)} sequences; "
        f"dashed, P(regain) = P(loose) instead of {REGAIN}"
    )
    fig_9 = (
        f"Fig. 9: shapes from above and from the front, after the best affine map; P(loose) = {FIG_9[0]}, "
        f"P(drift) = {FIG_9[1]}"
    )
    return Findings(
        "Cylinder",
        [Table((*CHANCES, *METHODS), errors, "Reprojection error in radii: median (quartiles).")],
        over_seeds(expectations_of, everything),
        [
            Plot("fig-10.png", lambda canvas: draw_panels(canvas, everything), (12.0, 9.0), fig_10),
            Plot("fig-9.png", lambda canvas: draw_shapes(canvas, shapes, example), (14.0, 6.5), fig_9),
        ],
        [Table((*CHANCES, "method", *MEASURES.values()), every_measure, "Everything.")],
    )


def expectations_of(everything: Mapping[Cell, Measured]) -> list[Expectation]:
    """What is wanted; of ratios of medians, in the worst of the cells that it is wanted of."""

    def over(values: Measured, name: str, others: Sequence[str], field: str = "reprojection_error") -> float:
        return _median(values[name], field) / min(_median(values[other], field) for other in others)

    by_half = [values for cell, values in everything.items() if cell.regain is not None]
    as_lost = [values for cell, values in everything.items() if cell.regain is None]
    lossy = [values for cell, values in everything.items() if cell.loose >= LOSSY]
    clean = everything[Cell(0.0, 0.0, REGAIN)]
    everywhere = [values[DUAL_COHERENT] for values in everything.values()]
    n_true = len(cylinder().shape)
    return [
        Expectation(
            f"{DUAL_COHERENT}: error over the oracle, P(regain) = {REGAIN}",
            max(over(values, DUAL_COHERENT, [ORACLE]) for values in by_half),
            "<=",
            1.5,
        ),
        Expectation(
            f"{DUAL_COHERENT}: error over the oracle, P(regain) = P(loose)",
            max(over(values, DUAL_COHERENT, [ORACLE]) for values in as_lost),
            "<=",
            2.0,
        ),
        Expectation(
            f"{DUAL_COHERENT}: error over the better single chain, P(loose) >= {LOSSY}",
            max(over(values, DUAL_COHERENT, [SINGLE, SINGLE_COHERENT]) for values in lossy),
            "<=",
            0.1,
        ),
        Expectation(
            f"{DUAL_COHERENT}: share of pure points",
            min(float(np.mean([each.purity for each in one])) for one in everywhere),
            ">=",
            0.95,
        ),
        Expectation(
            f"{DUAL_COHERENT}: points over true points",
            max(_median(one, "n_points") for one in everywhere) / n_true,
            "<=",
            1.1,
        ),
        Expectation(
            f"{DUAL_COHERENT}: true points that are missing, of {n_true}",
            max(_median(one, "n_missing") for one in everywhere),
        ),
        Expectation(
            "no loss, no drift: coherent methods' error over the oracle",
            max(over(clean, name, [ORACLE]) for name in (SINGLE_COHERENT, DUAL_COHERENT)),
            "<=",
            EQUAL,
        ),
        Expectation(
            "no loss, no drift: all methods' shape error over the oracle",
            max(over(clean, name, [ORACLE], "shape_error") for name in METHODS),
            "<=",
            EQUAL,
        ),
    ]


def draw_panels(canvas: Figure, everything: Mapping[Cell, Measured]) -> None:
    """Fig. 10: error over P(drift) above, over P(loose) below."""
    axes = canvas.subplots(2, 2)
    panels: list[tuple[Axes, str, str, list[tuple[float, float, float]]]] = []
    for axis, loose in zip(axes[0], DRIFT_AT, strict=True):
        panels.append((axis, f"P(loose) = {loose:g}", "P(drift)", [(drift, loose, drift) for drift in DRIFT]))
    for axis, drift in zip(axes[1], LOOSE_AT, strict=True):
        panels.append((axis, f"P(drift) = {drift:g}", "P(loose)", [(loose, loose, drift) for loose in LOOSE]))
    for axis, title, label, points in panels:
        for name, colour in METHODS.items():
            for regain, style in ((REGAIN, "-"), (None, "--")):
                shown = [
                    (x, *_quartiles(everything[cell][name], "reprojection_error"))
                    for x, loose, drift in points
                    if (cell := Cell(loose, drift, regain)) in everything
                ]
                if not shown:
                    continue
                x, low, middle, high = np.array(shown).T
                solid = regain is not None
                axis.plot(x, middle, style, color=colour, linewidth=1.4, label=name if solid else None)
                if solid:
                    axis.fill_between(x, low, high, color=colour, alpha=0.2, linewidth=0)
        axis.set_yscale("log")
        axis.set_title(title, fontsize=10)
        axis.set_xlabel(label)
        axis.set_ylabel("reprojection error, radii")
    axes[0, 0].legend(fontsize=8)


def draw_shapes(canvas: Figure, shapes: Mapping[str, Recovered], truth: Cylinder) -> None:
    """Fig. 9: every method's shape from above and from the front."""
    axes = canvas.subplots(2, len(METHODS), sharex=True, sharey="row")
    for column, (name, found) in zip(axes.T, shapes.items(), strict=True):
        placed = aligned(found, truth)
        for axis, height, label in ((column[0], 1, "y"), (column[1], 2, "height")):
            axis.scatter(placed[:, 0], placed[:, height], s=9, color=METHODS[name], linewidths=0)
            axis.set_xlim(-1.8, 1.8)
            axis.set_ylim(-1.8, 1.8)
            axis.set_aspect("equal")
            if name == SINGLE:  # the first column's axis serves all
                axis.set_ylabel(label)
        column[0].set_title(f"{name}\n{len(placed)} points", fontsize=10)
        column[1].set_xlabel("x")


def aligned(found: Recovered, truth: Cylinder) -> Numbers:
    """The shape `(n_points, 3)` after the affine map that brings it closest to the truth."""
    taken = found.point_of_track != REJECTED
    best = affine_alignment(
        found.shape[found.point_of_track[taken]], truth.shape[truth.point_of_track[taken]]
    )
    placed: Numbers = found.shape @ best.matrix.T + best.translation
    return placed


def _quartiles(scores: Sequence[StructureScores], field: str) -> Numbers:
    values: Numbers = np.quantile([getattr(each, field) for each in scores], (0.25, 0.5, 0.75))
    return values


def _median(scores: Sequence[StructureScores], field: str) -> float:
    return float(_quartiles(scores, field)[1])


def _in_words(scores: Sequence[StructureScores], field: str) -> str:
    low, middle, high = _quartiles(scores, field)
    return f"{middle:.3g} ({low:.3g}–{high:.3g})"
