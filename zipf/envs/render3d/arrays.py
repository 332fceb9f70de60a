"""The arrays that the compiled functions of the renderer work on, in groups.

Numba unpacks plain tuples of arrays in half the time that named ones take, which matters when few
envs are drawn at a time. So `drawing.draw` is called with plain tuples, in the order of the
fields here, and `named_scenes` and the like name them in compiled code, at no cost.
"""

from typing import Any, NamedTuple

from zipf.compiled import compiled


class Walls(NamedTuple):
    """See `Scenes`."""

    places: Any
    looks: Any
    repeat: Any
    tint: Any
    face: Any
    count: Any


class Flats(NamedTuple):
    """See `Scenes`."""

    places: Any
    looks: Any
    tiling: Any
    repeat: Any
    tint: Any
    count: Any
    tiles: Any


class Instances(NamedTuple):
    """See `Scenes`."""

    mesh: Any
    position: Any
    rotation: Any
    scale: Any
    colours: Any
    pattern: Any


class Terrains(NamedTuple):
    """See `Scenes`."""

    heights: Any
    place: Any
    texture: Any
    tint: Any


class Overlays(NamedTuple):
    """See `Scenes`."""

    places: Any
    colours: Any
    count: Any


class SceneArrays(NamedTuple):
    """All arrays of `Scenes`."""

    camera: Any
    sky: Any
    sun: Any
    lamp: Any
    shadows: Any
    screen: Any
    solid: Any
    grid: Any
    walls: Walls
    flats: Flats
    instances: Instances
    terrains: Terrains
    overlays: Overlays


class Meshes(NamedTuple):
    """A `MeshAtlas` as `prepare_meshes` lays it out. Lines end with LANES unused numbers."""

    vertices: Any  # float32 [3, V + LANES]: lines x, y, z
    triangles: Any  # int32 [T, 3]: vertices, counted from the first of their mesh
    planes: Any
    """float32 [4, T + LANES]: unit normals, and their products with a point of the plane."""
    corners: Any
    """float32 [4, 3 T + LANES]: unit normals at the corners of triangles, and -1."""
    smooth: Any  # uint8 [T]: whether the normals at a triangle's corners are not its own
    parts: Any  # uint8 [T]: which colour
    first_vertex: Any  # int32 [meshes + 1]
    first_triangle: Any  # int32 [meshes + 1]
    balls: Any  # float32 [meshes, 4]: centre and radius of a ball that contains the mesh


class Assets(NamedTuple):
    """Textures and meshes, the same for all envs."""

    texels: Any  # uint32 [K, 2 * 128 * 128], see `pack_textures`
    meshes: Meshes
    fixed_colours: Any
    """uint8 [4, 3]: of the parts of meshes from 2 on."""


class ImageBuffers(NamedTuple):
    """An image in the making. Lines end with LANES unused pixels."""

    colour: Any  # uint32 [H, stride]: 0x00BBGGRR
    depth: Any  # float32 [H, stride]: 1/t, 0 where nothing has been drawn


class EnvBuffers(NamedTuple):
    """Written by `draw`."""

    frame: Any  # float64 [3, 3]: see `Projection`
    palette: Any  # float32 [6, 3]: colours of the parts of a mesh in the light of the lamp


class SpanBuffers(NamedTuple):
    """Written by `draw_wall` and `draw_flat`."""

    low: Any
    high: Any
    """float32 [H]: the first and last column of the surface in each row."""


class MeshBuffers(NamedTuple):
    """Written by `draw_instance`, for meshes of up to V vertices and T triangles."""

    seen: Any  # float32 [6, V + LANES]: vertices as `vertex_block` writes them
    lit: Any  # float32 [T + LANES]: light on the triangles, 0 on those that face away
    corner_lit: Any  # float32 [3 T + LANES]: light on the corners of triangles
    front: Any  # int32 [T + 1]: the triangles that face the eye
    axis: Any
    """int32 [T + LANES]: with a pattern, the axis that a triangle faces most: 0 x, 1 y, 2 z."""
    area: Any  # float32 [T + LANES]: with a pattern, texels in a pixel divided by depth**3
    matrix: Any  # float32 [3, 4]: takes vertices to the eye's frame
    vectors: Any  # float32 [6, 3]: points and directions in the eye's and the mesh's frames
    corners: Any  # float32 [3, 4]: see `draw_cut_triangle`


class GridBuffers(NamedTuple):
    """Written by `look_around`."""

    faces: Any  # bool [rows * columns * 4]: the faces of cells that are visible
    spans: Any  # float64 [4, rows * columns + 2]


class TerrainBuffers(NamedTuple):
    """Written by `draw_terrain`, for terrains of R x C cells; W is C + 1 + LANES."""

    line: Any  # float32 [3, W]: columns' numbers, zeros, and the heights of one line of corners
    seen: Any  # float32 [6, 2 W]: two lines of corners as `vertex_block` writes them
    kinds: Any  # int32 [C + LANES]: of the cells of a row, as `cell_block` writes them
    shown: Any  # int32 [C + 1]: the columns of cells that may be visible
    light: Any  # float32 [2 R C]: light on each triangle
    area: Any  # float32 [2 R C]: texels in a pixel, divided by depth**3, of each triangle
    corners: Any  # float32 [3, 4]: see `draw_cut_triangle`


class Buffers(NamedTuple):
    """Scratch arrays for drawing one env; every thread has its own."""

    image: ImageBuffers
    env: EnvBuffers
    span: SpanBuffers
    mesh: MeshBuffers
    grid: GridBuffers
    terrain: TerrainBuffers


class Lens(NamedTuple):
    """The projection of a renderer, the same for all envs."""

    focal: Any  # focal length in pixels
    tilts: Any  # float64 [H]: angles of the image's rows above the middle of the view, radians


class View(NamedTuple):
    """The camera of one env, as float64 numbers; see `drawing.py` for the equations."""

    x: Any
    y: Any
    z: Any
    """Position of the eye."""
    hx: Any
    hy: Any
    """Heading."""
    c0: Any
    dc: Any
    """c in the first row, and its step per row."""
    rise0: Any
    drise: Any
    """Rise in the first row, and its step per row."""
    a0: Any
    da: Any
    """a in the first column, and its step per column."""


class Sector(NamedTuple):
    """The directions that a view can show, seen from above."""

    narrow: Any  # whether they span less than half a turn; if not, the rest is meaningless
    left_x: Any
    left_y: Any
    right_x: Any
    right_y: Any
    """The outermost directions."""


class Projection(NamedTuple):
    """Where the points of triangles appear in the image of one env."""

    frame: Any  # float64 [3, 3]: right, up and forward, as rows
    focal: Any
    middle_x: Any
    middle_y: Any
    """float32, pixels."""
    slant_x: Any
    slant_y: Any
    """Sine and cosine of half the field of view, sideways and upwards."""


class Canvas(NamedTuple):
    """The colour and depth buffers, as `draw_triangle` uses them."""

    width: Any
    height: Any
    stride: Any
    """Pixels in a line of the buffers."""
    colour: Any
    depth: Any
    """Addresses."""


@compiled(references=False)
def named_scenes(fields):
    """`SceneArrays` of plain tuples."""
    (
        camera, sky, sun, lamp, shadows, screen, solid, grid, walls, flats, instances, terrains,
        overlays,
    ) = fields  # fmt: skip
    return SceneArrays(
        camera, sky, sun, lamp, shadows, screen, solid, grid, Walls(*walls), Flats(*flats),
        Instances(*instances), Terrains(*terrains), Overlays(*overlays),
    )  # fmt: skip


@compiled(references=False)
def named_assets(fields):
    """`Assets` of plain tuples."""
    texels, meshes, fixed_colours = fields
    return Assets(texels, Meshes(*meshes), fixed_colours)


@compiled(references=False)
def named_buffers(fields):
    """`Buffers` of plain tuples."""
    image, env, span, mesh, grid, terrain = fields
    return Buffers(
        ImageBuffers(*image), EnvBuffers(*env), SpanBuffers(*span), MeshBuffers(*mesh),
        GridBuffers(*grid), TerrainBuffers(*terrain),
    )  # fmt: skip
