"""Loops that draw a textured mesh: triangles into samples with a depth each, and samples into pixels."""

import numpy as np
from numpy.typing import NDArray

from ...models.numerics.compiled import compiled

_f4 = np.float32
Pixels = NDArray[np.float32]

EMPTY_DEPTH = 1e30  # depth of a sample that nothing covers


@compiled
def draw_mesh(shown, depth, places, attributes, triangles, texture):
    """Draw triangles into samples `shown`, `depth` (height, width); nearer ones win, whatever their order.

    shown (height, width, channels), texture (rows, columns, channels). places (n, 3): column, row and depth
    of vertices, in samples. attributes (n, 3): column and row in the texture, and light; linear over a
    triangle like depth, as weak perspective has it. Outside, a texture goes on as at its nearest edge.
    """
    last_u, last_v = _f4(texture.shape[1]) - _f4(1.001), _f4(texture.shape[0]) - _f4(1.001)
    height, width = depth.shape
    for number in range(triangles.shape[0]):
        a, b, c = triangles[number, 0], triangles[number, 1], triangles[number, 2]
        ax, ay, az = places[a, 0], places[a, 1], places[a, 2]
        bx, by, bz = places[b, 0] - ax, places[b, 1] - ay, places[b, 2] - az
        cx, cy, cz = places[c, 0] - ax, places[c, 1] - ay, places[c, 2] - az
        area = bx * cy - by * cx
        if abs(area) < 1e-12:
            continue
        top = max(0, int(np.ceil(ay + min(0.0, by, cy))))
        bottom = min(height - 1, int(np.floor(ay + max(0.0, by, cy))))
        left = max(0, int(np.ceil(ax + min(0.0, bx, cx))))
        right = min(width - 1, int(np.floor(ax + max(0.0, bx, cx))))
        to_b, to_c = cy / area, -by / area  # growth of the shares of b and c from one column to the next
        ua, va, la = attributes[a, 0], attributes[a, 1], attributes[a, 2]
        ub, vb, lb = attributes[b, 0] - ua, attributes[b, 1] - va, attributes[b, 2] - la
        uc, vc, lc = attributes[c, 0] - ua, attributes[c, 1] - va, attributes[c, 2] - la
        for row in range(top, bottom + 1):
            depths = depth[row]
            dy = row - ay
            for column in range(left, right + 1):
                dx = column - ax
                share_b = dx * to_b - dy * cx / area
                share_c = dx * to_c + dy * bx / area
                # edges belong to both triangles: a sample may be drawn twice, but there are no cracks
                if share_b >= -1e-9 and share_c >= -1e-9 and share_b + share_c <= 1 + 1e-9:
                    z = az + share_b * bz + share_c * cz
                    if z < depths[column]:
                        depths[column] = z
                        u = min(max(_f4(ua + share_b * ub + share_c * uc), _f4(0)), last_u)
                        v = min(max(_f4(va + share_b * vb + share_c * vc), _f4(0)), last_v)
                        light = _f4(la + share_b * lb + share_c * lc)
                        i, j = np.int32(v), np.int32(u)
                        down, across = v - _f4(i), u - _f4(j)
                        for channel in range(texture.shape[2]):
                            above = texture[i, j, channel]
                            above += across * (texture[i, j + 1, channel] - above)
                            below = texture[i + 1, j, channel]
                            below += across * (texture[i + 1, j + 1, channel] - below)
                            shown[row, column, channel] = light * (above + down * (below - above))


def average_samples(
    picture: Pixels, covered: Pixels, grey: Pixels, depth: Pixels, across: int, left: int, top: int
) -> None:
    """Blend samples, `across` x `across` a pixel, over `picture` from pixel `(left, top)` on.

    `covered`, `(height, width)`, receives the share of each pixel that is drawn.
    """
    drawn, share = depth < _f4(EMPTY_DEPTH), _f4(1 / across**2)
    places = [np.s_[i::across, j::across] for i in range(across) for j in range(across)]
    height, width = depth.shape[0] // across, depth.shape[1] // across
    total, part = np.zeros((2, height, width), np.float32)
    for place in places:
        total += np.where(drawn[place], grey[place], _f4(0))
        part += drawn[place]
    part *= share
    window = np.s_[top : top + height, left : left + width]
    covered[window] = part
    picture[window] = total * share + (1 - part) * picture[window]
