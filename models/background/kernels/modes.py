"""Loop over the pixels of a sample of frames: the colour that is shown most often, and how exactly."""

import numpy as np

from ...numerics.compiled import compiled

_f4 = np.float32


@compiled
def find_modes(first, end, pixels, light, positions, bandwidth, channels, mean, scatter, support):
    """Rows `first` to `end`: the densest colour of every pixel over a sample of frames.

    `pixels` is `(n_frames, channels * n_pixels)` uint8, `light` `(n_frames, block_rows + 1, width)` the rows
    of every frame's `Light`, and `positions` those of all. The density at each colour that was seen is
    sum(max(0, 1 - d^2 / bandwidth)) over all frames. `mean` `(channels,
    n_pixels)` gets the mean of what is nearer to the densest one than the bandwidth, `scatter` the mean
    square of their distance to it by channel, and `support` how many they are.
    """
    n_frames, width = pixels.shape[0], light.shape[2]
    values = np.empty((3, n_frames), np.float32)
    closeness = np.empty(n_frames, np.float32)
    values[:] = _f4(0)
    for y in range(first, end):
        above = int(positions[y])
        share = positions[y] - _f4(above)
        for x in range(width):
            i = y * width + x
            for frame in range(n_frames):
                upper, lower = light[frame, above, x], light[frame, above + 1, x]
                dimmed = _f4(1) / (upper + share * (lower - upper))
                if channels == 3:
                    b, g, r = (
                        _f4(pixels[frame, 3 * i]),
                        _f4(pixels[frame, 3 * i + 1]),
                        _f4(pixels[frame, 3 * i + 2]),
                    )
                    grey = _f4(0.114) * b + _f4(0.587) * g + _f4(0.299) * r
                    values[0, frame] = dimmed * grey
                    values[1, frame] = dimmed * _f4(1.426) * (r - grey)
                    values[2, frame] = dimmed * _f4(1.128) * (b - grey)
                else:
                    values[0, frame] = dimmed * _f4(pixels[frame, i])
            best, highest = 0, _f4(-1)
            for frame in range(n_frames):
                density = _f4(0)
                for other in range(n_frames):
                    d0 = values[0, other] - values[0, frame]
                    d1 = values[1, other] - values[1, frame]
                    d2 = values[2, other] - values[2, frame]
                    density += max(_f4(0), bandwidth - d0 * d0 - d1 * d1 - d2 * d2)
                if density > highest:
                    best, highest = frame, density
            count = _f4(0)
            for other in range(n_frames):
                d0 = values[0, other] - values[0, best]
                d1 = values[1, other] - values[1, best]
                d2 = values[2, other] - values[2, best]
                closeness[other] = _f4(1) if d0 * d0 + d1 * d1 + d2 * d2 < bandwidth else _f4(0)
                count += closeness[other]
            squares = _f4(0)
            for channel in range(channels):
                total = _f4(0)
                for other in range(n_frames):
                    total += closeness[other] * values[channel, other]
                middle = total / count
                mean[channel, i] = middle
                for other in range(n_frames):
                    away = values[channel, other] - middle
                    squares += closeness[other] * away * away
            scatter[i] = squares / (count * _f4(channels))
            support[i] = count
