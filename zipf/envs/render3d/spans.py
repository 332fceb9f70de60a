"""Spans of columns: what of a line of the image a surface covers."""

import numpy as np

from zipf.compiled import compiled


@compiled(references=False, error_model="numpy")
def narrow(low, high, a, b):
    """Narrows a span to where a + b * x >= 0."""
    if b > 0.0:
        return max(low, -a / b), high
    if b < 0.0:
        return low, min(high, -a / b)
    return low, (high if a >= 0.0 else low - 1.0)


@compiled(references=False, error_model="numpy")
def narrow_rows(low, high, a, step, b):
    """Narrows the span of each row y, in float32 [H], to where a + step * y + b * x >= 0."""
    if abs(b) < 1e-30:
        b = 1e-30
    start = np.float32(-a / b)
    step = np.float32(-step / b)
    if b > 0.0:
        for y in range(len(low)):
            low[y] = max(low[y], start + step * np.float32(y))
    else:
        for y in range(len(high)):
            high[y] = min(high[y], start + step * np.float32(y))
