"""A software renderer of small first-person views, for whole batches of envs at once."""

from zipf.envs.render3d import textures
from zipf.envs.render3d.assets import pack_textures
from zipf.envs.render3d.meshes import MeshAtlas, load_meshes
from zipf.envs.render3d.renderer import Renderer
from zipf.envs.render3d.scene import FACES_DOWN, SCREEN, SEE_THROUGH, TWO_SIDED, Scenes

__all__ = [
    "FACES_DOWN", "SCREEN", "SEE_THROUGH", "TWO_SIDED", "MeshAtlas", "Renderer", "Scenes",
    "load_meshes", "pack_textures", "textures",
]  # fmt: skip
