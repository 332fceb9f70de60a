"""Draws what the labyrinth's levels look like.

    python scripts/labyrinth_sheet.py                 # docs/labyrinth.png, for the README
    python scripts/labyrinth_sheet.py --all out.png   # all levels: two views each, and the map

Views are those that agents get, magnified, while the scripted expert plays.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import zipf.envs
from zipf.envs.labyrinth.levels import LEVELS

OUTPUT = Path(__file__).parent.parent / "docs" / "labyrinth.png"
INK, QUIET = (31, 36, 48), (90, 96, 112)
WIDTH, HEIGHT = 192, 144
"""Of a view, pixels: twice those of an agent's."""
GAP, CAPTION = 8, 22


@dataclass(frozen=True)
class Shot:
    """A moment of an episode.

    Attributes:
        level: the level.
        seed: of the world.
        steps: of the expert before the view is taken.
        title: what the level is about, for the picture of the README.
    """

    level: str
    seed: int
    steps: int
    title: str = ""


SHOTS = (
    Shot("rooms_collect_good_objects_train", 3, 40, "take the good objects"),
    Shot("rooms_keys_doors_puzzle", 3, 0, "open doors with keys"),
    Shot("rooms_watermaze", 3, 35, "find the hidden platform"),
    Shot("natlab_varying_map_randomized", 3, 10, "gather mushrooms"),
    Shot("skymaze_irreversible_path_hard", 4, 4, "find the way down"),
    Shot("explore_object_locations_small", 3, 20, "collect all apples"),
    Shot("explore_obstructed_goals_small", 5, 10, "reach the goal through doors"),
    Shot("explore_object_rewards_many", 3, 15, "find out what is good"),
)


def look(shot: Shot) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """The agent's view at a moment, uint8 [72, 96, 3], and the map, [288, 288, 3]."""
    name = f"labyrinth/{shot.level}"
    env = zipf.envs.make_vec(name, 1, render_mode="rgb_array")
    observation, _ = env.reset(seed=shot.seed)
    expert = zipf.envs.expert(name, env)
    assert expert is not None
    for _ in range(shot.steps):
        observation, *_ = env.step(expert())
    frames = env.render()
    assert frames is not None
    return observation["image"][0], frames[0][:, 384:]


def enlarged(image: NDArray[np.uint8]) -> Image.Image:
    return Image.fromarray(image).resize((WIDTH, HEIGHT), Image.Resampling.NEAREST)


def strip() -> Image.Image:
    """Eight levels and, over their height, a map."""
    across = len(SHOTS) // 2
    side = 2 * (HEIGHT + CAPTION) + GAP - CAPTION
    page = Image.new("RGB", (across * (WIDTH + GAP) + side, 2 * (HEIGHT + CAPTION) + GAP), "white")
    pen, font = ImageDraw.Draw(page), ImageFont.load_default(size=13)
    for k, shot in enumerate(SHOTS):
        x, y = k % across * (WIDTH + GAP), k // across * (HEIGHT + CAPTION + GAP)
        page.paste(enlarged(look(shot)[0]), (x, y))
        pen.text((x + WIDTH // 2, y + HEIGHT + 11), shot.title, INK, font, anchor="mm")
    _, map_ = look(Shot("explore_object_locations_large", 3, 30))
    x = across * (WIDTH + GAP)
    page.paste(Image.fromarray(map_).resize((side, side), Image.Resampling.LANCZOS), (x, 0))
    title = "one of the mazes from above"
    pen.text((x + side // 2, side + 11), title, INK, font, anchor="mm")
    return page


def sheet() -> Image.Image:
    """All levels."""
    columns = 3
    rows = -(-len(LEVELS) // columns)
    width = 2 * WIDTH + HEIGHT + 2
    page = Image.new("RGB", (columns * (width + GAP), rows * (HEIGHT + CAPTION)), "white")
    pen, font = ImageDraw.Draw(page), ImageFont.load_default(size=13)
    for k, (level, found) in enumerate(LEVELS.items()):
        x, y = k % columns * (width + GAP), k // columns * (HEIGHT + CAPTION)
        pen.text((x + 2, y + 3), f"{level}, {found.seconds} s", INK, font)
        for shot in (Shot(level, 1, 0), Shot(level, 2, 25)):
            view, map_ = look(shot)
            page.paste(enlarged(view), (x, y + CAPTION))
            x += WIDTH + 1
        small = Image.fromarray(map_).resize((HEIGHT, HEIGHT), Image.Resampling.LANCZOS)
        page.paste(small, (x, y + CAPTION))
    return page


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--all", type=Path, metavar="FILE", help="draw all levels to this file")
    given = parser.parse_args()
    path, picture = (given.all, sheet()) if given.all else (OUTPUT, strip())
    picture.quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)
    print(f"wrote {path}: {path.stat().st_size / 1024:.0f} kB")


if __name__ == "__main__":
    main()
