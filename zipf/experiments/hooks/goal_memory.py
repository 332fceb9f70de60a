"""A memory of the last episodes of each goal, from which goals are drawn alike."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

Parts = dict[str, NDArray[Any]]
Episode = tuple[Parts, Parts]
"""Observations and fields, {name: [length, ...]}."""


class GoalMemory:
    """Keeps the last `per_goal` episodes of each goal.

    Draws every goal as often as the others, however rare its episodes are, and of a goal every kept
    episode (as classes are in class-balanced sampling: Kang et al. 2020). To draw episodes that
    asked for a goal as often as those that achieved it, keep them under different goals.
    """

    def __init__(self, per_goal: int):
        self.per_goal = per_goal
        self._episodes: dict[tuple[int, ...], list[Episode]] = {}

    def add(self, goal: NDArray[Any], episode: Episode) -> None:
        """Keeps an episode of `goal` [K], in the place of the oldest where there are enough."""
        episodes = self._episodes.setdefault(tuple(goal.tolist()), [])
        if len(episodes) == self.per_goal:
            del episodes[0]
        episodes.append(episode)

    def draw(self, count: int, generator: torch.Generator) -> list[Episode]:
        """So many episodes, with replacement; none as long as none is kept."""
        goals = list(self._episodes.values())
        if not goals:
            return []
        numbers = torch.rand(count, 2, generator=generator, dtype=torch.float64).tolist()
        drawn = [(goals[int(first * len(goals))], second) for first, second in numbers]
        return [episodes[int(second * len(episodes))] for episodes, second in drawn]

    def state_dict(self) -> list[dict[str, Any]]:
        """All episodes, goal by goal."""
        return [
            {"goal": list(goal), "observation": observation, "fields": fields}
            for goal, episodes in self._episodes.items()
            for observation, fields in episodes
        ]

    def load_state_dict(self, state: list[dict[str, Any]]) -> None:
        self._episodes = {}
        for one in state:
            self.add(np.array(one["goal"]), (one["observation"], one["fields"]))
