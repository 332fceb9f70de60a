"""Networks with named inputs as policies: what files of ONNX and TorchScript, and modules of
TorchRL, have in common.

A network is for a batch of N environments. Its inputs are:

- observations, by the names of the observation space, each in its dtype and shape `[N, ...]`; not
  all of them need to be read, and where there is only one the input may be called `observation`.
  Where a name is no identifier, as that of TorchScript's inputs has to be, the input may have
  underscores in the place of other characters: `arm_angle` reads `arm.angle`;
- if wanted, `previous_action` (int64 [N], -1 where an episode begins), `previous_reward`
  (float32 [N], 0 where an episode begins) and `is_first` (bool [N], an episode begins; as TorchRL
  has it, `is_init`, bool [N, 1]);
- any other input is a recurrent state `[N, ...]`.

The first output of a file is the actions (integers [N]) or their logits (floats [N, actions]).
After it come the states for the next step, in the order of their inputs. States begin anew with
every episode: in ONNX with zeros of the shape that the file declares, in TorchScript with what the
module's method `initial_state(num_envs: int) -> list[Tensor]` returns. Files run on the CPU.

A file may name the constructor options that it was trained with, as JSON: in ONNX as the metadata
property `env_options`, in TorchScript as the extra file `env_options.json`.
"""

from __future__ import annotations

import json
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray


def options_from(path: Path, text: str | None) -> Mapping[str, Any] | None:
    """The constructor options that a file says its network was trained with; None where it says
    none. Raises ValueError: the text is no JSON object."""
    if not text:
        return None
    try:
        options = json.loads(text)
    except ValueError:
        options = None
    if not isinstance(options, dict):
        raise ValueError(f"{path}: its env_options should be a JSON object, got {text!s:.100}")
    return options


class NetworkPolicy(ABC):
    """A network for `zipf.evaluate.score`.

    `for_envs` leaves in `read` the dtype and the shape without N of what is no state, by the names
    of the inputs, and in `states` the names of the states.

    Args:
        name: of the network, for messages.
        inputs: their names.
        env_options: the constructor options that it was trained with; None where it names none.
        deterministic: its most probable actions in the place of draws.
    """

    def __init__(
        self,
        name: str,
        inputs: Sequence[str],
        env_options: Mapping[str, Any] | None,
        deterministic: bool,
    ) -> None:
        self.name = name
        self.inputs = inputs
        self.env_options = env_options
        self.deterministic = deterministic

    @abstractmethod
    def initial_state(self, num_envs: int) -> list[NDArray]:
        """What the inputs `self.states` are where an episode begins, each [N, ...]."""

    @abstractmethod
    def run(self, inputs: dict[str, NDArray]) -> list[NDArray]:
        """The outputs for named inputs."""

    def for_envs(
        self, observation_space: spaces.Dict, action_space: spaces.Discrete, seed: int
    ) -> NetworkPolicy:
        """Prepares for environments with these spaces; draws from logits are made with `seed`.

        Raises:
            ValueError: the network cannot play them.
        """
        self.actions = int(action_space.n)
        self.rng = np.random.default_rng(seed)
        unread = [name for name in observation_space if name not in self.inputs]
        names = with_underscores(unread, r"\W")
        self.renamed = {
            other: name
            for name, other in names.items()
            if other in self.inputs and other not in observation_space
        }
        seen = dict(observation_space.items())
        seen |= {other: seen[name] for other, name in self.renamed.items()}
        if len(observation_space) == 1:
            (seen["observation"],) = observation_space.values()
        if not seen.keys() & set(self.inputs):
            raise ValueError(
                f"{self.name}: has no observation among its inputs "
                f"({', '.join(map(str, self.inputs))}); the observations are "
                f"{', '.join(observation_space)}"
            )
        given = _given(np.full(1, -1), np.zeros(1, np.float32), np.ones(1, np.bool_))
        kinds = {name: (array.dtype, array.shape[1:]) for name, array in given.items()}
        kinds |= {k: (np.dtype(space.dtype or int), space.shape or ()) for k, space in seen.items()}
        self.read = {name: kinds[name] for name in self.inputs if name in kinds}
        self.states = [name for name in self.inputs if name not in kinds]
        return self

    def start(self, num_envs: int) -> None:
        self.initial = self.state = self.initial_state(num_envs)
        self.action: NDArray = np.full(num_envs, -1)

    def __call__(
        self, observation: Mapping[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        given = {**_given(self.action, reward, is_first), **observation}
        given |= {other: observation[name] for other, name in self.renamed.items()}
        if len(observation) == 1:
            (given["observation"],) = observation.values()
        for name, first, old in zip(self.states, self.initial, self.state, strict=True):
            given[name] = np.where(is_first.reshape(-1, *[1] * (old.ndim - 1)), first, old)
        output, *self.state = self.run({name: given[name] for name in self.inputs})
        if len(self.state) != len(self.states):
            raise ValueError(
                f"{self.name}: returns {len(self.state)} states after the actions; its inputs "
                f"that are neither observations ({', '.join(observation)}) nor given are: "
                f"{', '.join(self.states) or 'none'}"
            )
        action = self.choose(output)
        if action.dtype.kind not in "iu":
            raise ValueError(f"{self.name}: returns {action.dtype} actions; should be integers")
        self.action = action.astype(np.int64)
        return self.action

    def choose(self, output: NDArray) -> NDArray:
        """Actions [N] from the first output."""
        if output.dtype.kind != "f":
            return output
        expected = len(self.action), self.actions
        if output.shape != expected:
            raise ValueError(
                f"{self.name}: its first output is {output.dtype} of shape {output.shape}; should "
                f"be actions, integers of shape ({expected[0]},), or logits of shape {expected}"
            )
        if np.isnan(output).any():
            raise ValueError(f"{self.name}: its logits are not numbers (NaN)")
        if not self.deterministic:
            # The highest of logits with Gumbel noise is a draw from their softmax.
            output = output + self.rng.gumbel(size=output.shape)
        return output.argmax(-1)


def with_underscores(names: Iterable[str], pattern: str) -> dict[str, str]:
    """For each name the one that has underscores where the pattern matches.

    Raises:
        ValueError: two of them are the same.
    """
    renamed = {name: re.sub(pattern, "_", name) for name in names}
    if len(set(renamed.values())) < len(renamed):
        alike = sorted(n for n, o in renamed.items() if list(renamed.values()).count(o) > 1)
        raise ValueError(
            f"the observations {', '.join(map(repr, alike))} would have the same name with "
            "underscores: give one of them another name"
        )
    return renamed


def _given(action: NDArray, reward: NDArray, is_first: NDArray) -> dict[str, NDArray]:
    """What a network may read beside observations, after these actions and rewards."""
    return {
        "previous_action": np.where(is_first, -1, action),
        "previous_reward": np.where(is_first, np.float32(0), reward),
        "is_first": is_first,
        "is_init": is_first[:, None],
    }
