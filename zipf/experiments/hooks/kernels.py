"""Compiled functions of hooks; they import nothing that changes with the laboratory."""

import math

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
    slots = np.empty(len(hashes), np.uint64)
    for i in range(len(hashes)):
        if mask[i]:
            slots[i] = ((hashes[i] >> np.uint64(32)) * size) >> np.uint64(32)
            visits[slots[i]] += 1
    for i in range(len(hashes)):
        if mask[i]:
            bonus[i] = scale / np.sqrt(visits[slots[i]])


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


@compiled()
def _source(pixel, size, scale):
    """The source pixel, in a row of `size`, that `pixel` shows after scaling."""
    source = math.floor((pixel + 0.5 - size / 2) / scale + size / 2)
    return min(max(source, 0), size - 1)


@compiled()
def change_images(image, orders, shifts, scales, centres, side):
    """Changes images uint8 [N, H, W, C] in place."""
    _, height, width, channels = image.shape
    before = np.empty((height, width, channels), np.uint8)
    columns = np.empty(width, np.int64)
    for i in range(len(image)):
        down, right = shifts[i]
        if scales[i] != 1 and scales[i] != 0:  # 0 of no frame
            before[:] = image[i]
            for c in range(width):
                columns[c] = _source(c - right, width, scales[i])
            for r in range(height):
                row = before[_source(r - down, height, scales[i])]
                for c in range(width):
                    image[i, r, c] = row[columns[c]]
        elif down or right:
            before[:] = image[i]
            for r in range(height):
                source, target = before[min(max(r - down, 0), height - 1)], image[i, r]
                first, last = max(right, 0), width + min(right, 0)
                target[first:last] = source[first - right : last - right]
                for c in range(first):
                    target[c] = source[0]
                for c in range(last, width):
                    target[c] = source[width - 1]
        first, second, third = orders[i]
        # A fourth channel is no colour, and more of them have none.
        if 3 <= channels <= 4 and (first != 0 or second != 1):
            for r in range(height):
                for c in range(width):
                    pixel = image[i, r, c]
                    pixel[0], pixel[1], pixel[2] = pixel[first], pixel[second], pixel[third]
        if side:
            top = int(centres[i, 0] * height) - side // 2
            left = int(centres[i, 1] * width) - side // 2
            for r in range(max(top, 0), min(top + side, height)):
                for c in range(max(left, 0), min(left + side, width)):
                    image[i, r, c] = 0
