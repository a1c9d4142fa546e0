"""Figs. 9, 10 and 12 of the RSMCM paper: points that are lost, found again and drift, and turning objects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ...chains.reconstruction import Association, Coherence, Reconstruction, reconstruct
from ...inference.sfm.affine_camera import affine_alignment
from ...inference.sfm.factor_analysis.factorisation import factorise, predicted
from ...models.core.frame import Frame
from ..evaluation.structure import REJECTED, StructureScores, score_structure
from ..scenes import Cylinder, cylinder
from ..structure.application import read_film
from ..structure.job import StructureJob
from ..structure.page import view_row
from ..view.overlay import PointsOverlay
from .datasets import data_folder
from .experiment import Findings, Image, Plot, by_seed, in_words, noisy, pictures
from .record import Expectation, Table, over_seeds

Numbers = NDArray[np.float64]

# --- the cylinder -------------------------------------------------------------------------------------------

SEEDS = range(20)
LOOSE = (0.0, 0.03, 0.06, 0.1, 0.12)
DRIFT = (0.0, 0.1, 0.2, 0.3)
DRIFT_AT = (0.0, 0.12)  # P(loose) of the upper panels of Fig. 10
LOOSE_AT = (0.0, 0.2)  # P(drift) of the lower panels
FIG_9 = (0.1, 0.3)  # P(loose) and P(drift) of Fig. 9
REGAIN = 0.5
PX = 100.0  # px per radius of the cylinder: noise is then 1 px, and drift 10 px
EM_ITERATIONS = 300

LOSSY = 0.1  # P(loose) from which single chains are said to fail
EQUAL = 1.02  # ratio up to which errors pass for equal: EM stops a little before the optimum

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
    """Probabilities with which sequences are made; `regain` is `None` where it equals `loose`."""

    loose: float
    drift: float
    regain: float | None

    @property
    def named(self) -> tuple[str, str, str]:
        """Probabilities as text, for tables."""
        return f"{self.loose:g}", f"{self.drift:g}", "P(loose)" if self.regain is None else f"{self.regain:g}"

    def sequence(self, seed: int) -> Cylinder:
        """Return the sequence of a seed."""
        regain = self.loose if self.regain is None else self.regain
        return cylinder(p_loose=self.loose, p_drift=self.drift, p_regain=regain, seed=seed)


@dataclass(frozen=True, eq=False)
class CylinderReconstruction:
    """Reconstruction of a sequence by a method, in radii."""

    positions: Numbers
    shape: Numbers
    point_of_track: NDArray[np.int64]


def cells() -> list[Cell]:
    """Return the cells of the four panels, at both values of P(regain); without loss there is but one."""
    chances = {(loose, drift) for loose in DRIFT_AT for drift in DRIFT}
    chances |= {(loose, drift) for loose in LOOSE for drift in LOOSE_AT}
    return [
        Cell(loose, drift, regain)
        for regain in (REGAIN, None)
        for loose, drift in sorted(chances)
        if loose > 0 or regain is not None
    ]


def recover(truth: Cylinder) -> dict[str, CylinderReconstruction]:
    """Run all methods on a sequence; the oracle is given which tracks belong together."""
    tracks = truth.tracks()
    oracle = factorise(PX * truth.observed, coherence=True)
    return {
        SINGLE: _factor_analysis(tracks, coherent=False),
        SINGLE_COHERENT: _factor_analysis(tracks, coherent=True),
        DUAL: _dual_chain(tracks, "none"),
        DUAL_COHERENT: _dual_chain(tracks, "second-order"),
        ORACLE: CylinderReconstruction(predicted(oracle)[0] / PX, oracle.shape, truth.point_of_track),
    }


def _factor_analysis(tracks: Numbers, coherent: bool) -> CylinderReconstruction:
    """Every track a point of its own, EM from the mean-filled matrix, as published."""
    found = factorise(PX * tracks, coherence=coherent, start="svd", polish=False, iterations=EM_ITERATIONS)
    return CylinderReconstruction(predicted(found)[0] / PX, found.shape, np.arange(tracks.shape[1]))


def _dual_chain(tracks: Numbers, coherence: Coherence) -> CylinderReconstruction:
    found = reconstruct(PX * tracks, coherence=coherence, camera="affine")
    return CylinderReconstruction(found.positions / PX, found.shape, found.point_of_track)


def scores(cell: Cell, seed: int) -> dict[str, StructureScores]:
    """Return errors of all methods on one sequence."""
    truth = cell.sequence(seed)
    return {
        name: score_structure(found.positions, found.shape, found.point_of_track, truth)
        for name, found in recover(truth).items()
    }


Measured = Mapping[str, Sequence[StructureScores]]  # by method, one for each seed


def turning_cylinder() -> Findings:
    """Run Figs. 9 and 10."""
    everything = by_seed("cylinder", scores, cells(), SEEDS)
    errors = [
        [*cell.named, *(in_words(_errors(measured[name])) for name in METHODS)]
        for cell, measured in everything.items()
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
    header = ("P(loose)", "P(drift)", "P(regain)", *METHODS)
    return Findings(
        "Cylinder",
        [Table(header, errors, "Reprojection error in radii: median (quartiles).")],
        over_seeds(expectations_of, everything),
        [
            Plot("fig-10.png", partial(draw_panels, everything), (12.0, 9.0), fig_10),
            Plot("fig-9.png", partial(draw_shapes, shapes, example), (14.0, 6.5), fig_9),
        ],
    )


def expectations_of(everything: Mapping[Cell, Measured]) -> list[Expectation]:
    """Return what is expected of ratios of medians, in the worst of the cells concerned."""

    def over(measured: Measured, name: str, *others: str, field: str = "reprojection_error") -> float:
        return _median(measured[name], field) / min(_median(measured[other], field) for other in others)

    cell_of = everything.items()
    by_half, as_lost = (
        max(
            over(measured, DUAL_COHERENT, ORACLE)
            for cell, measured in cell_of
            if (cell.regain is None) == same
        )
        for same in (False, True)
    )
    lossy = [measured for cell, measured in cell_of if cell.loose >= LOSSY]
    single = max(over(measured, DUAL_COHERENT, SINGLE, SINGLE_COHERENT) for measured in lossy)
    everywhere = [measured[DUAL_COHERENT] for measured in everything.values()]
    pure = min(float(np.mean([each.purity for each in one])) for one in everywhere)
    points, missing = (max(_median(one, field) for one in everywhere) for field in ("n_points", "n_missing"))
    clean, n_true = everything[Cell(0.0, 0.0, REGAIN)], len(cylinder().shape)
    coherent = max(over(clean, name, ORACLE) for name in (SINGLE_COHERENT, DUAL_COHERENT))
    shapes = max(over(clean, name, ORACLE, field="shape_error") for name in METHODS)
    who, nothing = DUAL_COHERENT, "no loss, no drift"
    return [
        Expectation(f"{who}: error over the oracle, P(regain) = {REGAIN}", by_half, "<=", 1.5),
        Expectation(f"{who}: error over the oracle, P(regain) = P(loose)", as_lost, "<=", 2.0),
        Expectation(f"{who}: error over the better single chain, P(loose) >= {LOSSY}", single, "<=", 0.1),
        Expectation(f"{who}: share of pure points", pure, ">=", 0.95),
        Expectation(f"{who}: points over true points", points / n_true, "<=", 1.1),
        Expectation(f"{who}: true points that are missing, of {n_true}", missing),
        Expectation(f"{nothing}: coherent methods' error over the oracle", coherent, "<=", EQUAL),
        Expectation(f"{nothing}: all methods' shape error over the oracle", shapes, "<=", EQUAL),
    ]


def draw_panels(everything: Mapping[Cell, Measured], canvas: Figure) -> None:
    """Draw Fig. 10: error over P(drift) above, over P(loose) below."""
    axes = canvas.subplots(2, 2)
    panels = [
        *(
            (f"P(loose) = {loose:g}", "P(drift)", [(drift, loose, drift) for drift in DRIFT])
            for loose in DRIFT_AT
        ),
        *(
            (f"P(drift) = {drift:g}", "P(loose)", [(loose, loose, drift) for loose in LOOSE])
            for drift in LOOSE_AT
        ),
    ]
    places = [(row, column) for row, at in enumerate((DRIFT_AT, LOOSE_AT)) for column in range(len(at))]
    for (title, label, points), place in zip(panels, places, strict=True):
        axis = axes[place]
        for name, colour in METHODS.items():
            for regain, style in ((REGAIN, "-"), (None, "--")):
                shown = [
                    (x, *np.quantile(_errors(everything[cell][name]), (0.25, 0.5, 0.75)))
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
        axis.set(xlabel=label, ylabel="reprojection error, radii")
    axes[0, 0].legend(fontsize=8)


def draw_shapes(shapes: Mapping[str, CylinderReconstruction], truth: Cylinder, canvas: Figure) -> None:
    """Draw Fig. 9: every method's shape from above and from the front."""
    axes = canvas.subplots(2, len(METHODS), sharex=True, sharey="row")
    for column, (name, found) in zip(axes.T, shapes.items(), strict=True):
        placed = aligned(found, truth)
        for axis, height, label in ((column[0], 1, "y"), (column[1], 2, "height")):
            axis.scatter(placed[:, 0], placed[:, height], s=9, color=METHODS[name], linewidths=0)
            axis.set(xlim=(-1.8, 1.8), ylim=(-1.8, 1.8), aspect="equal")
            if name == SINGLE:  # the first column's axis serves all
                axis.set_ylabel(label)
        column[0].set_title(f"{name}\n{len(placed)} points", fontsize=10)
        column[1].set_xlabel("x")


def aligned(recovered: CylinderReconstruction, truth: Cylinder) -> Numbers:
    """Return the shape `(n_points, 3)` after the affine map that brings it closest to the truth."""
    taken = recovered.point_of_track != REJECTED
    best = affine_alignment(
        recovered.shape[recovered.point_of_track[taken]], truth.shape[truth.point_of_track[taken]]
    )
    placed: Numbers = recovered.shape @ best.matrix.T + best.translation
    return placed


def _errors(scores: Sequence[StructureScores]) -> list[float]:
    return [each.reprojection_error for each in scores]


def _median(scores: Sequence[StructureScores], field: str) -> float:
    return float(np.median([getattr(each, field) for each in scores]))


# --- turning objects ----------------------------------------------------------------------------------------

SEQUENCES = ("cmu-hotel", "bobot")
NOISE_SEEDS = range(3)
ALONE_OR_NOT: dict[str, Association] = {"stand-alone": "none", "dual-chain": "dual-chain"}
LINE = ("sequence", "method", "frames", "tracks", "points", "median frames of a point", "error, px", "shape")


@dataclass(frozen=True, eq=False)
class TrackedObject:
    """Reconstruction of a turning object by a method."""

    counts: tuple[int, int, int]  # frames, tracks, points
    length: float  # median number of frames in which a point is seen
    error: float  # px: of reprojection
    geometry: str
    picture: Image | None  # the middle frame with its points and the way that they came


def box() -> Findings:
    """Run Fig. 12 on CMU's hotel and on a table top: tracker and shape together, and one after the other.

    Raises
    ------
    OSError
        if a sequence cannot be found.
    """
    folders = {name: data_folder(name) for name in SEQUENCES}
    measured = by_seed("turning objects", partial(track_object, folders), SEQUENCES, NOISE_SEEDS)
    lines: list[list[object]] = []
    plots: list[Plot] = []
    for name, methods in measured.items():
        for method, trials in methods.items():
            first, length = trials[0], float(np.mean([each.length for each in trials]))
            error = float(np.mean([each.error for each in trials]))
            lines.append([name, method, *first.counts, length, error, first.geometry])
            if first.picture is not None:
                caption = f"{name}-{method}: dots are seen, rings predicted"
                rows = [("", [first.picture])]
                plots.append(pictures(f"{name}-{method}.png", rows, [""], caption, 6.0))
    caption = f"Mean over {len(NOISE_SEEDS)} seeds of noise; counts and shape are of the first."
    return Findings(
        "Turning objects",
        [Table(LINE, lines, caption)],
        over_seeds(expectations_of_objects, measured),
        plots,
    )


def expectations_of_objects(
    measured: Mapping[str, Mapping[str, Sequence[TrackedObject]]],
) -> list[Expectation]:
    """Return what is expected of both chains over the tracker alone."""
    expectations = []
    for name, methods in measured.items():
        length, error = (
            [float(np.mean([getattr(each, of) for each in methods[method]])) for method in ALONE_OR_NOT]
            for of in ("length", "error")
        )
        expectations += [
            Expectation(
                f"{name}: median length of tracks, over stand-alone", length[1] / length[0], ">=", 2.0
            ),
            Expectation(f"{name}: reprojection error, over stand-alone", error[1] / error[0], "<=", 1.0),
        ]
    return expectations


def track_object(folders: Mapping[str, Path], name: str, seed: int) -> dict[str, TrackedObject]:
    """Run both methods on a sequence with noise; pictures are made with the first seed."""
    film = read_film(StructureJob(str(folders[name]), out=Path()))  # nothing is written
    frames = [noisy(frame, seed) for frame in film.frames]
    tracked = {}
    for method, association in ALONE_OR_NOT.items():
        result = reconstruct(frames, association=association, camera="affine")
        tracked[method] = TrackedObject(
            (len(result.positions), len(result.point_of_track), result.n_points),
            float(np.median(np.count_nonzero(result.observed, axis=0))),
            result.reprojection_error,
            result.geometry,
            _picture(frames, result) if seed == NOISE_SEEDS[0] else None,
        )
    return tracked


def _picture(frames: Sequence[Frame], result: Reconstruction) -> Image | None:
    overlay, drawn = PointsOverlay(), None
    for index, frame in enumerate(frames[: len(frames) // 2 + 1]):
        if frame.image is not None:
            drawn = overlay(frame.image, view_row(result, index), frame.number, frame.time, missing=False)
    return drawn
