"""The atlas of Zipf's Labyrinth: forty objects, thirty-six abstract ones, and its props."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from . import labyrinth_forms, labyrinth_objects, labyrinth_props
from .shapes import Mesh, Solid, assemble

OBJECTS = labyrinth_objects.OBJECTS | labyrinth_forms.OBJECTS | labyrinth_props.OBJECTS
"""The maker of each mesh, with its size along x, y and z in hundredths of a metre."""


def fit(solids: Sequence[Solid], size: tuple[int, int, int]) -> Mesh:
    """One mesh, stretched along each axis to exactly that size in hundredths of a metre."""
    vertices = np.concatenate([solid.vertices for solid in solids])
    factors = np.array(size) / 100 / (vertices.max(axis=0) - vertices.min(axis=0))
    return assemble([replace(s, vertices=s.vertices * factors) for s in solids], None)


def build() -> dict[str, Mesh]:
    """Every mesh by name."""
    return {name: fit(make(), size) for name, (make, size) in OBJECTS.items()}
