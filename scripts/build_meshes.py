"""Build every mesh of the playroom and of the labyrinth, and write the two atlases:
zipf/envs/render3d/meshes.npz and zipf/envs/labyrinth/meshes.npz.

    python scripts/build_meshes.py

The same code gives the same bytes. Prints a table of what was built.
"""

import argparse
from pathlib import Path

import numpy as np
from meshes import furniture, labyrinth, toys
from meshes.shapes import Mesh

ENVS = Path(__file__).parent.parent / "zipf" / "envs"


def build() -> dict[str, Mesh]:
    """Every mesh by name: the toys from rank 1 to 50, then the furniture."""
    makers = toys.TOYS | furniture.FURNITURE
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


ATLASES = {
    ENVS / "render3d" / "meshes.npz": build,
    ENVS / "labyrinth" / "meshes.npz": labyrinth.build,
}
"""The files, and what builds the meshes in them."""


def main() -> None:
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    for target, make in ATLASES.items():
        meshes = make()
        np.savez(target, **pack(meshes))  # type: ignore[arg-type]
        print(f"{'name':<16}{'triangles':>10}   extent x, y, z (m)")
        for name, mesh in meshes.items():
            x, y, z = mesh.extent
            print(f"{name:<16}{len(mesh.triangles):>10}   {x:.3f} {y:.3f} {z:.3f}")
        size = target.stat().st_size / 1024
        print(f"wrote {target.relative_to(ENVS)}: {len(meshes)} meshes, {size:.0f} KiB")


if __name__ == "__main__":
    main()
