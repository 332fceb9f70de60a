"""Zipf's Gridworld as tensors: many envs that a device steps by itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from zipf.envs.arguments import checked
from zipf.envs.gridworld import GridworldOptions
from zipf.envs.gridworld.level import Level
from zipf.envs.gridworld.maps import MOVES, PAD, VIEW
from zipf.envs.gridworld.sprites import (
    AGENT,
    CELL,
    FIRST_LOOK,
    FLOOR,
    NUM_CODES,
    SPRITES,
    WALL,
)
from zipf.envs.gridworld.symmetries import sources
from zipf.envs.tensor import Codes, Stepped, TensorEnv

_CELLS = VIEW * VIEW
_LOOKS = 2 * NUM_CODES  # of the codes of cells, and of cues
_TURNS = 4  # of the pictures


class GridworldTensorEnv(TensorEnv):
    """`N` envs of Zipf's Gridworld on a device; see `GridworldEnv` for the task and its arguments.

    Codes are what the option `observation=tiles` shows: `tiles` uint8 [N, 7, 7] and `cue` uint8
    [N, 1], 50 bytes, of which `decode` draws images of 11,907.

    A place is a cell of all maps with their padding, counted from 0. The state of an env is its
    situation (`map * objects + target`), its place and the length of its episode, int64 each.
    """

    achieves = True

    def __init__(
        self,
        num_envs: int = 1,
        level: str = "zipf_2",
        *,
        device: str | torch.device,
        **options: Any,
    ) -> None:
        self.level = Level.make(level, checked(GridworldOptions, options))
        super().__init__(
            num_envs,
            single_observation_space=self.level.observation_space,
            single_action_space=self.level.action_space,
            situation=self.level.situation,
            max_steps=self.level.max_steps,
            device=device,
        )
        maps = self.level.maps
        self._targets = maps.num_objects
        count, height, width = maps.codes.shape
        on_board = maps.cells + PAD
        places = (np.arange(count)[:, None] * height + on_board[..., 0]) * width + on_board[..., 1]
        down, right = np.array(MOVES).T
        rows, columns = np.indices((VIEW, VIEW)) - PAD
        codes = maps.codes.reshape(-1)
        put = self._put
        self._map_cdf, self._target_cdf = put(self.level.map_cdf), put(self.level.target_cdf)
        self._codes = put(codes)  # uint8 [places]
        self._starts = put(places[:, -1])  # by map
        self._goals = put(places[:, :-1].reshape(-1))  # the target's place, by situation
        self._cues = put(codes[places[:, :-1]].reshape(-1, 1))  # the target's code, likewise
        # int64 [3, actions], to the next place, and its parts down and right
        self._moves = put(np.stack([down * width + right, down * width, right]))
        self._view = put((rows * width + columns).reshape(-1))  # from the agent's place

        board = sources(VIEW)
        board[:, 0] = 0  # the first cell is hidden
        self._board = put(board)  # int64 [8, 49]
        pixels = SPRITES.reshape(_LOOKS, CELL * CELL, 3)
        turned = pixels[:, sources(CELL)[:_TURNS]].swapaxes(0, 1)  # [turns, looks, pixels, 3]
        # Rows of pixels of the sprites, uint8 [turns * looks * 9, 27]; one after another they make
        # an image, without a second copy.
        self._stripes = put(turned.reshape(-1, CELL * 3))
        self._within = torch.arange(CELL, dtype=torch.int32, device=self.device)[:, None]
        self._pictures = _TURNS if self.level.observation == "image" else 1

        self._situation = torch.zeros(self.num_envs, dtype=torch.int64, device=self.device)
        self._place = self._starts[0].repeat(self.num_envs)
        self._length = torch.zeros_like(self._situation)

    def _put(self, array: np.ndarray) -> Tensor:
        return torch.tensor(array, device=self.device)

    def tensors(self) -> dict[str, Tensor]:
        return {"situation": self._situation, "place": self._place, "length": self._length}

    def begin(self, mask: Tensor, forced: Tensor | None = None) -> None:
        shape = 2, self.num_envs
        drawn = torch.rand(shape, dtype=torch.float64, device=self.device, generator=self.generator)
        map = torch.searchsorted(self._map_cdf, drawn[0], right=True)
        target = torch.searchsorted(self._target_cdf, drawn[1], right=True)
        if forced is not None:
            map = torch.where(forced[0] < 0, map, forced[0])
            target = torch.where(forced[1] < 0, target, forced[1])
        situation = map * self._targets + target
        self._situation.copy_(torch.where(mask, situation, self._situation))
        self._place.copy_(torch.where(mask, self._starts[map], self._place))
        self._length.masked_fill_(mask, 0)

    def step(self, action: Tensor) -> Stepped:
        moves = self._moves[:, action]
        wall = self._codes[self._place + moves] == WALL
        # A move along an axis stays in its place in the other, where there is no wall.
        blocked = wall[0] | (wall[1] & wall[2])
        place = self._place + moves[0].masked_fill(blocked, 0)
        self._place.copy_(place)
        self._length.add_(1)

        code = self._codes[place]
        terminated = code >= FIRST_LOOK  # any object ends an episode
        truncated = ~terminated & (self._length >= self.max_steps)
        success = place == self._goals[self._situation]
        final = self.observe()
        outcome = {
            "map": self._situation // self._targets,
            "target": self._situation % self._targets,
            "return": success.double(),  # it is the only reward
            "length": self._length.clone(),
            "success": success,
        }
        if self._reports_achieved:
            outcome["achieved"] = code[:, None]  # the cue of the object that was touched
            outcome["has_achieved"] = terminated
        self.begin(terminated | truncated)
        return Stepped(success.float(), terminated, truncated, final, outcome)

    def observe(self) -> Codes:
        tiles = self._codes[self._place[:, None] + self._view]
        middle = tiles[:, _CELLS // 2]
        middle.masked_fill_(middle == FLOOR, AGENT)
        tiles[:, 0].fill_(FLOOR)
        return {"tiles": tiles.view(-1, VIEW, VIEW), "cue": self._cues[self._situation]}

    def decode(self, codes: Mapping[str, Tensor], symmetry: Tensor | None = None) -> Codes:
        tiles = codes["tiles"].flatten(-2)
        if symmetry is not None:
            tiles = tiles.gather(-1, self._board[symmetry // self._pictures])
        if self.level.observation == "tiles":
            return {"tiles": tiles.unflatten(-1, (VIEW, VIEW)), "cue": codes["cue"]}
        looks = _looks(tiles, codes["cue"])
        if symmetry is not None:
            looks = looks + (symmetry % self._pictures * _LOOKS).int().unsqueeze(-1)
        stripes = looks.unflatten(-1, (VIEW, 1, VIEW)) * CELL + self._within  # [*batch, 7, 9, 7]
        side = VIEW * CELL
        image = self._stripes.index_select(0, stripes.flatten())
        return {"image": image.view(*tiles.shape[:-1], side, side, 3)}

    def read_goal(self, codes: Mapping[str, Tensor]) -> Tensor:
        """The cue's code, uint8 [*batch, 1]."""
        return codes["cue"]

    def write_goal(self, codes: Mapping[str, Tensor], goals: Tensor) -> Codes:
        return {**codes, "cue": goals}

    def hashes(self, weights: Mapping[str, Tensor]) -> Callable[[Mapping[str, Tensor]], Tensor]:
        if self.level.observation == "tiles":
            return super().hashes(weights)
        self._check_weights(weights)
        by_cell = (
            weights["image"].view(VIEW, CELL, VIEW, CELL * 3).transpose(1, 2).reshape(_CELLS, -1)
        )
        sprites = self._stripes[: _LOOKS * CELL].view(_LOOKS, -1).long()
        table = torch.stack([(sprites * cell).sum(-1) for cell in by_cell]).view(-1)
        first = torch.arange(0, len(table), _LOOKS, device=self.device)

        def hashed(codes: Mapping[str, Tensor]) -> Tensor:
            return table[_looks(codes["tiles"].flatten(-2), codes["cue"]) + first].sum(-1)

        return hashed

    def _check_state(self, state: Mapping[str, Tensor]) -> None:
        # The device indexes with these numbers, and could say no more than that one is wrong.
        maps = self.level.maps
        free = np.zeros(maps.codes.shape, np.bool_)
        free[:, PAD:-PAD, PAD:-PAD] = maps.boards != WALL
        situation, place, length = (state[name].numpy() for name in self.tensors())
        for name, values, limit in (
            ("situation", situation, len(self._goals)),
            ("place", place, free.size),
        ):
            if (values < 0).any() or (values >= limit).any():
                raise ValueError(f"the state is of other maps, or damaged: a {name} out of range")
        if not free.reshape(-1)[place].all():
            raise ValueError("the state is of other maps, or damaged: an agent in a wall")
        if (place // free[0].size != situation // self._targets).any():
            raise ValueError("the state is of other maps, or damaged: an agent on another map")
        if (length < 0).any():
            raise ValueError("the state is damaged: lengths of episodes out of range")


def _looks(tiles: Tensor, cue: Tensor) -> Tensor:
    """What each cell of the image shows, int32 [*batch, 49]: the code, or past all codes that of
    the cue."""
    return torch.cat([cue.int() + NUM_CODES, tiles[..., 1:].int()], -1)
