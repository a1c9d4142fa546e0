"""Ghosts: blobs in whose place nothing stands, but the background's picture shows something that has gone.

Of a blob two things may be true: something real stands there, or it is a ghost. With colours a right inside
of its outline and b right outside, in the image I and in the background's picture B,

    p(I, B | real)  = prod_k  u_I  f_B(a_B - b_B)
    p(I, B | ghost) = prod_k  f_I(a_I - b_I)  u_B

f: a contrast within the scene, log-logistic about its median, which is measured a little further outside, in
the image (with its noise) and in the picture; u: any contrast, as likely as the scene's own on average, so
that scenes without an edge speak for neither. Neighbours along an outline are not independent, so the log
ratio of both is tempered; nor are looks at the same outline: a blob that stays as it is has one such view.
As it travels, each of its own lengths brings another one, and speaks for itself: a ghost does not travel.
Only lengths count by which it has left the place where it appeared, since there it may have been taken for
one thing with its ghost. What was found on the way stays for the blob's life. The loops are in
`chains.objects.kernels.outlines`.
"""

import numpy as np

from .blob_table import Blobs
from .blobs import Blob
from .kernels.records import MARGIN

VIEW_TIME = 0.4
"""s over which a view is averaged: masks err for a while in the same way."""


def inherited(blob: Blob, others: Blobs) -> float:
    """Evidence (nats) that a newborn has from what it touches: it is as likely as not a part of that."""
    x, y, width, height = blob.box
    left, top, columns, rows = others.boxes.T
    touched = (x - MARGIN < left + columns) & (left < x + width + MARGIN)
    touched &= (y - MARGIN < top + rows) & (top < y + height + MARGIN)
    return float(np.min(0.5 * others.table["past_views"][touched], initial=0.0)) if touched.any() else 0.0
