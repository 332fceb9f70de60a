"""Zipf's Playroom, many envs at once."""

from collections.abc import Hashable, Mapping
from typing import Any, Self

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from zipf.envs.arguments import checked
from zipf.envs.playroom import PlayroomOptions, chipmunk, hand, judgement, layout, levels
from zipf.envs.playroom.achieved import Achievement, achieved
from zipf.envs.playroom.actions import ACTIONS
from zipf.envs.playroom.room import Room
from zipf.envs.playroom.state import GROUND_LAYER, YAW, make_commands, make_envs
from zipf.envs.playroom.view import View, extents_of
from zipf.envs.vector import Observation, ZipfVectorEnv


class PlayroomVectorEnv(ZipfVectorEnv):
    """`N` envs of Zipf's Playroom; see `PlayroomEnv` for the tasks and the arguments.

    Every episode takes the same number of draws from its env's random stream: one for each
    object, one each to choose the target and the task, and two that seed a stream of the
    episode's own for poses, colours and looks.

    A saved state is how each env's episode began and the actions since: `set_state` replays
    them, which takes up to a few hundredths of a second for each env.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 7.5}  # noqa: RUF012
    achieves = True
    sliceable = True
    _state_axis = {"forced": 1}  # noqa: RUF012

    def __init__(
        self,
        num_envs: int = 1,
        level: str = "lift/lift_shape_zipf3",
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        chosen = checked(PlayroomOptions, options)
        self.level = levels.by_name(level, chosen.frequent_exponent)
        height, width = chosen.image_size
        self.object_names = levels.ORDERS[chosen.object_order]
        self.looks = chosen.looks
        self.max_steps = self.time_limit = chosen.max_steps
        super().__init__(
            num_envs,
            single_observation_space=spaces.Dict(
                {
                    "image": spaces.Box(0, 255, (height, width, 3), dtype=np.uint8),
                    "instruction": levels.VOCABULARY.space(),
                }
            ),
            single_action_space=spaces.Discrete(len(ACTIONS)),
            situation=self.level.situation,
            autoreset_mode=autoreset_mode,
            copy=copy,
            render_mode=render_mode,
        )
        n, count = num_envs, self.level.others + 1
        # How the episode began, and the actions since.
        self._began = np.zeros((n, 4), np.uint64)
        self._forced = np.full((len(self.situation), n), -1, np.int64)
        self._actions = np.zeros((n, self.max_steps), np.uint8)
        # The state that follows from them.
        self.envs = make_envs(
            n,
            count,
            finding=self.level.finding,
            furnished=self.level.furnished,
            near_failure=chosen.near_failure,
            reach=float(chosen.reach),
            extents=extents_of(self.object_names),
        )
        self.rooms: list[Room | None] = [None] * n
        self._spaces = np.zeros(n, np.int64)  # addresses, of the rooms of episodes that have begun
        self._bodies = np.zeros((n, count + 1), np.int64)
        self._layers = np.full((n, count), GROUND_LAYER)  # as they are in the physics
        self._instructions = np.zeros((n, levels.VOCABULARY.length), np.int64)
        self._texts = np.full(n, "", "<U40")
        self._side = np.zeros(n, np.int64)
        self._view = View(
            self.object_names, self.envs, width, height, varied=chosen.looks == "varied"
        )
        self._commands = make_commands(n, count)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One frame of each env, uint8 [288, 384, 3], with `render_mode="rgb_array"`."""
        if self.render_mode is None:
            return None
        return self._view.frames(self._texts.tolist())

    def pictures(self, width: int, height: int) -> tuple[NDArray[np.uint8], ...]:
        """As `ZipfVectorEnv.pictures`: what the agent sees, with a cross where the hand points."""
        return self._view.pictures(width, height)

    def _begin(self, mask: NDArray[np.bool_], forced: NDArray[np.int64]) -> None:
        self._began[mask] = self._streams[mask]
        self._forced[:, mask] = forced[:, mask]
        self._start(mask, self._streams)

    def _start(self, mask: NDArray[np.bool_], streams: NDArray[np.uint64]) -> None:
        level, envs = self.level, self.envs
        tasks = np.array(level.tasks, np.int64)
        layout.draw_situations(mask, self._forced, level.probabilities, tasks, streams, envs)
        if not layout.lay_out(mask, envs):
            raise RuntimeError("no room for every object: this should not happen")
        layout.begin(mask, envs)
        for i in np.flatnonzero(mask).tolist():
            self._furnish(i)
            target = self.object_names[envs.ranks[i, 0]]
            text = levels.instruction(level, target, int(envs.task[i]))
            self._texts[i] = text
            self._instructions[i] = levels.VOCABULARY.encode(text)
        if level.finding:
            yaw = envs.agents[:, YAW]
            dx, dy = (envs.objects[:, 0, :2] - envs.agents[:, :2]).T
            self._side[mask] = (np.cos(yaw) * dy < np.sin(yaw) * dx)[mask]
        self._view.begin(mask)

    def _furnish(self, i: int) -> None:
        """Begins an episode in the physics of env `i`, from the poses in `envs`."""
        envs = self.envs
        room = self.rooms[i]
        if room is None:
            room = self.rooms[i] = Room(envs.ranks.shape[1], self.level.furnished)
        sizes = envs.extents[envs.ranks[i], :2]
        room.begin(
            envs.agents[i, :2].tolist(),
            np.concatenate([envs.objects[i, :, :3], sizes], axis=1).tolist(),
            envs.furniture[i].tolist() if self.level.furnished else [],
        )
        self._spaces[i], self._bodies[i] = room.addresses()
        self._layers[i] = GROUND_LAYER

    def _advance(
        self, actions: NDArray[np.int64], mask: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        rows = np.flatnonzero(mask)
        self._actions[rows, self._lengths[rows] - 1] = actions[rows]
        reward, terminated, success = self._play(mask, actions)
        truncated = ~terminated & (self._lengths >= self.max_steps)
        return reward, terminated, truncated, success

    def _play(
        self, mask: NDArray[np.bool_], actions: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_]]:
        """Steps the envs of `mask`; returns reward, terminated and success [N]."""
        before = self.envs.objects[:, :, :2].copy()
        reward = np.zeros(self.num_envs)
        terminated = np.zeros(self.num_envs, np.bool_)
        success = np.zeros(self.num_envs, np.bool_)
        hand.control(mask, actions, self.envs, self._commands)
        start = self.envs.agents[:, :2].copy()
        self._simulate(mask)
        judgement.settle(mask, start, before, self.envs, reward, terminated, success)
        return reward, terminated, success

    def _simulate(self, mask: NDArray[np.bool_]) -> None:
        """Runs the physics of a step: moves the agents and objects of the envs of `mask`."""
        envs, commands = self.envs, self._commands
        for i, j in np.argwhere(mask[:, None] & (commands.layers != self._layers)).tolist():
            self._room(i).set_layer(j, int(commands.layers[i, j]))
        np.copyto(self._layers, commands.layers, where=mask[:, None])
        for i in np.flatnonzero(mask & (commands.turned >= 0)).tolist():
            item = int(commands.turned[i])
            self._room(i).place(item, *envs.objects[i, item, :3].tolist())
        # The compiled code works on whatever is at these addresses.
        assert self._spaces.all(where=mask), "there is no physics of an env that is to be stepped"
        chipmunk.move_held(
            mask,
            chipmunk.functions(),
            self._bodies,
            envs.hands,
            commands.turned,
            commands.drives,
            envs.agents,
            envs.objects,
        )
        chipmunk.simulate(
            mask,
            chipmunk.functions(),
            self._spaces,
            self._bodies,
            commands.forces,
            envs.agents,
            envs.objects,
        )

    def _room(self, i: int) -> Room:
        room = self.rooms[i]
        assert room is not None
        return room

    def _observe(self, out: Observation, mask: NDArray[np.bool_]) -> None:
        self._view.draw(out["image"], mask)
        np.copyto(out["instruction"], self._instructions, where=mask[:, None])

    def _situations(self) -> dict[str, NDArray[np.int64]]:
        # Without furniture the task is not a part of the situation.
        columns = [*self.envs.ranks.T.copy(), self.envs.task.copy()]
        return dict(zip(self.situation, columns, strict=False))

    def _describe(self) -> dict[str, NDArray[Any]]:
        info: dict[str, NDArray[Any]] = {"instruction": self._texts.copy()}
        if self.level.finding:
            info["side"] = self._side.copy()
        return info

    def _achieved(self, ended: NDArray[np.bool_]) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """The instruction to lift, put or approach what was lifted, put or approached."""
        goals = np.zeros_like(self._instructions)
        has = np.zeros(self.num_envs, np.bool_)
        for i in np.flatnonzero(ended).tolist():
            found = self._achievement(i)
            if found is not None:
                target = self.object_names[self.envs.ranks[i, found[0]]]
                text = levels.instruction(self.level, target, found[1])
                goals[i] = levels.VOCABULARY.encode(text)
                has[i] = True
        return goals, has

    def _achievement(self, i: int) -> Achievement | None:
        return achieved(self.envs, i)

    def _engine(self) -> Hashable:
        level = self.level
        return (
            (level.furnished, level.finding, tuple(self.situation.items())),
            (self.object_names, self.looks, self.max_steps),
            (self.envs.reach, self.envs.near_failure),
            self.single_observation_space["image"].shape,
        )

    def _use_engine(self, other: Self) -> None:
        level = self.level
        self.__dict__.update(other.__dict__)
        self.level = level

    def _get_env_states(self) -> dict[str, NDArray[Any]]:
        return {"began": self._began, "forced": self._forced, "actions": self._actions}

    def _set_env_states(self, state: Mapping[str, NDArray[Any]]) -> None:
        # The compiled functions index with these and check no bounds.
        sizes = np.array(list(self.situation.values()))[:, None]
        if (
            (state["forced"] < -1).any()
            or (state["forced"] >= sizes).any()
            or (state["actions"] >= len(ACTIONS)).any()
            or (state["lengths"] > self.max_steps).any()
            or (state["running"] & (state["lengths"] == self.max_steps)).any()
        ):
            raise ValueError(
                "the state is of another level, or damaged: ranks, actions or lengths out of range"
            )
        self._began[:] = state["began"]
        self._forced[:] = state["forced"]
        self._actions[:] = state["actions"]
        self._replay(state["seeded"], state["lengths"])

    def _replay(self, begun: NDArray[np.bool_], lengths: NDArray[np.int64]) -> None:
        self._start(begun, self._began.copy())
        for t in range(int(lengths.max(where=begun, initial=0))):
            self._play(begun & (lengths > t), self._actions[:, t].astype(np.int64))

    def __getstate__(self) -> dict[str, Any]:
        return {**super().__getstate__(), "rooms": [None] * self.num_envs}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._replay(self._seeded, self._lengths)
