"""ONNX files as policies (`pip install ".[onnx]"` in a clone of zipf)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from zipf.adapters.networks import NetworkPolicy, options_from

try:
    import onnxruntime
except ImportError as error:
    raise ImportError(
        "zipf.adapters.onnx needs onnxruntime: pip install '.[onnx]' in a clone of zipf"
    ) from error


def policy(path: str | Path, *, deterministic: bool = False) -> NetworkPolicy:
    """The network of an ONNX file as a policy; `zipf.adapters.networks` has the rules.

    Args:
        path: of the file.
        deterministic: the action with the highest logit in the place of a draw.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no ONNX model.
    """
    return _OnnxPolicy(Path(path), deterministic)


class _OnnxPolicy(NetworkPolicy):
    def __init__(self, path: Path, deterministic: bool) -> None:
        path.open("rb").close()
        try:  # by its path: weights may be in files beside it
            self.session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime's exceptions have no common, public base
            line = str(error).strip().partition("\n")[0]
            raise ValueError(f"{path}: is not an ONNX model ({line})") from None
        self.declared = {
            one.name: (
                _dtype(one.type),
                [length if isinstance(length, int) else None for length in one.shape],
            )
            for one in self.session.get_inputs()
        }
        known = self.session.get_modelmeta().custom_metadata_map
        trained_with = options_from(path, known.get("env_options"))
        super().__init__(str(path), list(self.declared), trained_with, deterministic)

    def for_envs(
        self, observation_space: spaces.Dict, action_space: spaces.Discrete, seed: int
    ) -> NetworkPolicy:
        super().for_envs(observation_space, action_space, seed)
        for name, (dtype, shape) in self.read.items():
            declared, lengths = self.declared[name]
            fitting = [a if a in (None, b) else b for a, b in zip(lengths[1:], shape, strict=False)]
            if declared != dtype.name or len(lengths) != 1 + len(shape) or fitting != lengths[1:]:
                axes = ["N", *("?" if one is None else str(one) for one in lengths[1:])]
                raise ValueError(
                    f"{self.name}: its input {name!r} is {declared} [{', '.join(axes)}], but the "
                    f"observation is {dtype.name} [{', '.join(['N', *map(str, shape)])}]"
                )
        return self

    def initial_state(self, num_envs: int) -> list[NDArray]:
        for lengths in (self.declared[name][1] for name in self.read):
            if lengths[:1] not in ([], [None], [num_envs]):
                raise ValueError(
                    f"{self.name}: takes batches of {lengths[0]} only, and {num_envs} environments "
                    f"are played; say num_envs={lengths[0]}, or export it with a dynamic batch axis"
                )
        initial = []
        for name in self.states:
            dtype, lengths = self.declared[name]
            known = [length for length in lengths[1:] if length is not None]
            if lengths[:1] not in ([None], [num_envs]) or len(known) < len(lengths) - 1:
                raise ValueError(
                    f"{self.name}: its input {name!r} is no observation, and as a state it should "
                    f"have the batch axis first and a fixed shape after it; it is {lengths}"
                )
            initial.append(np.zeros((num_envs, *known), dtype))
        return initial

    def run(self, inputs: dict[str, NDArray]) -> list[NDArray]:
        return list(self.session.run(None, inputs))


def _dtype(declared: str) -> str:
    """`tensor(uint8)` -> `uint8`, in NumPy's names."""
    name = declared.removeprefix("tensor(").removesuffix(")")
    return {"float": "float32", "double": "float64"}.get(name, name)
