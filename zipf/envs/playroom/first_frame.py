"""The finding levels' first frames as questions: left or right?"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from zipf.envs.baselines import BaselineScore
from zipf.envs.playroom import levels
from zipf.envs.playroom.achieved import Achievement
from zipf.envs.playroom.baselines import blind
from zipf.envs.playroom.vector import PlayroomVectorEnv
from zipf.envs.splits import Split
from zipf.envs.vector import Observation

LEFT, RIGHT = 0, 1
_HALVES = np.array([[0, 0, 1, 0.5], [0, 0.5, 1, 1]], np.float32)  # top, left, bottom, right


class FirstFrameVectorEnv(PlayroomVectorEnv):
    """`N` envs of a `supervised/` level in which an episode is its first frame.

    The action says on which side the object is that the instruction names: `LEFT` or `RIGHT`. The
    reward is 1 if that is right, and the episode ends. Where both objects are the same, either
    answer is right, as in the paper. An answer achieves what names the object on that side.
    Episodes are drawn as `PlayroomVectorEnv` draws them.
    Raises ValueError: the level has no two sides to tell apart.
    """

    def __init__(
        self, num_envs: int = 1, level: str = "supervised/find_shape_zipf3", **options: Any
    ):
        super().__init__(num_envs, level, **options)
        if not self.level.finding:
            raise ValueError(
                f"playroom/{self.level.name} has no object on the left and on the right"
            )
        self.single_action_space = spaces.Discrete(2)
        self.action_regions = _HALVES
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._pointed_at = np.zeros(num_envs, np.int64)  # of the two objects, the target first
        # An answer changes nothing in view: a frame is drawn once, and shown before and after it.
        self._frames = self.allocate()["image"]
        self._has_frame = np.zeros(num_envs, np.bool_)

    def _start(self, mask: NDArray[np.bool_], streams: NDArray[np.uint64]) -> None:
        super()._start(mask, streams)
        self._has_frame[mask] = False

    def _observe(self, out: Observation, mask: NDArray[np.bool_]) -> None:
        new = mask & ~self._has_frame
        if new.any():
            self._view.draw(self._frames, new)
            self._has_frame |= new
        shown = slice(None) if mask.all() else mask  # a slice is much faster
        out["image"][shown] = self._frames[shown]
        out["instruction"][shown] = self._instructions[shown]

    def _furnish(self, i: int) -> None:
        """Does nothing: no question needs the physics, which would take two thirds of the time."""

    def _set_env_states(self, state: Mapping[str, NDArray[Any]]) -> None:
        # An answer ends the episode: one that is running has none, and none has two.
        if (state["lengths"] > ~state["running"]).any():
            raise ValueError(
                "the state is not one of questions, or damaged: an episode is its first frame"
            )
        super()._set_env_states(state)

    def _replay(self, begun: NDArray[np.bool_], lengths: NDArray[np.int64]) -> None:
        # An answer moves nothing, and without physics nothing could be moved.
        self._start(begun, self._began.copy())

    def _advance(
        self, actions: NDArray[np.int64], mask: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
        self._pointed_at = np.where(actions == self._side, 0, 1)
        right = (self._pointed_at == 0) | (self.envs.ranks[:, 0] == self.envs.ranks[:, 1])
        ended = np.ones(self.num_envs, np.bool_)
        return right.astype(np.float64), ended, ~ended, right

    def _achievement(self, i: int) -> Achievement:
        return int(self._pointed_at[i]), int(self.envs.task[i])


@dataclass(frozen=True)
class FirstFrames:
    """Makes a finding level whose episodes are questions; it has the level's own name."""

    level: str

    def __call__(self, num_envs: int, **options: Any) -> FirstFrameVectorEnv:
        return FirstFrameVectorEnv(num_envs, self.level.partition("/")[2], **options)

    def baseline(self, name: str, **options: Any) -> BaselineScore | None:
        """What a policy that does not learn scores with its answers, see `zipf.envs.baseline`.

        Random answers name a random one of the two objects, and so does a policy that cannot read:
        both score as a blind policy that walks to an object. No scripted policy answers questions.
        """
        if name not in ("chance", "blind"):
            return None
        known = blind(self.level.partition("/")[2], **options)
        return known and replace(known, policy=None)

    def __str__(self) -> str:
        return self.level


def questions(split: Split) -> Split:
    """A split of finding levels whose episodes are questions about their first frame.
    Raises ValueError: a level does not show two objects, left and right."""
    for one in split.all_levels:
        if not levels.by_name(one.name).finding:
            raise ValueError(
                f"the first frame of {one.name} does not show two objects, left and right"
            )
    asked: dict[str, Any] = {
        kind: [replace(one, level=FirstFrames(one.name)) for one in split.levels(kind)]
        for kind in split.kinds
    }
    return replace(split, **asked)
