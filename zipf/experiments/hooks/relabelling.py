"""Hindsight: whole episodes, relabelled with what they achieved."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor

from zipf.agents.hindsight import AchievedOptions, NoHindsightOptions
from zipf.agents.unroll import Unroll
from zipf.envs.goals import Goal
from zipf.envs.vector import ZipfVectorEnv
from zipf.experiments.hooks.augmentation import Draws
from zipf.experiments.hooks.goal_memory import Episode, GoalMemory, Parts
from zipf.experiments.hooks.hook import OF_EPISODES, Hook, Row, arrays
from zipf.experiments.hooks.hook import Parts as Tensors
from zipf.registry import Registry

_FIRST_ROWS = 64  # ours: room for short episodes; it doubles where an episode is longer


class Hindsight(Hook):
    """Keeps the running episode of each of N envs, and relabels those that end.
    Raises ValueError: the envs do not say what an episode asks for, or what it has achieved.

    Args:
        options: how many episodes, and how many of their last frames.
        goal: reads what episodes ask for and replaces it; None where nothing says it.
        env: the envs; told to report what episodes achieve.
        clip: makes rewards those that are learned from; None: they are the same.
        seed: of the draws among more episodes than are asked for.
        draws: of the augmentation; kept episodes are drawn anew whenever they are learned from.
        teacher: whether fields have a teacher's actions as `label`. The memory then also keeps
            every episode for the goal that it was asked for, with these in the place of the
            actions taken; those that achieved another goal are kept and drawn apart from them.
            Where a matcher learns, its episodes say whether they `achieved` what they ask for.
    """

    name = "hindsight"

    def __init__(
        self,
        options: AchievedOptions,
        goal: Goal | None,
        env: ZipfVectorEnv,
        *,
        clip: Callable[[Tensor], Tensor] | None = None,
        seed: int,
        draws: Draws | None = None,
        teacher: bool = False,
    ):
        if goal is None:
            raise ValueError("these envs do not say what an episode asks for")
        env.report_achieved()
        self.options = options
        self._regions = env.action_regions if options.matching_cost else None
        self.goal = goal
        self.reward = reward_of(options, clip)
        self._teacher = teacher
        self._draws = draws
        # Another stream than that of the agent's actions, which stay as they are.
        own = np.random.SeedSequence([seed, 1]).generate_state(1)
        self._generator = torch.Generator().manual_seed(int(own[0]))
        self._envs = np.arange(env.num_envs)
        self._lengths = np.zeros(env.num_envs, np.int64)  # of the running episodes, so far
        # [rows, N]: frame k of an episode is in row k % rows.
        self._rows = options.length or _FIRST_ROWS
        like = {name: (part.shape[1:], part.dtype) for name, part in env.allocate().items()}
        self._observation = self._zeros(like)
        fields: dict[str, tuple[tuple[int, ...], Any]] = {
            name: ((), torch.empty(0, dtype=dtype).numpy().dtype)
            for name, dtype in OF_EPISODES.items()
        }
        if teacher:
            fields["label"] = (), np.dtype(np.int64)
        if draws is not None:
            fields["draw"] = (draws.augmentation.size,), np.dtype(np.float64)
        self._fields = self._zeros(fields)
        self._memory = GoalMemory(options.kept_per_goal) if options.kept_per_goal else None
        self._chosen: list[Episode] = []
        self._candidates = 0

    def begin(self, observation: Tensors, mask: Tensor) -> None:
        self._lengths[mask.numpy()] = 0

    def step(self, row: Row) -> None:
        observation, fields = arrays(row.observation), arrays(row.fields)
        ended, outcome = row.ended.numpy(), arrays(row.outcome)
        if self.options.length is None and self._lengths.max() == self._rows:
            self._grow(2 * self._rows)
        rows = self._lengths % self._rows
        for kept, given in ((self._observation, observation), (self._fields, fields)):
            for name, part in kept.items():
                part[rows, self._envs] = given[name]
        self._lengths += 1
        if not ended.any():
            return
        goals, achieved = outcome["achieved"], ended & outcome["has_achieved"]
        asked = self.goal.read(observation)
        other = achieved & (goals != asked).any(1)
        if self._memory is None:
            for i in np.flatnonzero(other).tolist():
                self._choose(i, goals[i])
        elif self._teacher:
            for i in np.flatnonzero(ended).tolist():
                succeeded = bool(achieved[i] and not other[i])
                self._memory.add(np.append(asked[i], 1), self._labelled(i, succeeded))
            for i in np.flatnonzero(other).tolist():
                self._memory.add(np.append(goals[i], 0), self._relabelled(i, goals[i]))
        else:
            for i in np.flatnonzero(achieved).tolist():
                self._memory.add(goals[i], self._relabelled(i, goals[i]))

    def _choose(self, i: int, goal: NDArray[Any]) -> None:
        """Relabels the episode of an env that has just ended, or, where there are more than are
        asked for, draws whether to: each is as likely to be kept."""
        self._candidates += 1
        place = len(self._chosen)
        if place == self.options.episodes:
            place = int(torch.randint(self._candidates, (), generator=self._generator))
        if place < self.options.episodes:
            self._chosen[place : place + 1] = [self._relabelled(i, goal)]

    def finish(self, unroll: Unroll) -> None:
        """Gives the unroll the relabelled episodes to learn from, [L, E], if there are any: those
        since the last call, or some of the memory's."""
        chosen, self._chosen, self._candidates = self._chosen, [], 0
        if self._memory is not None:
            kept = self._memory.draw(self.options.episodes, self._generator)
            chosen = [self._drawn_anew(episode) for episode in kept]
        if not chosen:
            return
        lengths = torch.tensor([len(fields["reward"]) for _, fields in chosen])
        shape = int(lengths.max()), len(chosen)
        row = torch.arange(shape[0])[:, None]
        inside = row < lengths
        episodes = TensorDict({"mask": inside}, batch_size=shape)
        episodes["observation"] = TensorDict(_padded([seen for seen, _ in chosen], shape), shape)
        episodes.update(_padded([fields for _, fields in chosen], shape))
        episodes["previous_action"][~inside] = -1
        episodes["is_first"] = ~inside | (row == 0)
        episodes["terminated"] = row == lengths - 1
        episodes["truncated"] = torch.zeros_like(inside)
        unroll.episodes = episodes

    def state_dict(self) -> dict[str, Any]:
        """The running episodes, with zeros in the place of what is left of earlier ones, and the
        memory."""
        lengths = np.minimum(self._lengths, self._rows)
        row = np.arange(lengths.max())[:, None]

        def running(parts: Parts) -> Parts:
            copies = {name: part[: len(row)].copy() for name, part in parts.items()}
            for copy in copies.values():
                copy[row >= lengths] = 0
            return copies

        return {
            "generator": self._generator.get_state(),
            "lengths": self._lengths.copy(),
            "observation": running(self._observation),
            "fields": running(self._fields),
            "kept": [] if self._memory is None else self._memory.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self._chosen, self._candidates = [], 0
        self._generator.set_state(torch.as_tensor(state["generator"]))
        self._lengths[:] = state["lengths"]
        used = len(state["fields"]["reward"])
        if used > self._rows:
            self._grow(used)
        for name, part in state["observation"].items():
            self._observation[name][:used] = part
        for name, part in state["fields"].items():
            self._fields[name][:used] = part
        if self._memory is not None:
            self._memory.load_state_dict(state["kept"])

    def _relabelled(self, i: int, goal: NDArray[Any]) -> Episode:
        """The episode of an env that has just ended, as if it had been asked for this goal."""
        observation, fields = self._episode(i)
        everywhere = np.ones(len(fields["reward"]), np.bool_)
        self.goal.write(observation, np.repeat(goal[None], len(everywhere), axis=0), everywhere)
        fields["reward"][-1] = self.reward
        if self._teacher and self._memory is not None and self.options.matching_cost:
            fields["achieved"] = everywhere
        fields.pop("label", None)
        if self._memory is None:
            self._point(fields)
        return observation, fields

    def _labelled(self, i: int, succeeded: bool) -> Episode:
        """The episode of an env that has just ended, for the memory, with what the teacher would
        have done for the actions taken."""
        observation, fields = self._episode(i)
        if self.options.matching_cost:
            fields["achieved"] = np.full(len(fields["reward"]), succeeded)
        fields["action"] = fields.pop("label")
        return observation, fields

    def _episode(self, i: int) -> Episode:
        """The kept frames of the running episode of an env, as it was."""
        length = int(self._lengths[i])
        rows = np.arange(max(length - self._rows, 0), length) % self._rows
        observation = {name: part[rows, i] for name, part in self._observation.items()}
        fields = {name: part[rows, i] for name, part in self._fields.items()}
        return observation, fields

    def _drawn_anew(self, episode: Episode) -> Episode:
        """An episode of the memory for the agent to see as another draw changes it."""
        observation, fields = episode[0], dict(episode[1])
        if self._draws is not None:
            change, before = self._draws.augmentation, fields["draw"]
            fields["draw"] = self._draws.draw(1).repeat(len(before), 0)
            for name in ("previous_action", "action"):
                played = change.to_env(fields[name], before)
                fields[name] = change.to_agent(played, fields["draw"])
        self._point(fields)
        return observation, fields

    def _point(self, fields: Parts) -> None:
        """Adds the regions of the image that the actions point at, where they do, as the
        augmentation has moved them."""
        if self._regions is not None:
            fields["region"] = self._regions[fields["action"]]
            if self._draws is not None:
                fields["region"] = self._draws.augmentation.move(fields["region"], fields["draw"])

    def _grow(self, rows: int) -> None:
        """Makes room for longer episodes; no frame has been overwritten yet."""
        for kept in (self._observation, self._fields):
            for name, part in kept.items():
                kept[name] = np.zeros((rows, *part.shape[1:]), part.dtype)
                kept[name][: len(part)] = part
        self._rows = rows

    def _zeros(self, like: dict[str, tuple[tuple[int, ...], Any]]) -> Parts:
        shape = self._rows, len(self._envs)
        return {name: np.zeros((*shape, *tail), dtype) for name, (tail, dtype) in like.items()}


def reward_of(options: AchievedOptions, clip: Callable[[Tensor], Tensor] | None) -> float:
    """What success pays, as it is learned from."""
    reward = torch.tensor([options.reward], dtype=torch.float64)
    return float(reward if clip is None else clip(reward))


RELABELLINGS: Registry[Hook | None] = Registry("hindsight")
"""Each is built from its options, which derive from `AchievedOptions`, the goal and the envs, and
by name `clip`, `seed`, `draws` and `teacher`; it raises ValueError where the envs do not
tell what an episode has achieved."""

RELABELLINGS.register(NoHindsightOptions, lambda options, goal, env, **named: None)
RELABELLINGS.register(AchievedOptions, Hindsight)


def _padded(episodes: list[Parts], shape: tuple[int, int]) -> dict[str, torch.Tensor]:
    """Episodes {name: [length, ...]} beside each other, with zeros behind the shorter ones."""
    padded = {}
    for name, first in episodes[0].items():
        array = np.zeros((*shape, *first.shape[1:]), first.dtype)
        for e, episode in enumerate(episodes):
            array[: len(episode[name]), e] = episode[name]
        padded[name] = torch.from_numpy(array)
    return padded
