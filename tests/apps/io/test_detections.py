"""Files of detections: every form says the same, and what is wrong with one is a line that says where."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from rsmcm.apps.io import Detections, read_detections, with_boxes
from rsmcm.models.core.frame import Frame

Row = tuple[int, tuple[float, float, float, float], float, str]
CLASSES = ["person", "car"]


def mot(rows: list[Row]) -> str:
    return "".join(
        f"{frame},-1,{x + 1},{y + 1},{w},{h},{score},-1,-1,-1\n" for frame, (x, y, w, h), score, _ in rows
    )


def sizes(rows: list[Row]) -> str:
    lines = [f"{score};{h};{w};{y};{x};{name};{frame}\n" for frame, (x, y, w, h), score, name in rows]
    return "".join(["Score;Height;Width;Y;X;Class;Frame\n", *lines])


def edges(rows: list[Row]) -> str:
    lines = [f"{frame},{x},{y},{x + w},{y + h},{name},{score}\n" for frame, (x, y, w, h), score, name in rows]
    return "".join(["frame,x_min,y_min,x_max,y_max,class_name,confidence\n", *lines])


def results(rows: list[Row]) -> str:
    return json.dumps(
        [
            {"image_id": frame, "category_id": CLASSES.index(name), "bbox": box, "score": score}
            for frame, box, score, name in rows
        ]
    )


def data_set(rows: list[Row]) -> str:
    frames = sorted({row[0] for row in rows})
    return json.dumps(
        {
            "annotations": [
                {"image_id": 70 + frame, "category_id": CLASSES.index(name), "bbox": box, "score": score}
                for frame, box, score, name in rows
            ],
            "info": {"date": "today", "tags": [1, [2]]},
            "categories": [{"id": index, "name": name} for index, name in enumerate(CLASSES)],
            "images": [{"id": 70 + frame, "file_name": f"img1/{frame:06d}.jpg"} for frame in frames],
        },
        indent=1,
    )


whole = st.integers(0, 400).map(float)
rows_of_a_film = st.lists(
    st.tuples(
        st.integers(1, 30),
        st.tuples(whole, whole, whole.map(lambda v: v + 1), whole.map(lambda v: v + 0.5)),
        st.floats(-9, 9).map(lambda v: round(v, 3)),
        st.sampled_from(CLASSES),
    ),
    min_size=1,
    max_size=12,
)


def written(folder: Path, text: str, name: str = "found") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def read_frame_result(detections: Detections, numbers: range) -> list[tuple[int, list[float], float]]:
    found = []
    for number in numbers:
        boxes = detections.at(number)
        if boxes is not None:
            assert boxes.confidence is not None
            found += [
                (number, xyxy, score)
                for xyxy, score in zip(boxes.xyxy.tolist(), boxes.confidence.tolist(), strict=True)
            ]
    return found


@pytest.mark.parametrize("form", [mot, sizes, edges, results, data_set])
@given(rows=rows_of_a_film)
def test_every_form_says_the_same(
    form: Callable[[list[Row]], str], tmp_path_factory: pytest.TempPathFactory, rows: list[Row]
) -> None:
    """A box that is written twice is one box."""
    detections = read_detections(written(tmp_path_factory.mktemp("found"), form(rows + rows[::-1])))
    once = dict.fromkeys((*row[:3], form is mot or row[3]) for row in rows)  # MOT's form has no classes
    expected = [
        (frame, [x, y, x + w, y + h], score)
        for frame, (x, y, w, h), score, _ in sorted(once, key=lambda row: row[0])
    ]
    assert len(detections) == len(once)
    assert read_frame_result(detections, range(1, 31)) == expected


@pytest.mark.parametrize("form", [sizes, edges, data_set])
def test_classes_are_kept_by_name(form: Callable[[list[Row]], str], tmp_path: Path) -> None:
    """The detector has run on frames in which it found only other ones."""
    box = (1.0, 2.0, 3.0, 4.0)
    path = written(tmp_path, form([(1, box, 0.5, "person"), (2, box, 0.7, "car"), (2, box, 0.9, "person")]))
    cars = read_detections(path, ["car"])
    assert cars.at(1) is not None
    assert read_frame_result(cars, range(1, 4)) == [(2, [1, 2, 4, 6], 0.7)]
    (boxes,) = [read_detections(path).at(2)]
    assert boxes is not None
    assert boxes.classes is not None
    assert boxes.classes.tolist() == ["car", "person"]
    with pytest.raises(ValueError, match=r"--classes: got 'cat', but .*found has person, car"):
        read_detections(path, ["person", "cat"])


# --- where a detector ran --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("listed", "looked"),
    [
        ([1, 2, 5], {1, 2, 3, 4, 5}),  # dense: nothing was found in 3 and 4
        ([4, 9, 19], {4, 9, 14, 19}),  # every fifth frame
        ([1, 6, 10, 15], {1, 6, 10, 15}),  # every 0.19 s of 25 frames a second: irregular
        ([7], {7}),
    ],
)
def test_frames_that_are_not_listed(listed: list[int], looked: set[int], tmp_path: Path) -> None:
    path = written(tmp_path, "".join(f"{number},-1,5,5,10,10,1\n" for number in listed[::-1]))
    detections = read_detections(path)
    assert {number for number in range(30) if detections.at(number) is not None} == looked
    assert {number for number in looked if len(detections.at(number) or ())} == set(listed)


# --- what is wrong ---------------------------------------------------------------------------------------

GOOD = '{"image_id": 1, "bbox": [1, 2, 3, 4], "score": 1}'
HEADER = "frame,x,y,width,height,score\n"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "found: holds nothing, expected MOT's"),
        ("hello\n", r"found, line 1: got 'hello', expected MOT's det\.txt, CSV with a header"),
        (HEADER, "found: holds no detections"),
        ("1,-1,5,5,10,10,1\n1,-1,5,5,0,10,1\n", "found, line 2: got a box of 0 x 10 px"),
        ("1,-1,5,5,10,10,nan\n", "found, line 1: got a score of nan"),
        ("1,-1,5,5,10,10,1\n2,-1,5,5,10,10\n", "found, line 2: got scores or classes for some boxes only"),
        ("frame,x,y\n1,2,3\n", "found, line 1: got columns 'frame,? x, y', expected frame and either"),
        (HEADER + "1,2,3,4,5,1\n1,2,3\n", "found, line 3: got 3 columns, expected width in column 4"),
        (HEADER + "1,2,3,4,high,1\n", "found, line 2: got height 'high', expected a number"),
        (HEADER + '1,2,3,4,5,"1\n', "found, line 2: got a quote that does not end"),
        (f"[{GOOD},\n{GOOD}", "found, line 2: got no JSON, or a part of it"),
        (f"[{GOOD}] 1", "found, line 1: got more behind the end"),
        (f"[{GOOD}, 7]", "found, result 2: got 7, expected an object"),
        (f'[{GOOD}, {{"bbox": [1, 2, 3, 4]}}]', "found, result 2: got no image_id"),
        ('[{"image_id": 1, "bbox": [1, 2, 3]}]', "found, result 1: got bbox"),
        ('{"annotations": []}', "found: got an object without images"),
        (
            '{"images": [], "annotations": [{"image_id": 3, "bbox": [1, 2, 3, 4]}]}',
            "found, annotation 1: got image_id 3, expected one of the images listed",
        ),
        ('{"images": [{"id": 3}]}', "found, image 1: got no file_name"),
        ("[" * 100_000, "found: got no value that such a file has"),
    ],
)
def test_what_is_wrong_is_said_with_its_place(text: str, complaint: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=complaint) as caught:
        read_detections(written(tmp_path, text))
    assert "\n" not in str(caught.value)
    assert str(tmp_path / "found") in str(caught.value)


def test_pictures_that_the_film_does_not_have(tmp_path: Path) -> None:
    path = written(tmp_path, '[{"image_id": "b.png", "bbox": [1, 2, 3, 4]}]')
    assert len(read_detections(path, pictures=["a.png", "b.png"]).at(2) or ()) == 1
    with pytest.raises(ValueError, match=r"result 1: got image 'b\.png', expected a picture of street"):
        read_detections(path, film="street", pictures=["a.png"])


@pytest.fixture
def detections(tmp_path: Path) -> Detections:
    path = tmp_path / "det.txt"
    path.write_text("1,-1,1,1,10,10,1\n1,-1,91,41,20,20,1\n3,-1,-8,1,10,10,1\n5,-1,1,1,10,10,1\n")
    return read_detections(path)


def test_boxes_are_those_of_the_frames_number(detections: Detections) -> None:
    image = np.zeros((50, 100), np.uint8)
    counts = [detections(Frame(image, 0.1 * number, number)) for number in range(1, 7)]
    assert [None if boxes is None else len(boxes) for boxes in counts] == [2, None, 1, None, 1, None]
    assert detections.counted(range(1, 4)) == {"boxes": 3, "frames": 2}


@pytest.mark.parametrize(
    ("size", "last", "complaint"),
    [
        (
            (90, 50),
            5,
            r"line 2: got a box from 90, 40, 110, 60 .* in frame 1, outside of the picture of 90x50",
        ),
        ((100, 50), 4, r"det\.txt, line 4: got frame 5, but film has 4 frames"),
    ],
)
def test_boxes_of_another_film(
    detections: Detections, size: tuple[int, int], last: int, complaint: str
) -> None:
    with pytest.raises(ValueError, match=complaint):
        detections.check("film", size, last)


IMAGE = np.zeros((40, 60, 3), np.uint8)
FRAMES = [Frame(None if number == 4 else IMAGE, 0.1 * number, number) for number in range(1, 9)]


def test_a_detector_is_called_with_every_frame_that_has_an_image() -> None:
    called = []

    def detector(frame: Frame) -> NDArray[np.float64] | None:
        called.append(frame.number)
        return None if frame.number == 2 else np.array([[1.0, 2, 3 + frame.number, 5]])

    frames = list(with_boxes(FRAMES, detector))
    assert called == [1, 2, 3, 5, 6, 7, 8]
    assert [frame.number for frame in frames] == list(range(1, 9))
    assert [frame.boxes is None for frame in frames] == [number in (2, 4) for number in range(1, 9)]
    assert frames[6].boxes is not None
    assert frames[6].boxes.xyxy.tolist() == [[1, 2, 10, 5]]
    assert frames[6].image is FRAMES[6].image


def test_a_detector_can_run_on_every_third_frame() -> None:
    """A missing frame is none of those that are counted."""
    frames = list(with_boxes(FRAMES, lambda _: [], every=3))
    assert [frame.number for frame in frames if frame.boxes is not None] == [1, 5, 8]
    assert all(len(frame.boxes) == 0 for frame in frames if frame.boxes is not None)


@pytest.mark.parametrize(
    ("arguments", "error", "complaint"),
    [
        ((lambda _: None, 0), ValueError, "every: got 0"),
        ((lambda _: np.zeros((2, 3)),), ValueError, r"frame 1: boxes: got \(2, 3\), expected \(n, 4\)"),
    ],
)
def test_what_is_no_detector(
    arguments: tuple[Callable[..., Any], int], error: type[Exception], complaint: str
) -> None:
    with pytest.raises(error, match=complaint):
        list(with_boxes(FRAMES, *arguments))
