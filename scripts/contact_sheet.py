"""Draw every mesh with its name: from three sides, and as the playroom's camera sees it.

    python scripts/contact_sheet.py out.png

The close views show the shape. The others are cut out of the 96 x 72 pixels of the playroom's view,
from 1.5 m away (two sides) and 2 m, every pixel magnified: these few pixels must be enough to
distinguish the toys. All toys have the same two greys, because their colours are random.
"""

import argparse
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from zipf.envs.playroom.constants import EYE
from zipf.envs.playroom.view import FIELD_OF_VIEW
from zipf.envs.render3d import Renderer, Scenes, load_meshes, pack_textures, textures

GREYS = [(165, 165, 170), (120, 122, 130)]
CLOSE = 132
"""Pixels of a close view."""
CUT = 28
"""Pixels of a room view that are shown, around the object, and how much they are magnified."""
MAGNIFIED = 5
COLUMNS = 2
ROOM = 6.0
CLOSE_YAWS = (-25, 90, 205)
ROOM_VIEWS = ((1.5, -30), (1.5, 70), (2.0, -30))
"""Distance in metres along the floor, and the degrees by which the object is turned."""


def rooms(views: Sequence[tuple[int, float, float, float, float]]) -> Scenes:
    """A room for each (mesh, degrees it is turned, distance, eye height, height looked at)."""
    scenes = Scenes(len(views), walls=4, flats=1, instances=1, shadows=1)
    half = ROOM / 2
    corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
    for i, (mesh, degrees, distance, eye, target) in enumerate(views):
        for (x0, y0), (x1, y1) in zip(corners, corners[1:] + corners[:1], strict=True):
            scenes.add_walls(i, (x0, y0, x1, y1), (0, 3), textures.index("plaster"), repeat=1)
        floor = textures.index("carpet")
        scenes.add_flat(i, (-half, -half, half, half), 0, floor, repeat=1)
        pitch = math.atan2(target - eye, distance)
        scenes.camera[i] = (distance, 0, eye, math.pi, pitch)
        turn = math.radians(degrees)
        scenes.rotation[i, 0, :2, :2] = (
            (math.cos(turn), -math.sin(turn)),
            (math.sin(turn), math.cos(turn)),
        )
        scenes.mesh[i, 0] = mesh
        length, width, _ = load_meshes().extent[mesh].tolist()
        scenes.shadows[i, 0] = 0, 0, 0, turn, 0.3 * length, 0.3 * width, 0.1, 0.5
        scenes.colours[i, 0] = GREYS
    return scenes


def draw(renderer: Renderer, scenes: Scenes) -> np.ndarray:
    out = np.zeros((scenes.num_envs, renderer.height, renderer.width, 3), np.uint8)
    renderer.render(scenes, out)
    return out


def sheet() -> Image.Image:
    atlas = load_meshes()
    packed = pack_textures(textures.stack())
    close = Renderer(atlas, packed, width=2 * CLOSE, height=2 * CLOSE, fov=18)
    far = Renderer(atlas, packed, fov=FIELD_OF_VIEW)
    closes, fars = [], []
    for mesh, extent in enumerate(atlas.extent):
        middle = float(extent[2]) / 2
        away = 4.2 * float(extent.max())
        closes += [(mesh, yaw, away, middle + 0.5 * away, middle) for yaw in CLOSE_YAWS]
        fars += [(mesh, yaw, distance, EYE, 0.17) for distance, yaw in ROOM_VIEWS]
    close_views, far_views = draw(close, rooms(closes)), draw(far, rooms(fars))
    left, top = (far.width - CUT) // 2, (far.height - CUT) // 2
    far_views = far_views[:, top : top + CUT, left : left + CUT]

    row, column = (
        max(CLOSE, CUT * MAGNIFIED) + 18,
        len(CLOSE_YAWS) * CLOSE + len(ROOM_VIEWS) * CUT * MAGNIFIED + 12,
    )
    rows = -(-len(atlas.names) // COLUMNS)
    page = Image.new("RGB", (COLUMNS * column, rows * row), "white")
    pen = ImageDraw.Draw(page)
    for mesh, name in enumerate(atlas.names):
        x, y = mesh // rows * column, mesh % rows * row
        triangles = atlas.first_triangle[mesh + 1] - atlas.first_triangle[mesh]
        pen.text((x + 4, y + 2), f"{mesh + 1}  {name}  ({triangles} triangles)", fill="black")
        for view in range(len(CLOSE_YAWS)):
            image = Image.fromarray(close_views[mesh * len(CLOSE_YAWS) + view])
            page.paste(image.resize((CLOSE, CLOSE), Image.Resampling.BOX), (x, y + 16))
            x += CLOSE
        for view in range(len(ROOM_VIEWS)):
            image = Image.fromarray(far_views[mesh * len(ROOM_VIEWS) + view])
            size = (CUT * MAGNIFIED, CUT * MAGNIFIED)
            page.paste(image.resize(size, Image.Resampling.NEAREST), (x, y + 16))
            x += CUT * MAGNIFIED
    return page


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path, help="the picture to write")
    out = parser.parse_args().out
    sheet().save(out)
    print(f"wrote {out}")


if __name__ == "__main__":
    main()
