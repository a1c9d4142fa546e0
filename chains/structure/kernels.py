"""Compiled loops of association: what tracks with drifting errors say of points, and how well pairs agree."""

import numpy as np

from ...models.numerics.compiled import compiled, inlined


@compiled
def track_information(tracks, cameras, white, drift, decay):
    """Return the information of each track about its point, under correlated noise.

    White noise of variance white / weight plus a first-order Gauss-Markov process of variance drift whose
    correlation falls by `decay` a frame, along each axis. A Kalman filter of that process turns observations
    into independent innovations, each a row of a regression on the point.

    Returns information (n, 3, 3), vector (n, 3), quadratic (n,) and log determinant (n,) of the noise.
    """
    edges, _, frame, x, y, weight = tracks
    n = len(edges) - 1
    information = np.zeros((n, 3, 3))
    vector = np.zeros((n, 3))
    quadratic = np.zeros(n)
    determinant = np.zeros(n)
    mean = np.empty((2, 4))  # of the drift, as a linear function of the point: three factors and a constant
    for k in range(n):
        for r in range(2):
            for c in range(4):
                mean[r, c] = 0.0
        variance = drift
        for o in range(edges[k], edges[k + 1]):
            t = frame[o]
            if o > edges[k]:
                kept = decay ** (t - frame[o - 1])
                for r in range(2):
                    for c in range(4):
                        mean[r, c] *= kept
                variance = kept * kept * variance + (1.0 - kept * kept) * drift
            spread = variance + white / weight[o]
            gain = variance / spread
            determinant[k] += 2.0 * np.log(spread)
            for r in range(2):
                seen = (x[o] if r == 0 else y[o]) - cameras[t, r, 3]
                a0 = cameras[t, r, 0] - mean[r, 0]
                a1 = cameras[t, r, 1] - mean[r, 1]
                a2 = cameras[t, r, 2] - mean[r, 2]
                rest = seen - mean[r, 3]
                information[k, 0, 0] += a0 * a0 / spread
                information[k, 0, 1] += a0 * a1 / spread
                information[k, 0, 2] += a0 * a2 / spread
                information[k, 1, 1] += a1 * a1 / spread
                information[k, 1, 2] += a1 * a2 / spread
                information[k, 2, 2] += a2 * a2 / spread
                vector[k, 0] += a0 * rest / spread
                vector[k, 1] += a1 * rest / spread
                vector[k, 2] += a2 * rest / spread
                quadratic[k] += rest * rest / spread
                mean[r, 0] += gain * a0
                mean[r, 1] += gain * a1
                mean[r, 2] += gain * a2
                mean[r, 3] += gain * rest
            variance *= 1.0 - gain
        for i in range(3):
            for j in range(i):
                information[k, i, j] = information[k, j, i]
    return information, vector, quadratic, determinant


@compiled
def camera_coupling(tracks, point, homogeneous, cameras, white, drift, decay, least):
    """Return second derivatives of the fit by cameras, and by cameras and points.

    Of both rows of a camera alike: own (n_frames, 4, n_frames, 4). With the points: cross (2, n_frames, 4,
    n_points, 3). The noise's inverse falls off with the frames between; what is below `least` is left out.
    """
    edges, _, frame, _, _, weight = tracks
    n_frames, n_points = cameras.shape[0], homogeneous.shape[0]
    own = np.zeros((n_frames, 4, n_frames, 4))
    cross = np.zeros((2, n_frames, 4, n_points, 3))
    longest = 0
    for k in range(len(edges) - 1):
        longest = max(longest, edges[k + 1] - edges[k])
    mean = np.zeros(longest)
    rows = np.zeros((longest, longest))  # innovations as combinations of the track's observations
    for k in range(len(edges) - 1):
        first, length, p = edges[k], edges[k + 1] - edges[k], point[k]
        variance = drift
        for i in range(length):
            if i > 0:
                kept = decay ** (frame[first + i] - frame[first + i - 1])
                for j in range(i):
                    mean[j] *= kept
                variance = kept * kept * variance + (1.0 - kept * kept) * drift
            spread = variance + white / weight[first + i]
            gain = variance / spread
            root = 1.0 / np.sqrt(spread)
            for j in range(i):
                rows[i, j] = -mean[j] * root
                mean[j] -= gain * mean[j]
            rows[i, i] = root
            mean[i] = gain
            variance *= 1.0 - gain
        for i in range(length):
            ti = frame[first + i]
            for j in range(i, -1, -1):
                entry = 0.0
                for m in range(i, length):
                    if abs(rows[m, i]) < least * rows[i, i]:
                        break
                    entry += rows[m, i] * rows[m, j]
                if abs(entry) < least * rows[i, i] * rows[i, i]:
                    break
                tj = frame[first + j]
                for a in range(4):
                    for b in range(4):
                        product = entry * homogeneous[p, a] * homogeneous[p, b]
                        own[ti, a, tj, b] += product
                        if i != j:
                            own[tj, a, ti, b] += product
                for r in range(2):
                    for a in range(4):
                        for b in range(3):
                            cross[r, ti, a, p, b] += entry * homogeneous[p, a] * cameras[tj, r, b]
                            if i != j:
                                cross[r, tj, a, p, b] += entry * homogeneous[p, a] * cameras[ti, r, b]
    return own, cross


@compiled
def same_point_gains(mean, covariance, apart, spread, gains):
    """Return log likelihood ratios of pairs of estimates: of one point, over two points.

    covariance (n, 3, n, 3) is of all estimates together; two different points differ by a draw of covariance
    `spread` (3, 3), beside their errors. Fills `gains` (n, n), with -1e30 for pairs that are `apart`.
    """
    n = mean.shape[0]
    same, other, away = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for i in range(n):
        gains[i, i] = -1e30
        for j in range(i):
            if apart[i, j]:
                gains[i, j] = gains[j, i] = -1e30
                continue
            for a in range(3):
                away[a] = mean[i, a] - mean[j, a]
                for b in range(a + 1):
                    across = covariance[i, a, j, b] + covariance[j, a, i, b]
                    across += covariance[i, b, j, a] + covariance[j, b, i, a]
                    same[a, b] = covariance[i, a, i, b] + covariance[j, a, j, b] - 0.5 * across
                    other[a, b] = same[a, b] + spread[a, b]
            square, log_root = _whitened(away, same)
            square_apart, log_root_apart = _whitened(away, other)
            gains[i, j] = gains[j, i] = 0.5 * (square_apart - square) + log_root_apart - log_root


@compiled
def assign_tracks(
    order, tracks, information, vector, alone, cameras, variance, far, log_new, hard, of_track, member,
    shares, others, whole, sums, mean, covariance, before, busy,
):  # fmt: skip
    """Return the probabilities that tracks show points, in `order`, each without its own observations.

    `information` `(n, 3, 3)` and `vector` `(n, 3)` are of each track, `alone` `(n,)` its log partition
    together with the prior over that of the prior. A point is tried if the middle observation of the track,
    of this variance, is at most `far` squared standard deviations from where cameras show it, or if the
    track was its own before. `log_new` are the log prior odds that a track shows none of the points against
    that it shows a certain one; `hard` makes each track a member of one point or none. `of_track` `(n + 1,)`,
    `member` and `shares` are memberships, track by track. What is known of the points is changed in place:
    sums of memberships `others`, of information `whole` and of vectors `sums`, with mean, covariance and log
    partition `before`, and `busy` `(n_points, n_frames)`, how many of its observations each has in a frame.
    Returns `(n_found, 2)` the new points and probabilities, in the order of the turns, and how many each
    turn has.
    """
    edges, _, frame, x, y, weight = tracks
    n, n_points = information.shape[0], busy.shape[0]
    tried, scores = np.empty(n_points, np.int64), np.empty(n_points)
    counts = np.zeros(n, np.int64)
    found, end = np.empty((2 * n, 2)), 0
    tried_whole, tried_sums = np.empty((3, 3)), np.empty(3)
    tried_mean, tried_covariance = np.empty(3), np.empty((3, 3))
    for k in order:
        own, most = -1, 0.0  # the point that would be left without a track
        for e in range(of_track[k], of_track[k + 1]):
            p, share = member[e], shares[e]
            others[p] -= share
            if others[p] < 0.5 and share > most:
                own, most = p, share
            _add(whole[p], sums[p], -share, information[k], vector[k], whole[p], sums[p])
            before[p] = _settle(whole[p], sums[p], mean[p], covariance[p])
            for o in range(edges[k], edges[k + 1]):
                busy[p, frame[o]] -= share
        middle = (edges[k] + edges[k + 1]) // 2
        noise = variance / weight[middle]
        n_tried = _near(cameras[frame[middle]], x[middle], y[middle], noise, far, mean, covariance, tried)
        for e in range(of_track[k], of_track[k + 1]):
            known = False
            for i in range(n_tried):
                known = known or tried[i] == member[e]
            if not known:
                tried[n_tried] = member[e]
                n_tried += 1
        highest = log_new
        for i in range(n_tried):
            p = tried[i]
            free = 1.0
            for o in range(edges[k], edges[k + 1]):
                free = min(free, 1.0 - busy[p, frame[o]])
            if free < 1e-3:
                scores[i] = -1e30
            else:
                _add(whole[p], sums[p], 1.0, information[k], vector[k], tried_whole, tried_sums)
                together = _settle(tried_whole, tried_sums, tried_mean, tried_covariance)
                scores[i] = together - before[p] - alone[k] + np.log(free)
            highest = max(highest, scores[i])
            if p == own:  # which is what "new" means then
                scores[i] = max(scores[i], log_new)
        total = 0.0 if own >= 0 else np.exp(log_new - highest)
        best = -1
        for i in range(n_tried):
            if scores[i] == highest:
                best = i
            total += np.exp(max(scores[i] - highest, -80.0))
        if end + n_tried > found.shape[0]:
            longer = np.empty((2 * found.shape[0] + n_tried, 2))
            for i in range(end):
                longer[i, 0], longer[i, 1] = found[i, 0], found[i, 1]
            found = longer
        for i in range(n_tried):
            p = tried[i]
            share = np.exp(max(scores[i] - highest, -80.0)) / total
            if hard:
                share = 1.0 if i == best else 0.0
            if share < 1e-4:
                continue
            found[end, 0], found[end, 1] = p, share
            end += 1
            counts[k] += 1
            others[p] += share
            _add(whole[p], sums[p], share, information[k], vector[k], whole[p], sums[p])
            before[p] = _settle(whole[p], sums[p], mean[p], covariance[p])
            for o in range(edges[k], edges[k + 1]):
                busy[p, frame[o]] += share
    return found[:end], counts


@compiled
def _add(whole, sums, share, information, vector, new_whole, new_sums):
    """Write a point's information with a share of a track's."""
    for i in range(3):
        new_sums[i] = sums[i] + share * vector[i]
        for j in range(3):
            new_whole[i, j] = whole[i, j] + share * information[i, j]


@compiled
def _near(camera, x, y, noise, far, mean, covariance, tried):
    """Fill `tried` with the points that a camera (2, 4) shows near a place, and say how many they are."""
    a, b = camera[0], camera[1]
    q00, q11, q22 = a[0] * a[0] + b[0] * b[0], a[1] * a[1] + b[1] * b[1], a[2] * a[2] + b[2] * b[2]
    q01 = 2.0 * (a[0] * a[1] + b[0] * b[1])
    q02 = 2.0 * (a[0] * a[2] + b[0] * b[2])
    q12 = 2.0 * (a[1] * a[2] + b[1] * b[2])
    count = 0
    for p in range(mean.shape[0]):
        s, c = mean[p], covariance[p]
        u = x - a[3] - a[0] * s[0] - a[1] * s[1] - a[2] * s[2]
        v = y - b[3] - b[0] * s[0] - b[1] * s[1] - b[2] * s[2]
        # variances of both coordinates together are no less than that of any direction
        spread = q00 * c[0, 0] + q11 * c[1, 1] + q22 * c[2, 2]
        spread += q01 * c[0, 1] + q02 * c[0, 2] + q12 * c[1, 2]
        if u * u + v * v <= far * (spread + noise):
            tried[count] = p
            count += 1
    return count


@compiled
def _settle(information, vector, mean, covariance):
    """Fill mean (3,) and covariance (3, 3) of what is known of a point; return the log partition.

    That is the log integral of exp(vector . x - x . information x / 2), without log(2 pi).
    """
    a, b, c = information[0, 0], information[0, 1], information[0, 2]
    d, e, f = information[1, 1], information[1, 2], information[2, 2]
    covariance[0, 0], covariance[0, 1], covariance[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    covariance[1, 1], covariance[1, 2], covariance[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * covariance[0, 0] + b * covariance[0, 1] + c * covariance[0, 2]
    for i in range(3):
        for j in range(i, 3):
            covariance[i, j] /= determinant
            covariance[j, i] = covariance[i, j]
    for i in range(3):
        mean[i] = 0.0
        for j in range(3):
            mean[i] += covariance[i, j] * vector[j]
    square = mean[0] * vector[0] + mean[1] * vector[1] + mean[2] * vector[2]
    return 0.5 * (square - np.log(determinant))


@inlined
def _whitened(vector, matrix):
    """Squared Mahalanobis length of a vector (3,) under a covariance (3, 3), and half its log determinant."""
    root0 = np.sqrt(max(matrix[0, 0], 1e-30))
    l10, l20 = matrix[1, 0] / root0, matrix[2, 0] / root0
    root1 = np.sqrt(max(matrix[1, 1] - l10 * l10, 1e-30))
    l21 = (matrix[2, 1] - l20 * l10) / root1
    root2 = np.sqrt(max(matrix[2, 2] - l20 * l20 - l21 * l21, 1e-30))
    u = vector[0] / root0
    v = (vector[1] - l10 * u) / root1
    w = (vector[2] - l20 * u - l21 * v) / root2
    return u * u + v * v + w * w, np.log(root0 * root1 * root2)
