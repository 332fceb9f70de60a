"""The strip of text below pictures in stills and films."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from zipf.experiments.reporting.any_matplotlib import matplotlib

# The default fonts of Pillow and pygame lack arrows.
FONT = Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")
BACKGROUND, BRIGHT, DIM = (24, 26, 32), (235, 235, 235), (150, 155, 165)
GOOD, BAD = (120, 220, 130), (255, 145, 110)

_SMALLEST = 9  # height of letters, pixels, at which they can just be read
_SHADES = 8  # of letters, so that a GIF has colours left for the picture
_LARGE = 30, 24  # a picture is so many letters wide and high, where nothing else limits them


def captioned(
    picture: NDArray[np.uint8], lines: Sequence[str], success: bool | None = None
) -> NDArray[np.uint8]:
    """A picture, uint8 [height, width, 3], above lines of text: the first is bright, and the last
    is coloured where there was a success or a failure. Letters grow with the picture; those of a
    line that is too long are smaller, and what does not fit then is cut off."""
    height, width, _ = picture.shape
    letters = max(round(min(width / _LARGE[0], height / _LARGE[1])), _SMALLEST + 2)
    step, margin = round(1.45 * letters), letters // 2
    strip = np.full((step * len(lines) + 2 * margin, width, 3), BACKGROUND, np.uint8)
    for i, line in enumerate(lines):
        size = letters
        while size > _SMALLEST and _font(size).getlength(line) > width - 2 * margin:
            size -= 1
        colour = DIM if i else BRIGHT
        if i == len(lines) - 1 and success is not None:
            colour = GOOD if success else BAD
        drawn = Image.new("L", (width, step))
        ImageDraw.Draw(drawn).text((margin, step / 2), line, 255, _font(size), anchor="lm")
        shade = np.round(np.asarray(drawn) * (_SHADES / 255))[..., None] / _SHADES
        shade[:, width - margin :] = 0
        rows = np.s_[margin + i * step : margin + (i + 1) * step]
        strip[rows] = BACKGROUND + shade * np.subtract(colour, BACKGROUND)
    return np.vstack([picture, strip])


@lru_cache(maxsize=64)
def _font(size: int) -> ImageFont.FreeTypeFont:
    return ImageFont.truetype(FONT, size)
