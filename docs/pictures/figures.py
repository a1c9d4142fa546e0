"""Keep small copies of the figures that experiments have drawn: python docs/pictures/figures.py [results].

They go to `docs/pictures/figures`, as the page on the papers' figures shows them.
"""

import sys
from pathlib import Path

from PIL import Image
from rsmcm.apps.experiments import EXPERIMENTS, usual_folder

WIDTH, COLOURS = 1000, 64
HERE = Path(__file__).parent / "figures"


def keep(drawn: Path, kept: Path) -> None:
    """Scale a picture down and take most of its colours away."""
    with Image.open(drawn) as picture:
        small = picture.convert("RGB")
        if small.width > WIDTH:
            small = small.resize((WIDTH, round(small.height * WIDTH / small.width)), Image.Resampling.LANCZOS)
        small.quantize(COLOURS).save(kept, optimize=True)


def main(results: Path) -> None:
    """Copy all that there are."""
    HERE.mkdir(exist_ok=True)
    curves = results / "curves" / "curves.png"
    if curves.exists():
        keep(curves, HERE.with_name("curves.png"))
    for name in EXPERIMENTS:
        for drawn in sorted((results / usual_folder(name).name).glob("fig-*.png")):
            keep(drawn, HERE / f"{name}-{drawn.name}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "results"))
