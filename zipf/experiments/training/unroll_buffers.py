"""The memory of one unroll, as tensors and, on the host, as NumPy arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor

from zipf.agents.unroll import FINAL, STEP

CARRIED = ("previous_action", "previous_reward", "is_first")
"""What an agent is told of the step before, beside its observation."""


class UnrollBuffers:
    """The steps of one unroll, [T + 1, N].

    Attributes:
        steps: all of them, and what the behaviour policy adds.
        rows: of each row the fields as tensors {name: [N]}.
        final: see `Unroll`; None where `finals` is 0.
        observation, fields: on the host the same memory as arrays by name: observations, and the
            fields that every agent needs and `further` ones.

    Args:
        like: observations of N envs, {name: [N, ...]}, on the device.
        rows: T + 1.
        finals: K of `Unroll.final`; 0: there is none.
        further: fields of hooks, as `Hook.columns`.
        pinned: whether it is in pinned RAM, which CUDA devices copy from and to while the CPU goes
            on.
    """

    def __init__(
        self,
        like: Mapping[str, Tensor],
        rows: int,
        *,
        finals: int = 0,
        further: Mapping[str, Tensor],
        pinned: bool = False,
    ):
        self._like, self._further, self._pinned = like, further, pinned
        first = next(iter(like.values()))
        self._num_envs, self._device = len(first), first.device
        more = {"bonus": torch.float32, "truncation_value": torch.float32}
        fields = {name: torch.empty((), dtype=dtype) for name, dtype in {**STEP, **more}.items()}
        self.steps = self._zeros(rows, {**fields, **further})
        self.steps["previous_action"].fill_(-1)
        self.steps["is_first"].fill_(True)
        self.final: TensorDict | None = None
        if finals:
            of_final = {name: torch.empty((), dtype=dtype) for name, dtype in FINAL.items()}
            drawn = {name: part for name, part in further.items() if name == "draw"}
            self.final = self._zeros(finals, {**of_final, **drawn})
        names = [*fields, *further]
        self.rows = [{name: self.steps[name][t] for name in names} for t in range(rows)]
        shown = dict(self.steps["observation"].items())
        self._shown = [{name: part[t] for name, part in shown.items()} for t in range(rows)]
        if self._device.type == "cpu":
            self.observation = {k: v.numpy() for k, v in self.steps["observation"].items()}
            self.fields = {name: self.steps[name].numpy() for name in names}

    def _zeros(self, rows: int, fields: Mapping[str, Tensor]) -> TensorDict:
        shape = rows, self._num_envs
        zeros = {k: self._tensor((*shape, *part.shape), part) for k, part in fields.items()}
        observation = {k: self._tensor((rows, *part.shape), part) for k, part in self._like.items()}
        return TensorDict({**zeros, "observation": TensorDict(observation, shape)}, shape)

    def _tensor(self, shape: Sequence[int], like: Tensor) -> Tensor:
        zeros = torch.zeros(*shape, dtype=like.dtype, device=self._device)
        return zeros.pin_memory() if self._pinned else zeros

    def shown(self, t: int) -> dict[str, Tensor]:
        """The observations of row t, {name: [N, ...]}, to be read and written."""
        return self._shown[t]

    def observation_row(self, t: int) -> dict[str, NDArray]:
        """The same on the host, as arrays."""
        return {name: part[t] for name, part in self.observation.items()}

    def begin_after(self, other: UnrollBuffers) -> None:
        """Copies the last row of another unroll, or of this one, to the first row of this one."""
        for name, part in self.steps["observation"].items():
            part[0].copy_(other.steps["observation", name][-1])
        for name, row in self.rows[0].items():
            row.copy_(other.rows[-1][name])
        if self.final is not None:
            self.final.zero_()  # so that what is not in use is the same in every run
            self.final["step"].fill_(-1)

    def keep_final(
        self,
        t: int,
        cut: NDArray[np.bool_],
        observation: dict[str, NDArray],
        reward: NDArray[np.float64],
    ) -> None:
        """Keeps the observations [N, ...] that the episodes of the envs `cut` were truncated at
        after row t, with the rewards [N] of that step, in those envs that have a place left."""
        assert self.final is not None
        used = (self.final["step"] >= 0).sum(0).numpy()
        envs = np.flatnonzero(cut & (used < len(self.final)))
        places = used[envs], envs
        for name, part in observation.items():
            self.final["observation", name].numpy()[places] = part[envs]
        self.final["step"].numpy()[places] = t
        self.final["previous_action"].numpy()[places] = self.fields["action"][t, envs]
        self.final["previous_reward"].numpy()[places] = reward[envs]
        if "draw" in self.fields:
            self.final["draw"].numpy()[places] = self.fields["draw"][t, envs]

    def write(self, t: int, given: Mapping[str, Tensor]) -> None:
        """Writes fields of row t, {name: [N, ...]}; what the behaviour policy adds gets its place
        when it is first there. The copy from a CUDA device to the host is queued."""
        for name, value in given.items():
            if name not in self.steps.keys():
                self.steps[name] = self._tensor((len(self.rows), *value.shape), value)
            self.steps[name][t].copy_(value, non_blocking=True)
