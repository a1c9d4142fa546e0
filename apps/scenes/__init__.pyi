from .room import Room, standing_in_a_room
from .shaken import ShakenFilm, shaken
from .signing.signer import SignerScene, signer
from .street import Scene, TruthBox, sleeping_man
from .talking_face import FaceScene, face
from .trees import Trees, waving_trees
from .turning_cylinder import Cylinder, cylinder
from .turntable import Turntable, turntable

__all__ = [
    "Cylinder",
    "FaceScene",
    "Room",
    "Scene",
    "ShakenFilm",
    "SignerScene",
    "Trees",
    "TruthBox",
    "Turntable",
    "cylinder",
    "face",
    "shaken",
    "signer",
    "sleeping_man",
    "standing_in_a_room",
    "turntable",
    "waving_trees",
]
