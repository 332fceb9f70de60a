"""The RAM of one unroll, as NumPy arrays and as tensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict
from torch import Tensor

from zipf.agents.unroll import FINAL, STEP
from zipf.envs.vector import ZipfVectorEnv

CARRIED = ("previous_action", "previous_reward", "is_first")
"""What an agent is told of the step before, beside its observation."""


class UnrollBuffers:
    """The steps of one unroll, [T + 1, N]: NumPy arrays and, in the same RAM, tensors.

    Attributes:
        observation: arrays by name.
        fields: arrays by name, those that every agent needs and `further` ones; see `Unroll`.
        steps: all of them as tensors, and what the behaviour policy adds.
        inputs: of `steps` the agent's inputs alone.
        rows: of each row the fields as tensors {name: [N]}.
        final: see `Unroll`; None for an agent that asks for none.
    """

    def __init__(
        self,
        env: ZipfVectorEnv,
        rows: int,
        finals: int,
        further: Mapping[str, Tensor],
        pinned: bool,
    ):
        self.pinned = pinned
        shape = rows, env.num_envs
        self.steps = TensorDict(batch_size=shape)
        self.steps["observation"] = self._observations(env, rows)
        self.observation = {name: part.numpy() for name, part in self.steps["observation"].items()}
        self.final = self._finals(env, finals, further) if finals else None
        self.fields: dict[str, NDArray[Any]] = {}
        more = {"bonus": torch.float32, "truncation_value": torch.float32}
        for name, dtype in {**STEP, **more}.items():
            self.steps[name] = self._tensor(torch.zeros(shape, dtype=dtype))
        for name, like in further.items():
            self.steps[name] = self._tensor(torch.zeros(*shape, *like.shape, dtype=like.dtype))
        for name in {**STEP, **more, **further}:
            self.fields[name] = self.steps[name].numpy()
        self.fields["previous_action"][:] = -1
        self.fields["is_first"][:] = True
        self.inputs = self.steps.select("observation", *CARRIED, *({"draw"} & further.keys()))
        self.rows = [{name: self.steps[name][t] for name in self.fields} for t in range(rows)]

    def observation_row(self, t: int) -> dict[str, NDArray]:
        """The observations of row t, {name: [N, ...]}, to be written to."""
        return {name: part[t] for name, part in self.observation.items()}

    def begin_after(self, other: UnrollBuffers) -> None:
        """Copies the last row of another unroll, or of this one, to the first row of this one."""
        for mine, last in ((self.observation, other.observation), (self.fields, other.fields)):
            for name, part in mine.items():
                part[0] = last[name][-1]
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

    def write(self, name: str, t: int, value: Tensor) -> None:
        """Writes what the behaviour policy adds to row t, [N, ...]; the copy from a CUDA device is
        queued."""
        if name not in self.steps.keys():
            rows = self.steps.batch_size[0]
            self.steps[name] = self._tensor(torch.zeros(rows, *value.shape, dtype=value.dtype))
        self.steps[name][t].copy_(value, non_blocking=True)

    def _observations(self, env: ZipfVectorEnv, rows: int) -> TensorDict:
        """Zeros in place of observations, [rows, N]."""
        zeros = {
            name: self._tensor(torch.from_numpy(np.zeros((rows, *array.shape), array.dtype)))
            for name, array in env.allocate().items()
        }
        return TensorDict(zeros, (rows, env.num_envs))

    def _finals(self, env: ZipfVectorEnv, count: int, further: Mapping[str, Tensor]) -> TensorDict:
        shape = count, env.num_envs
        final = TensorDict(batch_size=shape)
        for name, dtype in FINAL.items():
            final[name] = self._tensor(torch.zeros(shape, dtype=dtype))
        if "draw" in further:
            like = further["draw"]
            final["draw"] = self._tensor(torch.zeros(*shape, *like.shape, dtype=like.dtype))
        final["observation"] = self._observations(env, count)
        return final

    def _tensor(self, zeros: Tensor) -> Tensor:
        """The tensor itself, or a copy in pinned RAM, which CUDA devices copy from and to while the
        CPU goes on."""
        return zeros.pin_memory() if self.pinned else zeros
