"""One room's floor plane, simulated by pymunk: walls, furniture, the agent and loose objects."""

import math
from collections.abc import Sequence

import pymunk
from numpy.typing import NDArray

from zipf.envs.playroom.constants import (
    AGENT_MASS,
    AGENT_RADIUS,
    DAMPING,
    FRAME,
    FRAMES,
    FURNITURE_SIZE,
    ROOM,
)
from zipf.envs.playroom.state import (
    CARRIED_LAYER,
    GROUND_LAYER,
    LOW_LAYER,
    RAISED_LAYER,
    SUPPORTED_LAYER,
)

_WALL, _AGENT, _GROUND, _BED, _TRAY, _RAISED, _CARRIED, _SUPPORTED = (1 << k for k in range(8))
_WALL_DEPTH = 1.0  # so thick that nothing passes in one frame


def _filter(category: int, *against: int) -> pymunk.ShapeFilter:
    return pymunk.ShapeFilter(categories=category, mask=sum(against))


# A held object near the floor pushes objects on the floor, but not the agent that holds it; an
# object lower than the bed collides with its sides; a high one only with walls; one on a support
# only with others there.
_LAYERS = {
    GROUND_LAYER: _filter(_GROUND, _WALL, _AGENT, _GROUND, _BED, _TRAY, _CARRIED),
    RAISED_LAYER: _filter(_RAISED, _WALL),
    LOW_LAYER: _filter(_RAISED, _WALL, _BED),
    CARRIED_LAYER: _filter(_CARRIED, _WALL, _GROUND, _BED),
    SUPPORTED_LAYER: _filter(_SUPPORTED, _WALL, _SUPPORTED),
}
_SLOP = 0.005  # metres of overlap that is not corrected; pymunk's 0.1 is meant for pixels
_ITERATIONS = 30  # ours: enough for several objects that are pushed into a corner
_MASS = 2.0  # kilograms, of every object: ours
_ELONGATED = 1.3  # above this ratio of sides a footprint is a box, below it a disc: ours


class Room:
    """The bodies of one episode.

    Every episode has a new room, so that it does not depend on the episodes before it.

    Args:
        agent: x and y of the agent.
        objects: (x, y, angle, length, width) of each object.
        furniture: (x, y, angle, half length, half width) of bed and tray; empty without them.
    """

    def __init__(
        self,
        agent: Sequence[float],
        objects: Sequence[Sequence[float]],
        furniture: Sequence[Sequence[float]],
    ) -> None:
        self.space = pymunk.Space()
        self.space.iterations = _ITERATIONS
        self.space.collision_slop = _SLOP
        self.space.damping = math.exp(-DAMPING)
        still = self.space.static_body
        half = ROOM / 2 + _WALL_DEPTH
        corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
        for one, two in zip(corners, corners[1:] + corners[:1], strict=True):
            wall = pymunk.Segment(still, one, two, _WALL_DEPTH)
            wall.filter = _filter(_WALL, _AGENT, _GROUND, _RAISED, _CARRIED, _SUPPORTED)
            self.space.add(wall)
        for kind, (x, y, angle, length, width) in zip((_BED, _TRAY), furniture, strict=False):
            placed = pymunk.Transform.translation(x, y).rotated(angle)
            points = [(length, width), (-length, width), (-length, -width), (length, -width)]
            piece = pymunk.Poly(still, points, placed)
            piece.filter = _filter(kind, _AGENT, _GROUND, _RAISED, _CARRIED)
            self.space.add(piece)
        self.agent = pymunk.Body(AGENT_MASS, math.inf)
        self.agent.position = agent[0], agent[1]
        disc = pymunk.Circle(self.agent, AGENT_RADIUS)
        disc.filter = _filter(_AGENT, _WALL, _GROUND, _BED, _TRAY)
        self.space.add(self.agent, disc)
        self.objects: list[pymunk.Body] = []
        self.shapes: list[pymunk.Shape] = []
        for x, y, angle, length, width in objects:
            body = pymunk.Body(_MASS, pymunk.moment_for_box(_MASS, (length, width)))
            body.position = x, y
            body.angle = angle
            shape: pymunk.Shape
            if max(length, width) > _ELONGATED * min(length, width):
                shape = pymunk.Poly.create_box(body, (length, width))
            else:
                shape = pymunk.Circle(body, (length + width) / 4)
            shape.friction = 0.5
            shape.filter = _LAYERS[GROUND_LAYER]
            self.space.add(body, shape)
            self.objects.append(body)
            self.shapes.append(shape)
        self.bodies = [self.agent, *self.objects]
        self.layers = [GROUND_LAYER] * len(self.objects)

    def set_layers(self, layers: Sequence[int]) -> None:
        """Sets what each object collides with, GROUND_LAYER .. SUPPORTED_LAYER."""
        for j, layer in enumerate(layers):
            if layer != self.layers[j]:
                self.shapes[j].filter = _LAYERS[layer]
        self.layers = list(layers)

    def turn(self, item: int, angle: float) -> None:
        """Sets the angle of an object, radians."""
        self.objects[item].angle = angle
        self.space.reindex_shapes_for_body(self.objects[item])

    def step(self, force: Sequence[float]) -> None:
        """Simulates the frames of one action, with a force (x, y) on the agent, newtons."""
        agent, step = self.agent, self.space.step
        x, y = force
        for _ in range(FRAMES):
            if x or y:
                agent.force = x, y  # pymunk clears it after every frame
            step(FRAME)

    def poses(self) -> list[float]:
        """x, y and angle of the agent and then of each object, as one flat list."""
        values: list[float] = []
        for body in self.bodies:
            x, y = body.position
            values += (x, y, body.angle)
        return values


def furniture_of(poses: NDArray) -> list[list[float]]:
    """(x, y, angle, half length, half width) of bed and tray from their poses, float64 [2, 3]."""
    sizes = FURNITURE_SIZE.tolist()
    return [[*pose, *size[:2]] for pose, size in zip(poses.tolist(), sizes, strict=True)]
