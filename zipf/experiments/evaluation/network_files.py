"""Policies in files of TorchScript and ONNX.

Both are networks for a batch of N worlds, whose inputs have names:

- observations, by the names of the observation space, each in its dtype and shape `[N, ...]`; not
  all of them need to be read, and where there is only one the input may be called `observation`;
- if wanted, `previous_action` (int64 [N], -1 where an episode begins), `previous_reward`
  (float32 [N], 0 where an episode begins) and `is_first` (bool [N], an episode begins);
- any other input is a recurrent state `[N, ...]`.

The first output is the actions (integers [N]) or their logits (floats [N, actions]). After it come
the states for the next step, in the order of their inputs. States start again wherever an episode
begins: in ONNX from zeros of the shape that the file declares, in TorchScript from what the
module's method `initial_state(num_envs: int) -> list[Tensor]` returns. Networks run on the CPU.

A file may name the geometry that it was trained on, as JSON: in ONNX as the metadata property
`geometry`, in TorchScript as the extra file `geometry.json`.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from zipf import envs

_GIVEN = {"previous_action": np.int64, "previous_reward": np.float32, "is_first": np.bool_}


class Input(NamedTuple):
    """An input of a network, with what the file declares of it."""

    name: str
    dtype: str | None  # as NumPy names it; None where it is not declared
    shape: tuple[int | None, ...] | None  # None for a length, or all, that is not declared


class Network(Protocol):
    """A network from a file."""

    inputs: list[Input]
    geometry: Mapping[str, Any] | None

    def initial_state(self, states: list[Input], num_envs: int) -> list[NDArray]:
        """The states with which an episode begins, each [N, ...]."""

    def __call__(self, inputs: dict[str, NDArray]) -> list[NDArray]:
        """The outputs for named inputs."""


def network_of(path: Path) -> Network:
    """The network of a file.

    Raises:
        ValueError: there is no such file, its name ends in none of .onnx, .pt and .ts, or it holds
            something else.
        ImportError: what runs it is not installed.
    """
    kinds: dict[str, Callable[[Path], Network]] = {
        ".onnx": OnnxNetwork,
        ".pt": TorchScriptNetwork,
        ".ts": TorchScriptNetwork,
    }
    if path.suffix not in kinds:
        raise ValueError(
            f"{path}: should be a .onnx file, a TorchScript file (.pt, .ts), a run's folder, or "
            f"{' or '.join(map(repr, envs.SCRIPTED))}"
        )
    if not path.is_file():
        raise ValueError(f"{path}: no such file")
    return kinds[path.suffix](path)


class FilePolicy:
    """A network that chooses actions.

    Args:
        name: of the file, for messages.
        network: the network.
        observation_space, action_space: of one world.
        seed: of the draws from logits.
        deterministic: take the action with the highest logit in the place of a draw.

    Raises:
        ValueError: the network's inputs do not fit the observations.
    """

    def __init__(
        self,
        name: str,
        network: Network,
        observation_space: spaces.Dict,
        action_space: spaces.Discrete,
        *,
        seed: int,
        deterministic: bool,
    ) -> None:
        self.name = name
        self.network = network
        self.actions = int(action_space.n)
        self.deterministic = deterministic
        self.rng = np.random.default_rng(seed)
        self.sources: dict[str, str] = {}
        self.states: list[Input] = []
        self.fixed: int | None = None
        for one in network.inputs:
            source = one.name
            if source == "observation" and len(observation_space) == 1:
                (source,) = observation_space
            if source in observation_space.keys():
                space = observation_space[source]
                self._compare(one, np.dtype(space.dtype or np.int64), space.shape or ())
            elif source in _GIVEN:
                self._compare(one, np.dtype(_GIVEN[source]), ())
            else:
                self.states.append(one)
                continue
            self.sources[one.name] = source
        if not observation_space.keys() & set(self.sources.values()):
            raise ValueError(
                f"{name}: has no observation among its inputs "
                f"({', '.join(one.name for one in network.inputs)}); the observations are "
                f"{', '.join(observation_space)}"
            )

    def _compare(self, given: Input, dtype: np.dtype, shape: tuple[int, ...]) -> None:
        if given.shape is not None and given.shape:
            self.fixed = given.shape[0] or self.fixed
        lengths = given.shape and given.shape[1:]
        differs = lengths is not None and (
            len(lengths) != len(shape)
            or any(a not in (None, b) for a, b in zip(lengths, shape, strict=True))
        )
        if differs or given.dtype not in (None, dtype.name):
            declared = ["N", *("?" if one is None else one for one in lengths or ())]
            raise ValueError(
                f"{self.name}: its input {given.name!r} is {given.dtype} "
                f"[{', '.join(map(str, declared))}], but the observation is {dtype.name} "
                f"[{', '.join(map(str, ['N', *shape]))}]"
            )

    def start(self, num_envs: int) -> None:
        if self.fixed not in (None, num_envs):
            raise ValueError(
                f"{self.name}: takes batches of {self.fixed} only, and {num_envs} worlds are "
                f"played; say num_envs={self.fixed}, or export it with a dynamic batch axis"
            )
        self.initial = self.network.initial_state(self.states, num_envs)
        if len(self.initial) != len(self.states):
            raise ValueError(
                f"{self.name}: initial_state returns {len(self.initial)} states, but "
                f"{len(self.states)} inputs are neither observations nor given: "
                f"{', '.join(one.name for one in self.states)}"
            )
        self.state = self.initial
        self.action = np.full(num_envs, -1)

    def __call__(
        self, observation: Mapping[str, NDArray], reward: NDArray, is_first: NDArray
    ) -> NDArray:
        given = {
            **observation,
            "previous_action": np.where(is_first, -1, self.action),
            "previous_reward": np.where(is_first, np.float32(0), reward),
            "is_first": is_first,
        }
        state = [
            np.where(is_first.reshape(-1, *[1] * (old.ndim - 1)), first, old)
            for first, old in zip(self.initial, self.state, strict=True)
        ]
        inputs = {name: given[source] for name, source in self.sources.items()}
        inputs |= {one.name: value for one, value in zip(self.states, state, strict=True)}
        output, *self.state = self.network(inputs)
        if len(self.state) != len(self.states):
            names = ", ".join(one.name for one in self.states) or "none"
            raise ValueError(
                f"{self.name}: returns {len(self.state)} states after the actions; its inputs "
                f"that are neither observations ({', '.join(observation)}) nor given are: {names}"
            )
        self.action = self._choose(output, len(is_first))
        return self.action

    def _choose(self, output: NDArray, num_envs: int) -> NDArray:
        if output.dtype.kind != "f":
            return output
        if output.shape != (num_envs, self.actions):
            raise ValueError(
                f"{self.name}: its first output is {output.dtype} of shape {output.shape}; should "
                f"be actions, integers of shape ({num_envs},), or logits of shape "
                f"({num_envs}, {self.actions})"
            )
        if not self.deterministic:
            # The highest of logits with Gumbel noise is a draw from their softmax.
            output = output + self.rng.gumbel(size=output.shape)
        return output.argmax(-1)


class OnnxNetwork:
    """An ONNX file in onnxruntime.

    Raises:
        ImportError: onnxruntime is not installed.
        ValueError: the file is no ONNX model.
    """

    def __init__(self, path: Path) -> None:
        try:
            import onnxruntime
        except ImportError as error:
            raise ImportError(
                f"{path}: onnxruntime is needed to run it: pip install 'zipf-rl[onnx]'"
            ) from error
        try:
            self.session = onnxruntime.InferenceSession(
                path.read_bytes(), providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime's exceptions have no common, public base
            raise ValueError(f"{path}: is not an ONNX model ({_first_line(error)})") from None
        self.inputs = [
            Input(
                one.name,
                _onnx_dtype(one.type),
                tuple(length if isinstance(length, int) else None for length in one.shape),
            )
            for one in self.session.get_inputs()
        ]
        told = self.session.get_modelmeta().custom_metadata_map.get("geometry")
        self.geometry = json.loads(told) if told else None
        self.path = path

    def initial_state(self, states: list[Input], num_envs: int) -> list[NDArray]:
        initial = []
        for one in states:
            lengths = [length for length in (one.shape or ())[1:] if length is not None]
            if not one.shape or len(lengths) < len(one.shape) - 1:
                raise ValueError(
                    f"{self.path}: its input {one.name!r} is no observation, and as a state it "
                    f"needs a fixed shape after the batch axis; it is {one.shape}"
                )
            initial.append(np.zeros((num_envs, *lengths), one.dtype))
        return initial

    def __call__(self, inputs: dict[str, NDArray]) -> list[NDArray]:
        return list(self.session.run(None, inputs))


def _onnx_dtype(declared: str) -> str:
    """`tensor(uint8)` -> `uint8`, in NumPy's names."""
    name = declared.removeprefix("tensor(").removesuffix(")")
    return {"float": "float32", "double": "float64"}.get(name, name)


class TorchScriptNetwork:
    """A TorchScript file in PyTorch, on the CPU.

    Raises:
        ValueError: the file is no TorchScript module.
    """

    def __init__(self, path: Path) -> None:
        import torch

        self.path = path
        extra = {"geometry.json": ""}
        try:
            with warnings.catch_warnings():
                # The file exists: that PyTorch has deprecated the format helps nobody here.
                warnings.simplefilter("ignore", DeprecationWarning)
                self.module = torch.jit.load(path, map_location="cpu", _extra_files=extra)
        except RuntimeError as error:
            raise ValueError(
                f"{path}: is not a TorchScript module ({_first_line(error)})"
            ) from None
        self.module.eval()
        _, *arguments = self.module.forward.schema.arguments  # the first is the module itself
        self.inputs = [Input(one.name, None, None) for one in arguments]
        self.geometry = json.loads(extra["geometry.json"]) if extra["geometry.json"] else None

    def initial_state(self, states: list[Input], num_envs: int) -> list[NDArray]:
        if not states:
            return []
        if not hasattr(self.module, "initial_state"):
            raise ValueError(
                f"{self.path}: its inputs {', '.join(one.name for one in states)} are no "
                "observations, and as recurrent states they need a method "
                "initial_state(num_envs: int) -> list[Tensor] of the module"
            )
        return [state.numpy() for state in self.module.initial_state(num_envs)]

    def __call__(self, inputs: dict[str, NDArray]) -> list[NDArray]:
        import torch

        with torch.inference_mode():
            outputs = self.module(**{k: torch.from_numpy(v) for k, v in inputs.items()})
        if isinstance(outputs, torch.Tensor):
            outputs = [outputs]
        return [one.numpy() for one in outputs]


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
