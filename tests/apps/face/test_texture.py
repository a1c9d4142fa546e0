"""The texture of a face as a picture."""

import numpy as np
import pytest
from rsmcm.apps.face.texture import texture_picture
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.morphable_model import MorphableModel
from rsmcm.models.face.surface import SurfaceTexels


@pytest.fixture(scope="module")
def model() -> MorphableModel:
    return face_model()


def test_a_texture_lies_where_its_texels_are(model: MorphableModel) -> None:
    """A texture that grows to the right gives columns that do, wherever there is surface."""
    texels = SurfaceTexels.dense(model, 2000)
    morphs = np.zeros(model.n_bases)
    morphs[0] = 40.0
    corners = model.bases[0][texels.groups[texels.group_of_texel], 0]
    right = 40 * (texels.weights * corners).sum(axis=1)
    picture = texture_picture(model, morphs, texels, right)
    assert picture.shape[0] == 480
    known = np.isfinite(picture)
    assert 0.5 < known.mean() < 0.95
    columns = np.nonzero(known)[1]
    fit = np.polyfit(columns, picture[known], 1)
    px = float(np.ptp(model.bases[0, :, 1]) * 40) / 480
    assert fit[0] == pytest.approx(px, rel=0.15)  # texels that face aside are not shown
    rest = picture[known] - np.polyval(fit, columns)
    assert np.abs(rest).mean() < 0.02 * np.ptp(right)


def test_patches_are_discs(model: MorphableModel) -> None:
    texels = SurfaceTexels.patches(model, 2.0)
    morphs = np.zeros(model.n_bases)
    morphs[0] = 60.0
    picture = texture_picture(model, morphs, texels, np.full(len(texels), 77.0))
    known = np.isfinite(picture)
    np.testing.assert_allclose(picture[known], 77)
    assert known.mean() < 0.9, "with gaps between them"
