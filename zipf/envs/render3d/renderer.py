"""Draws batches of first-person views."""

import math
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.render3d import kernels
from zipf.envs.render3d.lanes import LANES
from zipf.envs.render3d.meshes import MeshAtlas
from zipf.envs.render3d.scene import Scenes
from zipf.envs.render3d.terrain import terrain_scratch
from zipf.envs.render3d.textures import SIZE

FIXED_COLORS = np.array(
    [(40, 40, 40), (235, 235, 235), (150, 105, 65), (70, 140, 60)], dtype=np.uint8
)
"""Of the parts of meshes from 2 on: dark, light, wood, green."""


_DRAW: Any = kernels.draw


class Renderer:
    """Draws what the cameras of `Scenes` see.

    The same scene gives the same pixels whatever the other worlds, the mask or the threads.

    Args:
        meshes: the atlas that the scenes' instances index
        textures: uint8 [K, 64, 64, 4], RGBA
        width, height: of the images, in pixels
        fov: the horizontal field of view, in degrees
        threads: how many worlds are drawn at a time

    Raises ValueError for sizes or threads below 1, a field of view outside 1 .. 170 and textures
    of another shape or dtype.
    """

    def __init__(
        self,
        meshes: MeshAtlas,
        textures: NDArray[np.uint8],
        *,
        width: int = 96,
        height: int = 72,
        fov: float = 90.0,
        threads: int = 1,
    ) -> None:
        for name, value in (("width", width), ("height", height), ("threads", threads)):
            if value < 1:
                raise ValueError(f"{name} must be 1 or more, not {value}")
        if not 1 <= fov <= 170:
            raise ValueError(f"fov must be from 1 to 170 degrees, not {fov}")
        if textures.ndim != 4 or textures.shape[1:] != (SIZE, SIZE, 4) or len(textures) == 0:
            raise ValueError(f"textures must be [K, {SIZE}, {SIZE}, 4], not {textures.shape}")
        if textures.dtype != np.uint8:
            raise ValueError(f"textures must be uint8, not {textures.dtype}")
        self.width = width
        self.height = height
        self.threads = threads
        self._meshes = _prepare(meshes)
        self._texels = pack_textures(textures)
        self._focal = width / 2 / math.tan(math.radians(fov) / 2)
        self._sizes = ((0, 0), (0, 0))
        self._scratch = [self._allocate() for _ in range(threads)]
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None

    def render(
        self, scenes: Scenes, out: NDArray[np.uint8], mask: NDArray[np.bool_] | None = None
    ) -> None:
        """Writes the views to `out`, uint8 [N, height, width, 3], C-contiguous.

        With `mask`, bool [N], only its rows are written. Raises ValueError for an `out` or a `mask`
        of another shape, dtype or layout, and for scenes with textures or meshes there are not;
        `tiles` are trusted.
        """
        n = scenes.num_worlds
        shape = (n, self.height, self.width, 3)
        if out.shape != shape or out.dtype != np.uint8 or not out.flags.c_contiguous:
            raise ValueError(
                f"out must be C-contiguous uint8 {shape}, not {out.dtype} {out.shape}"
                + ("" if out.flags.c_contiguous else " with strides")
            )
        if mask is None:
            mask = np.ones(n, np.bool_)
        elif mask.shape != (n,) or mask.dtype != np.bool_:
            raise ValueError(f"mask must be bool {(n,)}, not {mask.dtype} {mask.shape}")

        sizes = (scenes.solid.shape[1:], scenes.terrain_looks.shape[1:])
        if sizes != self._sizes:
            self._sizes = sizes
            self._scratch = [self._allocate() for _ in range(self.threads)]

        def draw(thread: int, start: int, stop: int) -> int:
            s = scenes
            return _DRAW(
                start, stop, mask, s.camera, s.walls, s.wall_looks, s.wall_repeat, s.wall_tint,
                s.wall_face, s.wall_count, s.flats, s.flat_looks, s.flat_tiles, s.flat_repeat,
                s.flat_tint, s.flat_count, s.tiles, s.mesh, s.position, s.rotation, s.scale,
                s.colors, s.sky, s.screen, s.overlays, s.overlay_colors, s.overlay_count, s.solid,
                s.grid, s.heights, s.terrain, s.terrain_looks, s.terrain_tint, self._meshes,
                FIXED_COLORS, self._texels, self._focal, *self._scratch[thread], out,
            )  # fmt: skip

        if self._pool is None:
            wrong = draw(0, 0, n)
        else:
            cuts = [n * k // self.threads for k in range(self.threads + 1)]
            jobs = [self._pool.submit(draw, k, cuts[k], cuts[k + 1]) for k in range(self.threads)]
            wrong = max(job.result() for job in jobs)
        if wrong >= 0:
            raise ValueError(
                f"world {wrong} shows a texture from {len(self._texels)} on, a mesh from "
                f"{len(self._meshes[-1])} on, or a screen without Scenes(screen=...)"
            )

    def _allocate(self) -> tuple[Any, ...]:
        stride = -(-self.width // LANES) * LANES + LANES
        vertices, triangles = (int(np.diff(ends).max(initial=0)) for ends in self._meshes[4:6])
        (rows, columns), terrain = self._sizes
        return (
            np.zeros((self.height, stride), np.uint32),
            np.zeros((self.height, stride), np.float32),
            np.arctan(((self.height - 1) / 2 - np.arange(self.height)) / self._focal),
            np.zeros(self.height, np.float32),
            np.zeros(self.height, np.float32),
            np.zeros((6, vertices + LANES), np.float32),
            np.zeros(triangles + LANES, np.float32),
            np.zeros(triangles + 1, np.int32),
            np.zeros(rows * columns * 4, np.bool_),
            np.zeros((4, rows * columns + 2)),
            terrain_scratch(*terrain),
        )


def pack_textures(textures: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Textures as lines of 128 texels 0xAABBGGRR, uint32 [K, 64 * 128].

    A line of a texture is followed by that of its half, its quarter and so on: line y of level n
    begins at texel y * 128 + 128 - (128 >> n). Colours are averages of what is not a hole.
    """
    packed = np.zeros((len(textures), SIZE, kernels.LEVEL_STRIDE), np.uint32)
    alpha = textures[..., 3:] / 255.0
    color = textures[..., :3] * alpha
    level = 0
    while True:
        size = SIZE >> level
        rgb = np.round(color / np.maximum(alpha, 1e-6)).astype(np.uint32)
        opaque = (np.round(alpha[..., 0] * 255)).astype(np.uint32)
        start = kernels.LEVEL_STRIDE - (kernels.LEVEL_STRIDE >> level)
        packed[:, :size, start : start + size] = (
            rgb[..., 0] | rgb[..., 1] << 8 | rgb[..., 2] << 16 | opaque << 24
        )
        if size == 1:
            return packed.reshape(len(textures), -1)
        color, alpha = (
            a.reshape(len(a), size // 2, 2, size // 2, 2, -1).mean((2, 4)) for a in (color, alpha)
        )
        level += 1


def _prepare(meshes: MeshAtlas) -> tuple[NDArray[Any], ...]:
    """The atlas as the kernels take it: corners by mesh, normals and planes of triangles."""
    owner = np.repeat(np.arange(len(meshes.names)), np.diff(meshes.first_triangle))
    corners = meshes.vertices[meshes.triangles].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    planes = np.concatenate([normals, (normals * corners[:, 0]).sum(1, keepdims=True)], axis=1)
    balls = np.zeros((len(meshes.names), 4), np.float32)
    for ball, first, last in zip(
        balls, meshes.first_vertex[:-1], meshes.first_vertex[1:], strict=True
    ):
        own = meshes.vertices[first:last]
        ball[:3] = (own.min(0) + own.max(0)) / 2
        ball[3] = np.linalg.norm(own - ball[:3], axis=1).max()
    local = meshes.triangles - meshes.first_vertex[owner][:, None]
    return (
        _lines(meshes.vertices),
        np.ascontiguousarray(local, np.int32),
        _lines(planes),
        np.ascontiguousarray(meshes.parts, np.uint8),
        np.ascontiguousarray(meshes.first_vertex, np.int32),
        np.ascontiguousarray(meshes.first_triangle, np.int32),
        balls,
    )


def _lines(rows: NDArray[Any]) -> NDArray[np.float32]:
    """The columns of `rows` as lines, with a block to spare at their ends."""
    lines = np.zeros((rows.shape[1], len(rows) + LANES), np.float32)
    lines[:, : len(rows)] = rows.T
    return lines
