"""The bed and the tray. The playroom's rules rely on their sizes and the heights of their tops."""

from .shapes import ACCENT, LIGHT, MAIN, WOOD, Mesh, Point, arc, assemble, box, cylinder, loft


def bed() -> Mesh:
    """1.4 x 0.9 m; mattress and blanket end at z = 0.35, the headboard is at -x."""
    pillow = [(0.24, 0.60, 0.345), (0.30, 0.68, 0.38), (0.26, 0.62, 0.42)]
    corners = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    return assemble(
        [
            box(0.05, 0.80, 0.50, WOOD, at=(-0.67, 0, 0.43)),
            *(box(0.06, 0.07, 0.74, WOOD, at=(-0.67, y, 0.37)) for y in (-0.415, 0.415)),
            *(cylinder(0.05, 0.05, WOOD, at=(-0.65, y, 0.73), sides=6) for y in (-0.4, 0.4)),
            *(box(0.07, 0.07, 0.34, WOOD, at=(0.665, y, 0.17)) for y in (-0.415, 0.415)),
            box(0.04, 0.80, 0.20, WOOD, at=(0.675, 0, 0.24)),
            box(1.30, 0.84, 0.10, WOOD, at=(0, 0, 0.17)),
            box(0.53, 0.82, 0.14, MAIN, at=(-0.395, 0, 0.28)),
            box(0.68, 0.88, 0.19, ACCENT, at=(0.315, 0, 0.255)),
            box(0.105, 0.88, 0.19, LIGHT, at=(-0.0775, 0, 0.255)),
            loft(
                [[(sx * x - 0.47, sy * y, z) for sx, sy in corners] for x, y, z in pillow],
                LIGHT,
            ),
        ],
        None,
    )


def tray() -> Mesh:
    """0.6 x 0.45 m with rounded corners; the floor is at z = 0.03, the rim ends at 0.06."""

    def outline(inset: float, z: float) -> list[Point]:
        x, y, radius = 0.22, 0.145, 0.08 - inset
        turns = ((1, 1, 0), (-1, 1, 90), (-1, -1, 180), (1, -1, 270))
        return [
            (float(point[0]), float(point[1]), z)
            for sx, sy, start in turns
            for point in arc(radius, start, start + 90, 3, plane="xy", at=(sx * x, sy * y, 0))
        ]

    rings = [outline(0.02, 0.0), outline(0.0, 0.06), outline(0.018, 0.06), outline(0.03, 0.03)]
    return assemble([loft(rings)], None)


FURNITURE = {thing.__name__: thing for thing in (bed, tray)}
