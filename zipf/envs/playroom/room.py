"""One room's floor plane, simulated by pymunk: walls, furniture, the agent and loose objects."""

import math
from collections.abc import Sequence

import pymunk

from zipf.envs.playroom.chipmunk import address
from zipf.envs.playroom.constants import (
    AGENT_MASS,
    AGENT_RADIUS,
    DAMPING,
    FRAME,
    FURNITURE_SIZE,
    ROOM,
)
from zipf.envs.playroom.state import (
    BED_LAYER,
    CARRIED_LAYER,
    GROUND_LAYER,
    HELD_LAYER,
    LOW_LAYER,
    RAISED_LAYER,
    TRAY_LAYER,
)

_WALL, _AGENT, _GROUND, _BED, _TRAY, _RAISED, _CARRIED, _SUPPORTED = (1 << k for k in range(8))
_WALL_DEPTH = 1.0  # so thick that nothing passes in one frame


def _filter(category: int, *against: int) -> pymunk.ShapeFilter:
    return pymunk.ShapeFilter(categories=category, mask=sum(against))


# A flying object collides with walls, and lower than the bed with its sides. One on a support
# collides with others there, and on the tray with the agent, who can walk over the tray. A held
# object near the floor pushes objects on the floor; `holding.py` keeps it out of everything else.
_LAYERS = {
    GROUND_LAYER: _filter(_GROUND, _WALL, _AGENT, _GROUND, _BED, _TRAY, _CARRIED),
    RAISED_LAYER: _filter(_RAISED, _WALL),
    LOW_LAYER: _filter(_RAISED, _WALL, _BED),
    CARRIED_LAYER: _filter(_CARRIED, _GROUND),
    HELD_LAYER: _filter(_CARRIED),
    BED_LAYER: _filter(_SUPPORTED, _WALL, _SUPPORTED),
    TRAY_LAYER: _filter(_SUPPORTED, _WALL, _SUPPORTED, _AGENT),
}
_SLOP = 0.005  # metres of overlap that is not corrected; pymunk's 0.1 is meant for pixels
_ITERATIONS = 30  # ours: enough for several objects that are pushed into a corner
_MASS = 2.0  # kilograms, of every object: ours
_NARROW = 0.1  # metres between bed and wall, closed so that no object is pushed in there: ours
_ELONGATED = 1.3  # above this ratio of sides a footprint is a box, below it a disc: ours


class Room:
    """The bodies of an env, for one episode after the other.

    Every episode has a new space, so that it does not depend on the episodes before it. Bodies and
    shapes are used again, because making them takes longer than everything else in a reset.
    """

    def __init__(self, num_objects: int, furnished: bool) -> None:
        self.space = pymunk.Space()
        self._still: list[pymunk.Body] = []
        self._fixed: list[pymunk.Shape] = []
        half = ROOM / 2 + _WALL_DEPTH
        corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
        walls = pymunk.Body(body_type=pymunk.Body.STATIC)
        self._still.append(walls)
        for one, two in zip(corners, corners[1:] + corners[:1], strict=True):
            wall = pymunk.Segment(walls, one, two, _WALL_DEPTH)
            wall.filter = _filter(_WALL, _AGENT, _GROUND, _RAISED, _SUPPORTED)
            self._fixed.append(wall)
        for kind, size in zip((_BED, _TRAY), FURNITURE_SIZE.tolist(), strict=True):
            if furnished:
                body = pymunk.Body(body_type=pymunk.Body.STATIC)
                piece = pymunk.Poly.create_box(body, (2 * size[0], 2 * size[1]))
                piece.filter = _filter(kind, _AGENT, _GROUND, _RAISED)
                self._still.append(body)
                self._fixed.append(piece)
                if kind == _BED:
                    self._bed = piece
        self.agent = pymunk.Body(AGENT_MASS, math.inf)
        self._disc = pymunk.Circle(self.agent, AGENT_RADIUS)
        self._disc.filter = _filter(_AGENT, _WALL, _GROUND, _BED, _SUPPORTED)
        self.objects = [pymunk.Body(_MASS, 1.0) for _ in range(num_objects)]
        self._boxes = [pymunk.Poly.create_box(body, (1.0, 1.0)) for body in self.objects]
        self._discs = [pymunk.Circle(body, 1.0) for body in self.objects]
        for shape in (*self._boxes, *self._discs):
            shape.friction = 0.5
        self.shapes: list[pymunk.Shape] = []
        self.bodies = [self.agent, *self.objects]

    def begin(
        self,
        agent: Sequence[float],
        objects: Sequence[Sequence[float]],
        furniture: Sequence[Sequence[float]],
    ) -> None:
        """Begins an episode with the agent at (x, y), objects (x, y, angle, length, width) and, if
        there are any, bed and tray (x, y, angle)."""
        if self.shapes:
            self.space.remove(*self.shapes, self._disc, *self._fixed)
            # Without shapes: what is left of the correction of overlaps is used up.
            self.space.step(FRAME)
            self.space.remove(*self.bodies, *self._still)
        for body, pose in zip(self._still[1:], furniture, strict=True):
            _place(body, *pose)
        if furniture:
            self._bed.unsafe_set_vertices(_up_to_the_walls(*furniture[0]))
        _place(self.agent, agent[0], agent[1], 0.0)
        self.shapes = []
        for j, (x, y, angle, length, width) in enumerate(objects):
            body = self.objects[j]
            _place(body, x, y, angle)
            body.moment = pymunk.moment_for_box(_MASS, (length, width))
            if max(length, width) > _ELONGATED * min(length, width):
                box = self._boxes[j]
                x, y = length / 2, width / 2
                box.unsafe_set_vertices([(x, -y), (x, y), (-x, y), (-x, -y)])
                self.shapes.append(box)
            else:
                disc = self._discs[j]
                disc.unsafe_set_radius((length + width) / 4)
                self.shapes.append(disc)
            self.shapes[j].filter = _LAYERS[GROUND_LAYER]
        self.space = pymunk.Space()
        self.space.iterations = _ITERATIONS
        self.space.collision_slop = _SLOP
        self.space.damping = math.exp(-DAMPING)
        self.space.add(*self._still, *self.bodies, *self._fixed, self._disc, *self.shapes)

    def addresses(self) -> tuple[int, list[int]]:
        """Where the episode's space is in memory, and the bodies of the agent and the objects."""
        return address(self.space._space), [address(body._body) for body in self.bodies]

    def set_layer(self, item: int, layer: int) -> None:
        """Sets what an object collides with, GROUND_LAYER .. TRAY_LAYER; at first GROUND_LAYER."""
        self.shapes[item].filter = _LAYERS[layer]

    def place(self, item: int, x: float, y: float, angle: float) -> None:
        """Puts an object somewhere on the floor plane; it keeps its velocity."""
        body = self.objects[item]
        body.position = x, y
        body.angle = angle
        self.space.reindex_shapes_for_body(body)


def _up_to_the_walls(x: float, y: float, angle: float) -> list[tuple[float, float]]:
    """The bed's corners in its own frame, without narrow gaps between its sides and the walls."""
    length, width = FURNITURE_SIZE[0].tolist()[:2]
    sides = []
    for turn, half in ((0.0, length), (0.5, width), (1.0, length), (1.5, width)):
        along = math.cos(angle + turn * math.pi), math.sin(angle + turn * math.pi)
        gap = math.inf
        for centre, step in zip((x, y), along, strict=True):
            if abs(step) > 1e-6:
                gap = min(gap, (math.copysign(ROOM / 2, step) - centre) / step - half)
        sides.append(half + gap if 0 < gap < _NARROW else half)
    foot, left, head, right = sides
    return [(foot, -right), (foot, left), (-head, left), (-head, -right)]


def _place(body: pymunk.Body, x: float, y: float, angle: float) -> None:
    """Puts a body that is in no space somewhere, at rest."""
    body.position = x, y
    body.angle = angle
    if body.body_type == pymunk.Body.DYNAMIC:
        body.velocity = 0.0, 0.0
        body.angular_velocity = 0.0
