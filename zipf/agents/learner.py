"""What all agents that learn by gradients share: networks, optimiser, one step, state, publishing.

An algorithm is its options, the network that it needs, `act` and `loss`:

    @register
    class Mine(Learner):
        Options = MyOptions  # derived from `LearnerOptions`

        def make_network(self):
            return ActorCritic(*self.spec.torso)

        def act(self, inputs, memory, generator, *, training=True): ...

        def loss(self, unroll):
            ...
            return Loss(loss, {"entropy": entropy})

`act` and `loss` are functions of tensors: what surrounds them is here. An update is one optimiser
step (PPO: several on an unroll), in which

    the loss is computed, and its gradients;
    gradients are averaged over learners (`zipf.agents.averaging`), and their norm is bounded;
    a loss or a norm that is not finite ends the run, before any weight has changed;
    the optimisers step, and what follows them is brought up to date (`after_step`).

On CUDA all of this can be captured (`Learner.capture`, `zipf.agents.capture`), in two graphs with
the averages between them. `act`, `loss` and `after_step` are then what that page asks for; what
depends on the number of updates reads `progress`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from zipf.agents.agent import Agent, AgentSpec
from zipf.agents.auxiliary import build_auxiliary
from zipf.agents.averaging import average_gradients
from zipf.agents.capture import Captured, CudaGraph, Graph, is_recording, mapped
from zipf.agents.captured_optimiser import CapturedOptimiser
from zipf.agents.episodic import Dictionary, build_recorder
from zipf.agents.memory import State
from zipf.agents.network import Inputs, Torso, autocast, frozen_copy
from zipf.agents.unroll import Unroll
from zipf.options import BelowOne, Options, Positive


class LearnerOptions(Options):
    """Options that all of these agents have: those of Adam, and a bound on the gradient's norm."""

    name: str
    learning_rate: Positive
    adam_beta1: BelowOne
    adam_beta2: BelowOne
    adam_epsilon: Positive
    max_gradient_norm: Positive


class Loss(NamedTuple):
    """What an update descends, and what it leaves.

    Attributes:
        loss: float32 [], a mean over time and batch.
        metrics: to log, [] each; with `loss` and `gradient_norm` those of an update.
        kept: tensors that `after_step` reads.
    """

    loss: Tensor
    metrics: dict[str, Tensor]
    kept: dict[str, Tensor] = {}  # noqa: RUF012  (nobody writes to it)


class Learner(Agent):
    """The base of agents that learn by gradients.

    Attributes:
        network: what is learned.
        actor: the network that `act` and `value` compute with; the same until `separate_acting`,
            or one that constructors set.
        auxiliary: the auxiliary loss, the base class where the agent adds none.
        recorder: writes the dictionary of `network`, where the agent has episodic memory.
        learned: the parameters whose gradients' norm is bounded.
        optimisers: by the names that they are saved by.
        parts: all that is saved, by name; and `updates`, the number of updates made.
        updates_made: the same number, int64 [] on the device.
    """

    averages_gradients = True
    options: Any
    network: Any
    actor: Any

    def __init__(self, options: Any, spec: AgentSpec):
        super().__init__(options, spec)
        self.precision = spec.precision
        self.updates = 0
        self.updates_made = torch.zeros((), dtype=torch.int64, device=self.device)
        # Norm and loss of the last update, or of the first that was not finite.
        self._sizes = torch.zeros(2, device=self.device)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(spec.seed)
            self.network = self.make_network()
            self.auxiliary = build_auxiliary(
                spec.auxiliary, spec.observation_space, spec.network, self.network, spec.seed
            )
        self.recorder = build_recorder(
            spec.episodic,
            spec.observation_space,
            spec.num_envs,
            self.network.memory.size,
            self.network.actions,
            spec.seed,
        )
        for module in (self.network, self.auxiliary, self.recorder):
            module.to(self.device)
        self.actor = self.network
        self.learned = [*self.network.parameters(), *self.auxiliary.learned()]
        self.optimisers = {"optimiser": self.make_optimiser(self.learned)}
        self.parts: dict[str, Any] = {"network": self.network, **self.optimisers}
        if "auxiliary" in self.supports:
            self.parts["auxiliary"] = self.auxiliary
        if "episodic" in self.supports:
            self.parts["recorder"] = self.recorder
        self._published: nn.Module | None = None  # the network that `actor` is a copy of
        self._is_compiled = False
        self._new_graph: Callable[[str], Graph] | None = None  # where this is captured
        self._captured: tuple[Captured, Captured] | None = None  # backward, step
        self._acting: dict[tuple[int, ...], Captured] = {}  # by [T, B]

    @abstractmethod
    def make_network(self) -> Torso:
        """The network that is learned, with weights from PyTorch's generator; called once, before
        anything but `options`, `spec` and `device` is known."""

    @abstractmethod
    def loss(self, batch: Any) -> Loss:
        """The loss of an unroll, or of what else `learn` was given: of the tensors alone, and
        without side effects."""

    def make_optimiser(self, parameters: list[nn.Parameter]) -> torch.optim.Optimizer:
        """The optimiser of `learned`."""
        return torch.optim.Adam(parameters, **adam(self.options))

    def autocast(self) -> torch.autocast:
        """Automatic mixed precision, as `spec.precision` says."""
        return autocast(self.device, self.precision)

    def initial_memory(self, batch: int) -> State:
        return self.network.memory.initial_state(batch)

    def forward_actor(self, inputs: Inputs, memory: State) -> Any:
        """What `actor` returns for inputs [T, B] and the memory before them, without gradient;
        captured, for each T and B, where this agent is."""
        if self._new_graph is None or is_recording():
            return self._forward_actor(inputs, memory)
        shape = tuple(inputs.is_first.shape)
        if shape not in self._acting:
            self._acting[shape] = Captured(
                self._forward_actor, self._new_graph(self.device), list, name="acting"
            )
        # A memory is kept for as long as an unroll, and the next call overwrites what is returned.
        return mapped(self._acting[shape](inputs, memory), lambda _, tensor: tensor.clone())

    @torch.no_grad()
    def _forward_actor(self, inputs: Inputs, memory: State) -> Any:
        with self.autocast():
            return self.actor(inputs, memory)

    def filled_up(self, inputs: Inputs, memory: State) -> tuple[Inputs, State]:
        """Inputs [B] and memory of any number of envs; where this agent is captured, with empty
        rows up to a multiple of `spec.num_envs`, for which there is a graph."""
        missing = -len(inputs.is_first) % self.spec.num_envs
        if self._new_graph is None or missing == 0:
            return inputs, memory
        return mapped(
            (inputs, memory), lambda _, x: torch.cat([x, x.new_zeros(missing, *x.shape[1:])])
        )

    def update(self, unroll: Unroll) -> Mapping[str, float | Tensor]:
        if not self._sees_on_device:
            unroll = unroll.changed(self.augmentation)
        metrics, _ = self.learn(unroll.to(self.device))
        return metrics

    @property
    def _sees_on_device(self) -> bool:
        return self.augmentation is not None and self.augmentation.on_device

    def seen(self, batch: Any) -> Any:
        """What `learn` was given, as the loss and `after_step` read it; a part of the captured
        function."""
        if isinstance(batch, Unroll) and self._sees_on_device:
            return batch.changed(self.augmentation)
        return batch

    def learn(self, batch: Any) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
        """One optimiser step on the loss of a batch; returns metrics, [] each, and what the loss
        kept. Where this agent is captured, the next call overwrites both.

        Raises FloatingPointError: learning has diverged; no weights were changed. Where this agent
        is captured, `check_finite` raises it.
        """
        if self._captured is None:
            batch, loss = self._backward(batch)
            average_gradients(_parameters(self.optimisers.values()))
            norm = self._descend(loss.loss)
            self.updates += 1
            self.after_step(batch, loss.kept)
        else:
            backward, step = self._captured
            _, loss = backward(batch)
            average_gradients(_parameters(self.optimisers.values()))
            norm = step()
            self.updates += 1
        self.after_update()
        return {"loss": loss.loss, "gradient_norm": norm, **loss.metrics}, loss.kept

    @property
    def progress(self) -> int | Tensor:
        """The number of updates made, as a loss reads it: `updates_made` where this agent is
        captured, else `updates`."""
        return self.updates if self._captured is None else self.updates_made

    def check_finite(self) -> None:
        """Raises FloatingPointError: the loss of an update since the last call, or its gradient's
        norm, was not finite; weights and optimisers are as they were before it."""
        for name, size in zip(("gradient's norm", "loss"), self._sizes.tolist(), strict=True):
            if not math.isfinite(size):
                self._sizes.zero_()
                raise FloatingPointError(f"the {name} is {size}")

    def capture(self, graph: Callable[[str], Graph] = CudaGraph) -> None:
        """From now on updates run as graphs, and so does `forward_actor`; `graph` makes one for a
        device. They are recorded when they are first called.

        Raises CaptureFailed, here and then: something cannot be captured.
        """
        self.parts |= {name: CapturedOptimiser(one) for name, one in self.optimisers.items()}
        self._new_graph = graph
        backward = Captured(
            self._backward,
            graph(self.device),
            self._tensors,
            generators=self.auxiliary.generators(),
            name="the loss of an update",
        )

        def follow() -> Tensor:
            batch, loss = backward.outputs
            norm = self._descend(loss.loss)
            self.after_step(batch, loss.kept)
            return norm

        step = Captured(follow, graph(self.device), self._tensors, name="the step of an update")
        self._captured = backward, step

    def _tensors(self) -> list[Tensor]:
        """All that an update writes."""
        found = [part for part in vars(self).values() if isinstance(part, Tensor)]
        for part in (*vars(self).values(), *self.parts.values()):
            if isinstance(part, nn.Module):
                found += [*part.parameters(), *part.buffers()]
        found += [one.grad for one in found if one.grad is not None]
        for optimiser in self.optimisers.values():
            found += [one for state in optimiser.state.values() for one in state.values()]
        return found

    def _backward(self, batch: Any) -> tuple[Any, Loss]:
        """The batch as it is seen, and its loss, without gradient; that is in the parameters."""
        batch = self.seen(batch)
        loss, metrics, kept = self.loss(batch)
        for optimiser in self.optimisers.values():
            # Where this is recorded, gradients are then where the graph will write them.
            optimiser.zero_grad()
        loss.backward()
        metrics = {name: metric.detach() for name, metric in metrics.items()}
        kept = {name: tensor.detach() for name, tensor in kept.items()}
        return batch, Loss(loss.detach(), metrics, kept)

    def _descend(self, loss: Tensor) -> Tensor:
        """One step of all optimisers; returns the norm of the gradients of `learned`."""
        norm = nn.utils.clip_grad_norm_(self.learned, self.options.max_gradient_norm)
        were_finite = self._sizes.isfinite().all()
        self._sizes.copy_(torch.where(were_finite, torch.stack([norm, loss]), self._sizes))
        if self._captured is None:
            self.check_finite()
        refused = 1 - self._sizes.isfinite().all().float()
        for name, optimiser in self.optimisers.items():
            part = self.parts[name]
            if isinstance(part, CapturedOptimiser):
                part.step(refused)
            else:
                optimiser.step()
        self.updates_made += 1 - refused.long()
        return norm

    def after_step(self, batch: Any, kept: dict[str, Tensor]) -> None:
        """Follows an optimiser step, and is captured with it: the targets of the auxiliary loss,
        and the dictionary, whose rows are made of the memory's outputs `core` [T + 1, B, size] and
        of `action` [T + 1, B]."""
        self.auxiliary.after_update(self.network.encoder)
        if "episodic" in self.supports:
            self.recorder.record(self.network.dictionary, batch.steps, kept["core"], kept["action"])

    def after_update(self) -> None:
        """Follows an update on the host and is never captured: what is done every so many `updates`
        is done here."""
        self.auxiliary.count(self.updates)

    def state_dict(self) -> dict[str, Any]:
        return {name: part.state_dict() for name, part in self.parts.items()} | {
            "updates": self.updates
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for name, part in self.parts.items():
            part.load_state_dict(state[name])
        self.updates = state["updates"]
        self.updates_made.fill_(self.updates)

    def carried(self) -> dict[str, Any]:
        """State that the last update keeps for the next unroll of the same envs, such as R2D2's
        burn-in rows; later updates do not change its tensors."""
        return self.recorder.carried()

    def carry(self, carried: dict[str, Any]) -> None:
        """Restores what `carried()` was after the previous unroll of the envs that the next
        update learns from; empty if that unroll was not learned from."""
        self.recorder.carry(carried)

    def begin_with(self, weights: Mapping[str, Mapping[str, Tensor]]) -> None:
        """Loads parts of another agent's network, before any other method is called: from a state
        dictionary for each, by its name in both networks (`Torso.parts`), such as `encoder` or
        `memory`.

        All attributes that are a `Torso` load them, and the auxiliary loss follows their encoder.
        Raises ValueError: the network has no such part, or one of another shape.
        """
        for network in self._torsos():
            parts = network.parts()
            for name, state in weights.items():
                if name not in parts:
                    raise ValueError(f"no part {name!r}: the network has {', '.join(parts)}")
                part = parts[name]
                _check_fits(name, part.state_dict(), state)
                part.load_state_dict(state)
                if isinstance(part, Dictionary):
                    part.become_old()
        self.auxiliary.begin_with(self.network.encoder)

    def scale_learning_rates(self, factor: float) -> None:
        """Sets the learning rates of all optimisers, for the updates that follow, to this factor, 0
        to 1, of those that they were built with."""
        for name, optimiser in self.optimisers.items():
            part = self.parts[name]
            if isinstance(part, CapturedOptimiser):
                part.scale(factor)
                continue
            for group in optimiser.param_groups:
                group["lr"] = factor * group.setdefault("initial_lr", group["lr"])

    def weights(self) -> dict[str, Tensor]:
        """The weights that `actor` has, or is to have at the next `publish`, by name: all that an
        agent needs to act as it has learned."""
        learned = self.actor if self._published is None else self._published
        return learned.state_dict()

    def load_weights(self, weights: Mapping[str, Tensor]) -> None:
        """From now on the agent acts as the one that `weights` are from.
        Raises RuntimeError: they do not fit its network."""
        self.actor.load_state_dict(weights)

    def separate_acting(self) -> None:
        """From now on `act` and `value` compute with a copy of the weights, which `publish` alone
        refreshes: they may then run in one thread while `update` runs in another. `state_dict()` is
        without the copy; `actor.state_dict()` has it."""
        self._published = self.actor
        self.actor = frozen_copy(self.actor)
        self._acting.clear()
        if self._is_compiled:  # a copy is not
            self.compile()

    def publish(self) -> None:
        """Copies the learned weights to those that act; without `separate_acting` they are the
        same and nothing is copied."""
        if self._published is not None:
            self.actor.load_state_dict(self._published.state_dict())

    def compile(self) -> None:
        """Compiles the image encoders of all attributes that are a `Torso` (`torch.compile`).
        Raises ValueError: there are none."""
        self._is_compiled = True
        fixed = self.device.startswith("cuda")  # graphs have few shapes
        if not sum(network.encoder.compile_images(fixed=fixed) for network in self._torsos()):
            raise ValueError(
                "compile=true: compiles image encoders, and this agent has none; "
                "choose compile=false"
            )

    def _torsos(self) -> list[Torso]:
        """The networks among the attributes, each once: `actor` is often one of the others."""
        return list(dict.fromkeys(part for part in vars(self).values() if isinstance(part, Torso)))


def adam(options: LearnerOptions) -> dict[str, Any]:
    """The arguments of `torch.optim.Adam` and of its relatives, but for the parameters."""
    return {
        "lr": options.learning_rate,
        "betas": (options.adam_beta1, options.adam_beta2),
        "eps": options.adam_epsilon,
        "fused": True,
    }


def _parameters(optimisers: Iterable[torch.optim.Optimizer]) -> list[nn.Parameter]:
    return [
        parameter
        for optimiser in optimisers
        for group in optimiser.param_groups
        for parameter in group["params"]
    ]


def _check_fits(part: str, own: Mapping[str, Tensor], other: Mapping[str, Tensor]) -> None:
    """Raises `ValueError` where two state dictionaries differ in names or shapes."""
    for name in sorted(own.keys() | other.keys()):
        shapes = [list(state[name].shape) if name in state else "none" for state in (own, other)]
        if shapes[0] != shapes[1]:
            raise ValueError(f"{part}: {name} is {shapes[0]} here and {shapes[1]} there")
