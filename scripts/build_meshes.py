"""Build every mesh of the playroom and write zipf/envs/render3d/meshes.npz.

    python scripts/build_meshes.py

The same code gives the same bytes. Prints a table of what was built.
"""

from pathlib import Path

import numpy as np
from meshes import furniture, toys_first, toys_second
from meshes.shapes import Mesh

TARGET = Path(__file__).parent.parent / "zipf" / "envs" / "render3d" / "meshes.npz"


def build() -> dict[str, Mesh]:
    """Every mesh by name: the toys from rank 1 to 50, then the furniture."""
    makers = toys_first.TOYS | toys_second.TOYS | furniture.FURNITURE
    return {name: make() for name, make in makers.items()}


def pack(meshes: dict[str, Mesh]) -> dict[str, np.ndarray]:
    """The atlas's arrays, by the names that `MeshAtlas` gives them."""
    built = list(meshes.values())
    first_vertex = np.cumsum([0] + [len(mesh.vertices) for mesh in built])
    first_triangle = np.cumsum([0] + [len(mesh.triangles) for mesh in built])
    return {
        "names": np.array(list(meshes)),
        "vertices": np.concatenate([mesh.vertices for mesh in built]),
        "triangles": np.concatenate(
            [
                mesh.triangles + np.int32(start)
                for mesh, start in zip(built, first_vertex, strict=False)
            ]
        ),
        "parts": np.concatenate([mesh.parts for mesh in built]),
        "first_vertex": first_vertex.astype(np.int32),
        "first_triangle": first_triangle.astype(np.int32),
        "extent": np.array([mesh.extent for mesh in built], dtype=np.float32),
    }


def main() -> None:
    meshes = build()
    np.savez(TARGET, **pack(meshes))  # type: ignore[arg-type]
    print(f"{'name':<12}{'triangles':>10}   extent x, y, z (m)")
    for name, mesh in meshes.items():
        x, y, z = mesh.extent
        print(f"{name:<12}{len(mesh.triangles):>10}   {x:.3f} {y:.3f} {z:.3f}")
    print(f"wrote {TARGET.name}: {len(meshes)} meshes, {TARGET.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
