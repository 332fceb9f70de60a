"""What a gridworld level is: its maps, its distributions, its spaces; one world's or many's."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from zipf.envs import distributions, pcg64
from zipf.envs.gridworld import kernels
from zipf.envs.gridworld.looks import CELL, NUM_CODES
from zipf.envs.gridworld.maps import MOVES, VIEW, Maps, build_maps

IMAGE_SIZE = VIEW * CELL
OBSERVATIONS = ("image", "tiles")


@dataclass(frozen=True, eq=False)
class GridworldSpec:
    """A level with its constructor options, checked and resolved.

    Attributes:
        level: the level's name without its family.
        maps: the maps.
        map_cdf, target_cdf: cumulated probabilities of the ranks, float64 [maps], [objects].
        max_steps: after how many steps an episode is truncated.
        observation: "image" or "tiles".
    """

    level: str
    maps: Maps
    map_cdf: NDArray[np.float64]
    target_cdf: NDArray[np.float64]
    max_steps: int
    observation: str

    @classmethod
    def make(
        cls,
        level: str,
        num_maps: int,
        num_rooms: Sequence[int],
        room_size: Sequence[int],
        num_objects: int,
        max_steps: int,
        observation: str,
    ) -> "GridworldSpec":
        """Resolves the arguments of an environment.

        Raises:
            ValueError: for an unknown level or observation, or sizes that make no map.
        """
        level = level.removeprefix("gridworld/")
        distribution = distributions.by_name(level)
        if observation not in OBSERVATIONS:
            raise ValueError(f"observation must be 'image' or 'tiles', got {observation!r}")
        if max_steps < 1:
            raise ValueError(f"max_steps must be at least 1, got {max_steps}")
        for name, pair in (("num_rooms", num_rooms), ("room_size", room_size)):
            if len(pair) != 2:
                raise ValueError(f"{name} must be (rows, columns), got {pair}")
        return cls(
            level=level,
            maps=build_maps(
                num_maps, (num_rooms[0], num_rooms[1]), (room_size[0], room_size[1]), num_objects
            ),
            map_cdf=pcg64.cumulative(distribution(num_maps)),
            target_cdf=pcg64.cumulative(distribution(num_objects)),
            max_steps=max_steps,
            observation=observation,
        )

    @property
    def situation(self) -> dict[str, int]:
        """Names and sizes of the ranks an episode is drawn at."""
        return {"map": self.maps.num_maps, "target": self.maps.num_objects}

    @property
    def action_space(self) -> spaces.Discrete:
        return spaces.Discrete(len(MOVES))

    @property
    def observation_space(self) -> spaces.Dict:
        if self.observation == "image":
            image = spaces.Box(0, 255, (IMAGE_SIZE, IMAGE_SIZE, 3), dtype=np.uint8)
            return spaces.Dict({"image": image})
        return spaces.Dict(
            {
                "tiles": spaces.Box(0, NUM_CODES - 1, (VIEW, VIEW), dtype=np.uint8),
                "cue": spaces.Box(0, NUM_CODES - 1, (1,), dtype=np.uint8),
            }
        )

    def observe(
        self,
        out: dict[str, NDArray[np.uint8]],
        mask: NDArray[np.bool_],
        worlds: NDArray[np.int64],
    ) -> None:
        """Writes what is seen in the worlds of `mask` to their rows of `out`."""
        codes, cells = self.maps.codes, self.maps.cells
        if self.observation == "image":
            kernels.draw_images(mask, worlds, codes, cells, kernels.STRIPES, out["image"])
        else:
            kernels.draw_tiles(mask, worlds, codes, cells, out["tiles"], out["cue"])
