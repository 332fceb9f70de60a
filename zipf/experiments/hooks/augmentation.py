"""Augmentation: random changes of what an agent sees in training, the same for a whole episode.

What changes is drawn when an episode begins, and is a column of unrolls, `draw`. Unrolls and
replays have observations as the envs show them; they are changed where an agent reads them: when it
acts, learns, and values the observation that an episode was cut at. So the policy that acted and
what is learned from agree, and nothing is ever changed back. Evaluations show the envs as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Protocol

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field, field_validator
from torch import Tensor

from zipf.agents.encoders import is_image
from zipf.agents.unroll import Augmentation
from zipf.envs.family import Symmetries
from zipf.experiments.hooks.hook import Hook, Parts
from zipf.experiments.hooks.kernels import change_images
from zipf.options import Options
from zipf.registry import Registry

Factor = Annotated[float, Field(ge=0.1, le=10)]


class HostAugmentation(Augmentation, Protocol):
    """An augmentation of what envs on the host show, in RAM."""

    def draw(self, rng: np.random.Generator, n: int) -> NDArray[np.float64]:
        """The numbers of `n` episodes, [n, D]."""
        ...

    def to_env(self, actions: NDArray[np.int64], draw: NDArray[Any]) -> NDArray[np.int64]:
        """The envs' actions for those of an agent that sees them so, [N] -> [N]; -1 stays."""
        ...

    def to_agent(self, actions: NDArray[np.int64], draw: NDArray[Any]) -> NDArray[np.int64]:
        """The agent's actions for those of the envs, [N] -> [N]; -1 stays."""
        ...

    def move(self, regions: NDArray[np.float32], draw: NDArray[Any]) -> NDArray[np.float32]:
        """Where regions of the image are moved to, [N, 4] -> [N, 4] (top, left, bottom, right, in
        sides of the image), but for symmetries, which change what regions stand for."""
        ...


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


# Where a draw has what; whole numbers first.
_SYMMETRY, _ORDER, _SHIFT, _SCALE, _CENTRE = 0, slice(1, 4), slice(4, 6), 6, slice(7, 9)
UNCHANGED = np.array([[0, 0, 1, 2, 0, 0, 1.0, 0, 0]])
"""The draw that changes nothing, float64 [1, 9]."""

# What changes images, with the values that do not.
_OF_IMAGES = {"channels": False, "shift": 0, "scale": [1, 1], "cutout": 0}


def _has_colours(image: gym.Space) -> bool:
    """Whether an image has colours: three channels, or four of which the last is none."""
    assert image.shape is not None
    return image.shape[-1] in (3, 4)


class RandomAugmentation:
    """Draws changes of episodes, and makes them; symmetries are those of these envs, where
    `options.symmetries`. Raises ValueError: there is nothing to change, or no symmetries.

    A draw is float64 [9]: the symmetry's number; the order of the colours [3]; how far the image is
    moved down and to the right, pixels [2]; its scale; the centre of the square, in sides of the
    image [2].
    """

    size = 9
    on_device = False

    def __init__(
        self,
        options: RandomAugmentationOptions,
        space: gym.spaces.Dict,
        *,
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
        if options.channels and not any(_has_colours(space[name]) for name in self.images):
            raise ValueError(
                "augmentation.channels=true: the images have no colours, which are the first three "
                "of three or four channels; choose false"
            )
        if not chosen and not options.symmetries:
            raise ValueError(
                "augmentation=random: changes nothing with these values; choose augmentation=none"
            )
        self.options = options
        self.symmetries = symmetries if options.symmetries else None
        if self.symmetries is not None:
            self._actions = self.symmetries.actions
            self._inverse = self._actions.argsort(1)
        self._changes_images = bool(chosen)

    def draw(self, rng: np.random.Generator, n: int) -> NDArray[np.float64]:
        o, drawn = self.options, UNCHANGED.repeat(n, 0)
        if self.symmetries is not None:
            drawn[:, _SYMMETRY] = rng.integers(self.symmetries.count, size=n)
        if o.channels:
            drawn[:, _ORDER] = rng.permuted(np.tile(np.arange(3), (n, 1)), axis=1)
        if o.shift:
            drawn[:, _SHIFT] = rng.integers(-o.shift, o.shift + 1, size=(n, 2))
        if o.scale != [1, 1]:
            least, largest = np.log(o.scale)
            drawn[:, _SCALE] = np.exp(rng.uniform(least, largest, n))
        if o.cutout:
            drawn[:, _CENTRE] = rng.random((n, 2))
        return drawn

    def __call__(self, observation: Mapping[str, Tensor], draw: Tensor | None) -> dict[str, Tensor]:
        assert draw is not None
        shown = {
            name: part.clone(memory_format=torch.contiguous_format)
            for name, part in observation.items()
        }
        batch = draw.ndim - 1
        flat = {name: part.flatten(0, batch - 1).numpy() for name, part in shown.items()}
        draws = draw.reshape(-1, draw.shape[-1]).numpy()
        if self.symmetries is not None:
            everywhere = np.ones(len(draws), np.bool_)
            self.symmetries(flat, draws[:, _SYMMETRY].astype(np.int64), everywhere)
        if self._changes_images:
            whole = draws[:, :_SCALE].astype(np.int64)
            scale, centre = draws[:, _SCALE], draws[:, _CENTRE]
            for name in self.images:
                side = self.options.cutout
                change_images(flat[name], whole[:, _ORDER], whole[:, _SHIFT], scale, centre, side)
        return shown

    def to_env(self, actions: NDArray[np.int64], draw: NDArray[Any]) -> NDArray[np.int64]:
        return (
            actions if self.symmetries is None else _mapped(self.symmetries.actions, actions, draw)
        )

    def to_agent(self, actions: NDArray[np.int64], draw: NDArray[Any]) -> NDArray[np.int64]:
        return actions if self.symmetries is None else _mapped(self._inverse, actions, draw)

    def move(self, regions: NDArray[np.float32], draw: NDArray[Any]) -> NDArray[np.float32]:
        """Sides on the image's border stay there, since it is repeated."""
        height, width, _ = self._space[self.images[0]].shape or ()
        down, right = (draw[:, _SHIFT] / (height, width)).T
        by = np.stack([down, right, down, right], -1)
        moved = (regions - 0.5) * draw[:, _SCALE, None] + 0.5 + by
        return np.where((regions > 0) & (regions < 1), moved, regions).astype(np.float32)


class Draws(Hook):
    """Draws what an augmentation changes in the episodes of N envs: the column `draw`."""

    name = "augmentation"

    def __init__(self, augmentation: HostAugmentation, num_envs: int, seed: int):
        self.augmentation = augmentation
        self.columns = {"draw": torch.empty(augmentation.size, dtype=torch.float64)}
        self._rng = np.random.default_rng(seed)
        self._drawn = np.zeros((num_envs, augmentation.size))

    def begin(self, observation: Parts, mask: Tensor) -> None:
        self._drawn[mask.numpy()] = self.draw(int(mask.sum()))

    def show(self, fields: Parts) -> None:
        fields["draw"].copy_(torch.from_numpy(self._drawn))

    def draw(self, n: int) -> NDArray[np.float64]:
        """The numbers of `n` episodes, [n, D]."""
        return self.augmentation.draw(self._rng, n)

    def state_dict(self) -> dict[str, Any]:
        return {"generator": self._rng.bit_generator.state, "draw": self._drawn.copy()}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        self._rng.bit_generator.state = state["generator"]
        self._drawn[:] = state["draw"]


def _mapped(
    table: NDArray[np.int64], actions: NDArray[np.int64], draw: NDArray[Any]
) -> NDArray[np.int64]:
    """`table[symmetry, action]`; -1 stands for none before the first."""
    found = table[draw[:, _SYMMETRY].astype(np.int64), actions]
    return np.where(actions >= 0, found, -1)


AUGMENTATIONS: Registry[HostAugmentation | None] = Registry("augmentation")
"""Each is built from its options, the space of the observations of one env, and by name the envs'
`symmetries`; it raises ValueError where there is nothing that it changes."""

AUGMENTATIONS.register(NoAugmentationOptions, lambda options, space, **named: None)
AUGMENTATIONS.register(RandomAugmentationOptions, RandomAugmentation)
