"""The film of a real signer, where somebody has it."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from rsmcm.apps.experiments.datasets import data_folder


def signer_clip() -> list[NDArray[np.uint8]]:
    """Its 125 images, 640x360 BGR; skips the test without it."""
    try:
        path = data_folder("signer") / "signseg_demo_video.mp4"
    except (FileNotFoundError, ValueError):
        pytest.skip("the signer's film is not here")
    reader = cv2.VideoCapture(str(path))
    images = []
    while (answer := reader.read())[0]:
        images.append(np.asarray(answer[1], np.uint8))
    return images
