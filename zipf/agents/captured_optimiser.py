"""Adam as captured updates need it."""

from __future__ import annotations

import warnings
from typing import Any

import torch
from torch import Tensor

from zipf.agents.capture import CaptureFailed


class CapturedOptimiser:
    """Adam, or a relative of it, whose steps are captured.

    Its learning rates are tensors, and `load_state_dict` writes in place. What is saved is as that
    of the optimiser before: either loads the other's. A step changes nothing where the tensor
    float32 [] that is given to it is 1.

    Raises:
        CaptureFailed: the optimiser has no fused kernel, which alone does all this.
    """

    def __init__(self, optimiser: torch.optim.Optimizer):
        self.optimiser = optimiser
        self._own: list[dict[str, Any]] = []  # of each group: what it is saved with
        for group in optimiser.param_groups:
            if "fused" not in group:
                kind = type(optimiser).__name__
                raise CaptureFailed(
                    f"{kind} cannot be captured, but Adam, AdamW and optimisers derived from them; "
                    "choose capture=false"
                )
            self._own.append({name: group[name] for name in ("lr", "fused", "capturable")})
            first = group["params"][0]
            # What the fused kernels of either device read.
            dtype = torch.float32 if first.is_cuda else torch.float64
            group["lr"] = torch.tensor(group["lr"], dtype=dtype, device=first.device)
            group["fused"] = group["capturable"] = True
            for parameter in group["params"]:
                if parameter in optimiser.state:
                    self._load(parameter, optimiser.state.pop(parameter))

    def step(self, refused: Tensor) -> None:
        """One step, unless `refused` is 1."""
        self.optimiser.found_inf = refused  # type: ignore[attr-defined]  # as GradScaler sets it
        with warnings.catch_warnings():  # the first steps are made outside of the graph
            warnings.filterwarnings("ignore", ".* without CUDA graph capture", UserWarning)
            self.optimiser.step()

    def scale(self, factor: float) -> None:
        """Sets the learning rates to this factor of those that they were built with."""
        for group, own in zip(self.optimiser.param_groups, self._own, strict=True):
            own["lr"] = factor * group.setdefault("initial_lr", own["lr"])
            group["lr"].fill_(own["lr"])

    def state_dict(self) -> dict[str, Any]:
        """As the optimiser's before it was captured."""
        state = self.optimiser.state_dict()
        for group, own in zip(state["param_groups"], self._own, strict=True):
            group.update(own)
        return state

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`, captured or not, of any device."""
        groups = zip(self.optimiser.param_groups, self._own, state["param_groups"], strict=True)
        for group, own, saved in groups:
            own["lr"] = float(saved["lr"])
            group["lr"].fill_(own["lr"])
            if "initial_lr" in saved:
                group["initial_lr"] = saved["initial_lr"]
            for parameter, place in zip(group["params"], saved["params"], strict=True):
                self._load(parameter, state["state"].get(place, {}))

    def _load(self, parameter: Tensor, saved: dict[str, Tensor]) -> None:
        own = self.optimiser.state[parameter]
        for name in own.keys() - saved.keys():
            own[name].zero_()  # as before the first step
        for name, value in saved.items():
            if name in own:
                own[name].copy_(value)
            else:
                own[name] = value.to(parameter.device, copy=True)
