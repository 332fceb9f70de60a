"""An env from above, for people to watch: floors, walls, doors, items, arrows of players."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from zipf.envs.labyrinth import materials
from zipf.envs.labyrinth.gaze import gaze
from zipf.envs.labyrinth.lasertag.arena import TAGGED_AT
from zipf.envs.labyrinth.patterns import Colour
from zipf.envs.labyrinth.scenery import METRES, Scenery, atlas
from zipf.envs.labyrinth.state import CELL, ITEMS, QUADS, YAW, Envs, X, Y
from zipf.envs.render3d import FACES_DOWN, SEE_THROUGH, TILE_TEXTURE

SIZE = 288  # height and width of a map, pixels
_FINE = 2  # a map is drawn this much larger, at least, and then reduced, against jagged lines
_NOTHING = (36, 40, 50)
_SOLID = (62, 68, 82)
_MARGIN = 0.05
_LEAST = 0.015  # radius of an item, as a share of the map


def draw_map(envs: Envs, scenery: Scenery, world: int, size: int = SIZE) -> NDArray[np.uint8]:
    """The map of an env, uint8 [size, size, 3], the north above.

    Platforms and hills are lighter the higher they are. Thin white outlines are zones in which
    something happens, whether they can be seen or not. Items are in their two colours. The
    player's arrow is white, those of opponents have their colour. In the place of a map, envs
    with a screen have the screen, with a ring where the player looks.
    """
    if envs.screen[world, 3] > 0:
        return _draw_screen(envs, scenery, world, size)
    page = _Page(_bounds(envs, scenery, world), size)
    if envs.quad[world] > 0:
        _draw_terrain(page, envs, scenery, world)
    _draw_floors(page, envs, scenery, world)
    _draw_walls(page, scenery, world)
    for zone in envs.zones[world]:
        if zone[0] < zone[3]:
            page.rectangle(zone[[0, 1]], zone[[3, 4]], None, outline=(255, 255, 255))
    _draw_items(page, envs, scenery, world)
    for k in range(1, int(envs.combat.fighters[world])):
        if envs.combat.status[world, k, TAGGED_AT] < 0:
            x, y, yaw = envs.combat.bodies[world, k, [X, Y, YAW]].tolist()
            colour = _colour(scenery.scenes.colours[world, ITEMS, 0])
            page.arrow(x, y, yaw, colour)
    body = envs.bodies[world]
    page.arrow(float(body[X]), float(body[Y]), float(body[YAW]))
    return page.finished()


def empty_map(size: int = SIZE) -> NDArray[np.uint8]:
    """The map of an env without an episode, uint8 [size, size, 3]."""
    return np.full((size, size, 3), _NOTHING, np.uint8)


class _Page:
    """An image that is drawn on in units of the env."""

    def __init__(self, bounds: tuple[float, float, float, float], size: int = SIZE) -> None:
        x0, y0, x1, y1 = bounds
        self.size = size
        self.fine = _finer(size)  # pixels of this page for one of a map of the usual size
        self.pixels = SIZE * self.fine
        span = max(x1 - x0, y1 - y0) * (1 + 2 * _MARGIN)
        self.scale = self.pixels / span
        self.west = (x0 + x1 - span) / 2
        self.north = (y0 + y1 + span) / 2
        self.image = Image.new("RGB", (self.pixels, self.pixels), _NOTHING)
        self.pen = ImageDraw.Draw(self.image)

    def at(self, x: float, y: float) -> tuple[float, float]:
        return (x - self.west) * self.scale, (self.north - y) * self.scale

    def grid(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """x and y of all pixels."""
        middles = (np.arange(self.pixels) + 0.5) / self.scale
        x, y = np.meshgrid(self.west + middles, self.north - middles)
        return x, y

    def paint(self, colours: NDArray[np.float64], where: NDArray[np.bool_]) -> None:
        """Sets pixels to colours, both [pixels, pixels, ...]."""
        image = np.asarray(self.image).copy()
        image[where] = np.clip(colours, 0, 255).astype(np.uint8)[where]
        self.image.paste(Image.fromarray(image))

    def rectangle(
        self,
        low: Sequence[float],
        high: Sequence[float],
        fill: Colour | None,
        outline: Colour | None = None,
    ) -> None:
        left, bottom = self.at(low[0], low[1])
        right, top = self.at(high[0], high[1])
        self.pen.rectangle((left, top, right, bottom), fill, outline, width=self.fine)

    def line(self, ends: Sequence[float], colour: Colour, width: float) -> None:
        points = self.at(ends[0], ends[1]), self.at(ends[2], ends[3])
        self.pen.line(points, colour, round(width * self.fine))

    def disc(self, x: float, y: float, radius: float, main: Colour, accent: Colour) -> None:
        left, top = self.at(x, y)
        radius = max(radius * self.scale, _LEAST * self.pixels)
        for far, colour in (
            (radius + self.fine, (20, 20, 24)),
            (radius, accent),
            (0.72 * radius, main),
        ):
            self.pen.ellipse((left - far, top - far, left + far, top + far), colour)

    def arrow(self, x: float, y: float, yaw: float, fill: Colour = (255, 255, 255)) -> None:
        left, top = self.at(x, y)
        for size, colour in ((11.0 * self.fine, (0, 0, 0)), (8.5 * self.fine, fill)):
            corners = [
                (left + far * size * math.cos(yaw + turn), top - far * size * math.sin(yaw + turn))
                for far, turn in ((1.0, 0.0), (0.85, 2.5), (0.3, math.pi), (0.85, -2.5))
            ]
            self.pen.polygon(corners, colour)

    def finished(self) -> NDArray[np.uint8]:
        return np.asarray(self.image.resize((self.size, self.size), Image.Resampling.BOX))


def _finer(size: int) -> int:
    """How much larger than `SIZE` a map of this size is drawn before it is reduced."""
    return -(-_FINE * size // SIZE)


def _bounds(envs: Envs, scenery: Scenery, world: int) -> tuple[float, float, float, float]:
    """West, south, east and north end of what there is."""
    if envs.quad[world] > 0:
        side = float(envs.quad[world]) * QUADS
        return 0.0, 0.0, side, side
    flats = _floors(scenery, world)
    low = (scenery.scenes.flats[world, flats, :2] / METRES).min(0)
    high = (scenery.scenes.flats[world, flats, 2:4] / METRES).max(0)
    if envs.cells[world, 0] > 0:  # without cells at the edge that nobody can get to
        rows, columns = envs.cells[world]
        free = np.argwhere(~envs.solid[world, :rows, :columns])
        low, high = (free.min(0) * CELL)[::-1], ((free.max(0) + 1) * CELL)[::-1]
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def _floors(scenery: Scenery, world: int) -> NDArray[np.int64]:
    """Numbers of the flats that are floors, from the lowest on."""
    scenes = scenery.scenes
    count = int(scenes.flat_count[world])
    floors = np.flatnonzero(scenes.flat_looks[world, :count, 1] & FACES_DOWN == 0)
    order: NDArray[np.int64] = floors[np.argsort(scenes.flats[world, floors, 4], kind="stable")]
    return order


def _draw_terrain(page: _Page, envs: Envs, scenery: Scenery, world: int) -> None:
    texture = int(scenery.scenes.terrain_texture[world])
    colour = _mixed(texture, scenery.scenes.terrain_tint[world])
    heights = np.ascontiguousarray(envs.heights[world])
    size = float(envs.quad[world])
    page.image.paste(_terrain(heights.tobytes(), size, tuple(colour.tolist()), page.size))


@lru_cache(maxsize=1)  # of all that is drawn it takes longest, and stays the same for an episode
def _terrain(
    bytes_of_heights: bytes, size: float, colour: tuple[float, ...], size_of_map: int
) -> Image.Image:
    heights = np.frombuffer(bytes_of_heights).reshape(QUADS + 1, QUADS + 1)
    page = _Page((0.0, 0.0, size * QUADS, size * QUADS), size_of_map)
    x, y = page.grid()
    column, row = x / size, y / size
    inside = (column >= 0) & (column < QUADS) & (row >= 0) & (row < QUADS)
    c, r = np.clip(column, 0, QUADS - 1e-6), np.clip(row, 0, QUADS - 1e-6)
    j, i = c.astype(int), r.astype(int)
    u, v = c - j, r - i
    low = heights[i, j] * (1 - u) + heights[i, j + 1] * u
    high = heights[i + 1, j] * (1 - u) + heights[i + 1, j + 1] * u
    height = low * (1 - v) + high * v
    light = 0.55 + 0.45 * (height - heights.min()) / max(float(np.ptp(heights)), 1.0)
    # Slopes that face the north-west are lit.
    slope = (np.gradient(height, axis=1) + np.gradient(height, axis=0)) * page.scale
    light *= np.clip(1 + 0.5 * slope, 0.5, 1.4)
    page.paint(light[..., None] * np.array(colour), inside)
    return page.image


def _draw_floors(page: _Page, envs: Envs, scenery: Scenery, world: int) -> None:
    scenes = scenery.scenes
    floors = _floors(scenery, world)
    z = scenes.flats[world, floors, 4]
    if scenes.grid[world, 2] > 0:
        rows, columns = envs.cells[world]
        page.rectangle((0, 0), (columns * CELL, rows * CELL), _SOLID)
    for k, height in zip(floors.tolist(), z.tolist(), strict=True):
        light = 0.4 + 0.6 * (height - z.min()) / (z.max() - z.min()) if np.ptp(z) > 0 else 1.0
        x0, y0, x1, y1 = (scenes.flats[world, k, :4] / METRES).tolist()
        rows, columns = scenes.flat_tiles[world, k].tolist()
        tint = scenes.flat_tint[world, k]
        if rows == 0:
            colour = light * _mixed(int(scenes.flat_looks[world, k, 0]), tint)
            page.rectangle((x0, y0), (x1, y1), _colour(colour))
            continue
        textures = scenes.tiles[world, : rows * columns].reshape(rows, columns)
        for row, column in np.argwhere(textures >= 0).tolist():
            corner = x0 + column * CELL, y0 + row * CELL
            colour = light * _mixed(int(textures[row, column]) & TILE_TEXTURE, tint)
            page.rectangle(corner, (corner[0] + CELL, corner[1] + CELL), _colour(colour))
    count = int(envs.plane_count[world])
    if count > 4:  # a round room's floor is cut off at its walls
        x, y = page.grid()
        planes = envs.planes[world, :count]
        along_x, along_y, offset = planes.T[:, :, None, None]
        beyond = np.any(along_x * x + along_y * y > offset, axis=0)
        page.paint(np.broadcast_to(np.array(_NOTHING, float), (*x.shape, 3)), beyond)


def _draw_walls(page: _Page, scenery: Scenery, world: int) -> None:
    scenes = scenery.scenes
    for k in range(int(scenes.wall_count[world])):
        texture, flags = scenes.wall_looks[world, k].tolist()
        ends = (scenes.walls[world, k, :4] / METRES).tolist()
        colour = _colour(_mixed(texture, scenes.wall_tint[world, k]))
        if texture == materials.index("riser"):
            page.line(ends, (16, 20, 30), 1)
        else:
            page.line(ends, colour, 5 if flags & SEE_THROUGH else 3)


def _draw_items(page: _Page, envs: Envs, scenery: Scenery, world: int) -> None:
    scenes = scenery.scenes
    there = np.flatnonzero(envs.present[world] & (scenery.shape[world] >= 0))
    extents = atlas().extent[scenery.shape[world, there], :2].max(1) / METRES
    radii = extents * scenes.scale[world, there] / 2
    for k in np.argsort(-radii, kind="stable").tolist():
        item = int(there[k])
        x, y, _ = envs.places[world, item].tolist()
        main, accent = (_colour(colour) for colour in scenes.colours[world, item])
        page.disc(x, y, float(radii[k]), main, accent)


def _mixed(texture: int, tint: NDArray[np.uint8]) -> NDArray[np.float64]:
    mixed: NDArray[np.float64] = materials.mean_colours()[texture] * tint / 255
    return mixed


def _colour(values: NDArray[np.floating] | NDArray[np.uint8]) -> Colour:
    red, green, blue = (min(max(round(float(value)), 0), 255) for value in values)
    return red, green, blue


def _draw_screen(envs: Envs, scenery: Scenery, world: int, size: int) -> NDArray[np.uint8]:
    """The screen and what surrounds it; of a gaze that is outside the nearest point is marked."""
    horizon, overhead = scenery.scenes.sky[world].astype(np.float64)
    fine = _finer(size)
    pixels = SIZE * fine
    high = np.linspace(1, 0, pixels)[:, None, None]
    sky = np.broadcast_to(horizon + (overhead - horizon) * high, (pixels, pixels, 3))
    image = Image.fromarray(sky.astype(np.uint8))
    pen = ImageDraw.Draw(image)
    side = round(pixels * 0.8)
    edge = (pixels - side) // 2
    rim = side // 16
    pen.rectangle((edge - rim, edge - rim, edge + side + rim, edge + side + rim), _SOLID)
    shown = Image.fromarray(scenery.scenes.screen[world, :, :, :3]).resize((side, side))
    image.paste(shown, (edge, edge))
    x, y = (edge + side * min(max(at, -0.11), 1.11) for at in gaze(envs, world))
    for far, colour, width in ((8 * fine, (0, 0, 0), 4), (7 * fine, (255, 255, 255), 2)):
        pen.ellipse((x - far, y - far, x + far, y + far), None, colour, width * fine)
    return np.asarray(image.resize((size, size), Image.Resampling.BOX))
