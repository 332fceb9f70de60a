"""Atlases of meshes, which `python scripts/build_meshes.py` builds."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np


@dataclass(frozen=True, eq=False)
class MeshAtlas:
    """Meshes in shared arrays, of which mesh i owns a half-open range each.

    A mesh is in metres, z up, facing +x, with its origin at the centre of its footprint and its
    lowest point at z = 0. It consists of closed surfaces, which may intersect.
    """

    names: tuple[str, ...]  # of each mesh
    vertices: np.ndarray  # float32 [V, 3], metres
    triangles: np.ndarray
    """int32 [T, 3]: indices into `vertices`, counter-clockwise seen from outside."""
    parts: np.ndarray
    """uint8 [T]: 0 the instance's main and 1 its accent colour; the fixed 2 dark, 3 light, 4 wood
    and 5 green."""
    first_vertex: np.ndarray
    """int32 [meshes + 1]: mesh i owns the vertices first_vertex[i] : first_vertex[i + 1]."""
    first_triangle: np.ndarray  # int32 [meshes + 1]: likewise for `triangles` and `parts`
    extent: np.ndarray  # float32 [meshes, 3]: size of the bounding box along x, y and z, metres

    def index(self, name: str) -> int:
        """The number of the mesh of that name. Raises KeyError for an unknown name."""
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(f"no mesh {name!r}; there are {', '.join(self.names)}") from None


def load_meshes(path: Path | None = None) -> MeshAtlas:
    """An atlas: a file that the script wrote (None: the 50 toys by rank, then the bed and the
    tray), loaded once. Arrays are read-only. Raises FileNotFoundError if there is no such file."""
    return _load(path or Path(__file__).with_name("meshes.npz"))


@cache
def _load(path: Path) -> MeshAtlas:
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    names = tuple(str(name) for name in arrays.pop("names"))
    for array in arrays.values():
        array.flags.writeable = False
    return MeshAtlas(names, **arrays)
