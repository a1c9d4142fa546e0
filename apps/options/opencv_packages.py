"""OpenCV comes as several packages with the same files: the one installed last replaces the others'."""

from importlib.metadata import packages_distributions

EXPECTED = "opencv-python-headless"


def opencv_hint(error: BaseException) -> str:
    """What is added to the message of an error that other packages of OpenCV may have led to.

    Parameters
    ----------
    error
        whatever was raised.

    Returns
    -------
    str
        names the packages; empty if the error does not come from OpenCV, or there is only the one that is
        expected.
    """
    found = sorted(set(packages_distributions().get("cv2", []))) if _of_opencv(error) else []
    if not set(found) - {EXPECTED}:
        return ""
    return f" (cv2 comes from {' and '.join(found)}, expected {EXPECTED} alone: uninstall all, install that)"


def _of_opencv(error: BaseException | None) -> bool:
    """Whether OpenCV could not be imported or lacks something, or the error was raised because of that."""
    if error is None:
        return False
    lacks = isinstance(error, AttributeError) and getattr(error.obj, "__name__", "").split(".")[0] == "cv2"
    fails = isinstance(error, ImportError) and error.name == "cv2"
    return lacks or fails or _of_opencv(error.__cause__ or error.__context__)
