from .glossy import GlossyRoom, glossy
from .shaken import ShakenFilm, shaken
from .signing.signer import SignerScene, signer
from .street import Scene, TruthBox, sleeping_man
from .talking_face import FaceScene, face
from .turning_cylinder import Cylinder, cylinder
from .turntable import Turntable, turntable

__all__ = [
    "Cylinder",
    "FaceScene",
    "GlossyRoom",
    "Scene",
    "ShakenFilm",
    "SignerScene",
    "TruthBox",
    "Turntable",
    "cylinder",
    "face",
    "glossy",
    "shaken",
    "signer",
    "sleeping_man",
    "turntable",
]
