"""Where a face begins to be tracked, and where there is none."""

import cv2
import numpy as np
import pytest
from rsmcm.chains.face.start import CONFIRMING, FaceStart, find_face, on_trial, start_from_box
from rsmcm.models import Frame
from rsmcm.models.face.built_in_model import face_model
from rsmcm.models.face.detectors import default_faces


def test_a_trial_goes_on_in_one_place() -> None:
    one, near, far = (start_from_box(face_model(), (x, 30, 40, 40)) for x in (50, 55, 95))
    assert on_trial([], one) == [one]
    assert on_trial([one], near) == [one, near]
    assert on_trial([one, near], far) == [far]
    assert on_trial([one, near], None) == []


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(cv2, "CascadeClassifier"), reason="OpenCV has no cascade")
def test_texture_is_hardly_ever_a_face() -> None:
    """Of 40 films of smooth random texture two were; more than five of 24 have a chance of 1 in 1000."""
    faces, begun = default_faces(), 0
    for seed in range(24):
        random = np.random.default_rng(seed)
        wide = cv2.GaussianBlur(random.normal(size=(300, 380)), (0, 0), 2.0 + 2 * (seed % 4))
        wide = 128 + 50 * wide / wide.std()
        trial: list[FaceStart] = []
        for number in range(1, 13):
            shown = wide[number : 240 + number, number : 320 + number] + random.normal(0, 3, (240, 320))
            frame = Frame(np.clip(shown, 0, 255).astype(np.uint8), number / 25, number)
            box = find_face(frame, faces, small=False)
            trial = on_trial(trial, None if box is None else start_from_box(face_model(), box))
            if len(trial) == CONFIRMING:
                begun += 1
                break
    assert begun <= 5
