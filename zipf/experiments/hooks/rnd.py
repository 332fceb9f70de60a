"""Random network distillation (Burda et al. 2019): a bonus for what a network cannot predict yet.

A target network with fixed random weights turns an observation into features; a predictor learns
these features on observations that were visited. Its squared error is large where there were few
like the one at hand.

As in the paper, observations are normalised by the mean and the standard deviation of each input
and clipped to +-5, and errors are divided by the standard deviation of their discounted sums, which
do not end with episodes. Statistics are of all observations so far, and begin as those of a single
one with mean 0 and variance 1; the paper begins with some thousand steps of random actions.

Ours, for one CPU core, is what the networks read: images averaged down, integers as codes and
other numbers as they are, in a vector for networks of dense layers; the paper has convolutions.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from copy import deepcopy
from typing import Annotated, Any, Literal

import gymnasium as gym
import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor, nn

from zipf.agents.encoders import is_image
from zipf.experiments.hooks.bonus import Bonus
from zipf.experiments.hooks.hook import Parts, arrays
from zipf.experiments.hooks.kernels import means_of_squares
from zipf.options import BelowOne, Fraction, Options, Positive

Size = Annotated[int, Field(ge=1, le=2**16)]

LARGEST_INPUT = 5.0  # Burda et al. 2019
CODE_SIZE = 8  # ours: numbers for each integer


class RNDOptions(Options):
    """A bonus of `scale` times the normalised error; `configs/exploration.yaml` has the sources
    of the values.

    Networks have layers of `hidden` units and `features` outputs. Images are averaged down to at
    most `image_side` pixels a side. Of the observations a share of `learned_share` is learned from,
    in batches of `batch_size`. `discount` is that of the sums that errors are divided by.
    """

    name: Literal["rnd"]
    scale: Positive
    hidden: Size
    features: Size
    image_side: Size
    learned_share: Fraction
    batch_size: Size
    learning_rate: Positive
    discount: BelowOne


class RNDBonus(Bonus):
    """The bonus, and its networks on the CPU. The seed is that of the networks' weights and of the
    choice of what is learned from."""

    def __init__(self, options: RNDOptions, observation_space: gym.spaces.Dict, seed: int):
        self.options = options
        self.generator = torch.Generator().manual_seed(seed)
        same_in_every_run = torch.Generator().manual_seed(0)
        self.readers = {
            name: _reader(space, options.image_side, same_in_every_run)
            for name, space in sorted(observation_space.items())
        }
        empty = {
            name: np.zeros((1, *(space.shape or ())), space.dtype)
            for name, space in observation_space.items()
        }
        inputs = self._read(empty, np.zeros(1, np.int64)).shape[1]
        hidden, features = options.hidden, options.features
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.target = _layers(inputs, hidden, features).requires_grad_(False)
            self.predictor = _layers(inputs, hidden, hidden, features)
        self.optimiser = torch.optim.Adam(
            self.predictor.parameters(), lr=options.learning_rate, fused=True
        )
        self.inputs = Statistics(inputs)
        self.sums = Statistics(1)
        self.sum = np.zeros(0)  # of each env, float64 [N]: the discounted sum of errors
        self.waiting = torch.zeros(0, inputs)  # to be learned from

    def __call__(self, observation: Parts, mask: Tensor) -> Tensor:
        """The observations of the mask enter the statistics, and some of them are learned from.
        Sums of errors go on over episodes, as in Burda et al. 2019."""
        bonus = np.zeros(len(mask), np.float32)
        rows = np.flatnonzero(np.asarray(mask))
        if not len(rows):
            return torch.from_numpy(bonus)
        if not len(self.sum):
            self.sum = np.zeros(len(mask))
        read = self._read(arrays(observation), rows)
        self.inputs.update(read.numpy())
        mean, deviation = (torch.from_numpy(x).float() for x in self.inputs.now())
        normal = ((read - mean) / deviation).clamp(-LARGEST_INPUT, LARGEST_INPUT)
        with torch.no_grad():
            error = self._errors(normal).numpy()
        self.sum[rows] = self.options.discount * self.sum[rows] + error
        self.sums.update(self.sum[rows, None])
        bonus[rows] = self.options.scale * error / self.sums.now()[1]
        chosen = torch.rand(len(rows), generator=self.generator) < self.options.learned_share
        self._learn(normal[chosen])
        return torch.from_numpy(bonus)

    def _read(self, observation: dict[str, NDArray], rows: NDArray) -> Tensor:
        """The observations of these rows as float32 [rows, inputs]."""
        return torch.cat([read(observation[name][rows]) for name, read in self.readers.items()], -1)

    def _errors(self, normal: Tensor) -> Tensor:
        return (self.predictor(normal) - self.target(normal)).square().mean(-1)

    def _learn(self, normal: Tensor) -> None:
        """An optimiser step for every full batch; what is left waits for the next call."""
        self.waiting = torch.cat([self.waiting, normal])
        size = self.options.batch_size
        while len(self.waiting) >= size:
            self.optimiser.zero_grad()
            self._errors(self.waiting[:size]).mean().backward()
            self.optimiser.step()
            self.waiting = self.waiting[size:]

    def state_dict(self) -> dict[str, Any]:
        return {
            "target": self.target.state_dict(),
            "predictor": self.predictor.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "generator": self.generator.get_state(),
            "inputs": self.inputs.state_dict(),
            "sums": self.sums.state_dict(),
            "sum": self.sum.copy(),
            "waiting": self.waiting.clone(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        tensors = _tensors(state)
        self.target.load_state_dict(tensors["target"])
        self.predictor.load_state_dict(tensors["predictor"])
        self.optimiser.load_state_dict(tensors["optimiser"])
        self.generator.set_state(tensors["generator"])
        self.inputs.load_state_dict(state["inputs"])
        self.sums.load_state_dict(state["sums"])
        self.sum = np.array(state["sum"])
        self.waiting = tensors["waiting"]


class Statistics:
    """Mean and variance of all rows so far, after one with mean 0 and variance 1; float64 [size].

    By the parallel algorithm of Chan et al. 1979, as in the code of Burda et al. 2019.
    """

    def __init__(self, size: int):
        self.count = 1
        self.mean = np.zeros(size)
        self.variance = np.ones(size)

    def update(self, rows: NDArray) -> None:
        """Adds rows [M, size]."""
        added = len(rows)
        total = self.count + added
        distance = rows.mean(0) - self.mean
        squares = self.count * self.variance + added * rows.var(0)
        self.variance = (squares + distance**2 * self.count * added / total) / total
        self.mean = self.mean + distance * added / total
        self.count = total

    def now(self) -> tuple[NDArray, NDArray]:
        """The mean and the standard deviation."""
        return self.mean, np.sqrt(self.variance)

    def state_dict(self) -> dict[str, Any]:
        return {"count": self.count, "mean": self.mean, "variance": self.variance}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.count = state["count"]
        self.mean, self.variance = np.array(state["mean"]), np.array(state["variance"])


Reader = Callable[[NDArray], Tensor]  # a part of observations [M, ...] -> float32 [M, inputs]


def _reader(space: gym.Space, side: int, generator: torch.Generator) -> Reader:
    """How a part is read, by its space.

    An image: means of squares of pixels, 0 to 1. Integers: for each `CODE_SIZE` cosines with random
    frequencies, so that any two are far apart (Rahimi and Recht 2007). Others: as they are.
    """
    shape = space.shape or ()
    if is_image(space):
        square = math.ceil(max(shape[:2]) / side)

        def image(part: NDArray) -> Tensor:
            rows, height, width, channels = part.shape
            places = rows, math.ceil(height / square), math.ceil(width / square), channels
            means = np.empty(places, np.float32)
            means_of_squares(part, square, means)
            return torch.from_numpy(means).flatten(1)

        return image
    if np.issubdtype(space.dtype, np.integer) and not isinstance(space, gym.spaces.MultiBinary):
        entries = math.prod(shape), CODE_SIZE
        frequency = 2 * math.pi * torch.rand(entries, generator=generator, dtype=torch.float64)
        phase = 2 * math.pi * torch.rand(entries, generator=generator, dtype=torch.float64)

        def codes(part: NDArray) -> Tensor:
            numbers = torch.from_numpy(part.reshape(len(part), -1, 1).astype(np.float64))
            return (numbers * frequency + phase).cos().flatten(1).float()

        return codes
    return lambda part: torch.from_numpy(part.reshape(len(part), -1).astype(np.float32))


def _layers(*sizes: int) -> nn.Sequential:
    """Dense layers with ReLUs between them, orthogonal as in the code of Burda et al. 2019."""
    layers: list[nn.Module] = []
    for inputs, outputs in itertools.pairwise(sizes):
        layer = nn.Linear(inputs, outputs)
        nn.init.orthogonal_(layer.weight, math.sqrt(2))
        nn.init.zeros_(layer.bias)
        layers += [layer, nn.ReLU()]
    return nn.Sequential(*layers[:-1])


def _tensors(state: Any) -> Any:
    """A copy with tensors in the place of arrays."""
    if isinstance(state, np.ndarray):
        return torch.from_numpy(state.copy())
    if isinstance(state, dict):
        return {key: _tensors(value) for key, value in state.items()}
    if isinstance(state, list | tuple):
        return type(state)(_tensors(value) for value in state)
    return deepcopy(state)
