"""Loop that draws textured triangles in colour into samples that keep a depth each."""

import numpy as np

from ....models.numerics.compiled import compiled

_f4 = np.float32


@compiled
def draw_solid(colours, depths, places, attributes, triangles, texture):
    """Draw triangles into samples `colours` (height, width, 3), `depths` (height, width); nearer ones win.

    places (n, 3): column, row and depth of vertices, in samples. attributes (n, 3): column and row in
    `texture` (rows, columns, 3), and light; linear over a triangle, as an orthographic camera has it.
    """
    height, width = depths.shape
    last_u, last_v = _f4(texture.shape[1]) - _f4(1.001), _f4(texture.shape[0]) - _f4(1.001)
    for number in range(triangles.shape[0]):
        a, b, c = triangles[number, 0], triangles[number, 1], triangles[number, 2]
        ax, ay, az = places[a, 0], places[a, 1], places[a, 2]
        bx, by, bz = places[b, 0] - ax, places[b, 1] - ay, places[b, 2] - az
        cx, cy, cz = places[c, 0] - ax, places[c, 1] - ay, places[c, 2] - az
        area = bx * cy - by * cx
        if abs(area) < 1e-9:
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
            dy = row - ay
            for column in range(left, right + 1):
                dx = column - ax
                share_b = dx * to_b - dy * cx / area
                share_c = dx * to_c + dy * bx / area
                # edges belong to both triangles: a sample may be drawn twice, but there are no cracks
                if share_b < -1e-9 or share_c < -1e-9 or share_b + share_c > 1 + 1e-9:
                    continue
                z = az + share_b * bz + share_c * cz
                if z >= depths[row, column]:
                    continue
                depths[row, column] = z
                u = min(max(_f4(ua + share_b * ub + share_c * uc), _f4(0)), last_u)
                v = min(max(_f4(va + share_b * vb + share_c * vc), _f4(0)), last_v)
                light = _f4(la + share_b * lb + share_c * lc)
                i, j = np.int32(v), np.int32(u)
                down, across = v - _f4(i), u - _f4(j)
                for channel in range(3):
                    above = texture[i, j, channel]
                    above += across * (texture[i, j + 1, channel] - above)
                    below = texture[i + 1, j, channel]
                    below += across * (texture[i + 1, j + 1, channel] - below)
                    colours[row, column, channel] = light * (above + down * (below - above))
