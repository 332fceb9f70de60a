"""The base class of tensor environments: batches of envs that a PyTorch device steps by itself."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import torch
from gymnasium import spaces
from torch import Tensor

from zipf.envs.arguments import whole
from zipf.envs.vector import rank_name

Codes = dict[str, Tensor]
"""Observations in their compact form, by name: [N, ...], or with other leading axes."""


class Stepped(NamedTuple):
    """What a step gives; all tensors are fresh ones."""

    reward: Tensor  # float32 [N], the task's
    terminated: Tensor  # bool [N]
    truncated: Tensor  # bool [N]
    final: Codes  # {name: [N, ...]}, what the action led to, before any new episode begins
    # Of the episodes that ended, rows elsewhere mean nothing: the ranks, int64 [N], by their names,
    # `return` float64, `length` int64, `success` bool (where it is reported), and after
    # `report_achieved` also `achieved` [N, G] and `has_achieved` bool [N]
    outcome: Codes


class TensorEnv(ABC):
    """`N` envs whose state is tensors on a device, which step without the host.

    It plays what a `ZipfVectorEnv` of the same level and options plays, in the autoreset mode
    `SAME_STEP`: the same rules, observations and law of the situations. Only the draws are others:
    those of one generator on the device, not of a stream for each env.

    **Codes.** `observe` gives observations in a compact form, and `decode` what the public spaces
    describe. Unrolls and replays keep codes.

    **Capture.** `step`, `begin`, `observe`, `decode`, `read_goal`, `write_goal` and the function
    that `hashes` returns can be recorded in a CUDA graph. They read nothing on the host (`.item()`,
    `.cpu()`, `bool(tensor)`), have no shape that depends on data (`nonzero`, boolean indexing),
    make no tensor from numbers of the host, and keep all tensors on one device. What lasts is
    written in place. So they cannot check the values of what they are given: an action, a rank or a
    symmetry out of range is an error that the device raises, or none.

    `zipf.envs.testing.check_tensor_env` compares one with its `ZipfVectorEnv`.

    Args:
        num_envs: number of envs N.
        single_observation_space: the public observations of one env, as `decode` gives them.
        single_action_space: the actions of one env, counted from 0.
        situation: name and size of each rank an episode is drawn at, as of a `ZipfVectorEnv`.
        max_steps: no episode is longer.
        device: where all tensors are.

    Attributes:
        generator: of all draws, on the device.
        reports_success: whether episodes end with a success or a failure.
        achieves: whether the family tells what an episode has achieved, see `report_achieved`.

    Raises:
        ValueError: for an argument out of range, or a device that PyTorch does not have here.
    """

    reports_success: bool = True
    achieves: bool = False

    def __init__(
        self,
        num_envs: int,
        *,
        single_observation_space: spaces.Dict,
        single_action_space: spaces.Discrete,
        situation: Mapping[str, int],
        max_steps: int,
        device: str | torch.device,
    ) -> None:
        self.num_envs = whole("num_envs", num_envs, 1)
        self.max_steps = whole("max_steps", max_steps, 1)
        self.single_observation_space = single_observation_space
        self.single_action_space = single_action_space
        self.situation = {rank_name("a rank", name): size for name, size in situation.items()}
        try:
            where = torch.device(device)
            self._everywhere = torch.ones(self.num_envs, dtype=torch.bool, device=where)
            self.device = self._everywhere.device
            self.generator = torch.Generator(self.device)
        except (RuntimeError, AssertionError, TypeError) as error:
            why = str(error).partition("\n")[0]
            raise ValueError(
                f"device must be one that PyTorch has here, such as 'cpu', got {device!r}: {why}"
            ) from None
        self._reports_achieved = False

    # What a family implements.

    @abstractmethod
    def tensors(self) -> dict[str, Tensor]:
        """The state: exactly those tensors that `step`, `begin` and `reset` write in place."""

    @abstractmethod
    def begin(self, mask: Tensor, forced: Tensor | None = None) -> None:
        """Starts an episode in the envs of `mask`, bool [N].

        Draws are for all envs and are used where `mask` is set, so that a graph always draws as
        much.

        Args:
            mask: bool [N].
            forced: ranks in the order of `situation`, int64 [ranks, N], -1 where they are drawn;
                None: all are.
        """

    @abstractmethod
    def step(self, action: Tensor) -> Stepped:
        """Takes one action in every env, int64 [N]; envs whose episode ends begin another."""

    @abstractmethod
    def observe(self) -> Codes:
        """What the running episodes show, {name: [N, ...]}, in fresh tensors."""

    @abstractmethod
    def decode(self, codes: Mapping[str, Tensor], symmetry: Tensor | None = None) -> Codes:
        """The public observations of codes.

        Args:
            codes: as `observe` gives them, with any leading axes: {name: [*batch, ...]}.
            symmetry: int64 [*batch], under which of the family's `symmetries` each is shown; None:
                as it is.

        Returns:
            {name: [*batch, ...]} in the shapes and dtypes of `single_observation_space`. The
            tensors may be those of `codes`.
        """

    def read_goal(self, codes: Mapping[str, Tensor]) -> Tensor:
        """What codes {name: [*batch, ...]} ask for: [*batch, G], equal where the same is asked for,
        as the family's `Goal` reads it from observations; for families with goals."""
        raise NotImplementedError

    def write_goal(self, codes: Mapping[str, Tensor], goals: Tensor) -> Codes:
        """Codes that ask for `goals` [*batch, G]: a new dict, in which only what is asked for is
        another tensor; for families with goals."""
        raise NotImplementedError

    def _check_state(self, state: Mapping[str, Tensor]) -> None:  # noqa: B027
        """Raises ValueError where numbers of a state, on the CPU, would lead the device astray. Its
        names, shapes and dtypes are checked before."""

    # What users call.

    def reset(self, seed: int) -> None:
        """Seeds the generator and begins an episode in every env.
        Raises ValueError: the seed is no whole number from 0 to 2^63 - 1."""
        self.generator.manual_seed(whole("seed", seed, 0, 2**63 - 1))
        self.begin(self._everywhere)

    def report_achieved(self) -> None:
        """From now on outcomes have `achieved` [N, G], the goal that the episode would have been a
        success for, in the code of `read_goal`, which means something where `has_achieved` (bool
        [N]) is set.

        Raises:
            ValueError: these envs do not tell what an episode has achieved.
        """
        if not self.achieves:
            raise ValueError("these envs do not tell what an episode has achieved")
        self._reports_achieved = True

    def hashes(self, weights: Mapping[str, Tensor]) -> Callable[[Mapping[str, Tensor]], Tensor]:
        """A function of codes {name: [*batch, ...]} that gives multilinear hashes of the public
        observations, int64 [*batch]: the sum of all bytes times their weights, modulo 2^64.

        Args:
            weights: int64 [bytes] by the names of the public observation, on the device.

        Raises:
            ValueError: weights of other names, dtypes or lengths.
        """
        shapes = self._check_weights(weights)

        def hashed(codes: Mapping[str, Tensor]) -> Tensor:
            sums = []
            for name, part in self.decode(codes).items():
                batch = part.shape[: part.ndim - len(shapes[name])]
                flat = part.reshape(*batch, -1).contiguous().view(torch.uint8)
                sums.append((flat * weights[name]).sum(-1))
            return torch.stack(sums).sum(0)

        return hashed

    def _check_weights(self, weights: Mapping[str, Tensor]) -> dict[str, tuple[int, ...]]:
        """Raises ValueError for weights that `hashes` does not take. Returns the shapes of the
        parts of a public observation."""
        parts = self.single_observation_space.spaces
        if weights.keys() != parts.keys():
            raise ValueError(f"weights must have the names {list(parts)}, got {list(weights)}")
        shapes = {}
        for name, space in parts.items():
            assert space.shape is not None
            assert space.dtype is not None
            shapes[name] = space.shape
            size = space.dtype.itemsize
            for length in space.shape:
                size *= length
            one = weights[name]
            if one.shape != (size,) or one.dtype != torch.int64 or one.device != self.device:
                raise ValueError(
                    f"the weights of {name!r} must be int64 ({size},) on {self.device}, "
                    f"got {one.dtype} {tuple(one.shape)} on {one.device}"
                )
        return shapes

    def get_state(self) -> dict[str, Tensor]:
        """Everything that stepping depends on, the generator included: copies on the CPU."""
        state = {name: tensor.to("cpu", copy=True) for name, tensor in self.tensors().items()}
        return {**state, "generator": self.generator.get_state()}

    def set_state(self, state: Mapping[str, Any]) -> None:
        """Writes what `get_state` returned, here or in an equal environment, in place.

        Raises:
            ValueError: the state is of another kind of environment, number of envs or kind of
                device, or damaged. The envs are then as they were.
        """
        own = self.get_state()
        if not isinstance(state, Mapping) or state.keys() != own.keys():
            got = list(state) if isinstance(state, Mapping) else type(state).__name__
            raise ValueError(f"a state has the keys {sorted(own)}, got {got}")
        for name, tensor in own.items():
            given = state[name]
            if not isinstance(given, Tensor):
                raise ValueError(f"state {name!r} must be a tensor, got a {type(given).__name__}")
            if given.shape != tensor.shape or given.dtype != tensor.dtype:
                raise ValueError(
                    f"state {name!r} must be {tensor.dtype} {tuple(tensor.shape)}, "
                    f"got {given.dtype} {tuple(given.shape)}"
                )
        on_cpu = {name: tensor.cpu() for name, tensor in state.items()}
        self._check_state(on_cpu)
        try:
            self.generator.set_state(on_cpu["generator"])
        except RuntimeError as error:
            raise ValueError(f"the state is damaged: {error}") from None
        for name, tensor in self.tensors().items():
            tensor.copy_(on_cpu[name])
