"""Loops over small square patches of a grey picture: sampling them, and finding where they are again.

A window is laid out as one line, row after row, so that each pixel of a patch is an offset along it: what all
places of the patch in the window need comes from a few long loops, each over `TAPS` offsets at once.
"""

import numpy as np

from ...numerics.compiled import compiled

_f4 = np.float32

TAPS = 5
"""Offsets that are taken in one go: the side of a usual patch."""

REGISTER = 16
"""Numbers of a vector register: a line that is a multiple of it long leaves nothing to be done one by one."""

SPAN = 64
"""Places: the best ones of all that are so far apart are found in long loops, then the best of these."""

FLAT = 0.5
"""Grey levels: patches whose standard deviation is below show little but rounding."""

NOWHERE = -1.0
"""Score where there is no peak."""

STEPS = 4
"""At most, of the way from the best whole pixel to the best place between pixels."""

NEAR_ENOUGH = 0.01
"""px: a step that is shorter is the last one."""

HIDDEN_NOISE = 1.5
"""Variance of the pixels' noise over that of the residuals: interpolation smooths up to 5/9 of it away, but
not the slow part of it, which is what shifts a patch."""

ROUNDING = 0.25
"""Squared grey levels: variance of what is left of two pictures' rounding, however well patches fit."""

LEAST_DEVIATION = 0.03
"""px: error of a place even where patches fit exactly, for what is between pixels is only interpolated."""

_LOW = _f4(-4)  # below any score, also when one is added
_FARTHEST = 0.999  # px from the best whole pixel: beyond, another one would be better


@compiled
def padded(count, unit):
    """Return `count`, made a multiple of `unit`."""
    return -(-count // unit) * unit


@compiled
def _sum_products(line, offsets, weights, out):
    """For every place the sum of `weights` times the numbers that are `offsets` further on the line."""
    n = out.size
    for k in range(0, offsets.size, TAPS):
        w0, w1, w2, w3, w4 = weights[k], weights[k + 1], weights[k + 2], weights[k + 3], weights[k + 4]
        a0, a1 = line[offsets[k] : offsets[k] + n], line[offsets[k + 1] : offsets[k + 1] + n]
        a2, a3 = line[offsets[k + 2] : offsets[k + 2] + n], line[offsets[k + 3] : offsets[k + 3] + n]
        a4 = line[offsets[k + 4] : offsets[k + 4] + n]
        if k == 0:
            for i in range(n):
                out[i] = w0 * a0[i] + w1 * a1[i] + w2 * a2[i] + w3 * a3[i] + w4 * a4[i]
        else:
            for i in range(n):
                out[i] += w0 * a0[i] + w1 * a1[i] + w2 * a2[i] + w3 * a3[i] + w4 * a4[i]


@compiled
def _row_sums(line, ones, total, energy):
    """For every place the sums of as many numbers as there are `ones`, and of their squares."""
    n = total.size
    for k in range(0, ones.size, TAPS):
        w0, w1, w2, w3, w4 = ones[k], ones[k + 1], ones[k + 2], ones[k + 3], ones[k + 4]
        a0, a1, a2 = line[k : k + n], line[k + 1 : k + 1 + n], line[k + 2 : k + 2 + n]
        a3, a4 = line[k + 3 : k + 3 + n], line[k + 4 : k + 4 + n]
        if k == 0:
            for i in range(n):
                b0, b1, b2, b3, b4 = w0 * a0[i], w1 * a1[i], w2 * a2[i], w3 * a3[i], w4 * a4[i]
                total[i] = b0 + b1 + b2 + b3 + b4
                energy[i] = b0 * b0 + b1 * b1 + b2 * b2 + b3 * b3 + b4 * b4
        else:
            for i in range(n):
                b0, b1, b2, b3, b4 = w0 * a0[i], w1 * a1[i], w2 * a2[i], w3 * a3[i], w4 * a4[i]
                total[i] += b0 + b1 + b2 + b3 + b4
                energy[i] += b0 * b0 + b1 * b1 + b2 * b2 + b3 * b3 + b4 * b4


@compiled
def _window(image, left, top, width, height, line):
    """Pixels of a window, less a middle grey: the squares of small numbers are summed more exactly."""
    for y in range(height):
        pixels, here = image[top + y, left : left + width], line[y * width : (y + 1) * width]
        for x in range(width):
            here[x] = _f4(pixels[x]) - _f4(128)


@compiled
def _layout(width, columns, rows, side, offsets, rim):
    """Lay out a window with room for `rows` of `columns` patches, as one line of rows of `width`.

    `offsets` takes those of a patch's column and of the whole patch, `rim` a low number for the places on the
    window's rim, and for those from which a patch would run over the end of a row; 0 for all others.
    """
    whole = offsets[padded(side, TAPS) :]
    for y in range(side):
        offsets[y] = y * width
        for x in range(side):
            whole[y * side + x] = y * width + x
    rim[:] = _LOW
    for y in range(1, rows - 1):
        for x in range(1, columns - 1):
            rim[y * width + x] = _f4(0)


@compiled
def _correlate(line, width, side, template, offsets, ones, scratch, score):
    """Normalised correlation of a patch of mean 0 and length 1 with all that begin on the line.

    See `_layout` for `offsets`; `ones` are as many as a patch has rows. A place from which a patch would run
    over the end of a row gets a number without meaning.
    """
    column, whole = offsets[: ones.size], offsets[ones.size :]
    in_rows = padded(score.size + (side - 1) * width, REGISTER)
    row_total, row_energy = scratch[0, :in_rows], scratch[1, :in_rows]
    total, energy = scratch[2, : score.size], scratch[3, : score.size]
    _row_sums(line, ones, row_total, row_energy)
    _sum_products(row_total, column, ones, total)
    _sum_products(row_energy, column, ones, energy)
    _sum_products(line, whole, template, score)
    share, least = _f4(1 / (side * side)), _f4(side * side * FLAT * FLAT)
    for i in range(score.size):
        score[i] *= _f4(1) / np.sqrt(max(energy[i] - share * total[i] * total[i], least))


@compiled
def _peaks(score, width, rim, highest, peak):
    """Leave in `peak` the scores that none of their eight neighbours exceeds, and low numbers elsewhere.

    On the window's rim there are none: nothing tells whether the score falls off behind it.
    """
    n = score.size
    inner = n - 2 * width - 2
    before, here, after = score[: n - 2], score[1 : n - 1], score[2:]
    for i in range(n - 2):  # of three in a row, at the first one's place
        highest[i] = max(here[i], max(before[i], after[i]))
    above, below = highest[:inner], highest[2 * width : 2 * width + inner]
    before, here, after = score[width:], score[width + 1 :], score[width + 2 :]
    peak[:] = _LOW
    found, inside = peak[width + 1 :], rim[width + 1 :]
    for i in range(inner):
        around = max(max(before[i], after[i]), max(above[i], below[i]))
        found[i] = here[i] + inside[i] if here[i] >= around else _LOW


@compiled
def _highest(peak, among):
    """Place on the line of the highest peak, or -1; the line is a multiple of four times `among`'s length."""
    n = among.size
    for i in range(n):
        among[i] = _LOW
    for first in range(0, peak.size, 4 * n):
        a0, a1 = peak[first : first + n], peak[first + n : first + 2 * n]
        a2, a3 = peak[first + 2 * n : first + 3 * n], peak[first + 3 * n : first + 4 * n]
        for i in range(n):
            among[i] = max(among[i], max(max(a0[i], a1[i]), max(a2[i], a3[i])))
    best = _LOW
    for i in range(n):
        best = max(best, among[i])
    if best < NOWHERE:
        return -1
    place = 0
    while among[place] != best:
        place += 1
    while peak[place] != best:
        place += n
    return place


@compiled
def _flat(template):
    """Whether a template is that of a patch without contrast, or of none: all 0."""
    for i in range(template.size):  # noqa: SIM110
        if template[i] != 0:
            return False
    return True


@compiled
def _summit(before, here, after):
    """Where a parabola through three scores is highest, as far as half a pixel, and by how much more."""
    bend, slope = 2 * here - before - after, 0.5 * (after - before)
    if bend < 1e-4:
        return 0.0, 0.0
    return min(max(slope / bend, -0.5), 0.5), 0.5 * slope * slope / bend


@compiled
def _around(image, x, y, reach, line):
    """Pixels about `(x, y)` as far as `reach`, less the middle one; beyond the edge the last ones repeat."""
    rows, columns = image.shape
    size, middle = 2 * reach + 1, _f4(image[y, x])
    whole = x >= reach and x + reach < columns
    for row in range(size):
        pixels = image[min(max(y - reach + row, 0), rows - 1)]
        here = line[row * size : (row + 1) * size]
        if whole:
            seen = pixels[x - reach : x + reach + 1]
            for i in range(size):
                here[i] = _f4(seen[i]) - middle
        else:
            for i in range(size):
                here[i] = _f4(pixels[min(max(x - reach + i, 0), columns - 1)]) - middle


@compiled
def _moments(line, width, count, template, inside):
    """Sums of products of a patch, its two gradients and a template, each less its mean.

    `line` is the patch with what is around it. `template` and `inside`, which is 1 on the patch's pixels,
    begin with the patch's first pixel, and have rows of the same `width` with zeros between them.

    Returns
    -------
    bb, bt
        of the patch with itself and with the template.
    gb, gt, hb, ht
        of the gradients along x and y with both.
    gg, gh, hh
        of the gradients.
    """
    zero, half = _f4(0), _f4(0.5)
    b1 = g1 = h1 = bb = bt = gb = gt = hb = ht = gg = gh = hh = zero
    before, middle, after = line[width:], line[width + 1 :], line[width + 2 :]
    above, below = line[1:], line[2 * width + 1 :]
    for i in range(template.size):
        g, h = half * (after[i] - before[i]), half * (below[i] - above[i])
        b, t, one = middle[i], template[i], inside[i]
        b_in, g_in, h_in = b * one, g * one, h * one
        b1 += b_in
        g1 += g_in
        h1 += h_in
        bb += b * b_in
        gb += g * b_in
        hb += h * b_in
        gg += g * g_in
        gh += h * g_in
        hh += h * h_in
        bt += b * t
        gt += g * t
        ht += h * t
    share = _f4(1) / _f4(count)
    return (
        bb - share * b1 * b1,
        bt,
        gb - share * g1 * b1,
        gt,
        hb - share * h1 * b1,
        ht,
        gg - share * g1 * g1,
        gh - share * g1 * h1,
        hh - share * h1 * h1,
    )


@compiled
def _information(xx, xy, yy, false, noise):
    """Inverse covariance of a shift: that of least squares, and `LEAST_DEVIATION` in all directions.

    `false` is the curvature that noise alone is expected to have. It takes little from a much larger one, and
    all of one that is not twice as large: of many places along an edge the best one fits its noise, too.
    """
    middle, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    radius = np.sqrt(half * half + xy * xy)
    most, least = _told(middle + radius, false, noise), _told(middle - radius, false, noise)
    middle, turn = 0.5 * (most + least), 0.5 * (most - least) / max(radius, 1e-12)
    return middle + turn * half, turn * xy, middle - turn * half


@compiled
def _told(curvature, false, noise):
    """Information along one axis, 1/px^2."""
    if curvature <= 2 * false:
        return 0.0
    true = curvature - 4 * false * false / curvature
    return true / (noise + LEAST_DEVIATION**2 * true + 1e-12)


@compiled
def _refine(image, x, y, side, template, inside, move_x, move_y, around, between):
    """Best place of a template about a pixel, between pixels, by least squares of the normalised patches.

    With the template a and the patch b, both of mean 0 and length 1, and with J the derivatives of b by the
    shift, less what is along b (a change of contrast): the correlation is 1 - |a - b|^2 / 2, its curvature is
    about J^T J, and the shift by (J^T J)^-1 J^T a leads to its peak. Noise of variance s in the pixels gives
    the shift the covariance s (J^T J)^-1, of which s = |a - b|^2 / (pixels - 4): mean, contrast and shift are
    fitted. The gradients of noise tell nothing of the shift, and are taken from J^T J as far as they are
    expected. See `_moments` for `template` and `inside`.

    Returns
    -------
    move_x, move_y
        px, from the pixel.
    score
        correlation there.
    information
        three numbers (xx, xy, yy), 1/px^2.
    """
    width, count = side + 4, side * side
    _around(image, x, y, side // 2 + 2, around)
    n = between.size
    score = xx = xy = yy = noise = 0.0
    for _ in range(STEPS):
        left, top = int(np.floor(move_x)), int(np.floor(move_y))
        right, down = move_x - left, move_y - top
        first = (1 + top) * width + 1 + left
        w0, w1 = _f4((1 - right) * (1 - down)), _f4(right * (1 - down))
        w2, w3 = _f4((1 - right) * down), _f4(right * down)
        a0, a1 = around[first : first + n], around[first + 1 : first + 1 + n]
        a2, a3 = around[first + width : first + width + n], around[first + width + 1 : first + width + 1 + n]
        for i in range(n):
            between[i] = w0 * a0[i] + w1 * a1[i] + w2 * a2[i] + w3 * a3[i]
        bb, bt, gb, gt, hb, ht, gg, gh, hh = _moments(between, width, count, template, inside)
        bb = max(bb, count * FLAT * FLAT)
        score = min(bt / np.sqrt(bb), 1.0)
        if score <= 0.0:
            return move_x, move_y, 0.0, 0.0, 0.0, 0.0
        xx, xy, yy = (gg - gb * gb / bb) / bb, (gh - gb * hb / bb) / bb, (hh - hb * hb / bb) / bb
        noise = HIDDEN_NOISE * 2 * (1 - score) / (count - 4) + ROUNDING / bb
        false = count * noise / 4 + 1e-6  # half the noise is the picture's, and a gradient has half of that
        size = np.sqrt(bb) * score
        ax, ay = (gt - gb * bt / bb) / size, (ht - hb * bt / bb) / size
        area = (xx + false) * (yy + false) - xy * xy
        step_x, step_y = ((yy + false) * ax - xy * ay) / area, ((xx + false) * ay - xy * ax) / area
        move_x = min(max(move_x + min(max(step_x, -0.7), 0.7), -_FARTHEST), _FARTHEST)
        move_y = min(max(move_y + min(max(step_y, -0.7), 0.7), -_FARTHEST), _FARTHEST)
        if max(abs(step_x), abs(step_y)) < NEAR_ENOUGH:
            break
    if max(abs(move_x), abs(move_y)) >= _FARTHEST:
        return move_x, move_y, score, 0.0, 0.0, 0.0
    xx, xy, yy = _information(xx, xy, yy, count * noise / 4, noise)
    return move_x, move_y, score, xx, xy, yy


@compiled
def search(image, templates, side, middles, reaches, scores, rivals, positions, information):
    """Best place of every template in its window.

    Parameters
    ----------
    templates
        `(n, ...)`: pixels of a patch in rows, mean 0 and length 1 (all 0: flat), then zeros.
    middles, reaches
        `(n, 2)` int64: x and y of the windows' middles and half sizes.
    scores, rivals, positions, information
        `(n,)`, `(n,)`, `(n, 2)`, `(n, 2, 2)`: results; positions stay as they are where there is no peak. A
        rival is the highest peak that is more than half a patch away along x or y.
    """
    half, taps = side // 2, padded(side, TAPS)
    longest = 1
    for k in range(len(reaches)):
        longest = max(longest, (2 * reaches[k, 0] + side) * (2 * reaches[k, 1] + side))
    longest = padded(longest, 4 * SPAN)
    # what is read beyond the end of a window counts for nothing, but must be numbers
    line, scratch = (
        np.zeros(longest + 2 * REGISTER, np.float32),
        np.empty((4, longest + REGISTER), np.float32),
    )
    whole_score, whole_peak = np.empty(longest, np.float32), np.empty(longest, np.float32)
    whole_rim, last_columns, last_rows = np.empty(longest, np.float32), 0, 0
    offsets, ones = np.zeros(taps + padded(side * side, TAPS), np.int64), np.zeros(taps, np.float32)
    among = np.empty(SPAN, np.float32)
    for i in range(side):
        ones[i] = _f4(1)
    # the best place's surroundings, two pixels wider than a patch, and between pixels one
    wide = side + 4
    inside = np.zeros(padded((side - 1) * wide + side, REGISTER), np.float32)
    spread, between = (
        np.zeros_like(inside),
        np.empty(padded(inside.size + 2 * wide + 2, REGISTER), np.float32),
    )
    around = np.zeros(between.size + 2 * wide + 4, np.float32)
    for row in range(side):
        for column in range(side):
            inside[row * wide + column] = _f4(1)
    for k in range(len(middles)):
        scores[k] = rivals[k] = NOWHERE
        information[k, 0, 0] = information[k, 0, 1] = information[k, 1, 0] = information[k, 1, 1] = 0.0
        # places of the patch's first pixel
        left = max(middles[k, 0] - reaches[k, 0], half) - half
        top = max(middles[k, 1] - reaches[k, 1], half) - half
        columns = min(middles[k, 0] + reaches[k, 0] + half + 1, image.shape[1]) - left - side + 1
        rows = min(middles[k, 1] + reaches[k, 1] + half + 1, image.shape[0]) - top - side + 1
        template = templates[k]
        if columns < 3 or rows < 3 or _flat(template):
            continue
        width = columns + side - 1
        count = (rows - 1) * width + columns
        score, peak, rim = (
            whole_score[:count],
            whole_peak[: -(-count // (4 * SPAN)) * 4 * SPAN],
            whole_rim[:count],
        )
        if columns != last_columns or rows != last_rows:
            _layout(width, columns, rows, side, offsets, rim)
            last_columns, last_rows = columns, rows
        _window(image, left, top, width, rows + side - 1, line)
        _correlate(line, width, side, template, offsets, ones, scratch, score)
        _peaks(score, width, rim, scratch[0], peak)
        best = _highest(peak, among)
        if best < 0:
            continue
        y, x = best // width, best % width
        move_x, _ = _summit(score[best - 1], score[best], score[best + 1])
        move_y, _ = _summit(score[best - width], score[best], score[best + width])
        for row in range(side):
            for column in range(side):
                spread[row * wide + column] = template[row * side + column]
        middle_x, middle_y = left + x + half, top + y + half
        move_x, move_y, found, xx, xy, yy = _refine(
            image, middle_x, middle_y, side, spread, inside, move_x, move_y, around, between
        )
        scores[k] = found
        positions[k, 0], positions[k, 1] = middle_x + move_x, middle_y + move_y
        information[k, 0, 0], information[k, 1, 1] = xx, yy
        information[k, 0, 1] = information[k, 1, 0] = xy
        for row in range(max(y - half, 0), min(y + half + 1, rows)):
            for column in range(max(x - half, 0), min(x + half + 1, columns)):
                peak[row * width + column] = _LOW
        other = _highest(peak, among)
        if other >= 0:
            _, more = _summit(score[other - 1], score[other], score[other + 1])
            _, still = _summit(score[other - width], score[other], score[other + width])
            rivals[k] = min(score[other] + more + still, 1.0)


@compiled
def sample(image, positions, side, unit, patches):
    """Patches `(n, side * side)` about positions between pixels; 0 where they leave the picture."""
    rows, columns = image.shape
    half = side // 2
    for k in range(len(positions)):
        patch = patches[k]
        patch[:] = _f4(0)
        x, y = positions[k, 0] - half, positions[k, 1] - half
        if not (x >= 0.0 and y >= 0.0 and x <= columns - side and y <= rows - side):
            continue
        left, top = min(int(x), columns - side - 1), min(int(y), rows - side - 1)
        right, down = _f4(x - left), _f4(y - top)
        total = _f4(0)
        for row in range(side):
            above, below = image[top + row], image[top + row + 1]
            for column in range(side):
                a, b = _f4(above[left + column]), _f4(above[left + column + 1])
                c, d = _f4(below[left + column]), _f4(below[left + column + 1])
                a += right * (b - a)
                c += right * (d - c)
                value = a + down * (c - a)
                patch[row * side + column] = value
                total += value
        if unit:
            mean, squares = total / _f4(side * side), _f4(0)
            for i in range(side * side):
                patch[i] -= mean
                squares += patch[i] * patch[i]
            flat = squares < _f4(side * side * FLAT * FLAT)
            scale = _f4(0) if flat else _f4(1) / np.sqrt(squares)
            for i in range(side * side):
                patch[i] *= scale
