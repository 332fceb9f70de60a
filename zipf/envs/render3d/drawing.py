"""Draws the images of a batch of envs, compiled.

A camera never rolls, which makes the projection simple. The ray of the pixel at column x, row y is
`forward + a(x) right + b(y) up`, its length t being the depth along the view. With `h` the heading,
`right` its right hand (both horizontal) and p the pitch, its horizontal part is c(y) h + a(x) right
where c(y) = cos p - b sin p, and its rise, sin p + b cos p, is the same along a row. Hence

- on a flat the depth is the same along a row, and positions are affine in x;
- on a wall 1/t, and positions times 1/t, are affine in x and y; and so are the conditions of being
  inside its rectangle. Each bounds x from one side in every row: a wall is a span of x per row,
  found without projecting, clipping or sorting its corners. The near plane is one more condition.

Depth is kept as 1/t, 0 where nothing has been drawn. Colours are uint32, 0x00BBGGRR, until the
image is complete.
"""

import math

import numpy as np

from zipf.compiled import compiled
from zipf.envs.render3d.arrays import (
    Canvas,
    Lens,
    Projection,
    Sector,
    View,
    named_assets,
    named_buffers,
    named_scenes,
)
from zipf.envs.render3d.blocks import STREAMED, address, end_stream, pack_block, stream_block
from zipf.envs.render3d.flats import draw_flat
from zipf.envs.render3d.instances import draw_instance
from zipf.envs.render3d.lanes import LANES
from zipf.envs.render3d.rounding import floor
from zipf.envs.render3d.scene import SCREEN
from zipf.envs.render3d.shadows import draw_shadow
from zipf.envs.render3d.sight import look_around
from zipf.envs.render3d.terrain import draw_terrain
from zipf.envs.render3d.walls import draw_wall


@compiled(references=False, error_model="numpy")
def draw(mask, scene_fields, asset_fields, lens_fields, buffer_fields, out):
    """Draws the envs that are in `mask` [N] to `out`, uint8 [N, H, W, 3].

    The fields are those of `SceneArrays`, `Assets`, `Lens` and `Buffers` as plain tuples. Returns
    the first env that names a texture, screen or mesh that does not exist, or -1.
    """
    scenes, assets = named_scenes(scene_fields), named_assets(asset_fields)
    lens, buffers = Lens(*lens_fields), named_buffers(buffer_fields)
    walls, flats, instances = scenes.walls, scenes.flats, scenes.instances
    terrains, overlays = scenes.terrains, scenes.overlays
    texels, focal, grid, shadows = assets.texels, lens.focal, scenes.grid, scenes.shadows
    height, width = out.shape[1], out.shape[2]
    middle_x, middle_y = (width - 1) / 2, (height - 1) / 2
    frame, palette = buffers.env.frame, buffers.env.palette
    to_edge = (width / 2 / focal, height / 2 / focal)
    projection = Projection(
        frame,
        np.float32(focal),
        np.float32(middle_x),
        np.float32(middle_y),
        (math.sin(math.atan(to_edge[0])), math.cos(math.atan(to_edge[0]))),
        (math.sin(math.atan(to_edge[1])), math.cos(math.atan(to_edge[1]))),
    )
    image = buffers.image
    canvas = Canvas(
        width, height, image.colour.shape[1], address(image.colour), address(image.depth)
    )
    for i in range(len(mask)):
        if not mask[i]:
            continue
        sun, lamp = scenes.sun[i], scenes.lamp[i]
        for part in range(2, len(palette)):
            for c in range(3):
                palette[part, c] = assets.fixed_colours[part - 2, c] * lamp[c]
        eye = scenes.camera[i]
        yaw, pitch = np.float64(eye[3]), np.float64(eye[4])
        hx, hy = math.cos(yaw), math.sin(yaw)
        cos, sin = math.cos(pitch), math.sin(pitch)
        frame[0] = hy, -hx, 0.0
        frame[1] = -sin * hx, -sin * hy, cos
        frame[2] = cos * hx, cos * hy, sin
        b = middle_y / focal
        view = View(
            np.float64(eye[0]), np.float64(eye[1]), np.float64(eye[2]), hx, hy,
            cos - b * sin, sin / focal, sin + b * cos, -cos / focal,
            -middle_x / focal, 1.0 / focal,
        )  # fmt: skip
        _draw_sky(scenes.sky[i], pitch, lens.tilts, image)
        if terrains.place[i, 2] > 0.0:
            if not 0 <= terrains.texture[i] < len(texels):
                return i
            # First of all, because it uses the colours of the pixels that it covers.
            draw_terrain(
                terrains.heights[i], terrains.place[i], terrains.tint[i], sun, lamp, view,
                projection, texels[terrains.texture[i]], canvas, image, buffers.terrain,
            )  # fmt: skip
        # Seen from above, the view is a sector as wide as its widest line; half a pixel is added.
        narrowest = min(view.c0, view.c0 + view.dc * (height - 1))
        half = math.atan2((middle_x + 1.0) / focal, narrowest)
        sector = Sector(
            narrowest > 1e-3, math.cos(yaw + half), math.sin(yaw + half), math.cos(yaw - half),
            math.sin(yaw - half),
        )  # fmt: skip
        by_grid = False
        faces = buffers.grid.faces
        if grid[i, 2] > 0.0 and sector.narrow:
            by_grid = look_around(
                scenes.solid[i], (eye[0] - grid[i, 0]) / np.float64(grid[i, 2]),
                (eye[1] - grid[i, 1]) / np.float64(grid[i, 2]), sector.left_x, sector.left_y,
                sector.right_x, sector.right_y, faces, buffers.grid.spans,
            )  # fmt: skip
        for k in range(walls.count[i]):
            if by_grid and walls.face[i, k] >= 0 and not faces[walls.face[i, k]]:
                continue
            texture = walls.looks[i, k, 0]
            if texture >= len(texels) or (texture == SCREEN and scenes.screen[i].size == 0):
                return i
            if texture >= 0 or texture == SCREEN:
                draw_wall(
                    walls.places[i, k], walls.looks[i, k], walls.repeat[i, k], walls.tint[i, k],
                    scenes.screen[i], sun, lamp, view, sector, texels, image, buffers.span, width,
                )  # fmt: skip
        for k in range(instances.mesh.shape[1]):
            if instances.mesh[i, k] >= len(assets.meshes.balls):
                return i
            if instances.mesh[i, k] >= 0:
                if instances.pattern[i, k] >= len(texels):
                    return i
                for part in range(2):
                    for c in range(3):
                        palette[part, c] = instances.colours[i, k, part, c] * lamp[c]
                draw_instance(
                    instances.mesh[i, k], instances.position[i, k], instances.rotation[i, k],
                    instances.scale[i, k], instances.pattern[i, k], texels, assets.meshes, palette,
                    sun, eye, projection, canvas, buffers.mesh,
                )  # fmt: skip
        for k in range(flats.count[i]):
            texture, rows = flats.looks[i, k, 0], flats.tiling[i, k, 0]
            if texture >= len(texels):
                return i
            if texture >= 0 or rows > 0:
                draw_flat(
                    flats.places[i, k], flats.looks[i, k], flats.tiling[i, k], flats.repeat[i, k],
                    flats.tint[i, k], flats.tiles[i], sun, lamp, view, texels, image, buffers.span,
                    width,
                )  # fmt: skip
        for k in range(shadows.shape[1]):
            if shadows[i, k, 7] > 0.0:  # most are not, and a call takes longer
                draw_shadow(shadows[i, k], view, projection, image, width)
        # What overlays are mixed with is read again at once.
        _write_image(image.colour, out, i, overlays.count[i] == 0)
        for k in range(overlays.count[i]):
            _draw_overlay(overlays.places[i, k], overlays.colours[i, k], out[i])
    end_stream()
    return -1


@compiled(references=False, error_model="numpy")
def _draw_sky(sky, pitch, tilts, image):
    """Fills the image with the sky, uint8 [2, 3] at the horizon and overhead."""
    for y in range(len(tilts)):
        angle = pitch + tilts[y]
        share = min(max(angle / (math.pi / 2), 0.0), 1.0)
        paint = np.uint32(0)
        for c in range(3):
            shade = sky[0, c] * (1.0 - share) + sky[1, c] * share
            paint |= np.uint32(shade) << np.uint32(8 * c)
        image.colour[y] = paint
    image.depth[:] = 0.0


@compiled(references=False, error_model="numpy")
def _write_image(colour, out, i, streamed):
    """Writes the colour buffer to image `i` of `out`, uint8 [N, H, W, 3].
    If `streamed` is set, past the caches, where the lines of the image allow it."""
    height, width = out.shape[1], out.shape[2]
    streamed &= address(out) % STREAMED == 0 and 3 * width % STREAMED == 0
    for y in range(height):
        line = address(colour) + y * 4 * colour.shape[1]
        pixels = address(out) + 3 * width * (i * height + y)
        whole = width & -LANES
        if streamed:
            for x in range(0, whole, LANES):
                stream_block(line + 4 * x, pixels + 3 * x)
        else:
            for x in range(0, whole, LANES):
                pack_block(line + 4 * x, pixels + 3 * x)
        for x in range(whole, width):
            paint = colour[y, x]
            out[i, y, x, 0] = paint & 255
            out[i, y, x, 1] = (paint >> 8) & 255
            out[i, y, x, 2] = (paint >> 16) & 255


@compiled(references=False, error_model="numpy")
def _draw_overlay(overlay, paint, image):
    """Draws a rectangle given as shares of `image`, uint8 [H, W, 3], in an RGBA colour."""
    height, width = image.shape[0], image.shape[1]
    left, right = _pixel(overlay[0], width), _pixel(overlay[2], width)
    top, bottom = _pixel(overlay[1], height), _pixel(overlay[3], height)
    alpha = np.int32(paint[3])
    for y in range(top, bottom):
        for x in range(left, right):
            for k in range(3):
                mixed = image[y, x, k] * (255 - alpha) + paint[k] * alpha
                image[y, x, k] = (mixed + 127) // 255


@compiled(references=False, error_model="numpy")
def _pixel(share, size):
    """The pixel at a share of an image's width or height, limited to the image."""
    return min(max(floor(share * size + 0.5), 0), size)
