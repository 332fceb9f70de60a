"""The images of the playroom: the agent's view, and larger frames for people to watch."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled
from zipf.envs.playroom.constants import CEILING, EYE, ROOM
from zipf.envs.playroom.geometry import half_width
from zipf.envs.playroom.state import AX, AY, PITCH, YAW, Worlds, X, Y, Z
from zipf.envs.render3d import FACES_DOWN, Renderer, Scenes, load_meshes, textures

FIELD_OF_VIEW = 75.0
"""Horizontal, degrees. Ours: an object 0.4 m wide at 1.5 m is 17 of 96 pixels wide."""

_FRAME = (240, 384)
_CAPTION = 48


def extents_of(names: tuple[str, ...]) -> NDArray[np.float64]:
    """Bounding boxes of the meshes of these names, float64 [len(names), 3], metres."""
    atlas = load_meshes()
    return np.array([atlas.extent[atlas.index(name)] for name in names], np.float64)


class View:
    """Draws the images of a batch of playrooms.

    Args:
        names: the objects' names by rank.
        worlds: the state of the worlds, read again by every method.
        width, height: of the agent's image, pixels.
    """

    def __init__(self, names: tuple[str, ...], worlds: Worlds, width: int, height: int) -> None:
        atlas = load_meshes()
        self.worlds = worlds
        self.meshes = np.array([atlas.index(name) for name in names])
        num_worlds, count = worlds.ranks.shape
        self.scenes = Scenes(num_worlds, walls=4, flats=2, instances=count + 2)
        for world in range(num_worlds):
            _build_room(self.scenes, world)
        if worlds.furnished:
            self.scenes.mesh[:, count:] = [atlas.index("bed"), atlas.index("tray")]
        self.renderer = Renderer(
            atlas, textures.stack(), width=width, height=height, fov=FIELD_OF_VIEW
        )

    def begin(self, mask: NDArray[np.bool_]) -> None:
        """Reads what stays the same for an episode, in the worlds of `mask`."""
        worlds, scenes = self.worlds, self.scenes
        count = worlds.ranks.shape[1]
        scenes.mesh[mask, :count] = self.meshes[worlds.ranks[mask]]
        scenes.colours[mask] = worlds.colours[mask]
        if worlds.furnished:
            x, y, angle = worlds.furniture[mask].transpose(2, 0, 1)
            scenes.position[mask, count:] = np.stack([x, y, np.zeros_like(x)], -1)
            cos, sin = np.cos(angle), np.sin(angle)
            rotation = np.zeros((*angle.shape, 3, 3))
            rotation[..., 0, 0] = rotation[..., 1, 1] = cos
            rotation[..., 0, 1], rotation[..., 1, 0] = -sin, sin
            rotation[..., 2, 2] = 1
            scenes.rotation[mask, count:] = rotation

    def draw(self, out: NDArray[np.uint8], mask: NDArray[np.bool_]) -> None:
        """Writes the images of the worlds of `mask` to their rows of `out`."""
        self._update(mask)
        self.renderer.render(self.scenes, out, mask)

    def frames(self, texts: list[str]) -> tuple[NDArray[np.uint8], ...]:
        """Larger images with the worlds' texts below, uint8 [288, 384, 3]."""
        height, width = _FRAME
        images = np.zeros((len(texts), height, width, 3), np.uint8)
        everywhere = np.ones(len(texts), np.bool_)
        self._update(everywhere)
        _large_renderer().render(self.scenes, images, everywhere)
        return tuple(_captioned(image, text) for image, text in zip(images, texts, strict=True))

    def _update(self, mask: NDArray[np.bool_]) -> None:
        """Copies the poses of cameras and objects to the scenes of the worlds of `mask`."""
        worlds, scenes = self.worlds, self.scenes
        _pose(
            mask, worlds.agents, worlds.objects, worlds.orientation, worlds.ranks, worlds.extents,
            scenes.camera, scenes.position, scenes.rotation,
        )  # fmt: skip


def _build_room(scenes: Scenes, world: int) -> None:
    """Adds floor, ceiling and four walls with different wallpapers, which show the direction."""
    half = ROOM / 2
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    papers = ("wallpaper", "wallpaper_blue", "stripes", "stripes_green")
    for k, paper in enumerate(papers):
        scenes.add_wall(
            world,
            (*corners[k], *corners[(k + 1) % 4]),
            (0.0, CEILING),
            textures.index(paper),
            repeat=(1.0, 1.0),
        )
    square = (-half, -half, half, half)
    scenes.add_flat(world, square, 0.0, textures.index("planks"), repeat=1.0)
    scenes.add_flat(world, square, CEILING, textures.index("ceiling"), flags=FACES_DOWN, repeat=2.0)


@compiled()
def _pose(mask, agents, objects, orientation, ranks, extents, camera, position, rotation):
    """Writes the last three, which are arrays of `Scenes`, from the others, those of `Worlds`."""
    for i in range(mask.size):
        if not mask[i]:
            continue
        camera[i, 0], camera[i, 1] = agents[i, AX], agents[i, AY]
        camera[i, 2] = EYE
        camera[i, 3], camera[i, 4] = agents[i, YAW], agents[i, PITCH]
        for j in range(ranks.shape[1]):
            frame, extent = orientation[i, j], extents[ranks[i, j]]
            half = extent[2] / 2
            middle = objects[i, j, Z] + half_width(frame, extent, 0.0, 0.0, 1.0)
            # Objects turn about their centres.
            position[i, j, 0] = objects[i, j, X] - half * frame[0, 2]
            position[i, j, 1] = objects[i, j, Y] - half * frame[1, 2]
            position[i, j, 2] = middle - half * frame[2, 2]
            for r in range(3):
                for c in range(3):
                    rotation[i, j, r, c] = frame[r, c]


@cache
def _large_renderer() -> Renderer:
    height, width = _FRAME
    return Renderer(load_meshes(), textures.stack(), width=width, height=height, fov=FIELD_OF_VIEW)


def _captioned(image: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    """The image above its instruction, with a cross where the hand points."""
    from PIL import Image, ImageDraw, ImageFont

    height, width = image.shape[:2]
    canvas = Image.new("RGB", (width, height + _CAPTION), (20, 20, 20))
    canvas.paste(Image.fromarray(image))
    draw = ImageDraw.Draw(canvas)
    x, y = width // 2, height // 2
    draw.line([(x - 6, y), (x + 6, y)], fill=(255, 255, 255))
    draw.line([(x, y - 6), (x, y + 6)], fill=(255, 255, 255))
    font = ImageFont.load_default(size=22)
    draw.text((width // 2, height + _CAPTION // 2), text, (255, 255, 255), font, anchor="mm")
    return np.asarray(canvas)
