"""The scenes of a batch of envs, as arrays that environments write in place.

Metres; x east, y north, z up. Yaw 0 looks along +x and grows counter-clockwise, positive pitch
looks up; both are in radians.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from zipf.envs.render3d.optics import UNIT_SUN

TWO_SIDED = 1  # a wall or flat that is visible from both sides
SEE_THROUGH = 2  # a wall whose texels with an alpha below 128 are holes
FACES_DOWN = 4  # a flat that is visible from below: a ceiling
GROUNDED = 8  # a wall that stands on a floor, where it is dark at its foot
EAST, NORTH, WEST, SOUTH = 16, 32, 64, 128
"""Flats with a wall at this side, where they are dark."""
TILE_TEXTURE, TILE_SIDES = 2047, 7
"""A tile is a texture, with the flags EAST .. SOUTH that hold for it so many bits higher."""
SCREEN = -2  # the texture of a wall that shows its env's `Scenes.screen`


class Scenes:
    """The scenes of N envs, each with a fixed capacity; arrays are C-contiguous.

    A wall is an upright rectangle above the line from (x0, y0) to (x1, y1). It is visible from the
    left of that direction, so the walls of a room are listed counter-clockwise. From there its
    texture is upright and not mirrored, starting at the top left. A flat is a horizontal rectangle,
    visible from above or, with FACES_DOWN, from below. Its texture starts at (x0, y0), with columns
    along x and rows along y.

    Arrays (initial values are zero unless given):

    - `camera` float32 [N, 5]: x, y, z, yaw, pitch
    - `walls` float32 [N, W, 6]: x0, y0, x1, y1, z0 (bottom), z1 (top)
    - `wall_looks` int32 [N, W, 2]: texture (negative: not drawn; or SCREEN), flags
    - `wall_repeat` float32 [N, W]: metres per repeat of the texture; 0: it is stretched over the
      wall once
    - `wall_tint` uint8 [N, W, 3]: the texture is multiplied by tint / 255 (initially 255)
    - `wall_face` int32 [N, W]: the face of a cell of `solid` that the wall lies on, or -1
      (initially). The face (row * columns + column) * 4 + side, with sides 0 east, 1 north,
      2 west, 3 south. Walls on a face are drawn only if the grid does not hide it
    - `wall_count` int32 [N]: how many walls there are; the rest of the arrays is ignored
    - `flats` float32 [N, F, 5]: x0, y0, x1, y1, z
    - `flat_looks` int32 [N, F, 2]: texture (negative: not drawn), flags
    - `flat_tiles` int32 [N, F, 2]: rows, columns. If rows is positive, the flat is a patchwork of
      rows * columns equal tiles and its own texture is ignored: `tiles[row * columns + column]` is
      the texture of a tile, with rows along y and columns along x
    - `flat_repeat` float32 [N, F]: metres per repeat; 0: once over the flat, or over each tile
    - `flat_tint` uint8 [N, F, 3]
    - `flat_count` int32 [N]
    - `tiles` int16 [N, tile_cells]: textures of tiles (negative: a hole), see TILE_SIDES
    - `mesh` int32 [N, M]: index into the atlas; -1 (initially): nothing
    - `position` float32 [N, M, 3]; `rotation` float32 [N, M, 3, 3] (initially the identity);
      `scale` float32 [N, M] (initially 1): env = rotation @ (scale * vertex) + position
    - `colours` uint8 [N, M, 2, 3]: main and accent colour
    - `pattern` int32 [N, M]: negative (initially): parts of the mesh are in its main or its accent
      colour; else a texture, laid on these parts in the mesh's own coordinates along the axis that
      a triangle faces most. It repeats after `optics.PATTERN` metres; its middle is at x = 0 and
      y = 0, its first row or column at z = 0. Its red channel is the share of the accent colour
    - `shadows` float32 [N, S, 8]: x, y, z of the middle, angle, half length, half width, softness
      and darkness of horizontal rectangles with soft corners. Whatever is at the height z, within 5
      mm, and seen from above loses the share `darkness` of its light (0, initially: there is no
      shadow) in the rectangle and a share that falls to 0 within `softness` metres around it
    - `sun` float32 [N, 3]: a unit vector, the direction of the light on walls, flats, meshes and
      terrain (initially `optics.SUN`)
    - `lamp` float32 [N, 3]: shares of red, green and blue of that light, 0 .. 1 (initially 1)
    - `sky` uint8 [N, 2, 3]: colours at the horizon and overhead
    - `screen` uint8 [N, h, w, 4]: the image, RGBA, on walls whose texture is SCREEN, stretched over
      the wall once and not shaded; its alpha is ignored
    - `overlays` float32 [N, K, 4]: left, top, right, bottom of rectangles drawn over the view, in
      order, as shares of the image's width and height from its top left corner
    - `overlay_colours` uint8 [N, K, 4]: RGBA
    - `overlay_count` int32 [N]
    - `solid` bool [N, rows, columns]: cells that block the view at any height. Everything outside
      the grid counts as solid. From a camera in a solid cell no wall is hidden
    - `grid` float32 [N, 3]: x, y of the grid's south-west corner and the size of a cell; a size
      of 0 (initially): there is no grid
    - `heights` float32 [N, rows + 1, columns + 1]: of a terrain, at the corners of its cells, with
      rows along y and columns along x. A cell is two triangles that share the line from its
      south-west to its north-east corner, shaded by their slopes and visible from above only
    - `terrain` float32 [N, 4]: x, y of its south-west corner; the size of a cell, 0 (initially):
      there is no terrain; metres per repeat of its texture
    - `terrain_texture` int32 [N]
    - `terrain_tint` uint8 [N, 3]

    Args:
        num_envs: N.
        walls, flats, instances, tile_cells, overlays, shadows: the capacity of each env.
        grid, terrain: rows and columns of cells.
        screen: height and width.

    Raises:
        ValueError: for a terrain that has rows and no columns, or the reverse.
    """

    def __init__(
        self,
        num_envs: int,
        *,
        walls: int = 0,
        flats: int = 0,
        instances: int = 0,
        tile_cells: int = 0,
        grid: tuple[int, int] = (0, 0),
        screen: tuple[int, int] = (0, 0),
        overlays: int = 0,
        terrain: tuple[int, int] = (0, 0),
        shadows: int = 0,
    ) -> None:
        if min(terrain) < 0 or (min(terrain) == 0) != (max(terrain) == 0):
            raise ValueError(f"terrain must be rows and columns of 1 or more, not {terrain}")
        n = num_envs
        self.num_envs = n
        self.camera = np.zeros((n, 5), np.float32)
        self.walls = np.zeros((n, walls, 6), np.float32)
        self.wall_looks = np.full((n, walls, 2), (-1, 0), np.int32)
        self.wall_repeat = np.zeros((n, walls), np.float32)
        self.wall_tint = np.full((n, walls, 3), 255, np.uint8)
        self.wall_face = np.full((n, walls), -1, np.int32)
        self.wall_count = np.zeros(n, np.int32)
        self.flats = np.zeros((n, flats, 5), np.float32)
        self.flat_looks = np.full((n, flats, 2), (-1, 0), np.int32)
        self.flat_tiles = np.zeros((n, flats, 2), np.int32)
        self.flat_repeat = np.zeros((n, flats), np.float32)
        self.flat_tint = np.full((n, flats, 3), 255, np.uint8)
        self.flat_count = np.zeros(n, np.int32)
        self.tiles = np.full((n, tile_cells), -1, np.int16)
        self.mesh = np.full((n, instances), -1, np.int32)
        self.position = np.zeros((n, instances, 3), np.float32)
        self.rotation = np.tile(np.eye(3, dtype=np.float32), (n, instances, 1, 1))
        self.scale = np.ones((n, instances), np.float32)
        self.colours = np.full((n, instances, 2, 3), 200, np.uint8)
        self.pattern = np.full((n, instances), -1, np.int32)
        self.shadows = np.zeros((n, shadows, 8), np.float32)
        self.sun = np.full((n, 3), UNIT_SUN, np.float32)
        self.lamp = np.ones((n, 3), np.float32)
        self.sky = np.full((n, 2, 3), [(190, 215, 235), (95, 150, 215)], np.uint8)
        self.screen = np.zeros((n, *screen, 4), np.uint8)
        self.overlays = np.zeros((n, overlays, 4), np.float32)
        self.overlay_colours = np.zeros((n, overlays, 4), np.uint8)
        self.overlay_count = np.zeros(n, np.int32)
        self.solid = np.zeros((n, *grid), np.bool_)
        self.grid = np.zeros((n, 3), np.float32)
        self.heights = np.zeros((n, terrain[0] + 1, terrain[1] + 1), np.float32)
        self.terrain = np.zeros((n, 4), np.float32)
        self.terrain_texture = np.zeros(n, np.int32)
        self.terrain_tint = np.full((n, 3), 255, np.uint8)

    def fields(self) -> tuple[Any, ...]:
        """The arrays as plain tuples, in the order of the fields of `arrays.SceneArrays`."""
        return (
            self.camera,
            self.sky,
            self.sun,
            self.lamp,
            self.shadows,
            self.screen,
            self.solid,
            self.grid,
            (self.walls, self.wall_looks, self.wall_repeat, self.wall_tint, self.wall_face,
             self.wall_count),
            (self.flats, self.flat_looks, self.flat_tiles, self.flat_repeat, self.flat_tint,
             self.flat_count, self.tiles),
            (self.mesh, self.position, self.rotation, self.scale, self.colours, self.pattern),
            (self.heights, self.terrain, self.terrain_texture, self.terrain_tint),
            (self.overlays, self.overlay_colours, self.overlay_count),
        )  # fmt: skip

    def add_walls(
        self,
        i: int,
        ends: ArrayLike,
        heights: ArrayLike,
        textures: ArrayLike,
        *,
        flags: int = 0,
        repeat: float = 0.0,
        tint: ArrayLike = 255,
        faces: ArrayLike = -1,
    ) -> int:
        """Adds a wall, or several, and returns the first one's index.

        Args:
            ends: x0, y0, x1, y1, [4] or [walls, 4].
            heights: bottom and top.
            textures, faces: of each wall, [walls], or one for all.

        Raises ValueError if there is no room for so many walls in the env.
        """
        lines = np.atleast_2d(np.asarray(ends))
        first = _take(self.wall_count, i, len(lines), self.walls.shape[1], "walls")
        rows = np.s_[i, first : first + len(lines)]
        self.walls[rows][:, :4] = lines
        self.walls[rows][:, 4:] = heights
        self.wall_looks[rows][:, 0] = textures
        self.wall_looks[rows][:, 1] = flags
        self.wall_repeat[rows] = repeat
        self.wall_tint[rows] = tint
        self.wall_face[rows] = faces
        return first

    def add_flat(
        self,
        i: int,
        rectangle: ArrayLike,
        height: float,
        texture: int,
        *,
        flags: int = 0,
        repeat: float = 0.0,
        tint: ArrayLike = 255,
        tiles: NDArray[np.integer] | None = None,
    ) -> int:
        """Adds a flat over `rectangle` (x0, y0, x1, y1) and returns its index.

        `tiles` [rows, columns] makes it a patchwork, written to `tiles[i]`.
        Raises ValueError if the env's flats or tiles are at their capacity.
        """
        index = _take(self.flat_count, i, 1, self.flats.shape[1], "flats")
        self.flats[i, index, :4] = rectangle
        self.flats[i, index, 4] = height
        self.flat_looks[i, index] = texture, flags
        self.flat_repeat[i, index] = repeat
        self.flat_tint[i, index] = tint
        self.flat_tiles[i, index] = 0
        if tiles is not None:
            if tiles.size > self.tiles.shape[1]:
                raise ValueError(
                    f"{tiles.size} tiles in an env with room for {self.tiles.shape[1]}"
                )
            self.tiles[i, : tiles.size] = tiles.reshape(-1)
            self.flat_tiles[i, index] = tiles.shape
        return index

    def set_terrain(
        self,
        i: int,
        corner: tuple[float, float],
        size: float,
        heights: NDArray[np.floating],
        texture: int,
        *,
        repeat: float,
        tint: ArrayLike = 255,
    ) -> None:
        """Sets an env's terrain, whose cells have this size and whose south-west corner this x, y,
        metres.

        `heights` are [rows + 1, columns + 1], metres; for the rest see `terrain` and
        `terrain_tint`. Raises ValueError for heights of another shape, and a size or `repeat` that
        is not positive.
        """
        if heights.shape != self.heights.shape[1:]:
            raise ValueError(f"heights must be {self.heights.shape[1:]}, not {heights.shape}")
        if size <= 0 or repeat <= 0:
            raise ValueError(f"size and repeat must be positive, not {size} and {repeat}")
        self.heights[i] = heights
        self.terrain[i] = *corner, size, repeat
        self.terrain_texture[i] = texture
        self.terrain_tint[i] = tint


def _take(counts: NDArray[np.int32], i: int, number: int, capacity: int, kind: str) -> int:
    """The next free index of an env, with `number` taken."""
    index = int(counts[i])
    if index + number > capacity:
        raise ValueError(f"env {i} has room for {capacity} {kind}")
    counts[i] += number
    return index
