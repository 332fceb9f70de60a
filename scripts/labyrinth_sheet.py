"""Draws what the labyrinth's levels look like.

    python scripts/labyrinth_sheet.py                 # docs/labyrinth.png, for the README
    python scripts/labyrinth_sheet.py --all out.png   # all levels: two views each, and the map

Views are those that agents get, magnified, while the scripted expert plays: of each episode's first
steps the one with the most colours.
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


TITLES = {
    "rooms_keys_doors_puzzle": "open doors with keys",
    "language_select_described_object": "take what is described",
    "lasertag_three_opponents_large": "tag the opponents",
    "natlab_varying_map_randomized": "gather mushrooms",
    "skymaze_irreversible_path_hard": "find the way down",
    "psychlab_arbitrary_visuomotor_mapping": "learn where to look",
    "explore_object_locations_small": "collect all apples",
    "explore_obstructed_goals_small": "reach the goal through doors",
}
"""Levels in the picture of the README, with what they are about."""
ENVS, STEPS = 6, 100
"""Of each level, from which views are chosen."""


@dataclass(frozen=True)
class Shot:
    """A moment of an episode: the agent's view, uint8 [72, 96, 3], and the map, [288, 288, 3]."""

    view: NDArray[np.uint8]
    map: NDArray[np.uint8]
    colours: int


def shots(level: str, seed: int = 3) -> list[Shot]:
    """Of every env the view with the most colours, sorted by their number."""
    name = f"labyrinth/{level}"
    env = zipf.envs.make_vec(name, ENVS, render_mode="rgb_array")
    observation, _ = env.reset(seed=seed)
    expert = zipf.envs.expert(name, env)
    assert expert is not None
    found: dict[int, Shot] = {}
    for _ in range(STEPS // 5):
        views = observation["image"]
        frames = env.render()
        assert frames is not None
        for i, (view, frame) in enumerate(zip(views, frames, strict=True)):
            colours = len(np.unique(view.reshape(-1, 3) >> 4, axis=0))
            if i not in found or colours > found[i].colours:
                found[i] = Shot(view.copy(), frame[:, 384:].copy(), colours)
        for _ in range(5):
            observation, *_ = env.step(expert())
    return sorted(found.values(), key=lambda shot: -shot.colours)


def enlarged(image: NDArray[np.uint8]) -> Image.Image:
    return Image.fromarray(image).resize((WIDTH, HEIGHT), Image.Resampling.NEAREST)


def strip() -> Image.Image:
    """Eight levels and, over their height, a map."""
    across = len(TITLES) // 2
    side = 2 * (HEIGHT + CAPTION) + GAP - CAPTION
    page = Image.new("RGB", (across * (WIDTH + GAP) + side, 2 * (HEIGHT + CAPTION) + GAP), "white")
    pen, font = ImageDraw.Draw(page), ImageFont.load_default(size=13)
    for k, (level, title) in enumerate(TITLES.items()):
        x, y = k % across * (WIDTH + GAP), k // across * (HEIGHT + CAPTION + GAP)
        page.paste(enlarged(shots(level)[0].view), (x, y))
        pen.text((x + WIDTH // 2, y + HEIGHT + 11), title, INK, font, anchor="mm")
    map_ = Image.fromarray(shots("explore_object_locations_large")[0].map)
    x = across * (WIDTH + GAP)
    page.paste(map_.resize((side, side), Image.Resampling.LANCZOS), (x, 0))
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
        first, second = shots(level, seed=k)[:2]
        for shot in (first, second):
            page.paste(enlarged(shot.view), (x, y + CAPTION))
            x += WIDTH + 1
        small = Image.fromarray(first.map).resize((HEIGHT, HEIGHT), Image.Resampling.LANCZOS)
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
