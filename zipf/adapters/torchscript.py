"""TorchScript files as policies."""

from __future__ import annotations

import warnings
from pathlib import Path

import torch
from numpy.typing import NDArray

from zipf.adapters.networks import NetworkPolicy, options_from


def policy(path: str | Path, *, deterministic: bool = False) -> NetworkPolicy:
    """The module of a TorchScript file as a policy; `zipf.adapters.networks` has the rules.

    Args:
        path: of the file.
        deterministic: the action with the highest logit in the place of a draw.

    Raises:
        ValueError: there is no such file, or it is no TorchScript module.
    """
    return _TorchScriptPolicy(Path(path), deterministic)


class _TorchScriptPolicy(NetworkPolicy):
    def __init__(self, path: Path, deterministic: bool) -> None:
        known = {"env_options.json": ""}
        try:
            with warnings.catch_warnings():
                # The file exists: that PyTorch has deprecated the format helps nobody here.
                warnings.simplefilter("ignore", DeprecationWarning)
                self.module = torch.jit.load(path, map_location="cpu", _extra_files=known)
        except RuntimeError as error:
            line = str(error).strip().partition("\n")[0]
            raise ValueError(f"{path}: is not a TorchScript module ({line})") from None
        self.module.eval()
        _, *arguments = self.module.forward.schema.arguments  # the first is the module itself
        trained_with = options_from(path, known["env_options.json"])
        super().__init__(str(path), [one.name for one in arguments], trained_with, deterministic)

    def initial_state(self, num_envs: int) -> list[NDArray]:
        if not self.states:
            return []
        if not hasattr(self.module, "initial_state"):
            raise ValueError(
                f"{self.name}: its inputs {', '.join(self.states)} are no observations, and as "
                "recurrent states they need a method initial_state(num_envs: int) -> list[Tensor] "
                "of the module"
            )
        states = [state.detach().numpy() for state in self.module.initial_state(num_envs)]
        if len(states) != len(self.states):
            raise ValueError(
                f"{self.name}: initial_state returns {len(states)} states, but {len(self.states)} "
                f"inputs are neither observations nor given: {', '.join(self.states)}"
            )
        return states

    def run(self, inputs: dict[str, NDArray]) -> list[NDArray]:
        with torch.inference_mode():
            outputs = self.module(**{k: torch.from_numpy(v) for k, v in inputs.items()})
        if isinstance(outputs, torch.Tensor):
            outputs = [outputs]
        for one in outputs:
            if not isinstance(one, torch.Tensor):
                raise ValueError(
                    f"{self.name}: returns {type(one).__name__} among its outputs; should be the "
                    "actions or logits and each state, tensors all"
                )
        return [(one.float() if one.dtype == torch.bfloat16 else one).numpy() for one in outputs]
