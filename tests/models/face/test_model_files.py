"""Files of morphable models: written and read again, small ones by hand, real ones, and damaged ones."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.model_files import read_correspondences, read_model, write_model
from rsmcm.models.face.morphable_model import MorphableModel, rms_radius

Array = NDArray[np.float64]

CANDIDE = """\
# VERTEX LIST:
4
-1 1 0
1 1 0
0 -1 0.5
7 7 7

# FACE LIST:
1
0 2 1

# ANIMATION UNITS LIST:
2

# Smile
2
0 0 0.1 0
2 0.2 0 0.3

# Frown
1
1 0 -0.1 0

# SHAPE UNITS LIST:
1

# Width
2
0 -0.3 0 0
1 0.3 0 0

# ANIMATION PARAMETERS:
0
"""

OBJ = """\
# a square and a triangle, numbers with textures and normals, from the end, and a polygon
v -1 1 0
v 1 1 0 1.0
v 1 -1 0
v -1 -1 0
vt 0 0
f 4/1 3/1/2 2//3 1
v 0 0 1
f -5 -1 -2
"""


def matrix(values: Array) -> bytes:
    """As eos writes it: rows, columns, then float32 column by column."""
    return np.array(values.shape, "<i4").tobytes() + values.astype("<f4").tobytes("F")


def write_surrey(folder: Path, *, beside: bool) -> tuple[Array, Array, Array]:
    """A model of six vertices in the layout of the Surrey files: its mean, scaled modes and expression."""
    random = np.random.default_rng(0)
    mean, expression = random.normal(size=(2, 6, 3))
    modes, deviations = random.normal(size=(18, 2)), np.array([3.0, 0.5])
    triangles = np.array([[0, 1, 2], [2, 3, 4], [4, 5, 0]], "<i4")
    content = np.array([1], "<i4").tobytes() + matrix(mean.reshape(-1, 1)) + matrix(modes)
    content += matrix(deviations[:, None] ** 2) + np.array([3], "<u8").tobytes() + triangles.tobytes()
    (folder / "sfm_shape_3448.bin").write_bytes(content + b"texture coordinates")
    if beside:
        head = np.array([1, 5], "<u8").tobytes() + b"happy"
        expressions = head + matrix(expression.reshape(-1, 1))
        (folder / "expression_blendshapes_3448.bin").write_bytes(expressions)
        (folder / "sfm_reference.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        (folder / "ibug_to_sfm.txt").write_text("# words\n[landmark_mappings]\n  2 = 1 # nose\n30 = 5\n")
    return mean, (modes * deviations).T.reshape(2, 6, 3), expression


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(1, 4), st.booleans())
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, seed: int, n_bases: int, labelled: bool
) -> None:
    random = np.random.default_rng(seed)
    bases = random.normal(size=(n_bases, 9, 3))
    bases /= rms_radius(bases[0])
    model = MorphableModel(
        bases,
        random.integers(9, size=(5, 3)),
        n_bases // 2,
        tuple(f"basis é {number}" for number in range(n_bases)) if labelled else (),
        random.integers(-1, 9, 6) if labelled else None,
    )
    path = tmp_path_factory.mktemp("model") / "some.npz"
    write_model(model, path)
    again = read_model(path)
    np.testing.assert_array_equal(again.bases, model.bases)
    np.testing.assert_array_equal(again.triangles, model.triangles)
    assert (again.identity, again.names) == (model.identity, model.names)
    assert (again.landmarks is None) == (model.landmarks is None)
    if model.landmarks is not None:
        np.testing.assert_array_equal(again.landmarks, model.landmarks)
    assert [file.name for file in path.parent.iterdir()] == ["some.npz"]


def test_bases_of_any_scale_are_brought_to_that_of_models(tmp_path: Path) -> None:
    face, path = face_model(), tmp_path / "face.npz"
    np.savez(path, bases=(250 * face.bases).astype(np.float32), triangles=face.triangles.astype(np.uint16))
    again = read_model(path)
    np.testing.assert_allclose(again.bases, face.bases, atol=1e-6)
    np.testing.assert_array_equal(again.triangles, face.triangles)
    assert (again.identity, again.names, again.landmarks) == (0, (), None)


def test_a_model_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"No such file or directory: '.*/none/face\.npz'"):
        write_model(face_model(), tmp_path / "none" / "face.npz")
    with pytest.raises(ValueError, match=r"got '\.model', expected a name that ends with \.npz"):
        write_model(face_model(), tmp_path / "face.model")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"shape": np.zeros(3)}, r"got shape \(float64\); expected an \.npz file with bases"),
        ({}, "got nothing; expected"),
        ({"triangles": np.array([[0, 1, 9]])}, "triangle 0: got vertex 9, expected 0 to 3"),
        ({"triangles": np.array([[0, 1, 2.0]])}, "triangles: got an array of float64"),
        ({"bases": np.array(["a"])}, r"got bases \(<U1\)"),
        ({"bases": np.zeros((1, 4, 3))}, "typical shape of no size"),
        ({"identity": np.array([1, 2])}, r"identity: got int64 \(2,\), expected a whole number"),
        ({"bases": np.array([{}], object)}, "got array 'bases' of objects"),
    ],
)
def test_no_archive_of_a_model(tmp_path: Path, content: dict[str, Array], message: str) -> None:
    path = tmp_path / "model.npz"
    good = {"bases": np.random.default_rng(0).normal(size=(2, 4, 3)), "triangles": np.array([[0, 1, 2]])}
    alone = not content or "shape" in content
    np.savez(path, **(content if alone else good | content))
    with pytest.raises(ValueError, match=rf"^{path}: .*{message}"):
        read_model(path)


def test_candide(tmp_path: Path) -> None:
    path = tmp_path / "small.wfm"
    path.write_text(CANDIDE)
    model = read_model(path)
    assert model.names == ("shape", "Width", "Smile", "Frown")
    assert model.identity == 1
    np.testing.assert_array_equal(model.triangles, [[0, 2, 1]])  # turned, it is still seen from the front
    assert rms_radius(model.bases[0]) == pytest.approx(1)
    np.testing.assert_allclose(model.bases[0].mean(axis=0), 0, atol=1e-12)
    scale = 2 / (model.bases[0, 1, 0] - model.bases[0, 0, 0])
    edge = [1.0, 2.0, -0.5]  # y down, z away
    np.testing.assert_allclose(scale * (model.bases[0, 2] - model.bases[0, 0]), edge)
    np.testing.assert_allclose(scale * model.bases[1, :, 0], [-0.3, 0.3, 0, 0])
    np.testing.assert_allclose(scale * model.bases[2, 2], [0.2, 0, -0.3])
    np.testing.assert_allclose(scale * model.bases[3, 1], [0, 0.1, 0])


def test_obj(tmp_path: Path) -> None:
    path = tmp_path / "small.obj"
    path.write_text(OBJ)
    model = read_model(path)
    assert (model.n_bases, model.n_vertices, model.names) == (1, 5, ("shape",))
    corners = model.bases[0][model.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert normals[:, 2].sum() < 0
    expected = [[1, 2, 3], [0, 1, 3], [0, 3, 4]]
    assert sorted(sorted(triangle) for triangle in model.triangles.tolist()) == sorted(expected)


@pytest.mark.parametrize("name", ["", "sfm_shape_3448.bin"])
def test_surrey(tmp_path: Path, name: str) -> None:
    mean, modes, expression = write_surrey(tmp_path, beside=True)
    model = read_model(tmp_path / name)
    kept = [0, 1, 2, 5]  # of the coarse mesh, and of landmarks
    assert model.names == ("shape", "identity 1", "identity 2", "happy")
    assert model.identity == 2
    assert sorted(model.triangles[0]) == [0, 1, 2]
    assert model.landmarks is not None
    assert len(model.landmarks) == 68
    assert model.landmarks[[1, 29]].tolist() == [1, 3]
    assert (np.delete(model.landmarks, [1, 29]) == -1).all()
    flip, scale = [1, -1, -1], rms_radius(mean[kept])
    centred = (mean[kept] - mean[kept].mean(axis=0)) * flip
    np.testing.assert_allclose(model.bases[0], centred / scale, atol=1e-6)
    np.testing.assert_allclose(model.bases[1:3], modes[:, kept] * flip / scale, atol=1e-6)
    np.testing.assert_allclose(model.bases[3], expression[kept] * flip / scale, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "shape", "n_triangles"),
    [("candide3/candide3.wfm", (53, 113, 3), 184), ("surrey-face", (70, 850, 3), 1610)],
)
def test_real_models_look_at_the_viewer(
    data_folder: Path, name: str, shape: tuple[int, ...], n_triangles: int
) -> None:
    if not (data_folder / name).exists():
        pytest.skip(f"no {name}")
    model = read_model(data_folder / name)
    assert (model.bases.shape, len(model.triangles)) == (shape, n_triangles)
    corners = model.bases[0][model.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.average(normals[:, 2] < 0, weights=np.linalg.norm(normals, axis=1)) > 0.97
    assert abs(model.bases[0, model.bases[0, :, 2].argmin(), 0]) < 0.05  # the tip of the nose
    if model.landmarks is not None:
        chin, left, right = model.bases[0][model.landmarks[[8, 36, 45]]]
        assert left[0] < -0.5 < 0.5 < right[0]
        assert chin[1] > 1


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.wfm", CANDIDE[:60], "got no complete list of faces, expected a Candide-3"),
        ("a.wfm", "hello", "got no complete list of vertices"),
        (
            "a.wfm",
            CANDIDE.replace("0 2 1", "0 2 4"),
            "vertex of face: got 4, expected a whole number up to 3",
        ),
        ("a.wfm", CANDIDE.replace("2 0.2 0", "2.5 0.2 0"), "vertex of animation unit: got 2.5"),
        ("a.wfm", "-3", "number of vertices: got -3"),
        ("a.obj", "", "got 0 vertices and 0 triangles"),
        ("a.obj", "v 1 2 x\n", r"line 1: got 'v 1 2 x', expected v and three numbers, or f"),
        ("a.obj", OBJ.replace("4/1 3/1/2", "0 3/1/2"), "line 7: got 'f 0"),
        ("a.obj", OBJ.replace("4/1 3/1/2", "9 3/1/2"), "got vertex 8, expected 0 to 4"),
        ("a.obj", "v 1 2 3\nv 2 1 1\nf 1 2\n", "line 3: got 'f 1 2'"),
        ("a.obj", "v 1 2 \0", "got binary data, expected"),
        ("a.npz", "PK or not", "got neither"),
        ("a.npz", "", "got neither"),
        ("a.bin", "abcdefgh", "got 8 bytes that end within a list of 2 numbers"),
        ("a.txt", "words", r"got '\.txt', expected a model file: \.npz, \.wfm, \.obj, \.bin"),
        ("a", "words", "got '', expected a model file"),
    ],
)
def test_no_model(tmp_path: Path, name: str, content: str, message: str) -> None:
    path = tmp_path / name
    path.write_text(content)
    with pytest.raises(ValueError, match=rf"^{path}.*{message}") as caught:
        read_model(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["sfm_shape_3448.bin", "expression_blendshapes_3448.bin"])
def test_a_surrey_file_that_is_cut_off(tmp_path: Path, name: str) -> None:
    write_surrey(tmp_path, beside=True)
    whole = (tmp_path / name).read_bytes()
    for length in range(0, len(whole) - 20, 37):
        (tmp_path / name).write_bytes(whole[:length])
        with pytest.raises(ValueError, match=rf"{name}: got .* expected a (shape )?model of eos"):
            read_model(tmp_path)


def test_correspondences(tmp_path: Path) -> None:
    path = tmp_path / "pairs.txt"
    path.write_text("# words = words\n\n7 = 9   # chin\n  0=3\n")
    np.testing.assert_array_equal(read_correspondences(path), [[7, 9], [0, 3]])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("7 = 9\nchin\n", "line 2: got 'chin', expected a pair like '7 = 9'"),
        ("7 = 0\n", "line 1: got '7 = 0'"),
        ("-7 = 1\n", "line 1: got '-7 = 1'"),
        ("1 = 2\n1 = 3\n", "line 2: got landmark 1 once more"),
        ("# nothing\n", "got no pair of landmarks"),
        ("\0\1\2", "got binary data, expected"),
    ],
)
def test_no_correspondences(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "pairs.txt"
    path.write_text(content)
    with pytest.raises(ValueError, match=rf"^{path}.*{message}"):
        read_correspondences(path)
