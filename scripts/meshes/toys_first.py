"""The toys of ranks 1 to 25, from the most frequent on."""

from .shapes import ACCENT, DARK, Mesh, assemble, cone, ellipsoid

EYE = DARK


def duck() -> Mesh:
    solids = [
        ellipsoid((0.5, 0.32, 0.26), at=(0, 0, 0.26)),
        ellipsoid((0.2, 0.2, 0.22), at=(0.3, 0, 0.65)),
        cone(0.1, 0.25, ACCENT, sides=6).turn("y", 90).move(0.46, 0, 0.62),
    ]
    return assemble(solids)


TOYS = {toy.__name__: toy for toy in (duck,)}
