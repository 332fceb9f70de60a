"""Pictures for people to watch, at the size that they ask for."""

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]


def fit(picture: Picture, width: int, height: int) -> Picture:
    """The picture, uint8 [height, width, 3], scaled to fit, in proportion; enlarged by whole
    factors only."""
    from PIL import Image

    factor = min(width / picture.shape[1], height / picture.shape[0])
    if factor >= 1:
        return enlarge(picture, int(factor))
    size = (max(round(picture.shape[i] * factor), 1) for i in (1, 0))
    return np.asarray(Image.fromarray(picture).resize(tuple(size), Image.Resampling.BOX))


def enlarge(picture: Picture, factor: int) -> Picture:
    """Each pixel as a square of `factor` x `factor`."""
    return picture.repeat(factor, axis=0).repeat(factor, axis=1)
