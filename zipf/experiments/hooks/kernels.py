"""Compiled functions of hooks; they import nothing that changes with the laboratory."""

import numpy as np

from zipf.compiled import compiled


@compiled()
def add_hashes(part, weights, mask, hashes):
    """Multilinear hashing: the high bits of sum_i weight_i * byte_i mod 2^64 are universal."""
    for i in range(len(part)):
        if mask[i]:
            total = np.uint64(0)
            for j in range(part.shape[1]):
                total += weights[j] * np.uint64(part[i, j])
            hashes[i] += total


@compiled()
def count_bonus(hashes, mask, visits, scale, bonus):
    size = np.uint64(len(visits))
    for i in range(len(hashes)):
        if mask[i]:
            slot = ((hashes[i] >> np.uint64(32)) * size) >> np.uint64(32)
            visits[slot] += 1
            bonus[i] = scale / np.sqrt(visits[slot])


@compiled()
def means_of_squares(images, square, means):
    """Of images uint8 [M, H, W, C] the means of squares of pixels, smaller ones at the right and at
    the bottom, 0 to 1."""
    rows, height, width, channels = images.shape
    lines = images.reshape(rows, height, width * channels)
    sums = np.empty(width * channels, np.int64)  # of the pixels of a row of squares, by column
    for i in range(rows):
        for y in range(means.shape[1]):
            top, bottom = y * square, min((y + 1) * square, height)
            sums[:] = 0
            for v in range(top, bottom):
                line = lines[i, v]
                for u in range(len(sums)):
                    sums[u] += line[u]
            for x in range(means.shape[2]):
                left, right = x * square, min((x + 1) * square, width)
                scale = 1 / (255 * (bottom - top) * (right - left))
                for c in range(channels):
                    total = 0
                    for u in range(left, right):
                        total += sums[u * channels + c]
                    means[i, y, x, c] = total * scale
