"""Checks of constructor arguments that several families have."""

import operator
from typing import Any


def whole_numbers(values: Any) -> list[int] | None:
    """The values as integers, or None if they are not whole numbers."""
    try:
        return [operator.index(value) for value in values]
    except TypeError:
        return None


def read_image_size(value: Any) -> tuple[int, int]:
    """Height and width of an image. Raises ValueError unless both are whole numbers from 1 on."""
    sizes = whole_numbers(value)
    if sizes is None or len(sizes) != 2 or min(sizes) < 1:
        raise ValueError(
            f"image_size must be (height, width), whole numbers of at least 1, got {value!r}"
        )
    return sizes[0], sizes[1]


def read_count(name: str, value: Any) -> int:
    """An argument of this name. Raises ValueError unless it is a whole number from 1 on."""
    numbers = whole_numbers([value])
    if numbers is None or numbers[0] < 1:
        raise ValueError(f"{name} must be a whole number of at least 1, got {value!r}")
    return numbers[0]
