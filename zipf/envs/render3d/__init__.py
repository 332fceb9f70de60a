"""A software renderer of small first-person views, for whole batches of envs at once."""

from zipf.envs.render3d import textures
from zipf.envs.render3d.assets import pack_textures
from zipf.envs.render3d.meshes import MeshAtlas, load_meshes
from zipf.envs.render3d.renderer import Renderer
from zipf.envs.render3d.scene import (
    EAST,
    FACES_DOWN,
    GROUNDED,
    NORTH,
    SCREEN,
    SEE_THROUGH,
    SOUTH,
    TILE_SIDES,
    TILE_TEXTURE,
    TWO_SIDED,
    WEST,
    Scenes,
)

__all__ = [
    "EAST", "FACES_DOWN", "GROUNDED", "NORTH", "SCREEN", "SEE_THROUGH", "SOUTH", "TILE_SIDES",
    "TILE_TEXTURE", "TWO_SIDED", "WEST", "MeshAtlas", "Renderer", "Scenes", "load_meshes",
    "pack_textures", "textures",
]  # fmt: skip
