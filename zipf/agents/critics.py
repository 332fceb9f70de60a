"""Critics: what an agent learns about returns, a number or a distribution, and the risk it takes.

A critic turns `size` outputs of a head into

    mean    the mean of the returns
    value   a risk measure of them, which an agent uses in the place of a value: the mean, or the
            mean of their lowest or highest share (conditional value at risk, CVaR)
    loss    a loss of the outputs against targets, which are numbers

`scalar` learns the mean alone; `hl_gauss` and `quantile` learn a distribution. An agent's targets
are estimates of returns, such as those of V-trace: rewards up to some step, and the value there.
So the distribution is that of these targets, over actions, over what the envs do, and in replay
over older policies, too. What varies behind the step where a target bootstraps is not in it. This
is simpler than a distributional Bellman equation (Bellemare et al. 2017), and the same for every
agent.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import torch
from pydantic import Field
from torch import Tensor, nn

from zipf.options import Fraction, Options, Positive
from zipf.registry import Registry

Finite = Annotated[float, Field(allow_inf_nan=False)]
Risk = Literal["neutral", "averse", "seeking"]


class ScalarOptions(Options):
    """The mean of the returns, as in the paper."""

    name: Literal["scalar"]


class HLGaussOptions(Options):
    """A histogram of returns; `configs/critic.yaml` has the sources of the values.

    `bins` of equal width cover the returns from `low` to `high`; `sigma` is the standard deviation
    of the targets' Gaussians in widths of a bin. `risk_level` is the share of the returns that a
    `risk` other than neutral looks at.
    """

    name: Literal["hl_gauss"]
    bins: Annotated[int, Field(ge=2)]
    low: Finite
    high: Finite
    sigma: Positive
    risk: Risk
    risk_level: Fraction


class QuantileOptions(Options):
    """Quantiles of returns; `configs/critic.yaml` has the sources of the values.

    Errors smaller than `kappa` have a squared loss. `risk_level` is the share of the returns that a
    `risk` other than neutral looks at.
    """

    name: Literal["quantile"]
    quantiles: Annotated[int, Field(ge=1)]
    kappa: Positive
    risk: Risk
    risk_level: Fraction


SCALAR = ScalarOptions(name="scalar")


class Critic(nn.Module):
    """The base of critics.

    Attributes:
        size: outputs of the head for each value.
    """

    size: int

    def mean(self, outputs: Tensor) -> Tensor:
        """The mean of the returns: float32 [..., size] -> [...]."""
        raise NotImplementedError

    def value(self, outputs: Tensor) -> Tensor:
        """The risk measure of the returns, by default the mean: [..., size] -> [...]."""
        return self.mean(outputs)

    def loss(self, outputs: Tensor, targets: Tensor) -> Tensor:
        """The loss against returns: [..., size], [...] -> [...]."""
        raise NotImplementedError


class Scalar(Critic):
    """The mean of the returns; it has no weights."""

    size = 1

    def mean(self, outputs: Tensor) -> Tensor:
        return outputs.squeeze(-1)

    def loss(self, outputs: Tensor, targets: Tensor) -> Tensor:
        """Half the squared error: [..., size], [...] -> [...]."""
        return 0.5 * (targets - self.mean(outputs)).square()


class Distribution(Critic):
    """The base of critics that learn a distribution."""

    def __init__(self, risk: Risk, risk_level: float):
        super().__init__()
        self.risk = risk
        self.risk_level = risk_level

    def atoms(self, outputs: Tensor) -> tuple[Tensor, Tensor]:
        """The distribution as returns with probabilities, both of a shape that broadcasts to
        [..., size], the returns ascending."""
        raise NotImplementedError

    def mean(self, outputs: Tensor) -> Tensor:
        returns, probabilities = self.atoms(outputs)
        return (returns * probabilities).sum(-1)

    def value(self, outputs: Tensor) -> Tensor:
        """`neutral`: the mean. `averse` and `seeking`: the mean of the lowest and of the highest
        `risk_level` of the returns (CVaR, Rockafellar and Uryasev 2000)."""
        if self.risk == "neutral":
            return self.mean(outputs)
        returns, probabilities = self.atoms(outputs)
        if self.risk == "seeking":
            return -cvar(-returns.flip(-1), probabilities.flip(-1), self.risk_level)
        return cvar(returns, probabilities, self.risk_level)


def cvar(returns: Tensor, probabilities: Tensor, level: float) -> Tensor:
    """The mean of the lowest `level` of a distribution, 0 < level <= 1, [..., n], [..., n] ->
    [...], from ascending returns and their probabilities, which sum to 1.

    A return at the boundary counts with the part of its probability that lies below `level`.
    """
    below = (probabilities.cumsum(-1) - probabilities).clamp(min=0)
    counted = torch.minimum(probabilities, (level - below).clamp(min=0))
    return (returns * counted).sum(-1) / counted.sum(-1)


class HLGauss(Distribution):
    """A histogram of returns, learned by cross-entropy (Imani and White 2018, Farebrother et al.
    2024): the outputs are the logits of its bins.

    A target y becomes the probabilities that a Gaussian with mean y has in the bins, given that it
    is in their range. So the histogram is that of the targets, blurred by `sigma` widths of a bin:
    CVaR of a return that does not vary is somewhat below or above it. Means are nearly exact with a
    `sigma` of half a bin's width or more, as far as the range does not cut the Gaussian; towards an
    end of the range they are drawn inwards, by up to a width.

    Targets are clipped to the range.

    Raises:
        ValueError: the range is empty.
    """

    edges: Tensor
    centres: Tensor

    def __init__(self, options: HLGaussOptions):
        super().__init__(options.risk, options.risk_level)
        if options.low >= options.high:
            raise ValueError(
                f"critic.low={options.low}: should be less than critic.high={options.high}"
            )
        self.size = options.bins
        self.low, self.high = options.low, options.high
        edges = torch.linspace(options.low, options.high, options.bins + 1, dtype=torch.float64)
        width = (options.high - options.low) / options.bins
        self.scale = 1 / (math.sqrt(2) * options.sigma * width)
        self.variance = (options.sigma * width) ** 2
        self.register_buffer("edges", edges.float(), persistent=False)
        self.register_buffer("centres", ((edges[1:] + edges[:-1]) / 2).float(), persistent=False)

    def atoms(self, outputs: Tensor) -> tuple[Tensor, Tensor]:
        """The centres of the bins, and their probabilities."""
        return self.centres, outputs.softmax(-1)

    def probabilities(self, targets: Tensor) -> Tensor:
        """What the histogram should be: [...] -> [..., size], which sums to 1."""
        distance = self.edges - targets.clamp(self.low, self.high).unsqueeze(-1)
        below = torch.erf(distance * self.scale)
        return below.diff(dim=-1) / (below[..., -1:] - below[..., :1])

    def loss(self, outputs: Tensor, targets: Tensor) -> Tensor:
        """The cross-entropy of the bins times the Gaussian's variance: [..., size], [...] -> [...].

        The factor is ours. For a histogram that is itself a blurred return, the slope is then that
        of half the squared error. The cross-entropy alone is 44 times as steep where the Gaussian's
        standard deviation is 0.15, and an actor that shares its memory with it learns next to
        nothing.
        """
        cross_entropy = -(self.probabilities(targets) * outputs.log_softmax(-1)).sum(-1)
        return self.variance * cross_entropy


class Quantile(Distribution):
    """Quantiles of returns, learned by quantile regression (Dabney et al. 2018): output i of n is
    the quantile of (i + 1/2) / n.

    Each target is a sample of the returns. Errors smaller than `kappa` have a squared loss, as in
    QR-DQN: what is found is a quantile for returns that vary much more than `kappa`, and an
    expectile for returns that vary less.
    """

    shares: Tensor

    def __init__(self, options: QuantileOptions):
        super().__init__(options.risk, options.risk_level)
        self.size = options.quantiles
        self.kappa = options.kappa
        shares = (torch.arange(self.size, dtype=torch.float64) + 0.5) / self.size
        self.register_buffer("shares", shares.float(), persistent=False)

    def atoms(self, outputs: Tensor) -> tuple[Tensor, Tensor]:
        """The quantiles in ascending order, equally likely; outputs may be out of order."""
        return outputs.sort(-1).values, torch.full_like(outputs, 1 / self.size)

    def mean(self, outputs: Tensor) -> Tensor:
        return outputs.mean(-1)

    def loss(self, outputs: Tensor, targets: Tensor) -> Tensor:
        """The quantile Huber loss divided by `kappa`: [..., size], [...] -> [...].

        Ours is the mean over the quantiles, where QR-DQN has the sum, so that the gradient that
        reaches the memory does not grow with their number.
        """
        errors = targets.unsqueeze(-1) - outputs
        sizes, kappa = errors.abs(), self.kappa
        huber = torch.where(sizes <= kappa, 0.5 * sizes.square(), kappa * (sizes - 0.5 * kappa))
        weights = (self.shares - (errors.detach() < 0).float()).abs()
        return (weights * huber / kappa).mean(-1)


CRITICS: Registry[Critic] = Registry("critic")
"""Each is built from its options alone."""

CRITICS.register(ScalarOptions, lambda options: Scalar())
CRITICS.register(HLGaussOptions, HLGauss)
CRITICS.register(QuantileOptions, Quantile)
