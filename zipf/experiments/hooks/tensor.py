"""Hooks of tensor environments: the same techniques as functions of tensors, in fixed shapes.

They do what the hooks of their names do around host environments (`zipf.experiments.hooks`), on
the device and without waiting for it, so that an unroll can be captured as a CUDA graph: nothing is
read back, no shape depends on data, and what lasts is written in place.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict
from torch import Tensor

from zipf.agents.hindsight import AchievedOptions
from zipf.agents.unroll import Unroll
from zipf.envs.tensor import TensorEnv
from zipf.experiments.hooks.augmentation import UNCHANGED, RandomAugmentation
from zipf.experiments.hooks.exploration import CountOptions, weights_of
from zipf.experiments.hooks.hook import OF_EPISODES, Hook, Parts, Row


class View:
    """What an agent sees of codes: they are decoded on the agent's device, and changed as the
    numbers say that were drawn for their episode. It is the agent's `Augmentation`.

    Args:
        env: decodes.
        augmentation: how observations are changed, in no way that is for the `host_alone`; None:
            they are not, and nothing is drawn.
    """

    on_device = True

    def __init__(self, env: TensorEnv, augmentation: RandomAugmentation | None):
        self.size = 0 if augmentation is None else augmentation.size
        self._decode = env.decode
        self._images = augmentation.images if augmentation and augmentation.options.channels else []
        self._count = 0
        if augmentation is not None and augmentation.symmetries is not None:
            self._count = augmentation.symmetries.count
            actions = torch.from_numpy(augmentation.symmetries.actions)
            self._to_env = actions.to(env.device)
        self._unchanged = torch.from_numpy(UNCHANGED).to(env.device)

    def draw(self, generator: torch.Generator, n: int) -> Tensor:
        """The numbers of `n` episodes, float64 [n, 9], as `RandomAugmentation` has them."""
        drawn, device = self._unchanged.repeat(n, 1), self._unchanged.device
        if self._count:
            drawn[:, 0] = torch.randint(self._count, (n,), device=device, generator=generator)
        if self._images:
            keys = torch.rand(n, 3, device=device, generator=generator)
            drawn[:, 1:4] = keys.argsort(1).double()
        return drawn

    def __call__(self, observation: Mapping[str, Tensor], draw: Tensor | None) -> dict[str, Tensor]:
        """The observations [*batch, ...] of codes, with their `draw` [*batch, 9]."""
        if draw is None:
            return self._decode(observation)
        shown = self._decode(observation, draw[..., 0].long() if self._count else None)
        for name in self._images:
            order = draw[..., None, None, 1:4].long()
            shown[name] = shown[name].gather(-1, order.expand(shown[name].shape))
        return shown

    def to_env(self, actions: Tensor, draw: Tensor | None) -> Tensor:
        """The envs' actions for those of the agent, [N] -> [N]; -1 stays."""
        return actions if not self._count or draw is None else _mapped(self._to_env, actions, draw)


def host_alone(options: Any) -> str | None:
    """Why an augmentation works on host environments alone, or None."""
    for name, off in {"shift": 0, "cutout": 0, "scale": [1, 1]}.items():
        if (value := getattr(options, name)) != off:
            return f"augmentation.{name}={value}"
    return None


def _mapped(table: Tensor, actions: Tensor, draw: Tensor) -> Tensor:
    found = table[draw[..., 0].long(), actions.clamp(min=0)]
    return torch.where(actions >= 0, found, -1)


class Draws(Hook):
    """Draws what an augmentation changes in the episodes of N envs: the column `draw`."""

    name = "augmentation"

    def __init__(self, view: View, env: TensorEnv):
        self.columns = {"draw": torch.empty(view.size, dtype=torch.float64)}
        self._view, self._generator = view, env.generator
        shape = env.num_envs, view.size
        self._drawn = torch.zeros(shape, dtype=torch.float64, device=env.device)

    def begin(self, observation: Parts, mask: Tensor) -> None:
        drawn = self._view.draw(self._generator, len(self._drawn))
        self._drawn.copy_(torch.where(mask.unsqueeze(-1), drawn, self._drawn))

    def show(self, fields: Parts) -> None:
        fields["draw"].copy_(self._drawn)

    def tensors(self) -> Parts:
        return {"draw": self._drawn}


class Counts(Hook):
    """The bonus `scale / sqrt(visits)` of `CountBonus`, with the same table and hash."""

    name = "exploration"

    def __init__(self, options: CountOptions, env: TensorEnv):
        self.scale = options.scale
        self.visits = torch.zeros(options.table_size, dtype=torch.int64, device=env.device)
        weights = {}
        for name, part in env.single_observation_space.items():
            size = np.zeros(part.shape or (), part.dtype).nbytes
            array = weights_of(name, size).view(np.int64)
            weights[name] = torch.from_numpy(array).to(env.device)
        self._hashes = env.hashes(weights)
        self._one = torch.ones(env.num_envs, dtype=torch.int64, device=env.device)

    def step(self, row: Row) -> None:
        high = (self._hashes(row.final) >> 32) & 0xFFFFFFFF
        slot = (high * len(self.visits)) >> 32
        self.visits.index_add_(0, slot, self._one)
        row.fields["bonus"].copy_(self.scale / self.visits[slot].double().sqrt())

    def tensors(self) -> Parts:
        return {"visits": self.visits}


class Hindsight(Hook):
    """Relabels whole episodes with what they achieved: `zipf.experiments.hooks.relabelling`, in
    fixed shapes.

    The last R + T frames of every env are kept in a ring, one row for a step of all of them. At an
    unroll's end E of the episodes that ended in it and achieved what they were not asked for are
    drawn, each set as likely as another, and gathered from there: `Unroll.episodes` [R, E], whose
    places that have no episode are masked everywhere.

    Args:
        options: how many episodes, and how many of their last frames.
        env: has goals.
        unroll_length: T.
        reward: what success pays, as it is learned from.
        draws: whether fields have a `draw`, of this size; 0: they have none.
    """

    name = "hindsight"

    def __init__(
        self,
        options: AchievedOptions,
        env: TensorEnv,
        *,
        unroll_length: int,
        reward: float,
        draws: int = 0,
    ):
        env.report_achieved()
        self.rows = options.length or env.max_steps
        self.episodes = min(options.episodes, unroll_length * env.num_envs)
        self.env, self.reward, self.unroll_length = env, reward, unroll_length
        self._generator = env.generator
        self._ring_rows = self.rows + unroll_length
        n, device = env.num_envs, env.device

        def ring(like: Tensor) -> Tensor:
            shape = self._ring_rows, n, *like.shape[1:]
            return torch.zeros(shape, dtype=like.dtype, device=device)

        self._codes = {name: ring(part) for name, part in env.observe().items()}
        kept = {name: torch.zeros(1, dtype=dtype) for name, dtype in OF_EPISODES.items()}
        if draws:
            kept["draw"] = torch.zeros(1, draws, dtype=torch.float64)
        self._fields = {name: ring(like) for name, like in kept.items()}
        self._next = torch.zeros(1, dtype=torch.int64, device=device)  # row of the next step
        self._lengths = torch.zeros(n, dtype=torch.int64, device=device)
        # Of the unroll's steps [T, N]: a random key where an episode can be relabelled, else -1.
        self._keys = torch.zeros(unroll_length, n, device=device)
        self._length = torch.zeros(unroll_length, n, dtype=torch.int64, device=device)
        self._row = torch.zeros(unroll_length, dtype=torch.int64, device=device)
        goal = env.read_goal(env.observe())
        shape = unroll_length, *goal.shape
        self._goals = torch.zeros(shape, dtype=goal.dtype, device=device)
        self._step = 0  # of the unroll

    def step(self, row: Row) -> None:
        t, outcome = self._step, row.outcome
        self._step += 1
        for ring, given in ((self._codes, row.observation), (self._fields, row.fields)):
            for name, part in ring.items():
                part.index_copy_(0, self._next, given[name].unsqueeze(0))
        self._row[t].copy_(self._next[0])
        self._next.add_(1).remainder_(self._ring_rows)
        self._lengths.add_(1)
        asked = self.env.read_goal(row.observation)
        other = row.ended & outcome["has_achieved"] & (outcome["achieved"] != asked).any(-1)
        keys = torch.rand(len(other), device=other.device, generator=self._generator)
        self._keys[t].copy_(torch.where(other, keys, -1.0))
        self._length[t].copy_(self._lengths)
        self._goals[t].copy_(outcome["achieved"])
        self._lengths.masked_fill_(row.ended, 0)

    def finish(self, unroll: Unroll) -> None:
        self._step = 0
        keys, chosen = self._keys.flatten().topk(self.episodes)
        n = len(self._lengths)
        t, env = chosen // n, chosen % n
        lengths = self._length[t, env].clamp(max=self.rows) * (keys >= 0)
        place = torch.arange(self.rows, device=keys.device).unsqueeze(-1)
        source = (self._row[t] - lengths + 1 + place).remainder(self._ring_rows)
        inside, last = place < lengths, place == lengths - 1

        def gathered(ring: Mapping[str, Tensor]) -> dict[str, Tensor]:
            found = {}
            for name, part in ring.items():
                rows = part[source, env]
                found[name] = rows.masked_fill(
                    ~inside.view(*inside.shape, *[1] * (rows.ndim - 2)), 0
                )
            return found

        shape = self.rows, self.episodes
        goals = self._goals[t, env].expand(self.rows, -1, -1)
        asked = self.env.write_goal(gathered(self._codes), goals)
        fields = gathered(self._fields)
        fields["previous_action"] = torch.where(inside, fields["previous_action"], -1)
        fields["reward"] = torch.where(last, self.reward, fields["reward"])
        unroll.episodes = TensorDict(
            {
                **fields,
                "observation": TensorDict(asked, shape),
                "mask": inside,
                "is_first": ~inside | (place == 0),
                "terminated": last,
                "truncated": torch.zeros_like(inside),
            },
            shape,
        )

    def tensors(self) -> Parts:
        rings = {f"observation.{k}": v for k, v in self._codes.items()} | {
            f"fields.{k}": v for k, v in self._fields.items()
        }
        return {**rings, "next": self._next, "lengths": self._lengths}
