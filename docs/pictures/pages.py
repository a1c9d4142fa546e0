"""Draw what pages of the documentation show at their tops: python docs/pictures/pages.py.

Most are pages of runs in Chromium, after commands of the documentation; the others are drawn by examples
of the gallery.
"""

import re
import runpy
import shlex
import shutil
import subprocess
import sys
from contextlib import chdir
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
from PIL import Image
from playwright.sync_api import sync_playwright

DOCS = Path(__file__).resolve().parent.parent
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
WINDOW = (1150, 850)  # px

RUNS = (
    "demo --out results/demo",
    "background results/demo/scene/input --out results/counted --zones zones.toml",
    "structure results/demo/cylinder.npz --out results/shape",
    "face results/demo/face/input --out results/face --landmarks results/demo/face/landmarks.npy",
    "body results/demo/body/input --out results/body --head 354,74,58,82",
    "body results/demo/body/input --out results/keypoints --keypoints results/demo/body/joints.csv",
    "batch background 'results/demo/*/input' --out results/films",
)
SHOWN = {
    "start": ("demo/view.html", 175),
    "background": ("demo/comparison/index.html", None),
    "events": ("counted/view.html", 315),
    "structure": ("shape/view.html", 30),
    "faces": ("face/view.html", 40),
    "bodies": ("body/view.html", 60),
    "keypoints": ("keypoints/view.html", 60),
    "scale": ("films/index.html", None),
}
"""By page of the documentation: which file of the results, and the index of the frame that is shown."""

EXAMPLES = {
    "detectors": "plot_03_detector",
    "own-chain": "plot_05_own_chain",
    "own-feature": "plot_06_own_feature",
    "validity": "plot_13_do_they_help",
}


def keep(picture: bytes, page: str) -> None:
    """Write the picture of a page."""
    Image.open(BytesIO(picture)).convert("RGB").save(
        DOCS / "pictures" / f"page-{page}.webp", quality=60, method=6
    )


def show_runs() -> None:
    """Run all commands in the current folder, and show their pages."""
    zones = re.search(r"^```toml zones.toml\n(.*?)^```", (DOCS / "events.md").read_text(), re.S | re.M)
    assert zones is not None
    Path("zones.toml").write_text(zones[1])
    for command in RUNS:
        subprocess.run([sys.executable, "-m", "rsmcm", *shlex.split(command)], check=True)
    executable = next(filter(None, map(shutil.which, BROWSERS)))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox"])
        opened = browser.new_page(viewport=dict(zip(("width", "height"), WINDOW, strict=True)))
        for page, (file, index) in SHOWN.items():
            opened.goto(Path("results", file).resolve().as_uri())
            opened.wait_for_timeout(1000)
            if index is not None:
                opened.locator("#seek").fill(str(index))
                opened.locator("#seek").blur()
                opened.evaluate("scrollTo(0, 0)")  # filling may have scrolled
            opened.wait_for_timeout(1000)
            keep(opened.screenshot(), page)


def show_examples() -> None:
    """Run the examples, and show what each draws first."""
    for page, example in EXAMPLES.items():
        runpy.run_path(str(DOCS / "gallery" / f"{example}.py"))
        drawn = BytesIO()
        plt.figure(plt.get_fignums()[0]).savefig(drawn, dpi=100)
        keep(drawn.getvalue(), page)
        plt.close("all")


if __name__ == "__main__":
    plt.switch_backend("Agg")
    with TemporaryDirectory() as folder, chdir(folder):
        show_runs()
        show_examples()
