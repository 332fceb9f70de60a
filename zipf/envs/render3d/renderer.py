"""Draws batches of first-person views."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from zipf.envs.render3d.assets import FIXED_COLOURS, prepare_meshes
from zipf.envs.render3d.drawing import draw
from zipf.envs.render3d.lanes import LANES
from zipf.envs.render3d.meshes import MeshAtlas
from zipf.envs.render3d.scene import Scenes
from zipf.envs.render3d.terrain import terrain_buffers
from zipf.envs.render3d.textures import SIZE


class Renderer:
    """Draws the views of the cameras of `Scenes`.

    The pixels of a scene do not depend on the other envs or the mask. Raises ValueError for sizes
    below 1, a field of view outside 1 .. 170 and textures that are not packed.

    Args:
        meshes: the atlas that the scenes' instances index.
        textures: what `pack_textures` has made of them; several renderers may share it.
        width, height: of the images, in pixels.
        fov: the horizontal field of view, in degrees.
    """

    def __init__(
        self,
        meshes: MeshAtlas,
        textures: NDArray[np.uint32],
        *,
        width: int = 96,
        height: int = 72,
        fov: float = 90.0,
    ) -> None:
        for name, value in (("width", width), ("height", height)):
            if value < 1:
                raise ValueError(f"{name} must be 1 or more, not {value}")
        if not 1 <= fov <= 170:
            raise ValueError(f"fov must be from 1 to 170 degrees, not {fov}")
        if textures.dtype != np.uint32 or textures.shape[1:] != (2 * SIZE * SIZE,):
            raise ValueError(
                f"textures must be packed by pack_textures, not {textures.dtype} {textures.shape}"
            )
        self.width = width
        self.height = height
        focal = width / 2 / math.tan(math.radians(fov) / 2)
        tilts = np.arctan(((height - 1) / 2 - np.arange(height)) / focal)
        # Plain tuples with the fields of `arrays.Assets`, `Lens` and `Buffers`.
        self._assets = (textures, prepare_meshes(meshes), FIXED_COLOURS)
        self._lens = (focal, tilts)
        self._most_vertices = int(np.diff(meshes.first_vertex).max(initial=0))
        self._most_triangles = int(np.diff(meshes.first_triangle).max(initial=0))
        self._sizes = ((0, 0), (0, 0))
        self._buffers = self._allocate()

    def render(
        self, scenes: Scenes, out: NDArray[np.uint8], mask: NDArray[np.bool_] | None = None
    ) -> None:
        """Writes the views to `out`, uint8 [N, height, width, 3], C-contiguous, but for the envs
        that are not in `mask`, bool [N]. The textures in `tiles` must exist; this is not checked.
        Raises ValueError for an `out` or a `mask` of another shape, dtype or layout, and for scenes
        with textures or meshes that do not exist.
        """
        n = scenes.num_envs
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

        _, rows, columns = scenes.heights.shape
        sizes = (scenes.solid.shape[1:], (rows - 1, columns - 1))
        if sizes != self._sizes:
            self._sizes = sizes
            self._buffers = self._allocate()
        wrong = draw(mask, scenes.fields(), self._assets, self._lens, self._buffers, out)
        if wrong >= 0:
            texels, meshes, _ = self._assets
            raise ValueError(
                f"env {wrong} shows a texture from {len(texels)} on, a mesh from "
                f"{len(meshes[-1])} on, or a screen without Scenes(screen=...)"
            )

    def _allocate(self) -> tuple[Any, ...]:
        """The fields of `arrays.Buffers`."""
        height, stride = self.height, -(-self.width // LANES) * LANES + LANES
        (rows, columns), terrain = self._sizes
        return (
            (np.zeros((height, stride), np.uint32), np.zeros((height, stride), np.float32)),
            (np.zeros((3, 3)), np.zeros((len(FIXED_COLOURS) + 2, 3), np.float32)),
            (np.zeros(height, np.float32), np.zeros(height, np.float32)),
            (
                np.zeros((6, self._most_vertices + LANES), np.float32),
                np.zeros(self._most_triangles + LANES, np.float32),
                np.zeros(3 * self._most_triangles + LANES, np.float32),
                np.zeros(self._most_triangles + 1, np.int32),
                np.zeros(self._most_triangles + LANES, np.int32),
                np.zeros(self._most_triangles + LANES, np.float32),
                np.zeros((3, 4), np.float32),
                np.zeros((6, 3), np.float32),
                np.zeros((3, 4), np.float32),
            ),
            (np.zeros(rows * columns * 4, np.bool_), np.zeros((4, rows * columns + 2))),
            terrain_buffers(*terrain),
        )
