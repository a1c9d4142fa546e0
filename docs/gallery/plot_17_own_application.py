"""
Your own application
====================

An application defines its model, its columns (one row per frame), its summary, and its page. The loop of
``rsmcm background`` runs it, with any source, Ctrl-C with complete results, resuming, progress,
``summary.json``, and the page that plays the video. This one measures how busy a place is.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import matplotlib.pyplot as plt
import numpy as np
from rsmcm.apps.runs import Application, Columns, FilmJob, Line, Page, Plot, run_film
from rsmcm.apps.scenes import sleeping_man
from rsmcm.chains import AdaptiveBackground, BlobTracker
from rsmcm.inference import MultiChain
from rsmcm.models import PixelLabels

pixels = PixelLabels()


class Busy(Application):
    name, files = "busy", ["busy.csv"]

    def build(self, start):
        return start.filter(MultiChain().connect(AdaptiveBackground(), pixels).connect(BlobTracker(), pixels))

    def columns(self, belief):
        if not belief.states:  # no image yet
            return Columns({"covered": 0.0, "there": 0})
        covered = np.mean(belief[pixels].foreground() > 0)
        return Columns({"covered": covered, "there": len(belief["blobs"].tracks())})

    def finish(self, log):
        log.write_table(self.job.out / "busy.csv")
        return {"mean_objects": log["there"].mean(), "most_covered": log["covered"].max()}

    def page(self, log, film, summary):
        plots = [
            Plot("covered", "%", [Line(100 * log["covered"])]),
            Plot("objects", "", [Line(log["there"])]),
        ]
        return Page("How busy it is", film=film, plots=plots, numbers=log["number"], times=log["time"])


# %%
# ``run_film`` takes the application with its job, whose fields are the common options of all runs:
# ``out``, ``start``, ``stop``, ``every``, ``live`` and so on. After a kill, the same job with
# ``resume=True`` continues, with the same bytes as an uninterrupted run.

folder = TemporaryDirectory()
source, out = Path(folder.name) / "film", Path(folder.name) / "results"
source.mkdir()
for frame in sleeping_man(120, size=(160, 120), enter=5):
    cv2.imwrite(str(source / f"{frame.number:04}.png"), frame.image)
outcome = run_film(Busy(FilmJob(str(source), out=out)))
print(*outcome.words, f"{outcome.summary['mean_objects']:.2f} objects a frame", sep=", ")
print(*sorted(path.name for path in out.iterdir()))

# %%
# The columns are kept in a log, which ``finish`` and ``page`` receive. With ``sinks`` an application
# writes files that grow with the frames, with ``drawing`` it draws on the video.

rows = np.genfromtxt(out / "busy.csv", delimiter=",", names=True)
axis = plt.figure(figsize=(9, 2.6), layout="constrained").subplots()
axis.plot(rows["time"], 100 * rows["covered"])
axis.set(xlabel="s", ylabel="foreground, %")
