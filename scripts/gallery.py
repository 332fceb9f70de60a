"""Draws the pictures of what the levels look like, in docs/.

    python scripts/gallery.py               # gallery/*.jpg, labyrinth.png and playroom.png
    python scripts/gallery.py playroom      # those of one family

Pictures of the gallery are moments while the scripted expert plays: of its first steps in a few
episodes the one with the most colours. Where a family renders at any size they are what the agent
sees, in more detail. `scripts/write_tables.py` writes the page, docs/gallery.md.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

import family_tables
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from zipf import envs
from zipf.experiments.playing.captions import FONT

DOCS = Path(__file__).parent.parent / "docs"
SIZE = WIDTH, HEIGHT = 264, 198
FINER = 2  # pictures are drawn so much larger and then reduced
ENVS, STEPS, EVERY = 4, 60, 5
"""Of each level, from which a moment is chosen."""
MOSAIC = 3  # pictures across and down, of a level that draws one of several tasks

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
"""Levels in docs/labyrinth.png, with what they are about."""
EPISODES = {
    "playroom/lift/lift_shape_uniform": 1,
    "playroom/put/put_on_bed_tray_all": 5,
    "playroom/put/put_near_bed_tray_frequent": 2,
    "playroom/supervised/find_shape_uniform": 3,
}
"""Level and seed of the rows of docs/playroom.png, and how many pictures a row has."""
ACROSS = 6
INK, GAP, CAPTION = (31, 36, 48), 8, 22


def picture(level: str, seed: int = 0) -> Image.Image:
    """The moment of a level that has the most colours."""
    found, _ = envs.find_level(level)
    wide, high = FINER * WIDTH, FINER * HEIGHT
    options = {}
    if "image_size" in found.options_class.model_fields:
        options["image_size"] = [high, wide]
    env = envs.make_vec(level, ENVS, render_mode="rgb_array", **options)
    expert = envs.expert(level, env)
    observation, _ = env.reset(seed=seed)
    best, most = None, -1
    for step in range(STEPS if expert else 1):
        if step % EVERY == 0:
            for drawn in observation["image"] if options else env.pictures(wide, high):
                colours = len(np.unique(drawn[::FINER, ::FINER].reshape(-1, 3) >> 4, axis=0))
                if colours > most:
                    best, most = drawn.copy(), colours
        if expert:
            observation, *_ = env.step(expert())
    env.close()
    assert best is not None
    small = Image.fromarray(best)
    small.thumbnail(SIZE, Image.Resampling.BOX)
    return small


def pictures(family: str) -> None:
    """Writes a picture for each group of levels that look alike."""
    folder = DOCS / "gallery"
    folder.mkdir(exist_ok=True)
    drawn = {}
    for k, group in enumerate(family_tables.groups(family)):
        if not group.tasks:
            drawn[group.levels[0]] = picture(group.levels[0], seed=10 * k)
            drawn[group.levels[0]].save(folder / group.file, quality=82)
    for group in family_tables.groups(family):
        if group.tasks:
            page = Image.new("RGB", SIZE)
            for k, task in enumerate(group.tasks[: MOSAIC**2]):
                place = k % MOSAIC * WIDTH // MOSAIC, k // MOSAIC * HEIGHT // MOSAIC
                page.paste(drawn[task].resize((WIDTH // MOSAIC, HEIGHT // MOSAIC)), place)
            page.save(folder / group.file, quality=82)


def labyrinth() -> Image.Image:
    """Eight levels and, over their height, a map."""
    across, font = len(TITLES) // 2, ImageFont.truetype(FONT, 12)
    side = 2 * (HEIGHT + CAPTION) + GAP - CAPTION
    page = Image.new("RGB", (across * (WIDTH + GAP) + side, side + CAPTION), "white")
    pen = ImageDraw.Draw(page)
    for k, (level, title) in enumerate(TITLES.items()):
        x, y = k % across * (WIDTH + GAP), k // across * (HEIGHT + CAPTION + GAP)
        page.paste(picture(f"labyrinth/{level}", seed=10 * k), (x, y))
        pen.text((x + WIDTH // 2, y + HEIGHT + 11), title, INK, font, anchor="mm")
    env = envs.make_vec("labyrinth/explore_object_locations_large", 1, render_mode="rgb_array")
    env.reset(seed=3)
    (drawn,) = env.pictures(10 * side, side)
    page.paste(Image.fromarray(drawn[:, -side:]), (across * (WIDTH + GAP), 0))
    middle = across * (WIDTH + GAP) + side // 2
    pen.text((middle, side + 11), "one of the mazes from above", INK, font, anchor="mm")
    return page


def playroom() -> Image.Image:
    """Episodes of the expert, one a row."""
    rows = []
    for level, seed in EPISODES.items():
        frames = list(episode(level, seed))
        picks = np.linspace(0, len(frames) - 1, ACROSS).round().astype(int)
        rows.append(np.concatenate([frames[k] for k in picks], 1))
    sheet = Image.fromarray(np.concatenate(rows))
    return sheet.resize((sheet.width // 2, sheet.height // 2), Image.Resampling.LANCZOS)


def episode(level: str, seed: int) -> Iterator[NDArray[np.uint8]]:
    env = envs.make_vec(level, 1, render_mode="rgb_array", autoreset_mode="Disabled")
    env.reset(seed=seed)
    expert = envs.expert(level, env)
    assert expert is not None
    over = False
    while True:
        yield (env.render() or ())[0]
        if over:
            return
        _, _, terminated, truncated, _ = env.step(expert())
        over = bool(terminated[0] or truncated[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("families", nargs="*", default=list(envs.families()))
    for family in parser.parse_args().families:
        pictures(family)
        for name, draw in (("labyrinth", labyrinth), ("playroom", playroom)):
            if name == family:
                sheet = draw().quantize(256, dither=Image.Dither.NONE)
                sheet.save(DOCS / f"{name}.png", optimize=True)
    paths = [*DOCS.glob("gallery/*.jpg"), DOCS / "labyrinth.png", DOCS / "playroom.png"]
    print(f"{len(paths)} pictures, {sum(path.stat().st_size for path in paths) / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
