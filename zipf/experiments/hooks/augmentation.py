"""Augmentation: random changes of what an agent sees in training, the same for a whole episode.

The agent acts and learns in envs that look otherwise: nothing is changed afterwards, so that
what it remembers, the policy that acted, and what it learns from always agree. Evaluations show the
envs as they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from zipf.agents.encoders import is_image
from zipf.compiled import compiled
from zipf.envs.family import Symmetries
from zipf.options import Options
from zipf.registry import Registry

Factor = Annotated[float, Field(ge=0.1, le=10)]


class NoAugmentationOptions(Options):
    """Observations as they are, as in the paper."""

    name: Literal["none"]


class RandomAugmentationOptions(Options):
    """What is drawn for every episode.

    `symmetries`: one of those that the envs' family declares. Images: `channels`: an order of
    the three colours; `shift`: whole pixels by which the image is moved down and to the right, from
    -shift to shift, its border repeated (Kostrikov et al. 2021); `scale`: least and largest factor
    by which it is enlarged around its centre before, log-uniformly (Simonyan and Zisserman 2015);
    `cutout`: the side of a black square whose centre is anywhere in the image (DeVries and Taylor
    2017).
    """

    name: Literal["random"]
    symmetries: bool
    channels: bool
    shift: Annotated[int, Field(ge=0, le=255)]
    cutout: Annotated[int, Field(ge=0, le=255)]
    scale: list[Factor] = Field([1.0, 1.0], min_length=2, max_length=2)

    @field_validator("scale")
    @classmethod
    def _in_order(cls, scale: list[float]) -> list[float]:
        if scale[0] > scale[1]:
            raise ValueError("the first should not be larger than the second")
        return scale


Draw = dict[str, NDArray]  # what was drawn for episodes, {name: [N, ...]}


class Augmentation:
    """Draws changes of the episodes of N envs and makes them.

    Args:
        options: what to draw.
        space: of the observations of one env.
        num_envs: N.
        seed: of the draws.
        symmetries: of these envs, where `options.symmetries`.

    Raises:
        ValueError: there is nothing to change, or no symmetries.
    """

    def __init__(
        self,
        options: RandomAugmentationOptions,
        space: gym.spaces.Dict,
        num_envs: int,
        *,
        seed: int,
        symmetries: Symmetries | None = None,
    ):
        if options.symmetries and symmetries is None:
            raise ValueError(
                "augmentation.symmetries=true: these envs declare no symmetries; choose "
                "augmentation.symmetries=false"
            )
        self.images = [name for name, part in space.items() if is_image(part)]
        self._space = space
        chosen = [name for name, off in _OF_IMAGES.items() if getattr(options, name) != off]
        if chosen and not self.images:
            raise ValueError(
                f"augmentation.{chosen[0]}: the observations have no image; choose "
                f"{_OF_IMAGES[chosen[0]]}"
            )
        if not chosen and not options.symmetries:
            raise ValueError(
                "augmentation=random: changes nothing with these values; choose augmentation=none"
            )
        self.options = options
        self.symmetries = symmetries if options.symmetries else None
        if self.symmetries is not None:
            self._inverse = self.symmetries.actions.argsort(1)
        self._rng = np.random.default_rng(seed)
        self._change_images = bool(chosen)
        self._drawn = _unchanged(num_envs)

    def begin(self, mask: NDArray[np.bool_]) -> None:
        """Draws anew for the envs of `mask` [N], in which an episode begins."""
        for name, values in self._draw(int(mask.sum())).items():
            self._drawn[name][mask] = values

    def _draw(self, n: int) -> Draw:
        """The changes of `n` episodes."""
        o, drawn = self.options, _unchanged(n)
        if self.symmetries is not None:
            drawn["symmetry"] = self._rng.integers(self.symmetries.count, size=n)
        if o.channels:
            drawn["order"] = self._rng.permuted(np.tile(np.arange(3), (n, 1)), axis=1)
        if o.shift:
            drawn["shift"] = self._rng.integers(-o.shift, o.shift + 1, size=(n, 2))
        if o.scale != [1, 1]:
            least, largest = np.log(o.scale)
            drawn["scale"] = np.exp(self._rng.uniform(least, largest, n))
        if o.cutout:
            drawn["centre"] = self._rng.random((n, 2))
        return drawn

    def observe(self, observation: dict[str, NDArray], mask: NDArray[np.bool_]) -> None:
        """Changes the envs' observations `{name: [N, ...]}`, in place, where `mask` [N]."""
        self._observe(observation, mask, **self._drawn)

    def _observe(
        self,
        observation: dict[str, NDArray],
        mask: NDArray[np.bool_],
        symmetry: NDArray[np.int64],
        order: NDArray[np.int64],
        shift: NDArray[np.int64],
        scale: NDArray[np.float64],
        centre: NDArray[np.float64],
    ) -> None:
        if self.symmetries is not None:
            self.symmetries(observation, symmetry, mask)
        if self._change_images:
            for name in self.images:
                _change(observation[name], mask, order, shift, scale, centre, self.options.cutout)

    def observe_episode(self, observation: dict[str, NDArray], i: int) -> Draw:
        """Changes the observations `{name: [frames, ...]}` of the running episode of one env, in
        place; returns what was drawn for it."""
        drawn = {name: values[i : i + 1] for name, values in self._drawn.items()}
        self._change_frames(observation, drawn)
        return drawn

    def actions_to_envs(self, fields: dict[str, NDArray], i: int) -> None:
        """Makes the actions in the fields `{name: [frames]}` of the running episode of one env
        those of the env, in place."""
        if self.symmetries is not None:
            _replace_actions(fields, self.symmetries.actions[self._drawn["symmetry"][i]])

    def change_episode(self, observation: dict[str, NDArray], fields: dict[str, NDArray]) -> Draw:
        """Changes an episode, as an env has it, by a draw of its own, in place: observations
        `{name: [frames, ...]}`, and the actions in `fields` `{name: [frames]}`; returns the draw.
        """
        drawn = self._draw(1)
        self._change_frames(observation, drawn)
        if self.symmetries is not None:
            _replace_actions(fields, self._inverse[drawn["symmetry"][0]])
        return drawn

    def move(self, regions: NDArray[np.float32], drawn: Draw) -> NDArray[np.float32]:
        """Where the draw of an episode moves regions of its images to, [..., 4] -> [..., 4] (top,
        left, bottom, right, in sides of the image). Sides on the image's border stay there, since
        it is repeated. Symmetries are ignored here: they change what regions stand for."""
        height, width, _ = self._space[self.images[0]].shape or ()
        down, right = drawn["shift"][0] / (height, width)
        moved = (regions - 0.5) * drawn["scale"][0] + 0.5 + np.array([down, right, down, right])
        return np.where((regions > 0) & (regions < 1), moved, regions).astype(np.float32)

    def _change_frames(self, observation: dict[str, NDArray], drawn: Draw) -> None:
        """Changes all frames as one draw says."""
        frames = len(next(iter(observation.values())))
        repeated = {name: np.repeat(values, frames, axis=0) for name, values in drawn.items()}
        self._observe(observation, np.ones(frames, np.bool_), **repeated)

    def to_envs(self, actions: NDArray[np.int64]) -> NDArray[np.int64]:
        """The envs' actions for those of the agent, [N] -> [N]."""
        if self.symmetries is None:
            return actions
        return self.symmetries.actions[self._drawn["symmetry"], actions]

    def from_envs(self, actions: NDArray[np.int64]) -> NDArray[np.int64]:
        """The agent's actions for those of the envs, [N] -> [N]."""
        if self.symmetries is None:
            return actions
        return self._inverse[self._drawn["symmetry"], actions]

    def state_dict(self) -> dict[str, Any]:
        """Everything that later calls depend on."""
        return {
            "generator": self._rng.bit_generator.state,
            **{name: drawn.copy() for name, drawn in self._drawn.items()},
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continues from `state_dict()`."""
        self._rng.bit_generator.state = state["generator"]
        for name in state.keys() - {"generator"}:
            self._drawn[name][:] = state[name]


# What changes images, with the values that do not.
_OF_IMAGES = {"channels": False, "shift": 0, "scale": [1, 1], "cutout": 0}


def _unchanged(n: int) -> Draw:
    """The draws that change nothing."""
    return {
        "symmetry": np.zeros(n, np.int64),
        "order": np.tile(np.arange(3), (n, 1)),
        "shift": np.zeros((n, 2), np.int64),
        "scale": np.ones(n),
        "centre": np.zeros((n, 2)),  # of the square, in sides of the image
    }


def _replace_actions(fields: dict[str, NDArray], table: NDArray[np.int64]) -> None:
    """Replaces actions by those of a table, in place; -1 stands for none before the first."""
    for name in ("action", "previous_action"):
        taken = fields[name] >= 0
        fields[name][taken] = table[fields[name][taken]]


@compiled()
def _source(pixel, size, scale):
    """The source pixel, in a row of `size`, that `pixel` shows after scaling."""
    source = math.floor((pixel + 0.5 - size / 2) / scale + size / 2)
    return min(max(source, 0), size - 1)


@compiled()
def _change(image, mask, orders, shifts, scales, centres, side):
    """Changes images uint8 [N, H, W, C] in place."""
    _, height, width, channels = image.shape
    before = np.empty((height, width, channels), np.uint8)
    columns = np.empty(width, np.int64)
    for i in range(len(image)):
        if not mask[i]:
            continue
        down, right = shifts[i]
        if scales[i] != 1:
            before[:] = image[i]
            for c in range(width):
                columns[c] = _source(c - right, width, scales[i])
            for r in range(height):
                row = before[_source(r - down, height, scales[i])]
                for c in range(width):
                    image[i, r, c] = row[columns[c]]
        elif down or right:
            before[:] = image[i]
            for r in range(height):
                source, target = before[min(max(r - down, 0), height - 1)], image[i, r]
                first, last = max(right, 0), width + min(right, 0)
                target[first:last] = source[first - right : last - right]
                for c in range(first):
                    target[c] = source[0]
                for c in range(last, width):
                    target[c] = source[width - 1]
        first, second, third = orders[i]
        # A fourth channel is no colour, and more of them have none.
        if 3 <= channels <= 4 and (first != 0 or second != 1):
            for r in range(height):
                for c in range(width):
                    pixel = image[i, r, c]
                    pixel[0], pixel[1], pixel[2] = pixel[first], pixel[second], pixel[third]
        if side:
            top = int(centres[i, 0] * height) - side // 2
            left = int(centres[i, 1] * width) - side // 2
            for r in range(max(top, 0), min(top + side, height)):
                for c in range(max(left, 0), min(left + side, width)):
                    image[i, r, c] = 0


AUGMENTATIONS: Registry[Augmentation | None] = Registry("augmentation")
"""Each is built from its options, the space of the observations of one env, the number of envs,
and by name `seed` and the envs' `symmetries`; it raises ValueError where there is nothing that it
changes."""

AUGMENTATIONS.register(NoAugmentationOptions, lambda options, space, num_envs, **named: None)
AUGMENTATIONS.register(RandomAugmentationOptions, Augmentation)
