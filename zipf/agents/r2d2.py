"""R2D2 (Kapturowski et al. 2019): recurrent double Q-learning from replay, top to bottom.

Replay holds sequences: the unroll of one env, the `burn_in` rows before it, the agent's memory
before those, and the observations at which the unroll's episodes were truncated. From there, the
online and the target network each unroll the burn-in rows without gradient, to bring their memory
up to date; then, on the T rows of the unroll, the online network takes one optimiser step on

    mean_{t,b} w_b 1/2 (h(G_t) - Q(x_t, a_t))^2

with G_t the lambda-return over h^-1(Q-(x_t+1, argmax_a Q(x_t+1, a))), Q- the target network, h the
rescaling of values and w_b the importance weight of the sequence, times the frame's own if it has
one. The sequence's next priority is
eta max_t |h(G_t) - Q| + (1 - eta) mean_t |h(G_t) - Q|.

With a critic that learns a distribution (`zipf.agents.critics`), it is that of the rescaled returns
h(G_t) of every action. The critic's loss against h(G_t) takes the place of the square, and Q is the
distribution's mean, in priorities and in G_t. Actions, also those in G_t, are those of the largest
risk measure: the values are those of the policy that takes this risk, as in Dabney et al. 2018
(IQN). Note that h^-1 of the mean of rescaled returns is not the mean return: where positive returns
vary it is below, with the scalar critic as with the others.

Where an episode is truncated after a_t, x_t+1 is the observation that it was cut at, and both
networks read it with the memory that they have after x_t. A sequence has room for
`final_observations` of these. A step without one has no error, and the returns of the steps before
it bootstrap from x_t.

Relabelled episodes (`zipf.agents.hindsight`) enter replay as sequences, too, cut from their first
frame on. The memory before a sequence is that of the network as it is when they do.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import torch
from pydantic import Field
from tensordict import TensorDict
from torch import Tensor, nn

from zipf.agents.agent import AgentSpec, register
from zipf.agents.critics import CRITICS, SCALAR
from zipf.agents.hindsight import AchievedOptions
from zipf.agents.learner import Learner, LearnerOptions, Loss, adam
from zipf.agents.memory import State
from zipf.agents.network import Inputs, Torso, frozen_copy, in_full
from zipf.agents.returns import lambda_returns, rescale, unrescale
from zipf.agents.sequences import Sequences
from zipf.agents.truncations import Finals
from zipf.agents.unroll import Needs, Unroll, changed, weighted
from zipf.options import Context, NotNegative, Options, Positive, Share, Size

if TYPE_CHECKING:  # imported where learning begins: it brings TorchRL, which takes a second
    from zipf.agents.replay import Replay

LADDER = 7.0  # alpha of Horgan et al. 2018

METRICS = ("loss", "gradient_norm", "td_error", "value", "priority", "importance_weight")


class R2D2Options(LearnerOptions):
    """The options; `configs/agent.yaml` has the sources of their values."""

    name: Literal["r2d2"]
    weight_decay: NotNegative
    discount: Share
    trace_lambda: Share
    target_period: Size
    epsilon: Share
    epsilon_ladder: bool
    burn_in: Annotated[int, Field(ge=0)]
    final_observations: Annotated[int, Field(ge=0)]
    samples_per_insert: Positive
    replay_capacity: Size
    replay_min: Size
    storage: Literal["ram", "memmap"]
    priority_exponent: NotNegative
    importance_exponent: NotNegative
    priority_max_weight: Share
    fresh_priority: Literal["error", "largest"]

    def problems(self, context: Context) -> Iterator[str]:
        num_envs, unroll_length = context.num_envs, context.unroll_length
        batch = self.samples_per_insert * num_envs
        if abs(batch - round(batch)) > 1e-6 or round(batch) < 1:
            yield (
                f"agent.samples_per_insert={self.samples_per_insert}: times "
                f"collector.num_envs={num_envs} is {batch:g} sequences a batch; should be a whole "
                "number"
            )
        if self.burn_in > unroll_length:
            yield (
                f"agent.burn_in={self.burn_in}: should be at most "
                f"collector.unroll_length={unroll_length}"
            )
        if self.replay_capacity < num_envs:
            yield (
                f"agent.replay_capacity={self.replay_capacity}: should be at least "
                f"collector.num_envs={num_envs}, the sequences of one update"
            )
        if self.replay_min > self.replay_capacity:
            yield (
                f"agent.replay_min={self.replay_min}: should be at most "
                f"agent.replay_capacity={self.replay_capacity}"
            )
        hindsight = context.chosen["hindsight"]
        if isinstance(hindsight, AchievedOptions):
            yield from self._with_hindsight(hindsight)

    def _with_hindsight(self, hindsight: AchievedOptions) -> Iterator[str]:
        if hindsight.length is None:
            yield (
                f"hindsight.length=null: agent={self.name} needs a whole number, the frames of an "
                "episode that its replay has room for"
            )
        elif hindsight.episodes > self.replay_capacity:
            yield (
                f"hindsight.episodes={hindsight.episodes}: should be at most "
                f"agent.replay_capacity={self.replay_capacity}"
            )
        if hindsight.kept_per_goal:
            yield (
                f"hindsight.kept_per_goal={hindsight.kept_per_goal}: agent={self.name} keeps "
                "episodes in its replay; choose null"
            )
        if hindsight.fade is not None:
            yield (
                f"hindsight.fade={hindsight.fade}: agent={self.name} has no costs that fall; "
                "choose null"
            )
        if hindsight.matching_cost:
            yield (
                f"hindsight.matching_cost={hindsight.matching_cost}: agent={self.name} has no "
                "such loss; choose 0"
            )


class DuelingQ(Torso):
    """Q of every action (Wang et al. 2016): a state's value plus each action's advantage, less
    the mean of the advantages; where a critic has several outputs, each of them so (Hessel et al.
    2018)."""

    value_heads = ("value", "advantage")

    def __init__(self, *torso: Any, critic: Options = SCALAR):
        super().__init__(*torso)
        self.critic = CRITICS.build(critic)
        self.value = self.make_head(self.critic.size)
        self.advantage = self.make_head(self.critic.size * self.actions)

    def outputs(self, inputs: Inputs, state: State) -> tuple[Tensor, State]:
        """What the critic reads, float32 [T, B, actions, critic.size], and the memory's state after
        the last frame."""
        core, state = self.remember(inputs, state)
        with in_full(core) as exact:
            value = self.value(exact).unsqueeze(-1)
            advantage = self.advantage(exact).unflatten(-1, (self.critic.size, self.actions))
        return (value + advantage - advantage.mean(-1, keepdim=True)).transpose(-2, -1), state

    def forward(self, inputs: Inputs, state: State) -> tuple[Tensor, State]:
        """Rescaled Q, or the critic's risk measure, float32 [T, B, actions], and the memory's state
        after the last frame."""
        outputs, state = self.outputs(inputs, state)
        return self.critic.value(outputs), state


class Replayed(NamedTuple):
    """What an update learns from: sequences [B], and their importance weights, float32 [B]."""

    items: TensorDict
    weights: Tensor


@register
class R2D2(Learner):
    """The agent: acts epsilon-greedily and learns from replayed sequences.

    Until replay holds `replay_min` sequences, an update inserts its unroll and takes no optimiser
    step. With a burn-in, a run's first unroll has no rows before it and is not inserted. With
    `storage=memmap` replay is kept in the run's folder, else in RAM or, where envs are stepped
    there, on the agent's device.

    With `fresh_priority=error` a sequence enters replay with the priority of its errors, as if it
    had just been learned from; with `largest` it has the largest priority so far, which saves that
    pass and draws every sequence soon. Raises ValueError: options that do not go together.
    """

    Options = R2D2Options
    captures = True
    supports = frozenset({"critic", "exploration", "hindsight", "reweighting"})
    averages_gradients = False  # each learner would draw from a replay of its own
    largest_lag = 1  # replay is off-policy anyway
    options: R2D2Options
    network: DuelingQ
    actor: DuelingQ

    def __init__(self, options: R2D2Options, spec: AgentSpec):
        super().__init__(options, spec)
        self.num_envs = spec.num_envs
        self.batch_size = round(options.samples_per_insert * spec.num_envs)
        self.needs = Needs(burn_in=options.burn_in, final_observations=options.final_observations)
        self.target = frozen_copy(self.network)
        self.parts["target"] = self.target
        self.epsilon = torch.full((self.num_envs,), options.epsilon, dtype=torch.float64)
        if options.epsilon_ladder and self.num_envs > 1:
            # At random, since several levels have a row of envs each, and should explore alike.
            places = torch.randperm(self.num_envs, generator=torch.Generator().manual_seed(0))
            self.epsilon **= 1 + LADDER * places / (self.num_envs - 1)
        self.epsilon = self.epsilon.to(self.device)
        self._inserts = spec.num_envs  # sequences of an update, at most
        if isinstance(spec.hindsight, AchievedOptions) and spec.hindsight.length:
            cuts = -(-spec.hindsight.length // spec.unroll_length)
            self._inserts += cuts * spec.hindsight.episodes
        self.sequences = Sequences(
            spec.unroll_space or spec.observation_space,
            num_envs=spec.num_envs,
            unroll_length=spec.unroll_length,
            burn_in=options.burn_in,
            final_observations=options.final_observations,
            weighted=spec.weighted,
            draws=spec.augmentation.size if spec.augmentation else 0,
            device=self.device if self._keeps_on_device else "cpu",
        )
        self.replay: Replay | None = None

    @property
    def _keeps_on_device(self) -> bool:
        """Whether replay stays where its unrolls are played."""
        return self._sees_on_device and self.options.storage == "ram"

    def make_network(self) -> DuelingQ:
        return DuelingQ(*self.spec.torso, critic=self.spec.critic)

    def make_optimiser(self, parameters: list[nn.Parameter]) -> torch.optim.Optimizer:
        decay = self.options.weight_decay
        return torch.optim.AdamW(parameters, **adam(self.options), weight_decay=decay)

    def act(
        self, inputs: Inputs, memory: State, generator: torch.Generator, *, training: bool = True
    ) -> tuple[Tensor, State, dict[str, Tensor]]:
        """The greedy action in each of B envs; in training, env i of `num_envs` takes a random one
        with probability `epsilon`, or with the ladder (Horgan et al. 2018) epsilon^(1 + 7 k /
        (num_envs - 1)), k a place of its own in 0 .. num_envs - 1.

        What is random is drawn on the generator's device.
        """
        q, memory = self.forward_actor(inputs.unsqueeze(), memory)
        action = q[0].argmax(-1)
        if training:
            device = generator.device
            chance = torch.rand(len(action), generator=generator, device=device)
            anything = torch.randint(
                self.network.actions, action.shape, generator=generator, device=device
            )
            explores = chance.to(action.device) < self.epsilon
            action = torch.where(explores, anything.to(action.device), action)
        return action, memory, {}

    def begin_learning(self, folder: Path | None = None, every: int = 0) -> list[str]:
        """Makes the replay; the lines to show give its size. Raises ValueError: it does not fit
        where it is kept, or there is no folder for it."""
        from zipf.agents.free_space import in_words
        from zipf.agents.replay import Replay

        o = self.options
        if o.storage == "memmap" and folder is None:
            raise ValueError("agent.storage=memmap: needs a folder to keep the replay in")
        self.replay = Replay(
            self.sequences.empty(self.initial_memory(1)),
            capacity=o.replay_capacity,
            priority_exponent=o.priority_exponent,
            importance_exponent=o.importance_exponent,
            folder=folder / "replay" if folder and o.storage == "memmap" else None,
            spare=every * self._inserts,
            seed=self.spec.seed,
        )
        if o.storage == "memmap":
            where = f"disk, in {self.replay.folder}"
        else:
            device = self.device if self._keeps_on_device else "RAM"
            where = f"{device}, as much in every checkpoint, and again while one is read"
        return [
            f"replay: {o.replay_capacity} sequences of {self.sequences.rows} rows, "
            f"{in_words(self.replay.bytes)} of {where}",
            f"replay: {o.samples_per_insert:g} samples per insert, batches of {self.batch_size}; "
            f"learning begins with {o.replay_min} sequences",
        ]

    def update(self, unroll: Unroll) -> dict[str, float | Tensor]:
        """Puts an unroll into replay and takes one optimiser step on a batch from there.

        Returns the loss and other metrics; all but those of the replay are NaN where no step was
        taken. Raises FloatingPointError: learning has diverged; no weights were changed. Raises
        OSError: the replay's files do not fit onto the disk.
        """
        assert self.replay is not None, "begin_learning() comes first"
        inserted = self._insert(unroll)
        metrics: dict[str, float | Tensor] = dict.fromkeys(METRICS, float("nan"))
        if len(self.replay) >= self.options.replay_min:
            items, index, weights = self.replay.sample(self.batch_size)
            items = items.to(self.device) if self._sees_on_device else self._seen(items)
            learned, kept = self.learn(Replayed(items, weights.to(self.device)))
            if not self._keeps_on_device:
                self.check_finite()  # the priorities are waited for anyway
            metrics |= learned
            self.replay.update_priorities(index, kept["priorities"])
        return metrics | {"replay_sequences": len(self.replay), "replay_inserted": inserted}

    def seen(self, batch: Any) -> Any:
        """Sequences as the agent sees them, where that is a part of the captured function."""
        return batch._replace(items=self._seen(batch.items)) if self._sees_on_device else batch

    def _insert(self, unroll: Unroll) -> int:
        """Puts an unroll into replay, and the relabelled episodes that come with it; returns the
        number of sequences."""
        fresh = self.sequences.of_unroll(unroll)
        every = [] if fresh is None else [fresh]
        if unroll.episodes is not None:
            memory = self.initial_memory(unroll.episodes.shape[1])
            every += self.sequences.of_episodes(unroll.episodes, memory, self._advance)
        for items in every:
            self._store(items)
        return sum(map(len, every))

    def _store(self, items: TensorDict) -> None:
        assert self.replay is not None
        index = self.replay.insert(items)
        if self.options.fresh_priority == "error":
            with torch.no_grad():
                _, errors, _ = self._losses(self._seen(items))
            self.replay.update_priorities(index, self._priorities(errors))

    def _seen(self, items: TensorDict) -> TensorDict:
        """Sequences [B] as the agent sees them, where it computes."""
        items = items.clone(recurse=False)
        for name in {"steps", "final"} & set(items.keys()):
            items[name] = self._seen_steps(items[name])
        return items.to(self.device)

    def _seen_steps(self, steps: TensorDict) -> TensorDict:
        """Steps or final observations [...] likewise."""
        if self._sees_on_device:
            steps = steps.to(self.device)
        if self.augmentation is not None:
            steps = changed(steps, self.augmentation)
        return steps.to(self.device)

    @torch.no_grad()
    def _advance(self, steps: TensorDict, memory: State) -> State:
        """The memory after steps [rows, E], from that before them."""
        with self.autocast():
            return self.network.remember(Inputs.of(self._seen_steps(steps)), memory)[-1]

    def loss(self, replayed: Replayed) -> Loss:
        """The loss of sequences from replay; keeps their new `priorities`, float32 [B]."""
        items, weights = replayed
        losses, errors, values = self._losses(items)
        steps = items["steps"].transpose(0, 1)[self.options.burn_in : -1]
        loss = weighted(weights * losses, steps).mean()
        priorities = self._priorities(errors)
        metrics = {
            "td_error": errors.abs().mean(),
            "value": values.mean(),
            "priority": priorities.mean(),
            "importance_weight": weights.mean(),
        }
        return Loss(loss, metrics, {"priorities": priorities})

    def after_update(self) -> None:
        """Lets the target network follow."""
        super().after_update()
        if self.updates % self.options.target_period == 0:
            self.target.load_state_dict(self.network.state_dict())

    def _losses(self, items: TensorDict) -> tuple[Tensor, Tensor, Tensor]:
        """Of sequences [B], float32: the critic's loss of h(G_t) [T, B]; and, without gradient,
        h(G_t) - Q [T, B] and the values h^-1(Q) of the greedy actions of the rows [T + 1, B]."""
        o, critic = self.options, self.network.critic
        steps = items["steps"].transpose(0, 1)
        memory = {name: items["memory"][name] for name in items["memory"].keys()}
        prefix, steps = steps[: self.options.burn_in], steps[self.options.burn_in :]
        inputs, finals = Inputs.of(steps), None
        if self.options.final_observations:
            finals = Finals(items["final"].transpose(0, 1), len(steps))
            inputs = finals.insert(inputs)
        target_memory = memory
        with torch.no_grad(), self.autocast():
            if self.options.burn_in:
                _, target_memory = self.target.remember(Inputs.of(prefix), memory)
                _, memory = self.network.remember(Inputs.of(prefix), memory)
            target_outputs, _ = self.target.outputs(inputs, target_memory)
        with self.autocast():
            outputs, _ = self.network.outputs(inputs, memory)

        chosen = critic.value(outputs.detach()).argmax(-1)
        bootstraps = unrescale(critic.mean(of_actions(target_outputs, chosen)))
        values = unrescale(critic.mean(of_actions(outputs.detach(), chosen)))
        unknown = (steps["truncated"] & ~steps["terminated"])[:-1]
        final_values = torch.zeros_like(steps["reward"][:-1])
        if finals is not None:
            known, final_values = finals.by_step(bootstraps)
            unknown = unknown & ~known
            outputs, bootstraps, values = (
                finals.without(rows) for rows in (outputs, bootstraps, values)
            )
        steps = steps[:-1]
        returns = lambda_returns(
            rewards=torch.where(unknown, bootstraps[:-1], steps["reward"]),
            values=bootstraps[1:],
            terminated=steps["terminated"],
            truncated=steps["truncated"],
            truncation_values=final_values,
            discount=o.discount,
            lambda_=o.trace_lambda,
        )
        targets, taken = rescale(returns), of_actions(outputs[:-1], steps["action"])
        losses, errors = critic.loss(taken, targets), targets - critic.mean(taken.detach())
        return losses.masked_fill(unknown, 0.0), errors.masked_fill(unknown, 0.0), values

    def _priorities(self, errors: Tensor) -> Tensor:
        """The priorities, float32 [B], of sequences with errors [T, B]."""
        sizes, eta = errors.abs(), self.options.priority_max_weight
        return eta * sizes.amax(0) + (1 - eta) * sizes.mean(0)

    def state_dict(self) -> dict[str, Any]:
        """Everything that `update` changes; with `storage=memmap` without the sequences, which are
        in the replay's files beside the checkpoint."""
        assert self.replay is not None, "begin_learning() comes first"
        state = super().state_dict()
        steps = state.pop("updates")  # of the optimiser: none until replay holds `replay_min`
        replay = self.replay.state_dict()
        return state | {"steps": steps, "prefix": self.carried(), "replay": replay}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continues from `state_dict()`; without the replay where `begin_learning` was not called.
        Raises OSError: the files of the replay are missing, or are not those of this state."""
        super().load_state_dict(state | {"updates": state["steps"]})
        if self.replay is None:
            return
        self.carry(state["prefix"])
        self.replay.load_state_dict(state["replay"])

    def carried(self) -> dict[str, Any]:
        return self.sequences.carried()

    def carry(self, carried: dict[str, Any]) -> None:
        """With {} the next unroll is not inserted where there is a burn-in, as a run's first."""
        self.sequences.carry(carried, self.device)


def of_actions(outputs: Tensor, action: Tensor) -> Tensor:
    """The outputs for these actions: [T, B, actions, size], int64 [T, B] -> [T, B, size]."""
    index = action.unsqueeze(-1).unsqueeze(-1).expand(*action.shape, 1, outputs.shape[-1])
    return outputs.gather(-2, index).squeeze(-2)
