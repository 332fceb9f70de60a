"""Zipf's Labyrinth, many envs at once."""

from collections.abc import Hashable, Mapping
from typing import Any, Self

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from zipf.envs import pcg64
from zipf.envs.arguments import checked
from zipf.envs.labyrinth import engine
from zipf.envs.labyrinth.actions import commands
from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.levels import LEVELS, Level, by_name
from zipf.envs.labyrinth.options import LabyrinthOptions
from zipf.envs.labyrinth.scenery import LARGE, Scenery
from zipf.envs.labyrinth.state import FRAMES_PER_SECOND, clear, make_envs
from zipf.envs.labyrinth.topdown import draw_map, empty_map
from zipf.envs.labyrinth.words import VOCABULARY
from zipf.envs.labyrinth.world import World
from zipf.envs.vector import Observation, ZipfVectorEnv


class LabyrinthVectorEnv(ZipfVectorEnv):
    """`N` envs of a level of Zipf's Labyrinth; see `LabyrinthEnv`.

    An episode takes one number of its env's random stream, which seeds generators of its own:
    one for the layout and one for each map. A saved state is that number and the actions since:
    `set_state` replays them.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 15}  # noqa: RUF012
    reports_success = False
    sliceable = True

    def __init__(
        self,
        num_envs: int = 1,
        level: str = "explore_goal_locations_small",
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        chosen = checked(LabyrinthOptions, options)
        self.level = by_name(level)
        self._rules = self.level.load()
        height, width = chosen.image_size
        self.action_repeat = chosen.action_repeat
        self.metadata = {**self.metadata, "render_fps": FRAMES_PER_SECOND / self.action_repeat}
        self.max_steps = chosen.max_steps
        self.time_limit = self._steps(self.level)
        super().__init__(
            num_envs,
            single_observation_space=spaces.Dict(
                {
                    "image": spaces.Box(0, 255, (height, width, 3), dtype=np.uint8),
                    "instruction": VOCABULARY.space(),
                }
            ),
            single_action_space=spaces.Discrete(chosen.num_actions),
            situation={},
            autoreset_mode=autoreset_mode,
            copy=copy,
            render_mode=render_mode,
        )
        n = num_envs
        longest = max(map(self._steps, LEVELS.values()))
        # How the episode began, and the actions since.
        self.seeds = np.zeros(n, np.float64)
        self._actions = np.zeros((n, longest), np.uint8)
        # The state that follows from them.
        self.envs = make_envs(n)
        self.episodes: list[Episode | None] = [None] * n
        self.maps = np.zeros(n, np.int64)  # 1 for the layout, and one more for each map
        self._scenery = Scenery(self.envs, width, height)
        self._commands = commands(chosen.num_actions)
        self._rewards = np.zeros(n)
        self._left, self._part = np.zeros((2, n), np.int64)
        self._event, self._index = np.zeros((2, n), np.int64)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One frame of each env, uint8 [288, 672, 3], with `render_mode="rgb_array"`: the view
        of the player, and beside it the map from above, which is empty before an env's first
        episode."""
        if self.render_mode is None:
            return None
        return self._drawn(*LARGE)

    def pictures(self, width: int, height: int) -> tuple[NDArray[np.uint8], ...]:
        """As `ZipfVectorEnv.pictures`: what the agent sees, and beside it the map from above."""
        own = self._scenery.renderer
        high = max(round(min(height, width / (own.width / own.height + 1))), 1)
        return self._drawn(high, max(round(high * own.width / own.height), 1))

    def _drawn(self, height: int, width: int) -> tuple[NDArray[np.uint8], ...]:
        """Views of this size, with maps of their height."""
        views = self._scenery.large_views(height, width)
        maps = [
            empty_map(height) if episode is None else draw_map(self.envs, self._scenery, i, height)
            for i, episode in enumerate(self.episodes)
        ]
        return tuple(np.hstack(pair) for pair in zip(views, maps, strict=True))

    def _frames(self, level: Level) -> int:
        if self.max_steps is None:
            return level.frames
        return min(level.frames, self.max_steps * self.action_repeat)

    def _steps(self, level: Level) -> int:
        """The most steps of an episode of a level."""
        return -(-self._frames(level) // self.action_repeat)

    def _begin(self, mask: NDArray[np.bool_], forced: NDArray[np.int64]) -> None:
        for i in np.flatnonzero(mask).tolist():
            self.seeds[i] = pcg64.next_double(self._streams[i])
        self._start(mask)

    def _start(self, mask: NDArray[np.bool_]) -> None:
        for i in np.flatnonzero(mask).tolist():
            clear(self.envs, i)
            self._scenery.clear(i)
            self._part[i] = 0
            self.maps[i] = 0
            self.envs.limit[i] = self._frames(self.level)
            world = World(self.envs, self._scenery, i, self._rewards)
            self.episodes[i] = self._rules(world, self._generator(i))
            self._begin_map(i)

    def _generator(self, i: int) -> np.random.Generator:
        """For the layout of an episode, then for each of its maps."""
        self.maps[i] += 1
        seed = int(self.seeds[i] * 2**53)
        return np.random.default_rng([seed, int(self.maps[i])])

    def _begin_map(self, i: int) -> None:
        episode = self.episodes[i]
        assert episode is not None
        episode.begin_map(self._generator(i))

    def _advance(
        self, actions: NDArray[np.int64], mask: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        rows = np.flatnonzero(mask)
        self._actions[rows, self._lengths[rows] - 1] = actions[rows]
        return self._play(mask, actions)

    def _play(
        self, mask: NDArray[np.bool_], actions: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        over, timed_out = np.zeros((2, self.num_envs), np.bool_)
        taken = self._commands[actions]
        self._rewards[:] = 0.0
        self._left[:] = self.action_repeat
        while engine.run(
            mask, taken, self._left, self._part, self.envs, over, timed_out, self._event,
            self._index,
        ):  # fmt: skip
            for i in np.flatnonzero(self._event).tolist():
                self._tell(i, int(self._event[i]), int(self._index[i]))
        return self._rewards.copy(), over, timed_out, over

    def _tell(self, i: int, event: int, index: int) -> None:
        episode = self.episodes[i]
        assert episode is not None
        if event == engine.MAP:
            self._begin_map(i)
        elif event == engine.ITEM:
            episode.picked_up(index)
        elif event == engine.ZONE:
            episode.entered(index)
        elif event == engine.POINT:
            episode.scored(index)
        elif event == engine.TIMER:
            episode.went_off()
        elif event == engine.LOOKED:
            episode.looked_at(index)
        else:
            episode.looked_away(index)

    def _observe(self, out: Observation, mask: NDArray[np.bool_]) -> None:
        self._scenery.draw(out["image"], mask)
        np.copyto(out["instruction"], self.envs.instruction, where=mask[:, None])

    def _situations(self) -> dict[str, NDArray[np.int64]]:
        return {}

    def _describe(self) -> dict[str, NDArray[Any]]:
        texts = [episode.world.instruction if episode else "" for episode in self.episodes]
        return {"instruction": np.array(texts)}

    def _engine(self) -> Hashable:
        shape = self.single_observation_space["image"].shape
        return shape, int(self.single_action_space.n), self.action_repeat, self.max_steps

    def _use_engine(self, other: Self) -> None:
        level, rules = self.level, self._rules
        self.__dict__.update(other.__dict__)
        self.level, self._rules = level, rules

    def _get_env_states(self) -> dict[str, NDArray[Any]]:
        return {"seeds": self.seeds, "actions": self._actions}

    def _set_env_states(self, state: Mapping[str, NDArray[Any]]) -> None:
        most = self._steps(self.level)
        if (
            not ((state["seeds"] >= 0) & (state["seeds"] < 1)).all()
            or (state["actions"] >= self.single_action_space.n).any()
            or (state["lengths"] > most).any()
            or (state["running"] & (state["lengths"] == most)).any()
        ):
            raise ValueError(
                "the state is of another level, or damaged: seeds, actions or lengths out of range"
            )
        self.seeds[:] = state["seeds"]
        self._actions[:] = state["actions"]
        self._replay(state["seeded"], state["lengths"])

    def _replay(self, begun: NDArray[np.bool_], lengths: NDArray[np.int64]) -> None:
        self._start(begun)
        for t in range(int(lengths.max(where=begun, initial=0))):
            self._play(begun & (lengths > t), self._actions[:, t].astype(np.int64))

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "episodes": [None] * self.num_envs}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._replay(self._seeded, self._lengths)
