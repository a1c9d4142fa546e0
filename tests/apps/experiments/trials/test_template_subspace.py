"""The subspace of templates: PCA against the SVD, gaps, explicit elimination, and tracking."""

import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.experiments.trials.template_subspace import (
    LEAST_NOISE,
    SubspaceLikelihood,
    TextureSubspace,
    best_pose,
)
from rsmcm.chains.face.image_pyramid import image_pyramid
from rsmcm.chains.face.pose_dynamics import PoseDynamics, PosePrior
from rsmcm.chains.face.texture_likelihood import TexturedObject, TextureLikelihood
from rsmcm.models.face.pose import Poses
from rsmcm.models.face.surface_texels import SurfaceTexels

from ....support.surfaces import bilinear, bumpy, level, poses_near, smooth_picture

Array = NDArray[np.float64]


class Looks:
    """Looks that truly lie near a subspace."""

    def __init__(self, n: int = 40, n_texels: int = 150, n_modes: int = 3, noise: float = 9.0) -> None:
        random = np.random.default_rng(0)
        self.mean = random.uniform(60, 200, (2, n_texels))
        scale = np.array([50.0, 35.0, 25.0])[:n_modes]
        self.modes = scale[:, None, None] * random.normal(size=(n_modes, 2, n_texels))
        self.share = random.normal(size=(n, n_modes))
        clean = self.mean + np.einsum("fk,kln->fln", self.share, self.modes)
        self.looks = (clean + noise * random.normal(size=clean.shape)).astype(np.float32)
        self.everything = np.ones((n, n_texels), np.bool_)
        self.some = random.random((n, n_texels)) < 0.6


def angle(found: Array, wanted: Array) -> float:
    """Largest angle (rad) between two subspaces, spanned by rows."""
    first, second = (np.linalg.qr(rows.T)[0] for rows in (found, wanted))
    return float(np.arccos(np.clip(np.linalg.svd(first.T @ second)[1].min(), 0, 1)))


def test_whole_looks_give_the_principal_components() -> None:
    looks = Looks()
    found = TextureSubspace.learned(looks.looks, looks.everything, 3)
    middle = looks.looks[:, 0].mean(axis=0)
    _, values, right = np.linalg.svd(looks.looks[:, 0] - middle, full_matrices=False)
    np.testing.assert_allclose(found.mean[0], middle, atol=0.5)
    assert angle(found.modes[:, 0], right[:3]) < 0.01
    # the closed form of probabilistic PCA
    noise = (values[3:] ** 2).sum() / (40 * (150 - 3))
    lengths = np.sqrt(values[:3] ** 2 / 40 - noise)
    np.testing.assert_allclose(np.linalg.norm(found.modes[:, 0], axis=1), lengths, rtol=0.02)
    assert found.noise == pytest.approx(noise, rel=0.05)
    gram = found.modes[:, 0] @ found.modes[:, 0].T
    np.testing.assert_allclose(gram - np.diag(np.diag(gram)), 0, atol=0.02 * gram[0, 0])
    assert angle(found.modes[:, 1], looks.modes[:, 1]) < 0.1


def test_missing_texels_are_made_up_for() -> None:
    looks = Looks()
    found = TextureSubspace.learned(looks.looks, looks.some, 3)
    damaged = np.where(looks.some[:, None], looks.looks, np.float32(1e4))
    again = TextureSubspace.learned(damaged, looks.some, 3)
    np.testing.assert_allclose(again.modes, found.modes, rtol=1e-3, atol=0.05)
    for number in range(2):
        assert angle(found.modes[:, number], looks.modes[:, number]) < 0.12
    # each texel's four numbers are fitted to about 24 looks
    assert found.noise == pytest.approx(81.0 * (1 - 4 / 24), rel=0.05)


def test_texels_that_were_never_seen_are_known_as_such() -> None:
    looks = Looks()
    seen = looks.some.copy()
    seen[:, :7] = False
    found = TextureSubspace.learned(looks.looks, seen, 2)
    assert np.flatnonzero(~found.known).tolist() == list(range(7))
    assert not found.modes[..., :7].any()
    assert np.isfinite(found.mean).all()


def test_no_modes_are_a_template() -> None:
    looks = Looks(noise=0.0)
    found = TextureSubspace.learned(looks.looks, looks.everything, 0)
    np.testing.assert_allclose(found.mean, looks.looks.mean(axis=0), rtol=1e-5)
    assert found.modes.shape == (0, 2, 150)
    constant = TextureSubspace.learned(looks.looks[[0, 0, 0]], looks.everything[:3], 0)
    assert constant.noise == LEAST_NOISE


@pytest.mark.parametrize(
    ("looks", "seen", "n_modes", "message"),
    [
        (np.zeros((3, 2, 5)), np.ones((3, 4)), 1, r"observed: got \(3, 2, 5\) with \(3, 4\) seen"),
        (np.zeros((3, 5)), np.ones((3, 5)), 1, r"observed: got \(3, 5\)"),
        (np.zeros((3, 2, 5)), np.ones((3, 5)), 3, "modes: got 3 for 3 pictures, expected 0 to 2"),
    ],
)
def test_what_does_not_fit_is_refused(looks: Array, seen: Array, n_modes: int, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        TextureSubspace.learned(looks.astype(np.float32), seen.astype(np.bool_), n_modes)


@pytest.mark.parametrize("number", [0, 1])
def test_equations_are_those_with_appearance_eliminated(number: int) -> None:
    random, model = np.random.default_rng(1), bumpy(3)
    texels = SurfaceTexels.dense(model, 400)
    surface, poses, count = TexturedObject(model, texels), poses_near(2, 3, 4), len(texels)
    picture = smooth_picture(4)
    levels = [level(picture), level(picture[::2, ::2], 0.5)]
    subspace = TextureSubspace(
        random.uniform(90, 160, (2, count)).astype(np.float32),
        (12 * random.normal(size=(2, 2, count))).astype(np.float32),
        50.0,
        random.random(count) < 0.9,
    )
    visible = random.random(count) < 0.8
    found = SubspaceLikelihood(surface, levels, subspace, visible).equations(
        number, poses, np.zeros(2, np.int64)
    )
    group = texels.group_of_texel
    counts = texels.counts
    part = -(-counts // 4**number)
    used = (texels.row_of_texel < part[group]) & visible & subspace.known
    scale = levels[number].scale
    for m in range(2):
        corners, moves = model.project(poses[m])[0][texels.groups], model.jacobian(poses[m])[0][texels.groups]
        places = np.einsum("nc,nca->na", texels.weights, corners[group])
        values, slopes = bilinear(levels[number].image, places * scale + (scale - 1) / 2)
        rows = np.einsum("na,nc,ncad->nd", slopes * scale, texels.weights, moves[group])
        edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        area = 0.5 * np.abs(edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0]) / np.maximum(part, 1)
        root = np.sqrt(area[group] * used / 50.0)
        # one least-squares problem in the coefficients and the change of the pose, whitened
        error = np.r_[root * (values - subspace.mean[number]), np.zeros(2)]
        modes = np.vstack([root[:, None] * subspace.modes[:, number].T, np.eye(2)])
        basis = np.linalg.qr(modes)[0]
        rows = np.vstack([root[:, None] * rows, np.zeros((2, 8))])
        rows, error = rows - basis @ (basis.T @ rows), error - basis @ (basis.T @ error)
        unit = 1 / np.linalg.norm(rows, axis=0)
        np.testing.assert_allclose(found.sums[m, 0], error @ error, rtol=1e-4)
        np.testing.assert_allclose(found.sums[m, 2], (area[group] * used).sum(), rtol=1e-4)
        np.testing.assert_allclose(
            found.matrices[m] * unit * unit[:, None], rows.T @ rows * unit * unit[:, None], atol=2e-4
        )
        wanted = error @ rows * unit
        np.testing.assert_allclose(found.vectors[m] * unit, wanted, atol=3e-4 * np.abs(wanted).max())


def test_without_modes_it_is_template_matching() -> None:
    looks, model = Looks(n_texels=300), bumpy(3)
    surface = TexturedObject(model, SurfaceTexels.dense(model, 300))
    subspace = TextureSubspace.learned(looks.looks, looks.everything, 0)
    poses, every = poses_near(3, 3, 4), np.zeros(3, np.int64)
    levels, visible = [level(smooth_picture(4))], np.ones(300, np.bool_)
    found = SubspaceLikelihood(surface, levels, subspace, visible).equations(0, poses, every)
    tau = np.full((1, 300), subspace.noise, np.float32)
    wanted = TextureLikelihood(surface, levels, subspace.mean[None], tau, visible[None]).equations(
        0, poses, every
    )
    np.testing.assert_allclose(found.matrices, wanted.matrices, rtol=1e-6)
    np.testing.assert_allclose(found.vectors, wanted.vectors, rtol=1e-6)
    np.testing.assert_allclose(found.sums, wanted.sums, rtol=1e-6)


def test_changes_that_were_learned_do_not_mislead_it() -> None:
    """A patch of shade comes and goes: the subspace knows it, a single template takes it for motion."""
    model, size = bumpy(3), 24.0
    surface = TexturedObject(model, SurfaceTexels.dense(model, 900))
    y, x = np.mgrid[:120, :160]
    texture, shade = 60 + 0.5 * smooth_picture(8), np.exp(-(((x - 74) / 9.0) ** 2 + ((y - 66) / 9.0) ** 2))
    truth = Poses.upright(np.array([[80.0, 60.0]]), np.array([size]), 3)
    visible = surface.visible(truth)
    random = np.random.default_rng(2)

    def levels(amount: float, shift: Array) -> list[object]:
        seen = texture + amount * shade
        moved = bilinear(np.pad(seen, 8, mode="edge"), np.stack([x, y], axis=-1).reshape(-1, 2) + 8 - shift)[
            0
        ]
        noisy = moved.reshape(120, 160) + random.normal(0, 1, (120, 160))
        return list(
            image_pyramid(
                np.clip(np.rint(noisy), 0, 255).astype(np.uint8), size, n_levels=3, local_mean=False
            )
        )

    looks, seen = zip(
        *(surface.observe(levels(amount, np.zeros(2)), truth, visible) for amount in (-50, -25, 0, 25, 50)),
        strict=True,
    )  # fmt: skip
    looks, seen = np.concatenate(looks), np.concatenate(seen)
    errors = []
    for n_modes in (0, 1):
        subspace = TextureSubspace.learned(looks, seen, n_modes)
        off = []
        for amount, shift in ((40.0, np.array([2.3, -1.4])), (-45.0, np.array([-1.7, 2.2]))):
            prior = PosePrior.after(truth, PoseDynamics(), size, 1.0)
            peak = best_pose(surface, subspace, levels(amount, shift), prior, 400.0)
            found, wanted = model.project(peak.poses)[0], model.project(truth)[0] + shift
            off.append(np.linalg.norm(found - wanted, axis=1).mean())
        errors.append(np.mean(off))
    assert errors[1] < 0.3
    assert errors[1] < 0.4 * errors[0]
