"""Slow ray casting, one surface at a time, as a reference for the renderer."""

import math
from dataclasses import replace

import numpy as np

from zipf.envs.render3d import (
    EAST,
    FACES_DOWN,
    GROUNDED,
    NORTH,
    SEE_THROUGH,
    SOUTH,
    TILE_SIDES,
    TILE_TEXTURE,
    TWO_SIDED,
    WEST,
    MeshAtlas,
    Renderer,
    Scenes,
    optics,
    textures,
)
from zipf.envs.render3d.assets import FIXED_COLOURS, pack_textures
from zipf.envs.render3d.lanes import ENLARGED
from zipf.envs.render3d.textures import SIZE

CORNERS = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0), (-1, -1, 2), (1, -1, 2), (1, 1, 2)] + [
    (-1, 1, 2)
]
SQUARES = [(0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
BOX = [t for a, b, c, d in SQUARES for t in ((a, b, c), (a, c, d))]
PEAK = [(-1, -1, 0), (1, -1, 0), (0, 1, 0), (0, 0, 2)]
SIDES = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)]
ATLAS = MeshAtlas(
    names=("box", "peak"),
    vertices=np.array(CORNERS + PEAK, np.float32) * np.float32(0.2),
    triangles=np.array(BOX + [(a + 8, b + 8, c + 8) for a, b, c in SIDES], np.int32),
    parts=np.array([0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 0, 1, 2, 3], np.uint8),
    first_vertex=np.array([0, 8, 12], np.int32),
    first_triangle=np.array([0, 12, 16], np.int32),
    extent=np.full((2, 3), 0.4, np.float32),
)
COLOURED = replace(ATLAS, parts=ATLAS.parts % 2)
"""The same meshes without parts of fixed colours."""
FENCE = len(textures.NAMES)
STACK = np.concatenate([textures.stack(), textures.stack()[:1]])
STACK[FENCE, ..., 3] = np.where(np.arange(SIZE) % 32 < 10, 255, 0)
"""All textures, and last one with holes: upright bars."""
WIDTH, HEIGHT = 64, 48


def plain(*colours):
    """A stack of textures of one colour each."""
    stack = np.full((len(colours), SIZE, SIZE, 4), 255, np.uint8)
    for image, colour in zip(stack, colours, strict=True):
        image[..., :3] = colour
    return stack


def view(scenes, stack=STACK, width=WIDTH, height=HEIGHT, atlas=ATLAS, **options):
    renderer = Renderer(atlas, pack_textures(stack), width=width, height=height, **options)
    out = np.zeros((scenes.num_envs, height, width, 3), np.uint8)
    renderer.render(scenes, out)
    return out


def sun_on(scenes, world, normal, dark, bright):
    """The light on a surface, in red, green and blue."""
    lit = dark + bright * (0.5 + 0.5 * np.asarray(normal) @ scenes.sun[world].astype(float))
    return lit * scenes.lamp[world].astype(float)


def shaded(colour, light, t):
    return colour * light / (1 + (np.asarray(t)[..., None] / optics.FADE) ** 2)


def texel(packed, texture, u, v, area):
    """The colours and alphas of a texture at texels u, v for pixels that cover `area` texels."""

    def look_up(level, column, row):
        size = SIZE >> level
        place = size * size + (row % SIZE >> level) * size + (column % SIZE >> level)
        value = packed[texture, place]
        return np.stack([value >> 8 * k & 255 for k in range(4)], -1).astype(float)

    level = np.clip(np.floor(np.log2(np.maximum(area, 2.0) / 2) / 2), 0, 7).astype(int)
    column, row = np.floor(u).astype(int), np.floor(v).astype(int)
    shown = look_up(level, column, row)
    left, top = np.floor(u - 0.5).astype(int), np.floor(v - 0.5).astype(int)
    right, below = (u - 0.5 - left)[..., None], (v - 0.5 - top)[..., None]
    first, second = (
        look_up(0, left, r) * (1 - right) + look_up(0, left + 1, r) * right for r in (top, top + 1)
    )
    enlarged = (np.broadcast_to(area, column.shape) < ENLARGED)[..., None]
    return np.where(enlarged, first * (1 - below) + second * below, shown)


def darker(distance):
    """The share of light that is left so far from where a wall meets a floor."""
    near = np.clip(1 - np.asarray(distance) / optics.STRIP, 0, None)
    return 1 - optics.STRIP_DARK * near**2


def within(distance, size):
    return (distance >= -optics.GROW) & (distance <= size + optics.GROW)


def cast(scenes, world, stack, width=WIDTH, height=HEIGHT, atlas=ATLAS):
    """An image [H, W, 3] of floats, and which surface each pixel shows (0: the sky)."""
    packed = pack_textures(stack)
    eye, (yaw, pitch) = (
        scenes.camera[world, :3].astype(float),
        scenes.camera[world, 3:].astype(float),
    )
    focal = width / 2
    y, x = np.mgrid[:height, :width]
    right = np.array([math.sin(yaw), -math.cos(yaw), 0])
    ahead = np.array([math.cos(pitch) * math.cos(yaw), math.cos(pitch) * math.sin(yaw)])
    ahead = np.append(ahead, math.sin(pitch))
    up = np.cross(right, ahead)
    rays = (
        ahead
        + ((x - (width - 1) / 2) / focal)[..., None] * right
        + (((height - 1) / 2 - y) / focal)[..., None] * up
    )
    low, high = scenes.sky[world].astype(float)
    share = np.clip((pitch + np.arctan(((height - 1) / 2 - y) / focal)) / (math.pi / 2), 0, 1)
    image = low + share[..., None] * (high - low)
    depth = np.full((height, width), np.inf)
    shown = np.zeros((height, width), int)
    surfaces = 0

    def put(t, where, colour):
        nonlocal surfaces
        surfaces += 1
        with np.errstate(invalid="ignore"):
            where = where & (t >= optics.NEAR) & (t < depth)
        depth[where], shown[where], image[where] = t[where], surfaces, colour[where]

    with np.errstate(all="ignore"):
        for k in range(scenes.wall_count[world]):
            x0, y0, x1, y1, z0, z1 = scenes.walls[world, k].astype(float)
            texture, flags = scenes.wall_looks[world, k]
            along = np.array([x0 - x1, y0 - y1, 0])
            length = np.linalg.norm(along)
            along /= length
            normal = np.array([-(y1 - y0), x1 - x0, 0]) / length  # to the left of the direction
            distance = (eye - (x0, y0, 0)) @ normal
            if texture < 0 or (distance < 0 and not flags & TWO_SIDED):
                continue
            t = -distance / (rays @ normal)
            hit = eye + t[..., None] * rays
            u, v = (hit - (x1, y1, 0)) @ along, z1 - hit[..., 2]
            inside = within(u, length) & within(v, z1 - z0)
            per = [SIZE / (scenes.wall_repeat[world, k] or whole) for whole in (length, z1 - z0)]
            area = per[0] * per[1] * t**3 / focal**2 / abs(distance)
            found = texel(
                packed, texture, np.nan_to_num(u * per[0]), np.nan_to_num(v * per[1]), area
            )
            if flags & SEE_THROUGH:
                inside &= found[..., 3] >= 128
            light = sun_on(
                scenes, world, normal * np.sign(distance), optics.SURFACE_DARK, optics.SURFACE_SUN
            )
            colour = found[..., :3] * scenes.wall_tint[world, k] / 255
            if flags & GROUNDED:
                colour = colour * darker(z1 - z0 - v)[..., None]
            put(t, inside, shaded(colour, light, t))
        for k in range(scenes.flat_count[world]):
            x0, y0, x1, y1, z = scenes.flats[world, k].astype(float)
            texture, flags = scenes.flat_looks[world, k]
            rows, columns = scenes.flat_tiles[world, k]
            above = eye[2] > z
            if not flags & TWO_SIDED and above == bool(flags & FACES_DOWN):
                continue
            t = (z - eye[2]) / rays[..., 2]
            hit = eye + t[..., None] * rays
            u, v = np.nan_to_num(hit[..., 0] - x0), np.nan_to_num(hit[..., 1] - y0)
            inside = within(u, x1 - x0) & within(v, y1 - y0)
            which, sides = np.full(u.shape, texture), np.full(u.shape, flags)
            wide, deep = (x1 - x0) / max(columns, 1), (y1 - y0) / max(rows, 1)
            column = row = 0
            if rows:
                column = np.clip(u * columns / (x1 - x0), 0, columns - 1).astype(int)
                row = np.clip(v * rows / (y1 - y0), 0, rows - 1).astype(int)
                which = scenes.tiles[world, row * columns + column]
                inside &= which >= 0
                which = np.maximum(which, 0)
                which, sides = which & TILE_TEXTURE, which >> TILE_SIDES
            repeat = scenes.flat_repeat[world, k]
            per_u, per_v = SIZE / (repeat or wide), SIZE / (repeat or deep)
            area = per_u * per_v * t**3 / focal**2 / abs(z - eye[2])
            found = texel(packed, which, u * per_u, v * per_v, area)
            normal = (0, 0, 1 if above else -1)
            light = sun_on(scenes, world, normal, optics.SURFACE_DARK, optics.SURFACE_SUN)
            colour = found[..., :3] * scenes.flat_tint[world, k] / 255
            x, y = u - column * wide, v - row * deep
            for one, there, other, here in ((EAST, wide - x, WEST, x), (NORTH, deep - y, SOUTH, y)):
                nearest = np.minimum(
                    np.where(sides & one, there, np.inf), np.where(sides & other, here, np.inf)
                )
                colour = colour * darker(nearest)[..., None]
            put(t, inside, shaded(colour, light, t))
        for k, mesh in enumerate(scenes.mesh[world]):
            if mesh < 0:
                continue
            scale, rotation = float(scenes.scale[world, k]), scenes.rotation[world, k].astype(float)
            position = scenes.position[world, k].astype(float)
            colours = np.concatenate([scenes.colours[world, k], FIXED_COLOURS]).astype(float)
            fade = max((position - eye) @ ahead, 0.0)
            for triangle in range(*atlas.first_triangle[mesh : mesh + 2]):
                corners = atlas.vertices[atlas.triangles[triangle] + atlas.first_vertex[mesh] * 0]
                a, b, c = scale * corners.astype(float) @ rotation.T + position
                normal = np.cross(b - a, c - a)
                normal /= np.linalg.norm(normal)
                if (eye - a) @ normal <= 0:
                    continue
                t = (a - eye) @ normal / (rays @ normal)
                hit = eye + t[..., None] * rays
                inside = np.ones(t.shape, bool)
                for p, q in ((a, b), (b, c), (c, a)):
                    inside &= np.cross(q - p, hit - p) @ normal >= 0
                light = sun_on(scenes, world, normal, optics.MESH_DARK, optics.MESH_SUN)
                part, pattern = atlas.parts[triangle], scenes.pattern[world, k]
                colour = np.broadcast_to(colours[part], (height, width, 3))
                if pattern >= 0 and part < 2:
                    own = np.nan_to_num(hit - position) @ rotation
                    faces = abs(normal @ rotation)
                    across = [axis for axis in range(3) if axis != faces.argmax()]
                    u, v = (
                        SIZE / optics.PATTERN * own[..., axis] + (SIZE / 2 if axis < 2 else 0)
                        for axis in across
                    )
                    away = (eye - a) @ normal
                    area = (SIZE / optics.PATTERN / focal) ** 2 * faces.max() * t**3 / away
                    share = texel(packed, pattern, u, v, area)[..., :1] / 255
                    colour = colours[0] + share * (colours[1] - colours[0])
                put(t, inside, shaded(colour, light, fade))
        if scenes.terrain[world, 2] > 0:
            cast_terrain(scenes, world, packed, eye, rays, focal, put)
        heights = eye[2] + depth * rays[..., 2]
        for k, shadow in enumerate(scenes.shadows[world].astype(float)):
            x, y, z, angle, half_length, half_width, soft, darkness = shadow
            if darkness == 0 or eye[2] <= z:
                continue
            dx, dy = (eye[c] + depth * rays[..., c] - (x, y)[c] for c in range(2))
            along = math.cos(angle) * dx + math.sin(angle) * dy
            across = math.cos(angle) * dy - math.sin(angle) * dx
            beside = np.hypot(
                np.maximum(abs(along) - half_length, 0), np.maximum(abs(across) - half_width, 0)
            )
            there = abs(heights - z) <= optics.SHADOW_DEPTH
            share = np.maximum(1 - (beside / soft) ** 2, 0) ** 2
            image[there] = np.floor(image[there]) * (1 - darkness * share[there])[:, None]
            shown[there] += 1000 << k  # one more edge: where a surface leaves the shadow's plane
    return image, shown


def cast_terrain(scenes, world, packed, eye, rays, focal, put):
    west, south, size, repeat = scenes.terrain[world].astype(float)
    per = SIZE / repeat
    for row, column in np.ndindex(*np.subtract(scenes.heights.shape[1:], 1)):
        sw, se, nw, ne = (
            np.array([west + size * c, south + size * r, scenes.heights[world, r, c]])
            for r in (row, row + 1)
            for c in (column, column + 1)
        )
        for a, b, c in ((sw, se, ne), (sw, ne, nw)):
            normal = np.cross(b - a, c - a)
            normal /= np.linalg.norm(normal)
            above = (eye - a) @ normal / normal[2]
            if above <= 0:
                continue
            t = (a - eye) @ normal / (rays @ normal)
            hit = eye + t[..., None] * rays
            inside = np.ones(t.shape, bool)
            for p, q in ((a, b), (b, c), (c, a)):
                inside &= np.cross(q - p, hit - p) @ normal >= 0
            u, v = np.nan_to_num(hit[..., 0] - west), np.nan_to_num(hit[..., 1] - south)
            look = scenes.terrain_texture[world]
            found = texel(packed, look, u * per, v * per, per**2 * t**3 / focal**2 / above)
            light = sun_on(scenes, world, normal, optics.MESH_DARK, optics.MESH_SUN)
            colour = found[..., :3] * scenes.terrain_tint[world] / 255
            put(t, inside, shaded(colour, light, t))


def inner(shown):
    """Pixels whose eight neighbours show the same surface; the image's border is none."""
    same = np.zeros(shown.shape, bool)
    same[1:-1, 1:-1] = True
    h, w = shown.shape
    for down in range(3):
        for across in range(3):
            there = shown[down : h - 2 + down, across : w - 2 + across]
            same[1:-1, 1:-1] &= there == shown[1:-1, 1:-1]
    return same


def random_rotation(rng):
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def random_scenes(seed, envs=6, *, patterns=False, **more):
    """Rooms with walls, a patchwork floor with a hole, shelves, a fence and meshes."""
    rng = np.random.default_rng(seed)
    scenes = Scenes(envs, walls=10, flats=4, instances=5, tile_cells=12, shadows=6, **more)
    corners = ((0, 0), (5, 0), (5, 4), (0, 4))
    for world in range(envs):
        for k in range(4):
            repeat = (1, 0, 1.5, 0.7)[k]
            ends = corners[k] + corners[(k + 1) % 4]
            texture, flags = int(rng.integers(len(STACK))), GROUNDED * (k % 2)
            scenes.add_walls(world, ends, (0, 2.5), texture, flags=flags, repeat=repeat)
        for k in range(5):
            scenes.add_walls(
                world, rng.uniform((0, 0, 0, 0), (5, 4, 5, 4)), (rng.uniform(0, 1), 1.5),
                int(rng.integers(len(STACK))), flags=TWO_SIDED * (k % 2), repeat=1,
                tint=rng.integers(100, 256, 3),
            )  # fmt: skip
        scenes.add_walls(
            world, rng.uniform((0, 0, 0, 0), (5, 4, 5, 4)), (0, 1), FENCE,
            flags=TWO_SIDED | SEE_THROUGH,
        )  # fmt: skip
        tiles = rng.integers(0, len(STACK), (3, 4))
        tiles += rng.integers(0, 16, (3, 4)) * EAST << TILE_SIDES
        tiles[1, 1] = -1
        scenes.add_flat(world, (0, 0, 5, 4), 0, 0, tiles=tiles)
        scenes.add_flat(world, (0, 0, 5, 4), 2.5, 1, flags=FACES_DOWN, repeat=1.0)
        scenes.add_flat(
            world, (1, 1, 2, 3), 0.7, 2, flags=TWO_SIDED | WEST | NORTH, tint=(255, 90, 40)
        )
        scenes.add_flat(world, (3, 1, 4, 2), 0.4, 3)
        for k in range(5):
            scenes.mesh[world, k] = rng.integers(-1, 2)
            scenes.position[world, k] = rng.uniform((0, 0, 0), (5, 4, 2))
            scenes.rotation[world, k] = random_rotation(rng)
            scenes.scale[world, k] = rng.uniform(0.5, 2)
            scenes.pattern[world, k] = rng.integers(-3, len(STACK)) if patterns else -1
        scenes.colours[world] = rng.integers(0, 256, (5, 2, 3))
        sun = rng.normal(size=3)
        scenes.sun[world] = sun / np.linalg.norm(sun)
        scenes.lamp[world] = rng.uniform(0.3, 1, 3)
        for k, height in enumerate((0, 0, 0, 0.7, 0.4, 1.2)):  # nothing is at 1.2
            scenes.shadows[world, k] = (
                *rng.uniform((0, 0), (5, 4)), height, rng.uniform(-4, 4),
                *rng.uniform((0, 0, 0.05, 0.2), (1, 1, 1, 1)),
            )  # fmt: skip
        scenes.camera[world] = (
            *rng.uniform((0.3, 0.3, 0.3), (4.7, 3.7, 2.2)),
            *rng.uniform((-math.pi, -0.9), (math.pi, 0.9)),
        )
    return scenes
