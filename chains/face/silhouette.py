"""The outline of an object against a background that is known, as evidence of its pose.

The region terms of G-flow eq. (18) change with the pose only where the outline moves. Gauss-Newton cannot
see that in them, so across the outline the place of the edge is looked for, and its mean and variance are
Gaussian terms of the pose.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...models.face.morphable_model import MorphableModel
from ...models.face.outline import MeshEdges, covered, outline
from ...models.face.pose import Poses
from .background_contrast import BackgroundContrast
from .kernels import pose_terms as place_kernels
from .pose_terms import PointTerms

Array = NDArray[np.float64]

REACH = 4
"""Steps of a scan to either side, each of a pixel of the level."""

NOISE = 1.0
"""Squared steps by which the outline of a coarse mesh is off the object's."""


@dataclass(frozen=True, eq=False)
class Silhouette:
    """Evidence of the outline.

    Parameters
    ----------
    model
        shape.
    edges
        of its triangles.
    contrast
        what is known of the background.
    effective_pixels
        number of independent pixels that the object's pixels are worth.
    """

    model: MorphableModel
    edges: MeshEdges
    contrast: BackgroundContrast
    effective_pixels: float

    def around(self, poses: Poses, level: int) -> PointTerms:
        """Points of the outlines in `poses`, known along their normals where the background ends.

        Every 3 px of the outline the edge is at s on its normal, within 4 px of the level, with density
        exp(sum of the border beyond s): known background against the object's tones. Its mean and variance
        make a Gaussian, and that of the scan itself is taken out again.
        """
        positions = self.model.project(poses)
        box = self.contrast.box
        inside = covered(positions, self.edges.triangles, box)
        found = outline(positions, self.edges, inside, box)
        every = np.arange(len(poses))[:, None, None]
        ends = positions[every, found.vertices]
        places = (ends * found.weights[..., None]).sum(axis=2)
        share = self.effective_pixels / np.maximum(inside.sum(axis=(1, 2)), 1)
        targets = np.empty_like(places)
        information = np.empty((*places.shape[:2], 3))
        scans = place_kernels.Scans(
            places, found.normals.astype(np.float64), found.lengths.astype(np.float64), REACH, float(2**level)
        )
        place_kernels.find_edges(self.contrast.border, box, scans, share, NOISE, targets, information)
        bases = self.model.bases[:, found.vertices]  # (n_bases, n, n_points, 2, 3)
        bases = np.einsum("npe,knpec->npkc", found.weights, bases)
        return PointTerms(np.ascontiguousarray(bases), targets, information)
