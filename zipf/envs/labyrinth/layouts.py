"""Fixed text maps, with regions that have a look each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth import materials
from zipf.envs.labyrinth.grids import Cell
from zipf.envs.labyrinth.world import World


@dataclass(frozen=True)
class Layout:
    """A text map."""

    solid: NDArray[np.bool_]  # bool [rows, columns], rows to the north, with a solid border
    starts: tuple[Cell, ...]  # cells that the player may start in
    slots: tuple[Cell, ...]  # cells of objects, from the north-west on as one reads
    # [rows, columns], the letter of each cell's region; empty in corridors
    region: NDArray[np.str_]

    @property
    def regions(self) -> tuple[str, ...]:
        """Letters of the regions."""
        return tuple(letter for letter in np.unique(self.region).tolist() if letter)

    @property
    def slot_regions(self) -> tuple[str, ...]:
        """The region of each slot."""
        return tuple(str(self.region[slot]) for slot in self.slots)


def read(cells: str, regions: str = "") -> Layout:
    """A layout of two texts, rows from the north on, one a word.

    In `cells` `*` is a wall, as is what is missing, `P` a start, `O` a slot; `regions` has letters
    of regions; `.` is none.
    """
    rows, letters = cells.split(), regions.split()
    high, wide = len(rows) + 2, max(map(len, rows)) + 2
    solid = np.ones((high, wide), np.bool_)
    region = np.full((high, wide), "", "<U1")
    found: dict[str, list[Cell]] = {"P": [], "O": []}
    for i, row in enumerate(rows):
        for j, sign in enumerate(row):
            cell = high - 2 - i, j + 1
            solid[cell] = sign == "*"
            if sign in found:
                found[sign].append(cell)
            if letters and letters[i][j] != "." and sign != "*":
                region[cell] = letters[i][j]
    return Layout(solid, tuple(found["P"]), tuple(found["O"]), region)


@dataclass(frozen=True)
class Theme:
    """What a layout looks like."""

    # floors, walls: names of textures by region; corridors have their own
    floors: dict[str, str]
    walls: dict[str, str]


def random_theme(regions: str, rng: np.random.Generator) -> Theme:
    """A floor and walls for each of these regions."""
    drawn = rng.integers(0, 4 * materials.STYLES, (2, len(regions))).tolist()
    floors, walls = (
        {letter: f"{kind}_{number}" for letter, number in zip(regions, numbers, strict=True)}
        for kind, numbers in zip(("floor", "wall"), drawn, strict=True)
    )
    return Theme(floors, walls)


def build_layout(world: World, layout: Layout, theme: Theme, rng: np.random.Generator) -> None:
    """Builds a layout with pictures on its walls, which are drawn."""
    floors = np.full(layout.solid.shape, materials.index("corridor_floor"))
    walls = np.full(layout.solid.shape, materials.index("corridor_wall"))
    for letter in layout.regions:
        here = layout.region == letter
        floors[here] = materials.index(theme.floors[letter])
        walls[here] = materials.index(theme.walls[letter])
    world.add_text_map(layout.solid, floors, walls)
    world.add_pictures(layout.solid, rng)


TWO_AREAS = read(
    """
    O....O
    ..PP..
    O....O
    """,
    "AAABBB " * 3,
)
TWO_ROOMS = read(
    """
    O..***..O
    ..P...P..
    O..***..O
    """,
    "AAA...BBB " * 3,
)
FOUR_ROOMS = read(
    """
    ***O.O***
    ***...***
    ***.P.***
    O..*.*..O
    ..P...P..
    O..*.*..O
    ***.P.***
    ***...***
    ***O.O***
    """,
    "...AAA... " * 3 + "BBB...CCC " * 3 + "...DDD... " * 3,
)
SIX_ROOMS = read(
    """
    O..***..O
    ..P...P..
    O..*.*..O
    ****.****
    O..*.*..O
    ..P...P..
    O..*.*..O
    ****.****
    O..*.*..O
    ..P...P..
    O..***..O
    """,
    "......... ".join(3 * row for row in ("AAA...BBB ", "CCC...DDD ", "EEE...FFF ")),
)
