"""Kalman filter and smoother of many points in the plane: position and velocity along x and y, fully coupled.

Points are worked on `LANES` at a time, numbers first and points last, so that every operation of the loops is
one on whole vector registers; arrays outside have points first. A state is (x, y, velocity of x, velocity of
y). Within a loop a 4x4 covariance is its 2x2 blocks: position `s`, position with velocity `b`, velocity `v`.
A block is the tuple (xx, xy, yx, yy).
"""

from typing import Any

import numpy as np

from ..models.numerics.compiled import compiled, inlined

Block = tuple[Any, Any, Any, Any]

LANES = 32
_S, _B, _V = 4 * LANES, 7 * LANES, 11 * LANES  # where a block's rows begin in the lanes' array
_NUMBERS = 14

_ROUNDING = 1e-14
"""Share of the diagonal that is added or kept, so that rounding leaves every covariance positive definite."""


@inlined
def _product(a, b):
    return (
        a[0] * b[0] + a[1] * b[2],
        a[0] * b[1] + a[1] * b[3],
        a[2] * b[0] + a[3] * b[2],
        a[2] * b[1] + a[3] * b[3],
    )


@inlined
def _transposed(a):
    return a[0], a[2], a[1], a[3]


@inlined
def _sum(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]


@inlined
def _difference(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2], a[3] - b[3]


@inlined
def _scaled(p, a):
    return p * a[0], p * a[1], p * a[2], p * a[3]


@inlined
def _plus_unit(a, p):
    """a + p times the unit matrix."""
    return a[0] + p, a[1], a[2], a[3] + p


@inlined
def _sizes(a):
    return abs(a[0]), abs(a[1]), abs(a[2]), abs(a[3])


@inlined
def _raised(a):
    """A covariance with its diagonal so much larger that rounding cannot make it indefinite."""
    return (1.0 + _ROUNDING) * a[0], a[1], a[2], (1.0 + _ROUNDING) * a[3]


@inlined
def _applied(a, x, y):
    return a[0] * x + a[1] * y, a[2] * x + a[3] * y


def inverse(a: Block) -> Block:
    """Inverse of a symmetric, positive definite block, of numbers or of arrays."""
    determinant = np.maximum(a[0] * a[3] - a[1] * a[1], _ROUNDING * a[0] * a[3])
    scale = 1.0 / determinant
    return scale * a[3], -scale * a[1], -scale * a[1], scale * a[0]


_inverse = inlined(inverse)


@inlined
def _remainder(v, explained):
    """Symmetric v - explained, a covariance, kept positive definite whatever rounding does."""
    xx, yy = max(v[0] - explained[0], 0.0), max(v[3] - explained[3], 0.0)
    most = np.sqrt(xx * yy)
    xy = min(max(v[1] - 0.5 * (explained[1] + explained[2]), -most), most)
    return xx + _ROUNDING * v[0], xy, xy, yy + _ROUNDING * v[3]


@inlined
def _either(first, a, b):
    return (
        a[0] if first else b[0],
        a[1] if first else b[1],
        a[2] if first else b[2],
        a[3] if first else b[3],
    )


@inlined
def _congruent(ss, sv, vs, vv, s, b, v):
    """Blocks of m p m^T, for m with the blocks ss, sv, vs and vv, and p with s, b and v."""
    across = _transposed(b)
    us, uv = _sum(_product(ss, s), _product(sv, across)), _sum(_product(ss, b), _product(sv, v))
    ls, lv = _sum(_product(vs, s), _product(vv, across)), _sum(_product(vs, b), _product(vv, v))
    return (
        _sum(_product(us, _transposed(ss)), _product(uv, _transposed(sv))),
        _sum(_product(us, _transposed(vs)), _product(uv, _transposed(vv))),
        _sum(_product(ls, _transposed(vs)), _product(lv, _transposed(vv))),
    )


@inlined
def _mean_of(lanes, k):
    return lanes[k], lanes[LANES + k], lanes[2 * LANES + k], lanes[3 * LANES + k]


@inlined
def _covariance_of(lanes, k):
    """Blocks s, b and v of lane k."""
    xy, vxy = lanes[_S + LANES + k], lanes[_V + LANES + k]
    s = (lanes[_S + k], xy, xy, lanes[_S + 2 * LANES + k])
    b = (lanes[_B + k], lanes[_B + LANES + k], lanes[_B + 2 * LANES + k], lanes[_B + 3 * LANES + k])
    v = (lanes[_V + k], vxy, vxy, lanes[_V + 2 * LANES + k])
    return s, b, v


@inlined
def _put(lanes, k, x, y, u, w, s, b, v):
    lanes[k], lanes[LANES + k], lanes[2 * LANES + k], lanes[3 * LANES + k] = x, y, u, w
    lanes[_S + k], lanes[_S + LANES + k], lanes[_S + 2 * LANES + k] = s[0], s[1], s[3]
    lanes[_B + k], lanes[_B + LANES + k] = b[0], b[1]
    lanes[_B + 2 * LANES + k], lanes[_B + 3 * LANES + k] = b[2], b[3]
    lanes[_V + k], lanes[_V + LANES + k], lanes[_V + 2 * LANES + k] = v[0], v[1], v[3]


@compiled
def _predict(lanes, steps, noise):
    """Move each lane on by its step, in s; `noise` has its spectral density of acceleration."""
    for k in range(LANES):
        dt = steps[k]
        x, y, u, w = _mean_of(lanes, k)
        s, b, v = _covariance_of(lanes, k)
        q = dt * noise[k]
        moved = _sum(b, _scaled(dt, v))
        grown = _sum(s, _scaled(dt, _sum(moved, _transposed(b))))
        _put(
            lanes, k, x + dt * u, y + dt * w, u, w,
            _raised(_plus_unit(grown, dt * dt * q / 3)),
            _plus_unit(moved, 0.5 * dt * q),
            _raised(_plus_unit(v, q)),
        )  # fmt: skip


@compiled
def _update(lanes, measured):
    """Take in measurements of positions, rows of information (xx, xy, yy) and vector (x, y)."""
    for k in range(LANES):
        x, y, u, w = _mean_of(lanes, k)
        s, b, v = _covariance_of(lanes, k)
        jxx, jxy, jyy = measured[k], measured[LANES + k], measured[2 * LANES + k]
        # (s^-1 + j)^-1 without the inverse of j, which need not be of full rank; all terms are positive
        area = max(s[0] * s[3] - s[1] * s[1], _ROUNDING * s[0] * s[3])
        trace = max(jxx * s[0] + 2 * jxy * s[1] + jyy * s[3], 0.0)
        scale = 1.0 / (1.0 + trace + area * max(jxx * jyy - jxy * jxy, 0.0))
        after = _raised(_scaled(scale, _sum(s, _scaled(area, (jyy, -jxy, -jxy, jxx)))))
        off_x = measured[3 * LANES + k] - jxx * x - jxy * y
        off_y = measured[4 * LANES + k] - jxy * x - jyy * y
        dx, dy = _applied(after, off_x, off_y)
        # A position says nothing of the velocity given the position: regression and remainder stay.
        slope = _product(_inverse(s), b)
        across = _transposed(slope)
        rest = _remainder(v, _product(across, b))
        between = _product(after, slope)
        fast = _sum(rest, _product(across, between))
        errors = _product(_sizes(across), _product(_sizes(after), _sizes(slope)))
        fast = (fast[0] + _ROUNDING * errors[0], fast[1], fast[2], fast[3] + _ROUNDING * errors[3])
        du, dw = _applied(across, dx, dy)
        seen = jxx + jyy > 0.0  # no information leaves every bit as it is
        _put(
            lanes, k,
            x + dx if seen else x, y + dy if seen else y, u + du if seen else u, w + dw if seen else w,
            _either(seen, after, s), _either(seen, between, b), _either(seen, fast, v),
        )  # fmt: skip


@compiled
def _step_back(lanes, later, steps, noise):
    """Smoothed states, from the filtered ones in `lanes` and, replaced by them, those of a step s later.

    The recursion as a sum of two covariances: with the motion undone, the later state is the earlier one plus
    noise of covariance n, and is believed by k = p (p + n)^-1.
    """
    for i in range(LANES):
        dt = steps[i]
        x, y, u, w = _mean_of(lanes, i)
        s, b, v = _covariance_of(lanes, i)
        later_x, later_y, later_u, later_w = _mean_of(later, i)
        later_s, later_b, later_v = _covariance_of(later, i)
        far = dt * noise[i]
        near, cross = dt * dt * far / 3, -0.5 * dt * far
        # r = (p + n)^-1 by blocks
        both, of_position = _plus_unit(b, cross), _inverse(_plus_unit(s, near))
        slope = _product(of_position, both)
        rvv = _inverse(_remainder(_plus_unit(v, far), _product(_transposed(slope), both)))
        rsv = _scaled(-1.0, _product(slope, rvv))
        rvs = _transposed(rsv)
        rss = _difference(of_position, _product(rsv, _transposed(slope)))
        # what remains of the earlier state's own error, l = n r, and k = 1 - l
        lss = _sum(_scaled(near, rss), _scaled(cross, rvs))
        lsv = _sum(_scaled(near, rsv), _scaled(cross, rvv))
        lvs = _sum(_scaled(cross, rss), _scaled(far, rvs))
        lvv = _sum(_scaled(cross, rsv), _scaled(far, rvv))
        kss, ksv = _plus_unit(_scaled(-1.0, lss), 1.0), _scaled(-1.0, lsv)
        kvs, kvv = _scaled(-1.0, lvs), _plus_unit(_scaled(-1.0, lvv), 1.0)
        # the later state with the motion undone, and its covariance with the noise
        off_x, off_y = later_x - dt * later_u - x, later_y - dt * later_w - y
        off_u, off_w = later_u - u, later_w - w
        undone = _difference(later_b, _scaled(dt, later_v))
        back = _sum(undone, _transposed(later_b))
        later_s = _plus_unit(_difference(later_s, _scaled(dt, back)), near)
        later_b, later_v = _plus_unit(undone, cross), _plus_unit(later_v, far)
        (xs, ys), (xv, yv) = _applied(kss, off_x, off_y), _applied(ksv, off_u, off_w)
        (us, ws), (uv, wv) = _applied(kvs, off_x, off_y), _applied(kvv, off_u, off_w)
        s, b, v = _congruent(lss, lsv, lvs, lvv, s, b, v)
        grown_s, grown_b, grown_v = _congruent(kss, ksv, kvs, kvv, later_s, later_b, later_v)
        _put(
            later, i, x + xs + xv, y + ys + yv, u + us + uv, w + ws + wv,
            _raised(_sum(s, grown_s)), _sum(b, grown_b), _raised(_sum(v, grown_v)),
        )  # fmt: skip


@compiled
def _load(mean, covariance, first, lanes):
    """States from `first` on into the lanes; those beyond the last repeat it."""
    last = mean.shape[0] - 1
    for k in range(LANES):
        n = min(first + k, last)
        m, p = mean[n], covariance[n]
        s, v = (p[0, 0], p[0, 1], p[0, 1], p[1, 1]), (p[2, 2], p[2, 3], p[2, 3], p[3, 3])
        _put(lanes, k, m[0], m[1], m[2], m[3], s, (p[0, 2], p[0, 3], p[1, 2], p[1, 3]), v)


@compiled
def _store(lanes, first, mean, covariance):
    for k in range(min(LANES, mean.shape[0] - first)):
        m, p = mean[first + k], covariance[first + k]
        m[0], m[1], m[2], m[3] = _mean_of(lanes, k)
        s, b, v = _covariance_of(lanes, k)
        p[0, 0], p[0, 1], p[0, 2], p[0, 3] = s[0], s[1], b[0], b[1]
        p[1, 0], p[1, 1], p[1, 2], p[1, 3] = s[1], s[3], b[2], b[3]
        p[2, 0], p[2, 1], p[2, 2], p[2, 3] = b[0], b[2], v[0], v[1]
        p[3, 0], p[3, 1], p[3, 2], p[3, 3] = b[1], b[3], v[1], v[3]


@compiled
def _load_measured(information, vector, first, measured):
    last = vector.shape[0] - 1
    for k in range(LANES):
        n = min(first + k, last)
        measured[k], measured[LANES + k] = information[n, 0, 0], information[n, 0, 1]
        measured[2 * LANES + k] = information[n, 1, 1]
        measured[3 * LANES + k], measured[4 * LANES + k] = vector[n, 0], vector[n, 1]


@compiled
def _load_numbers(numbers, first, lanes):
    last = numbers.size - 1
    for k in range(LANES):
        lanes[k] = numbers[min(first + k, last)]


@compiled
def predict_states(mean, covariance, dt, acceleration, new_mean, new_covariance):
    """States `(n, 4)`, `(n, 4, 4)` after `dt` s; `dt` and `acceleration` are `(n,)`."""
    lanes, steps, noise = np.empty(_NUMBERS * LANES), np.empty(LANES), np.empty(LANES)
    for first in range(0, mean.shape[0], LANES):
        _load(mean, covariance, first, lanes)
        _load_numbers(dt, first, steps)
        _load_numbers(acceleration, first, noise)
        _predict(lanes, steps, noise)
        _store(lanes, first, new_mean, new_covariance)


@compiled
def update_states(mean, covariance, information, vector, new_mean, new_covariance):
    """States after measurements `(n, 2, 2)`, `(n, 2)`."""
    lanes, measured = np.empty(_NUMBERS * LANES), np.empty(5 * LANES)
    for first in range(0, mean.shape[0], LANES):
        _load(mean, covariance, first, lanes)
        _load_measured(information, vector, first, measured)
        _update(lanes, measured)
        _store(lanes, first, new_mean, new_covariance)


@compiled
def filter_states(mean, covariance, dt, information, vector, acceleration, means, covariances):
    """All frames' states after their measurements, from those before the first one's.

    `dt` `(n_frames, n)` is from the frame before.
    """
    lanes, measured = np.empty(_NUMBERS * LANES), np.empty(5 * LANES)
    steps, noise = np.empty(LANES), np.empty(LANES)
    for first in range(0, mean.shape[0], LANES):
        _load(mean, covariance, first, lanes)
        _load_numbers(acceleration, first, noise)
        for t in range(dt.shape[0]):
            if t > 0:
                _load_numbers(dt[t], first, steps)
                _predict(lanes, steps, noise)
            _load_measured(information[t], vector[t], first, measured)
            _update(lanes, measured)
            _store(lanes, first, means[t], covariances[t])


@compiled
def smooth_states(means, covariances, dt, acceleration, new_means, new_covariances):
    """All frames' states given all measurements, from the filtered ones; `dt` is that of `filter_states`."""
    lanes, later = np.empty(_NUMBERS * LANES), np.empty(_NUMBERS * LANES)
    steps, noise = np.empty(LANES), np.empty(LANES)
    end = dt.shape[0] - 1
    for first in range(0, means.shape[1], LANES):
        _load_numbers(acceleration, first, noise)
        _load(means[end], covariances[end], first, later)
        _store(later, first, new_means[end], new_covariances[end])
        for t in range(end - 1, -1, -1):
            _load(means[t], covariances[t], first, lanes)
            _load_numbers(dt[t + 1], first, steps)
            _step_back(lanes, later, steps, noise)
            _store(later, first, new_means[t], new_covariances[t])
