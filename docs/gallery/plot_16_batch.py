"""
Many videos
===========

``rsmcm batch`` runs an application on any number of videos: one folder each, several at a time, and a
summary. A failure does not stop the others. When the same command is run again, complete videos are
skipped, and interrupted ones continue.
"""

import csv
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import matplotlib.pyplot as plt
from rsmcm.apps.scenes import sleeping_man

# %%
# Two videos as folders of images, and a broken file.

folder = TemporaryDirectory()
films, results = Path(folder.name) / "films", Path(folder.name) / "results"
for seed in range(2):
    (films / f"street{seed}").mkdir(parents=True)
    for frame in sleeping_man(75, seed=seed, size=(160, 120), enter=0):
        cv2.imwrite(str(films / f"street{seed}" / f"{frame.number:04}.png"), frame.image)
(films / "broken.mp4").write_bytes(b"this is no film")

# %%
# The command as in a shell (``rsmcm`` is ``python -m rsmcm.apps.command_line``), and its summary. The second
# run only repeats what has failed.

command = "-m rsmcm.apps.command_line batch background films --out results --jobs 1 --masks none --quiet"
for time in ("first", "second"):
    done = subprocess.run([sys.executable, *command.split()], cwd=folder.name, capture_output=True, text=True)
    print(f"{time} time: exit code {done.returncode}")
with (results / "summary.csv").open() as lines:
    rows = list(csv.DictReader(lines))
for row in rows:
    print(f"{row['folder']}: {row['state']} {row['error'].split(': ', 1)[-1]}")

# %%
# Each folder has the results of the single command. Here are the background image and the paths of the
# feet, from ``background.png`` and ``tracks.csv``; ``results/index.html`` is a page of all videos.

figure, axes = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
for axis, row in zip(axes, (row for row in rows if row["state"] == "complete"), strict=True):
    axis.imshow(cv2.imread(str(results / row["folder"] / "background.png"))[..., ::-1])
    with (results / row["folder"] / "tracks.csv").open() as lines:
        tracks = [{name: float(value) for name, value in line.items()} for line in csv.DictReader(lines)]
    axis.plot([t["x"] + t["width"] / 2 for t in tracks], [t["y"] + t["height"] for t in tracks], "w.")
    axis.set(title=f"{row['folder']}: {row['frames']} frames", xticks=[], yticks=[])
folder.cleanup()
