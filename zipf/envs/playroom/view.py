"""The images of the playroom: the agent's view, and larger frames for people to watch."""

import math
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled
from zipf.envs.playroom import varied_looks
from zipf.envs.playroom.constants import CEILING, EYE, FURNITURE_SIZE, LANDING, ROOM
from zipf.envs.playroom.geometry import half_width, rectangle_gap
from zipf.envs.playroom.state import AX, AY, PITCH, YAW, Envs, X, Y, Z
from zipf.envs.render3d import (
    EAST,
    FACES_DOWN,
    GROUNDED,
    NORTH,
    SOUTH,
    WEST,
    Renderer,
    Scenes,
    load_meshes,
    pack_textures,
    textures,
)
from zipf.envs.render3d.shadows import DARKNESS, cast

FIELD_OF_VIEW = 75.0
"""Horizontal, degrees. Ours: the smallest object is 7 of 96 pixels wide from 2 m away."""

_FURNITURE_SOFTNESS = (0.2, 0.09)
"""Widths of the soft edges of bed's and tray's shadows on each side of the edge, metres."""

# Of the room, metres: ours.
SKIRTING = 0.1  # height
HANGING = 0.01  # distance from the wall
WINDOW = (-0.6, 0.6), (0.95, 2.05)
PICTURE = (-1.1, -0.2), (1.05, 1.75)
"""In the east and in the west: from where to where, and from which height to which."""

_FRAME = (240, 384)
_CAPTION = 48


def extents_of(names: tuple[str, ...]) -> NDArray[np.float64]:
    """Bounding boxes of the meshes of these names, float64 [len(names), 3], metres."""
    atlas = load_meshes()
    return np.array([atlas.extent[atlas.index(name)] for name in names], np.float64)


class View:
    """Draws the images of a batch of playrooms, whose state every method reads again. `names` are
    the objects' by rank; with `varied` every episode has its own looks, see `varied_looks.py`."""

    def __init__(
        self, names: tuple[str, ...], envs: Envs, width: int, height: int, *, varied: bool
    ) -> None:
        atlas = load_meshes()
        self.envs = envs
        self.varied = varied
        self.meshes = np.array([atlas.index(name) for name in names])
        num_envs, count = envs.ranks.shape
        self.scenes = Scenes(num_envs, walls=10, flats=2, instances=count + 2, shadows=count + 2)
        for i in range(num_envs):
            _build_room(self.scenes, i)
        if envs.furnished:
            self.scenes.mesh[:, count:] = [atlas.index("bed"), atlas.index("tray")]
        self.renderer = _renderer(height, width)
        # Not shared with other views: a renderer draws without the GIL, in buffers of its own.
        self._large: Renderer | None = None

    def begin(self, mask: NDArray[np.bool_]) -> None:
        """Reads or draws what stays the same for an episode, in the envs of `mask`.
        Varied looks are drawn from `envs.scenery`, after everything else of the episode."""
        envs, scenes = self.envs, self.scenes
        count = envs.ranks.shape[1]
        scenes.mesh[mask, :count] = self.meshes[envs.ranks[mask]]
        scenes.colours[mask] = envs.colours[mask]
        if envs.furnished:
            x, y, angle = envs.furniture[mask].transpose(2, 0, 1)
            scenes.position[mask, count:] = np.stack([x, y, np.zeros_like(x)], -1)
            cos, sin = np.cos(angle), np.sin(angle)
            rotation = np.zeros((*angle.shape, 3, 3))
            rotation[..., 0, 0] = rotation[..., 1, 1] = cos
            rotation[..., 0, 1], rotation[..., 1, 0] = -sin, sin
            rotation[..., 2, 2] = 1
            scenes.rotation[mask, count:] = rotation
            soft = np.array(_FURNITURE_SOFTNESS)
            shadows = np.zeros((*x.shape, 8))
            shadows[..., 0], shadows[..., 1], shadows[..., 3] = x, y, angle
            shadows[..., 4:6] = FURNITURE_SIZE[:, :2] - soft[:, None]
            shadows[..., 6], shadows[..., 7] = 2 * soft, DARKNESS
            scenes.shadows[mask, count:] = shadows
        if self.varied:
            varied_looks.vary(
                mask, envs.scenery, varied_looks.VARIED_WALLS, varied_looks.VARIED_FLOORS, count,
                scenes.wall_looks, scenes.flat_looks, scenes.sun, scenes.lamp, scenes.scale,
            )  # fmt: skip

    def draw(self, out: NDArray[np.uint8], mask: NDArray[np.bool_]) -> None:
        """Writes the images of the envs of `mask` to their rows of `out`."""
        self._update(mask)
        self.renderer.render(self.scenes, out, mask)

    def frames(self, texts: list[str]) -> tuple[NDArray[np.uint8], ...]:
        """Larger images with the envs' texts below, uint8 [288, 384, 3]."""
        images = self._drawn(*_FRAME)
        return tuple(_captioned(image, text) for image, text in zip(images, texts, strict=True))

    def pictures(self, width: int, height: int) -> tuple[NDArray[np.uint8], ...]:
        """Images in the proportions of the agent's, as large as fit, without texts."""
        own = self.renderer
        factor = min(width / own.width, height / own.height)
        size = (max(round(side * factor), 1) for side in (own.height, own.width))
        return tuple(self._drawn(*size))

    def _drawn(self, height: int, width: int) -> NDArray[np.uint8]:
        """Images of this size, uint8 [N, height, width, 3], with a cross where the hand points."""
        everywhere = np.ones(len(self.scenes.camera), np.bool_)
        images = np.zeros((len(everywhere), height, width, 3), np.uint8)
        self._update(everywhere)
        if self._large is None or (self._large.height, self._large.width) != (height, width):
            self._large = _renderer(height, width)
        self._large.render(self.scenes, images, everywhere)
        x, y = width // 2, height // 2
        half, line = height // 40, height // 480
        images[:, y - line : y + line + 1, x - half : x + half + 1] = 255
        images[:, y - half : y + half + 1, x - line : x + line + 1] = 255
        return images

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_large": None}

    def _update(self, mask: NDArray[np.bool_]) -> None:
        envs, scenes = self.envs, self.scenes
        _pose(
            mask, envs.agents, envs.objects, envs.orientation, envs.ranks, envs.extents,
            envs.furnished, envs.furniture, scenes.scale, scenes.camera, scenes.position,
            scenes.rotation, scenes.shadows,
        )  # fmt: skip


def _build_room(scenes: Scenes, i: int) -> None:
    """Adds floor, ceiling, four walls with different wallpapers, which show the direction, their
    skirtings, a window and a picture. What varied looks change comes first."""
    half = ROOM / 2
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    sides = [(*one, *two) for one, two in zip(corners, corners[1:] + corners[:1], strict=True)]
    for ends, paper in zip(sides, varied_looks.WALLS, strict=True):
        scenes.add_walls(i, ends, (SKIRTING, CEILING), textures.index(paper), repeat=1.0)
    for ends in sides:
        scenes.add_walls(i, ends, (0.0, SKIRTING), textures.index("skirting"), flags=GROUNDED)
    near = half - HANGING
    (left, right), heights = WINDOW
    scenes.add_walls(i, (near, left, near, right), heights, textures.index("window"))
    (left, right), heights = PICTURE
    scenes.add_walls(i, (-near, right, -near, left), heights, textures.index("picture"))
    square = (-half, -half, half, half)
    walled = EAST | NORTH | WEST | SOUTH
    floor = textures.index(varied_looks.FLOOR)
    scenes.add_flat(i, square, 0.0, floor, flags=walled, repeat=1.0)
    scenes.add_flat(i, square, CEILING, textures.index("ceiling"), flags=FACES_DOWN, repeat=2.0)


@compiled(references=False)
def _pose(
    mask, agents, objects, orientation, ranks, extents, furnished, furniture, scale, camera,
    position, rotation, shadows,
):  # fmt: skip
    """Writes `camera`, `position`, `rotation` and `shadows`, arrays of `Scenes`, from arrays of
    `Envs`. `scale` is an array of `Scenes`, too."""
    for i in range(mask.size):
        if not mask[i]:
            continue
        camera[i, 0], camera[i, 1] = agents[i, AX], agents[i, AY]
        camera[i, 2] = EYE
        camera[i, 3], camera[i, 4] = agents[i, YAW], agents[i, PITCH]
        for j in range(ranks.shape[1]):
            frame = orientation[i, j]
            extent = extents[ranks[i, j]]
            size = (extent[0] * scale[i, j], extent[1] * scale[i, j], extent[2] * scale[i, j])
            half = size[2] / 2
            middle = objects[i, j, Z] + half_width(frame, size, 0.0, 0.0, 1.0)
            # Objects turn about their centres.
            position[i, j, 0] = objects[i, j, X] - half * frame[0, 2]
            position[i, j, 1] = objects[i, j, Y] - half * frame[1, 2]
            position[i, j, 2] = middle - half * frame[2, 2]
            for r in range(3):
                for c in range(3):
                    rotation[i, j, r, c] = frame[r, c]
            _shade(shadows[i, j], objects[i, j], middle, frame, size, furnished, furniture[i])


@compiled(references=False)
def _shade(shadow, item, middle, frame, size, furnished, furniture):
    """Writes a row of `Scenes.shadows`: the shadow of an object on what is below.
    `middle` is the height of the object's centre, and `size` that at which it is drawn, metres."""
    top = 0.0
    if furnished:
        for k in range(2):
            over = rectangle_gap(furniture[k], FURNITURE_SIZE[k], item[X], item[Y]) == 0.0
            if over and item[Z] >= FURNITURE_SIZE[k, 2] - LANDING:
                top = FURNITURE_SIZE[k, 2]
    # Along one of the object's own axes that is not upright.
    axis = 0 if abs(frame[2, 0]) < 0.9 else 1
    angle = math.atan2(frame[1, axis], frame[0, axis])
    cos, sin = math.cos(angle), math.sin(angle)
    length = breadth = tall = 0.0
    for c in range(3):
        length += abs(cos * frame[0, c] + sin * frame[1, c]) * size[c] / 2
        breadth += abs(cos * frame[1, c] - sin * frame[0, c]) * size[c] / 2
        tall += abs(frame[2, c]) * size[c] / 2
    height = max(middle - tall - top, 0.0)
    cast(shadow, item[X], item[Y], top, angle, length, breadth, height)


@cache
def _textures() -> NDArray[np.uint32]:
    return pack_textures(textures.stack())


def _renderer(height: int, width: int) -> Renderer:
    return Renderer(load_meshes(), _textures(), width=width, height=height, fov=FIELD_OF_VIEW)


def _captioned(image: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    """The image above its instruction."""
    from PIL import Image, ImageDraw, ImageFont

    height, width = image.shape[:2]
    canvas = Image.new("RGB", (width, height + _CAPTION), (20, 20, 20))
    canvas.paste(Image.fromarray(image))
    draw = ImageDraw.Draw(canvas)
    font = ImageFont.load_default(size=22)
    draw.text((width // 2, height + _CAPTION // 2), text, (255, 255, 255), font, anchor="mm")
    return np.asarray(canvas)
