"""What a gridworld level is: its maps, its distributions, its spaces; one env's or many's."""

from dataclasses import dataclass

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from zipf.envs import distributions, pcg64
from zipf.envs.distributions import Distribution
from zipf.envs.gridworld import GridworldOptions, kernels
from zipf.envs.gridworld.maps import MOVES, VIEW, Maps, build_maps, fresh_from
from zipf.envs.gridworld.sprites import CELL, NUM_CODES

FRESH = "fresh"  # the level of the fresh maps, all situations of which are equally likely

OBSERVATIONS: dict[str, dict[str, tuple[int, ...]]] = {
    "image": {"image": (VIEW * CELL, VIEW * CELL, 3)},
    "tiles": {"tiles": (VIEW, VIEW), "cue": (1,)},
}
"""Keys and shapes of what one env shows, all uint8, by the `observation` option."""


def distribution(name: str) -> Distribution:
    """What the ranks of maps and of targets are drawn from, each by itself, on the level of a name
    without its family. Raises ValueError: there is no such level."""
    if name == FRESH:
        return distributions.uniform
    try:
        return distributions.by_name(name)
    except ValueError as error:
        raise ValueError(f"{error}, or '{FRESH}'") from None


def maps_of(name: str, options: GridworldOptions) -> Maps:
    """The maps of the level of a name."""
    return build_maps(
        options.num_maps,
        (options.num_rooms[0], options.num_rooms[1]),
        (options.room_size[0], options.room_size[1]),
        options.num_objects,
        fresh_from(options.num_maps) if name == FRESH else 0,
    )


@dataclass(frozen=True, eq=False)
class Level:
    """A level with its constructor options, checked and resolved."""

    name: str  # the level's name without its family
    maps: Maps
    # map_cdf, target_cdf: cumulated probabilities of the ranks, float64 [maps], [objects]
    map_cdf: NDArray[np.float64]
    target_cdf: NDArray[np.float64]
    max_steps: int  # after how many steps an episode is truncated
    observation: str  # "image" or "tiles"

    @classmethod
    def make(cls, name: str, options: GridworldOptions) -> "Level":
        """Resolves the arguments of an environment.
        Raises ValueError for an unknown level, or sizes that make no map."""
        if not isinstance(name, str):
            raise ValueError(f"level must be a level's name, got {name!r}")
        name = name.removeprefix("gridworld/")
        of_ranks = distribution(name)
        sizes = {"num_maps": options.num_maps, "num_objects": options.num_objects}
        for option, size in sizes.items():
            if of_ranks in (distributions.rare, distributions.validation) and size < 5:
                raise ValueError(
                    f"{option} must be at least 5 for level {name!r}, a fifth; got {size}"
                )
        return cls(
            name=name,
            maps=maps_of(name, options),
            map_cdf=pcg64.cumulative(of_ranks(options.num_maps)),
            target_cdf=pcg64.cumulative(of_ranks(options.num_objects)),
            max_steps=options.max_steps,
            observation=options.observation,
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
        highest = 255 if self.observation == "image" else NUM_CODES - 1
        shapes = OBSERVATIONS[self.observation]
        return spaces.Dict(
            {key: spaces.Box(0, highest, shape, dtype=np.uint8) for key, shape in shapes.items()}
        )

    def observe(
        self, out: dict[str, NDArray[np.uint8]], mask: NDArray[np.bool_], envs: NDArray[np.int64]
    ) -> None:
        """Writes what is seen in the envs of `mask` to their rows of `out`."""
        codes, cells = self.maps.codes, self.maps.cells
        if self.observation == "image":
            kernels.draw_images(mask, envs, codes, cells, kernels.STRIPES, out["image"])
        else:
            kernels.draw_tiles(mask, envs, codes, cells, out["tiles"], out["cue"])
