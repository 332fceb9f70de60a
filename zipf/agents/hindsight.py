"""Hindsight: learning from episodes as if what they achieved had been asked for.

An episode that achieved something else than it was asked for is a success at that (Andrychowicz
et al. 2017; with language: Chan et al. 2019). Collection relabels whole episodes; replay stores
them beside the others, and actor-critics imitate them as far as they were better than expected
(Oh et al. 2018), by

    mean_{t,e}[ -c_p log pi(a_t|x_t) (R_t - V(x_t))_+  +  c_v/2 ((R_t - V(x_t))_+)^2 ]

where R_t is the discounted return to the episode's end and the first factor (R - V)_+ a constant;
with `advantage=none` that factor is 1 (Ghosh et al. 2021). Relabelled episodes are many where
successes are few, and their gradient then hides that of reinforcement learning; with `fade` both
costs fall, linearly with the number of updates, to 0.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

import torch
import torch.nn.functional as F
from pydantic import Field
from tensordict import TensorDict
from torch import Tensor

from zipf.agents.encoders import Encoder
from zipf.agents.episodic import NO_EPISODIC
from zipf.agents.network import ActorCritic, Inputs, action_log_probability, autocast
from zipf.agents.network_options import MatchingOptions
from zipf.options import Context, NotNegative, Options, Size


class NoHindsightOptions(Options):
    """Episodes are learned from as they were, as in the paper."""

    name: Literal["none"]


class AchievedOptions(Options):
    """Episodes are also learned from as if what they achieved had been asked for.

    At most `episodes` of them an update, drawn at random from those that ended during the unroll,
    and of each the last `length` frames, None: all. With `kept_per_goal` the last so many episodes
    that achieved each goal are kept, whether or not it was asked for, and updates draw from these,
    every goal as often as the others. `reward` is what success pays. `policy_cost` and
    `value_cost` are c_p and c_v, and after `fade` updates they are 0; None: they stay as they are.
    `advantage` and `value_cost` are of actor-critics alone, and `reward` of these and R2D2, which
    needs no costs. `matching_cost` times the contrastive loss of `network=matching` is added.
    """

    name: Literal["achieved"]
    episodes: Size
    length: Size | None
    kept_per_goal: Size | None
    reward: Annotated[float, Field(allow_inf_nan=False)]
    advantage: Literal["positive", "none"]
    policy_cost: NotNegative
    value_cost: NotNegative
    fade: Size | None
    matching_cost: NotNegative = 0.0

    def problems(self, context: Context) -> Iterator[str]:
        if not context.has_goals:
            yield (
                f"hindsight={self.name}: the envs of {context.family} do not say what an episode "
                "asks for; choose hindsight=none"
            )
        episodic, network = context.chosen["episodic"], context.chosen["network"]
        if self.kept_per_goal and episodic != NO_EPISODIC:
            yield (
                f"hindsight.kept_per_goal={self.kept_per_goal}: kept episodes would read their own "
                f"rows from the dictionary of episodic={episodic.name}; choose null, or "
                "episodic=none"
            )
        if not self.matching_cost:
            return
        option = f"hindsight.matching_cost={self.matching_cost}"
        if not isinstance(network, MatchingOptions):
            yield (
                f"{option}: network={network.name} matches no images with instructions; choose 0, "
                "or network=matching"
            )
        elif network.matcher == "fixed":
            yield (
                f"{option}: network.matcher=fixed learns nothing; choose 0, or "
                "network.matcher=learned"
            )

    def share(self, updates: int | Tensor) -> float | Tensor:
        """The factor of `policy_cost` and `value_cost` after so many updates, in [0, 1]; float32 []
        of a tensor [] where it fades."""
        if self.fade is None:
            return 1.0
        left = 1 - updates / self.fade
        return left.clamp(min=0) if isinstance(left, Tensor) else max(0.0, left)


HindsightOptions = NoHindsightOptions | AchievedOptions
NO_HINDSIGHT = NoHindsightOptions(name="none")


def hindsight_loss(
    network: ActorCritic,
    episodes: TensorDict | None,
    options: HindsightOptions,
    *,
    discount: float,
    updates: int | Tensor,
    precision: Literal["float32", "bfloat16"] = "float32",
) -> tuple[Tensor | float, dict[str, Tensor]]:
    """The loss of relabelled episodes [L, E], as `Unroll.episodes` has them, and metrics, after so
    many updates.

    The memory is unrolled from before each episode's first row. Where the `mask` of one of the E is
    False throughout, there is no episode in its place; its actions are some that there are. Without
    an episode, or once the costs are 0, the loss is 0, `hindsight_episodes` too, and the other
    metrics are NaN; without hindsight there are no metrics. The contrastive loss of a matcher,
    which does not fade, is added (`matching_loss`).

    With the number of updates as a tensor [], all shapes are those of `episodes`, and no number is
    read on the host.
    """
    if isinstance(options, NoHindsightOptions):
        return 0.0, {}
    matching, matched = matching_loss(network.encoder, episodes, options, precision=precision)
    share = options.share(updates)
    if episodes is None or (not isinstance(share, Tensor) and share == 0):
        device = next(network.parameters()).device
        nothing = torch.full((), torch.nan, device=device)
        return matching, {
            "hindsight_policy_loss": nothing,
            "hindsight_value_loss": nothing,
            "hindsight_episodes": torch.zeros((), device=device),
            **matched,
        }
    mask = episodes["mask"]
    with autocast(mask.device.type, precision):
        outputs = network(Inputs.of(episodes), network.memory.initial_state(mask.shape[1]))
    returns = discounted_returns(episodes["reward"], discount)
    better = (returns - outputs.value).clamp(min=0)
    factor = better.detach() if options.advantage == "positive" else torch.ones_like(returns)
    log_pi = action_log_probability(outputs.logits.log_softmax(-1), episodes["action"])
    frames = mask.sum().clamp(min=1)
    policy_loss = -(log_pi * factor * mask).sum() / frames
    value_loss = 0.5 * (better.square() * mask).sum() / frames
    loss = share * (options.policy_cost * policy_loss + options.value_cost * value_loss)
    count = mask.any(0).sum() * (share > 0)
    return loss + matching, {
        "hindsight_policy_loss": policy_loss.masked_fill(count == 0, torch.nan),
        "hindsight_value_loss": value_loss.masked_fill(count == 0, torch.nan),
        "hindsight_episodes": count.float(),
        **matched,
    }


def matching_loss(
    encoder: Encoder,
    episodes: TensorDict | None,
    options: AchievedOptions,
    *,
    precision: Literal["float32", "bfloat16"] = "float32",
) -> tuple[Tensor | float, dict[str, Tensor]]:
    """The contrastive loss of the last frames of relabelled episodes [L, E], times its cost, and
    the metric `matching_accuracy`: how often the achieved goal matches best of those in the batch.

    It is the cross-entropy of softmax_g(m_g), where m_g = log sum_p e^s_pg over the places p. Where
    episodes have a `region` [L, E, 4], the part of the image that the last action points at (as
    `ZipfVectorEnv.action_regions`), the sum is over the places there, and the softmax has one more,
    negative term: the achieved goal at all places outside the region. Where episodes have
    `achieved`, bool [L, E], those that did not achieve what they ask for are left out.

    Without such an episode the loss is 0 and the metric NaN; without a cost there is no metric.
    """
    if not options.matching_cost:
        return 0.0, {}
    if episodes is not None and "achieved" in episodes.keys():
        episodes = episodes[:, episodes["achieved"][0]]
    if episodes is None or episodes.shape[1] == 0:
        return 0.0, {"matching_accuracy": torch.tensor(float("nan"))}
    ends = episodes["mask"].sum(0) - 1
    each = torch.arange(len(ends), device=ends.device)
    last = {name: frames[ends, each] for name, frames in episodes["observation"].items()}
    texts = [last[name] for name in encoder.texts]
    goals, goal = torch.cat(texts, 1).unique(dim=0, return_inverse=True)
    parts = goals.split([text.shape[1] for text in texts], 1)
    with autocast(goal.device.type, precision):
        scores = encoder.match(last, dict(zip(encoder.texts, parts, strict=True)))
    if "region" in episodes.keys():
        top, left, bottom, right = episodes["region"][ends, each].unsqueeze(1).unbind(-1)
        down, across = encoder.places().unbind(-1)
        there = (top <= down) & (down < bottom) & (left <= across) & (across < right)  # [E, P]
        own = scores[each, :, goal].masked_fill(there, _NOWHERE).logsumexp(1, keepdim=True)
        named = scores.masked_fill(~there.unsqueeze(-1), _NOWHERE).logsumexp(1)
        matches = torch.cat([named, own], 1)
    else:
        matches = scores.logsumexp(1)
    loss = options.matching_cost * F.cross_entropy(matches, goal)
    return loss, {"matching_accuracy": (matches.argmax(-1) == goal).float().mean()}


_NOWHERE = -1e4  # far below any score, and finite: minus infinity everywhere has no gradient


def discounted_returns(rewards: Tensor, discount: float) -> Tensor:
    """R_t = r_t + discount R_t+1 of episodes that end with the last row, [L, E] -> [L, E]; the rows
    behind a shorter episode's end have no reward."""
    returns = torch.empty_like(rewards)
    following = torch.zeros_like(rewards[0])
    for t in reversed(range(len(rewards))):
        following = rewards[t] + discount * following
        returns[t] = following
    return returns
