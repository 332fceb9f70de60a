"""BYOL (Grill et al. 2020): the memory's output predicts encoded frames.

Three forms, which share all but the forward map and the augmentation. The paper gives sizes, calls
its loss predictive, and says that it did not enforce temporal consistency and that augmentations
were not tuned. Two readings of that: `byol` predicts the next frame as it is, `byol_frame` the same
frame, shifted. Ours is `byol_horizon`: several steps ahead (Guo et al. 2022) towards frames that
are shifted (Schwarzer et al. 2021).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Literal

import gymnasium as gym
import torch
import torch.nn.functional as F
from pydantic import Field
from torch import Tensor, nn

from zipf.agents.auxiliary.base import AUXILIARIES, Auxiliary, AuxiliaryOptions, sample
from zipf.agents.encoders import Encoder, has_image
from zipf.agents.network import Inputs, Torso, frozen_copy, head
from zipf.agents.network_options import NetworkOptions
from zipf.options import Fraction, NotNegative, Share, Size


class BYOLSizes(AuxiliaryOptions):
    """Options of all forms; they learn from a random `fraction` of the envs."""

    weight: NotNegative
    fraction: Fraction
    target_rate: Share
    forward_hidden: Size
    projection_hidden: Size
    prediction_hidden: Size
    projection_size: Size


class BYOLOptions(BYOLSizes):
    """Predicts the next frame's code."""

    name: Literal["byol"]


class BYOLFrameOptions(BYOLSizes):
    """Predicts the code of the memory's own frame, which is shifted by up to `shift` pixels.

    The square of `unshifted` x `unshifted` pixels in the top left corner is not shifted.
    """

    name: Literal["byol_frame"]
    shift: Annotated[int, Field(ge=0)]
    unshifted: Annotated[int, Field(ge=0)]


class BYOLHorizonOptions(BYOLSizes):
    """Predicts the codes of the next `horizon` frames, which are shifted by up to `shift` pixels.

    The square of `unshifted` x `unshifted` pixels in the top left corner is not shifted.
    """

    name: Literal["byol_horizon"]
    horizon: Size
    shift: Annotated[int, Field(ge=0)]
    unshifted: Annotated[int, Field(ge=0)]


AnyBYOLOptions = BYOLOptions | BYOLFrameOptions | BYOLHorizonOptions


class BYOL(Auxiliary):
    """Predicts encoded frames from the memory's output and the actions in between.

    With f the encoder, g the projector, q the predictor, F the forward map, and f', g' the target
    networks (moving averages of f and g), the loss is the mean over rows t and distances k within
    an episode of

        2 - 2 cos(q(g(F_k(core_t, a_t .. a_{t+k-1}))), g'(f'(o_{t+k})))

    where `byol_frame` has k = 0 alone, for rows 1 to T and without actions. Only the frames that
    the target networks read are shifted; the memory reads them as they are.
    """

    def __init__(
        self, encoder: Encoder, core_size: int, actions: int, options: AnyBYOLOptions, seed: int
    ):
        super().__init__(seed)
        o = self.options = options
        self.actions = actions
        sizes = core_size, actions, o.forward_hidden, encoder.size
        self.forward_map: SameFrameMap | OneStepMap | HorizonMap
        match o:
            case BYOLFrameOptions():
                self.forward_map = SameFrameMap(core_size, o.forward_hidden, encoder.size)
            case BYOLHorizonOptions():
                self.forward_map = HorizonMap(*sizes, o.horizon)
            case BYOLOptions():
                self.forward_map = OneStepMap(*sizes)
        self.projector = NormalisedMLP(encoder.size, o.projection_hidden, o.projection_size)
        self.predictor = NormalisedMLP(o.projection_size, o.prediction_hidden, o.projection_size)
        self.target_encoder = frozen_copy(encoder)
        self.target_projector = frozen_copy(self.projector)

    def forward(self, inputs: Inputs, core: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted `auxiliary_byol`, in [0, 4].

        `auxiliary_byol_spread` measures how much the targets differ from frame to frame: the root
        mean squared distance of their directions from the mean direction, 0 where they have
        collapsed and near 1 where they are uniform.
        """
        generator = self.generator()
        if self.options.fraction < 1:
            envs = sample(core.shape[1], self.options.fraction, generator)
            core = core[:, envs]
            inputs = Inputs(
                {name: part[:, envs] for name, part in inputs.observation.items()},
                *(part[:, envs] for part in inputs[1:]),
            )
        targets = F.normalize(self.targets(inputs, generator), dim=-1)
        total = torch.zeros((), device=core.device)
        pairs = torch.zeros((), device=core.device)
        for first, features, counted in self.predictions(inputs, core):
            projected = self.projector(features, counted)
            predicted = F.normalize(self.predictor(projected, counted), dim=-1)
            distance = 2 - 2 * (predicted * targets[first:]).sum(-1)
            total = total + distance.masked_fill(~counted, 0.0).sum()
            pairs = pairs + counted.sum()
        loss = total / pairs.clamp(min=1)
        later = self.targeted(inputs)
        mean = (targets * later.unsqueeze(-1)).sum((0, 1)) / later.sum().clamp(min=1)
        spread = (1 - mean.square().sum()).clamp(min=0).sqrt()  # as directions have length 1
        metrics = {"auxiliary_byol": loss.detach(), "auxiliary_byol_spread": spread.detach()}
        return self.options.weight * loss, metrics

    def predictions(self, inputs: Inputs, core: Tensor) -> Iterator[tuple[int, Tensor, Tensor]]:
        """For each distance: the first of the `targets` that are predicted, the predicted features
        [T', B, F], and which of them count, bool [T', B]."""
        if isinstance(self.forward_map, SameFrameMap):
            yield 0, self.forward_map(core[1:]), self.targeted(inputs)
            return
        # The action between two rows of an episode; -1, no action, where an episode begins.
        every = torch.arange(self.actions, device=core.device)
        actions = (inputs.previous_action[1:].unsqueeze(-1) == every).to(torch.int64)
        same_episode = torch.ones_like(inputs.is_first)
        for k, features in enumerate(self.forward_map(core[:-1], actions.to(core.dtype)), start=1):
            same_episode = same_episode[:-1] & ~inputs.is_first[k:]
            yield k - 1, features, same_episode

    def targeted(self, inputs: Inputs) -> Tensor:
        """Which of the rows 1 to T are predicted from any row, bool [T, B]."""
        later = ~inputs.is_first[1:]
        return torch.ones_like(later) if isinstance(self.forward_map, SameFrameMap) else later

    @torch.no_grad()
    def targets(self, inputs: Inputs, generator: torch.Generator) -> Tensor:
        """The target networks' output for rows 1 to T: [T, B, projection size]."""
        o = self.options
        later = self.targeted(inputs)
        observation = {name: part[1:].flatten(0, 1) for name, part in inputs.observation.items()}
        if not isinstance(o, BYOLOptions) and o.shift:
            observation["image"] = random_shift(
                observation["image"], o.shift, o.unshifted, generator
            )
        return self.target_projector(
            self.target_encoder(observation).unflatten(0, later.shape), later
        )

    def begin_with(self, encoder: Encoder) -> None:
        self.target_encoder.load_state_dict(encoder.state_dict())

    @torch.no_grad()
    def after_update(self, encoder: Encoder) -> None:
        """Moves the target networks: target <- rate * target + (1 - rate) * online."""
        pairs = (self.target_encoder, encoder), (self.target_projector, self.projector)
        for target, online in pairs:
            for old, new in zip(target.parameters(), online.parameters(), strict=True):
                old.lerp_(new, 1 - self.options.target_rate)


class NormalisedMLP(nn.Module):
    """A hidden layer with batch normalisation: projector and predictor of Grill et al. 2020.

    Without it (Richemond et al. 2020 need other means then) the outputs of all rows are nearly
    equal at the start, and become more so. The statistics are always those of the rows in `mask`.
    """

    def __init__(self, inputs: int, hidden: int, outputs: int):
        super().__init__()
        self.enter = nn.Linear(inputs, hidden)
        self.scale = nn.Parameter(torch.ones(hidden))
        self.offset = nn.Parameter(torch.zeros(hidden))
        self.leave = nn.Linear(hidden, outputs, bias=False)

    def forward(self, inputs: Tensor, mask: Tensor) -> Tensor:
        """`[T, B, inputs]`, bool `[T, B]` -> float32 `[T, B, outputs]`, for rows of the mask."""
        hidden = self.enter(inputs).float()
        weight = (mask / mask.sum().clamp(min=1)).unsqueeze(-1)
        hidden = hidden - (weight * hidden).sum((0, 1))
        variance = (weight * hidden.square()).sum((0, 1))
        hidden = self.scale * hidden * (variance + 1e-5).rsqrt() + self.offset
        return self.leave(hidden.relu()).float()


class SameFrameMap(nn.Module):
    """From the memory's output to the features of the frame that it has just read."""

    def __init__(self, core_size: int, hidden: int, features: int):
        super().__init__()
        self.layers = head(core_size, hidden, features)

    def forward(self, core: Tensor) -> Tensor:
        """`[T, B, core]` -> `[T, B, features]`."""
        return self.layers(core)


class OneStepMap(nn.Module):
    """From the memory's output and an action to the next frame's features."""

    def __init__(self, core_size: int, actions: int, hidden: int, features: int):
        super().__init__()
        self.layers = head(core_size + actions, hidden, features)

    def forward(self, core: Tensor, actions: Tensor) -> Iterator[Tensor]:
        """`[T, B, core]`, one-hot `[T, B, actions]` -> `[T, B, features]`, once."""
        yield self.layers(torch.cat([core, actions], -1))


class HorizonMap(nn.Module):
    """Several steps ahead: a GRU whose initial state is made from the memory's output and whose
    inputs are the actions."""

    def __init__(self, core_size: int, actions: int, hidden: int, features: int, horizon: int):
        super().__init__()
        self.horizon = horizon
        self.begin = nn.Linear(core_size, hidden)
        self.gru = nn.GRUCell(actions, hidden)
        self.end = nn.Linear(hidden, features)

    def forward(self, core: Tensor, actions: Tensor) -> Iterator[Tensor]:
        """`[T, B, core]`, one-hot `[T, B, actions]` -> `[T - k + 1, B, features]` for each k.
        Row t is k steps after row t of `core`; k goes from 1 to the horizon or to T."""
        state = self.begin(core).tanh()
        for k in range(min(self.horizon, len(core))):
            state = state[: len(core) - k]
            flat = self.gru(actions[k:].flatten(0, 1), state.flatten(0, 1))
            state = flat.view_as(state)
            yield self.end(state)


def random_shift(image: Tensor, most: int, unshifted: int, generator: torch.Generator) -> Tensor:
    """Shifts every image by up to `most` pixels each way and repeats the pixels of its edges there
    (Kostrikov et al. 2020).

    The square of `unshifted` x `unshifted` pixels in the top left corner stays in its place, and no
    shifted copy of it appears beside it: pixels that would show one are not shifted.
    uint8 [N, H, W, C].
    """
    n, height, width, channels = image.shape
    device = image.device
    inner_rows, inner_columns = slice(most, most + height), slice(most, most + width)
    padded = image.new_empty(n, height + 2 * most, width + 2 * most, channels)
    padded[:, inner_rows, inner_columns] = image
    padded[:, inner_rows, :most] = image[:, :, :1]
    padded[:, inner_rows, most + width :] = image[:, :, -1:]
    padded[:, :most] = padded[:, most : most + 1]
    padded[:, most + height :] = padded[:, most + height - 1 : most + height]
    down, right = torch.randint(0, 2 * most + 1, (2, n), generator=generator, device=device)
    # All shifts of an image as views of it: choosing one copies whole rows.
    one, row, column, channel = padded.stride()
    views = padded.as_strided(
        (n, 2 * most + 1, 2 * most + 1, height, width, channels),
        (one, row, column, row, column, channel),
    )
    shifted = views[torch.arange(n, device=device), down, right]

    def of_square(shift: Tensor, pixels: int) -> tuple[Tensor, Tensor]:
        place = torch.arange(min(unshifted + most, pixels), device=device).expand(n, -1)
        return place < unshifted, place + shift[:, None] - most < unshifted

    row_is, row_was = of_square(down, height)
    column_is, column_was = of_square(right, width)
    is_square = row_is[:, :, None] & column_is[:, None, :]
    was_square = row_was[:, :, None] & column_was[:, None, :]
    corner = (slice(None), slice(row_is.shape[1]), slice(column_is.shape[1]))
    kept = (is_square | was_square).unsqueeze(-1)
    shifted[corner] = torch.where(kept, image[corner], shifted[corner])
    return shifted


def build(
    options: AnyBYOLOptions,
    space: gym.spaces.Dict,
    network: NetworkOptions,
    torso: Torso,
    seed: int,
) -> BYOL:
    """The loss for an agent; the arguments are those of `build_auxiliary`.
    Raises ValueError: a form that shifts images, for observations without one."""
    if not isinstance(options, BYOLOptions) and not has_image(space):
        raise ValueError(
            f"auxiliary={options.name} needs an image named 'image', and the observations here "
            f"have only {', '.join(sorted(space))}; auxiliary=byol reads whatever the network does"
        )
    return BYOL(torso.encoder, torso.memory.size, torso.actions, options, seed)


AUXILIARIES.register(BYOLOptions, build)
AUXILIARIES.register(BYOLFrameOptions, build)
AUXILIARIES.register(BYOLHorizonOptions, build)
