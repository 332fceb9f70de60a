"""The bed and the tray, on which toys are put: the heights of their surfaces are exact."""

from .shapes import MAIN, WOOD, Mesh, assemble, box, loft


def bed() -> Mesh:
    """1.4 x 0.9 m; the top of the mattress and of the blanket is at z = 0.35."""
    solids = [
        box(0.06, 0.90, 0.70, WOOD, at=(-0.67, 0, 0.35)),
        box(0.06, 0.90, 0.42, WOOD, at=(0.67, 0, 0.21)),
        box(1.30, 0.86, 0.10, WOOD, at=(0, 0, 0.15)),
        box(1.28, 0.84, 0.17, MAIN, at=(0, 0, 0.265)),
    ]
    return assemble(solids, size=None)


def tray() -> Mesh:
    """0.6 x 0.45 m; the floor is at z = 0.03 and the rim at 0.06."""
    corners = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    outline = ((0.60, 0.45, 0.0), (0.60, 0.45, 0.06), (0.57, 0.42, 0.06), (0.57, 0.42, 0.03))
    rings = [[(sx * x, sy * y, z) for sx, sy in corners] for x, y, z in outline]
    return assemble([loft(rings)], size=None)


FURNITURE = {thing.__name__: thing for thing in (bed, tray)}
