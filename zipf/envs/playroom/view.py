"""What is seen in the playroom: the room's scene, and frames for people to watch."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled
from zipf.envs.playroom import kernels
from zipf.envs.render3d import FACES_DOWN, Renderer, Scenes, load_meshes, textures

if TYPE_CHECKING:
    from zipf.envs.playroom.vector import PlayroomVectorEnv

FIELD_OF_VIEW = 75.0
"""Horizontal, degrees. Ours: what is 0.4 m large 1.5 m away is 17 of 96 pixels wide."""

# The colours of objects: Carvalho et al. 2021.
PALETTE = np.array(
    [
        (205, 40, 40),  # red
        (50, 160, 60),  # green
        (45, 80, 200),  # blue
        (90, 205, 180),  # aquamarine
        (200, 50, 190),  # magenta
        (235, 130, 30),  # orange
        (125, 60, 170),  # purple
        (240, 140, 180),  # pink
        (235, 210, 50),  # yellow
        (230, 230, 230),  # white
    ],
    np.uint8,
)

_FRAME = (240, 384)
_CAPTION = 48


def extents_of(objects: tuple[str, ...]) -> NDArray[np.float64]:
    """Bounding boxes of these objects' meshes, float64 [len(objects), 3], metres."""
    atlas = load_meshes()
    return np.array([atlas.extent[atlas.index(name)] for name in objects], np.float64)


class View:
    """The scenes of `num_worlds` rooms, and what draws them."""

    def __init__(
        self,
        objects: tuple[str, ...],
        num_worlds: int,
        count: int,
        furnished: bool,
        width: int,
        height: int,
    ) -> None:
        atlas = load_meshes()
        self.furnished = furnished
        self.meshes = np.array([atlas.index(name) for name in objects])
        self.scenes = Scenes(num_worlds, walls=4, flats=2, instances=count + 2)
        for world in range(num_worlds):
            _build_room(self.scenes, world)
        if furnished:
            self.scenes.mesh[:, count:] = [atlas.index("bed"), atlas.index("tray")]
        self.renderer = Renderer(
            atlas, textures.stack(), width=width, height=height, fov=FIELD_OF_VIEW
        )

    def begin(self, mask: NDArray[np.bool_], worlds: PlayroomVectorEnv) -> None:
        """Takes what stays the same for an episode, in the worlds of `mask`."""
        count = worlds.ranks.shape[1]
        self.scenes.mesh[mask, :count] = self.meshes[worlds.ranks[mask]]
        self.scenes.colors[mask] = worlds.colors[mask]
        if self.furnished:
            x, y, angle = worlds.furniture[mask].transpose(2, 0, 1)
            self.scenes.position[mask, count:] = np.stack([x, y, np.zeros_like(x)], -1)
            cos, sin = np.cos(angle), np.sin(angle)
            rotation = np.zeros((*angle.shape, 3, 3))
            rotation[..., 0, 0] = rotation[..., 1, 1] = cos
            rotation[..., 0, 1], rotation[..., 1, 0] = -sin, sin
            rotation[..., 2, 2] = 1
            self.scenes.rotation[mask, count:] = rotation

    def draw(
        self, worlds: PlayroomVectorEnv, out: NDArray[np.uint8], mask: NDArray[np.bool_]
    ) -> None:
        """Writes the images of the worlds of `mask` to their rows of `out`."""
        self._update(worlds, mask)
        self.renderer.render(self.scenes, out, mask)

    def frames(self, worlds: PlayroomVectorEnv, texts: list[str]) -> tuple[NDArray[np.uint8], ...]:
        """Larger images with the instruction below, uint8 [288, 384, 3]."""
        height, width = _FRAME
        images = np.zeros((len(texts), height, width, 3), np.uint8)
        everywhere = np.ones(len(texts), np.bool_)
        self._update(worlds, everywhere)
        _large_renderer().render(self.scenes, images, everywhere)
        return tuple(_captioned(image, text) for image, text in zip(images, texts, strict=True))

    def _update(self, worlds: PlayroomVectorEnv, mask: NDArray[np.bool_]) -> None:
        _pose(
            mask,
            worlds.agents,
            worlds.items,
            worlds.orientation,
            worlds.ranks,
            worlds.extents,
            self.scenes.camera,
            self.scenes.position,
            self.scenes.rotation,
        )


def _build_room(scenes: Scenes, world: int) -> None:
    """Four walls that differ a little, so that one can tell where one looks."""
    half = kernels.ROOM / 2
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    papers = ("wallpaper", "wallpaper_blue", "stripes", "stripes_green")
    for k, paper in enumerate(papers):
        scenes.add_wall(
            world,
            (*corners[k], *corners[(k + 1) % 4]),
            (0.0, kernels.CEILING),
            textures.index(paper),
            repeat=(1.0, 1.0),
        )
    square = (-half, -half, half, half)
    scenes.add_flat(world, square, 0.0, textures.index("planks"), repeat=1.0)
    scenes.add_flat(
        world, square, kernels.CEILING, textures.index("ceiling"), flags=FACES_DOWN, repeat=2.0
    )


@compiled()
def _pose(mask, agents, items, orientation, ranks, extents, camera, position, rotation):
    """Writes camera and objects of the worlds of `mask` into their scenes."""
    for i in range(mask.size):
        if not mask[i]:
            continue
        camera[i, 0], camera[i, 1] = agents[i, kernels.AX], agents[i, kernels.AY]
        camera[i, 2] = kernels.EYE
        camera[i, 3], camera[i, 4] = agents[i, kernels.YAW], agents[i, kernels.PITCH]
        for j in range(ranks.shape[1]):
            frame = orientation[i, j]
            half = extents[ranks[i, j], 2] / 2
            # Objects turn about their middles.
            position[i, j, 0] = items[i, j, kernels.X] - half * frame[0, 2]
            position[i, j, 1] = items[i, j, kernels.Y] - half * frame[1, 2]
            position[i, j, 2] = items[i, j, kernels.Z] + half - half * frame[2, 2]
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
