"""Auxiliary losses: what else an agent's memory is asked for, beside what the reward teaches.

`Reconstruction` (Hill et al. 2020) asks it for the frame and the instruction just seen, `BYOL`
(Grill et al. 2020, in the forms that reinforcement learning gave it) for the coming frames' codes.
Both read the memory's output, so that their gradients reach memory and encoder. An agent adds the
loss to its own, hands `learned()` to its optimiser and calls `after_update` behind each step:

    loss, metrics = auxiliary(inputs, outputs.core)
    ...
    auxiliary.after_update(network.encoder)
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from typing import Annotated, Literal

import gymnasium as gym
import torch
import torch.nn.functional as F
from pydantic import Field
from torch import Tensor, nn

from zipf.agents.encoders import (
    Encoder,
    NetworkOptions,
    ResidualBlock,
    ResNetOptions,
    ShallowOptions,
    largest_patch,
)
from zipf.agents.network import Inputs, Torso, head
from zipf.options import Options

Size = Annotated[int, Field(ge=1)]
Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(gt=0, le=1)]
Rate = Annotated[float, Field(ge=0, le=1)]


class NoAuxiliaryOptions(Options):
    """No auxiliary loss."""

    name: Literal["none"]


class VisionOptions(Options):
    """Reconstructs the image, in a random `fraction` of the frames."""

    name: Literal["vision"]
    vision_weight: Weight
    fraction: Fraction


class VisionLanguageOptions(Options):
    """Reconstructs image and instruction, in a random `fraction` of the frames."""

    name: Literal["vision_language"]
    vision_weight: Weight
    language_weight: Weight
    fraction: Fraction


class BYOLSizes(Options):
    """What both forms can be told; they learn from a random `fraction` of the worlds."""

    weight: Weight
    fraction: Fraction
    target_rate: Rate
    forward_hidden: Size
    projection_hidden: Size
    prediction_hidden: Size
    projection_size: Size


class BYOLOptions(BYOLSizes):
    """Predicts the next frame's code: the paper's form."""

    name: Literal["byol"]


class BYOLHorizonOptions(BYOLSizes):
    """Predicts the codes of the next `horizon` frames, which are shifted by up to `shift` pixels.

    The square of `unshifted` pixels in the image's top left corner stays where it is.
    """

    name: Literal["byol_horizon"]
    horizon: Size
    shift: Annotated[int, Field(ge=0)]
    unshifted: Annotated[int, Field(ge=0)]


AuxiliaryOptions = Annotated[
    NoAuxiliaryOptions | VisionOptions | VisionLanguageOptions | BYOLOptions | BYOLHorizonOptions,
    Field(discriminator="name"),
]
NO_AUXILIARY = NoAuxiliaryOptions(name="none")


class Auxiliary(nn.Module):
    """No auxiliary loss, and what all of them have in common.

    What an update draws at random follows from `seed` and the number of updates before it, which is
    in `state_dict()`: a run that goes on draws what it would have drawn.
    """

    def __init__(self, seed: int):
        super().__init__()
        self.seed = seed
        self.updates = 0

    def forward(self, inputs: Inputs, core: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted loss of an unroll, float32 [], and what to log of it.

        Args:
            inputs: of T + 1 steps of B worlds.
            core: the memory's output there, [T + 1, B, size].
        """
        return torch.zeros((), device=core.device), {}

    def learned(self) -> list[nn.Parameter]:
        """The parameters that gradients reach."""
        return [parameter for parameter in self.parameters() if parameter.requires_grad]

    def after_update(self, encoder: Encoder) -> None:
        """Follows an optimiser step that changed the agent's encoder."""
        self.updates += 1

    def generator(self) -> torch.Generator:
        """Of this update's draws; on the CPU, so that a run can move between devices."""
        return torch.Generator().manual_seed(self.seed + self.updates)

    def get_extra_state(self) -> int:
        """The part of `state_dict()` that is no tensor."""
        return self.updates

    def set_extra_state(self, state: int) -> None:
        """Continues from `get_extra_state()`."""
        self.updates = state


def sample(n: int, fraction: float, generator: torch.Generator) -> Tensor:
    """That fraction of 0 .. n - 1, at least one, in random order."""
    return torch.randperm(n, generator=generator)[: max(1, round(fraction * n))]


class Reconstruction(Auxiliary):
    """The image, and the instruction where that is asked for, from the memory's output.

    Hill et al. 2020 give the losses, sigmoid cross-entropy of every pixel's channels and
    cross-entropy of the words, and neither weights nor sizes. Both losses are means, over the
    channels and over the words of the frames read. Row T of an unroll, the next one's first, is
    left to that.

    What decodes the image adds to the mean image of the first update. Without that the mean is the
    first thing it learns, and learns by driving memory and encoder to saturation: what they know
    of a frame is lost for a hundred updates or more.
    """

    mean_image: Tensor

    def __init__(
        self,
        space: gym.spaces.Dict,
        network: NetworkOptions,
        core_size: int,
        options: VisionOptions | VisionLanguageOptions,
        *,
        seed: int,
    ):
        super().__init__(seed)
        self.options = options
        shape = space["image"].shape
        assert shape is not None
        self.image = build_image_decoder(core_size, shape, network)
        self.register_buffer("mean_image", torch.zeros(shape))  # as logits
        self.instruction = None
        if isinstance(options, VisionLanguageOptions):
            words = space["instruction"]
            assert isinstance(words, gym.spaces.Box)
            self.instruction = InstructionDecoder(core_size, int(words.high.max()) + 1)

    def forward(self, inputs: Inputs, core: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted sum of `auxiliary_vision` and `auxiliary_language`, nats each."""
        o = self.options
        frames = {name: part[:-1].flatten(0, 1) for name, part in inputs.observation.items()}
        core = core[:-1].flatten(0, 1)
        if o.fraction < 1:
            rows = sample(len(core), o.fraction, self.generator()).to(core.device)
            core = core[rows]
            frames = {name: part[rows] for name, part in frames.items()}

        if self.updates == 0:
            mean = frames["image"].float().mean(0) / 255.0
            self.mean_image = mean.logit(eps=0.01)  # seldom is anything always black or white
        vision = image_cross_entropy(self.mean_image + self.image(core), frames["image"])
        loss = o.vision_weight * vision
        metrics = {"auxiliary_vision": vision.detach()}
        if isinstance(o, VisionLanguageOptions):
            assert self.instruction is not None
            instruction = frames["instruction"]
            language = word_cross_entropy(self.instruction(core, instruction), instruction)
            loss = loss + o.language_weight * language
            metrics["auxiliary_language"] = language.detach()
        return loss, metrics


def image_cross_entropy(logits: Tensor, image: Tensor) -> Tensor:
    """Mean sigmoid cross-entropy of channels in [0, 1]: [N, H, W, 3] and uint8 [N, H, W, 3] -> [].

    Its least value is not 0 but the entropy of what lies between black and white.
    """
    return F.binary_cross_entropy_with_logits(logits.float(), image / 255.0)


def word_cross_entropy(logits: Tensor, instruction: Tensor) -> Tensor:
    """Mean cross-entropy of the words: [N, L, vocabulary] and int64 [N, L] (0 = padding) -> []."""
    total = F.cross_entropy(
        logits.flatten(0, 1).float(), instruction.flatten(), ignore_index=0, reduction="sum"
    )
    return total / (instruction != 0).sum().clamp(min=1)


class ResNetDecoder(nn.Module):
    """`ResNet` the other way round: [N, core] -> logits [N, H, W, 3].

    A transposed convolution of stride 2 stands for a section's convolution and max-pool.
    """

    def __init__(self, core_size: int, shape: tuple[int, ...], options: ResNetOptions):
        super().__init__()
        height, width, channels = shape
        sections = []
        for outputs in options.channels:
            # A side of an even number of pixels is one more than twice the half, less one.
            odd = (1 - height % 2, 1 - width % 2)
            back = nn.ConvTranspose2d(outputs, channels, 3, stride=2, padding=1, output_padding=odd)
            sections.append([*(ResidualBlock(outputs) for _ in range(options.blocks)), back])
            height, width, channels = (height + 1) // 2, (width + 1) // 2, outputs
        self.layers = nn.Sequential(
            nn.Linear(core_size, channels * height * width),
            nn.ReLU(),
            nn.Unflatten(-1, (channels, height, width)),
            *(layer for section in reversed(sections) for layer in section),
        )
        self.layers.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, core: Tensor) -> Tensor:
        return self.layers(core).permute(0, 2, 3, 1)


class ShallowDecoder(nn.Module):
    """`ShallowNet` the other way round: [N, core] -> logits [N, H, W, 3].

    Rows and columns at the lower and right edge that no filter of the network reaches, and which
    the agent therefore does not see, are one colour here.
    """

    def __init__(self, core_size: int, shape: tuple[int, ...], options: ShallowOptions):
        super().__init__()
        height, width, channels = shape
        convolutions = zip(options.channels, options.kernels, options.strides, strict=True)
        layers: list[nn.Module] = []
        for outputs, kernel, stride in convolutions:
            rest = ((height - kernel) % stride, (width - kernel) % stride)
            back = nn.ConvTranspose2d(outputs, channels, kernel, stride, output_padding=rest)
            layers += [back, nn.ReLU()]
            height, width = (height - kernel) // stride + 1, (width - kernel) // stride + 1
            channels = outputs
        self.layers = nn.Sequential(
            nn.Linear(core_size, channels * height * width),
            nn.Unflatten(-1, (channels, height, width)),
            *reversed(layers),
        )
        self.layers.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, core: Tensor) -> Tensor:
        return self.layers(core).permute(0, 2, 3, 1)


class PatchDecoder(nn.Module):
    """`PatchEncoder` the other way round: [N, core] -> logits [N, H, W, 3]."""

    def __init__(self, core_size: int, shape: tuple[int, ...], patch: int, channels: int):
        super().__init__()
        self.shape, self.patch = shape, patch
        self.rows, self.columns = shape[0] // patch, shape[1] // patch
        self.unmix = nn.Linear(core_size, self.rows * self.columns * channels)
        self.unembed = nn.Linear(channels, patch**2 * shape[2])

    def forward(self, core: Tensor) -> Tensor:
        embedded = self.unmix(core).relu().view(len(core), self.rows, self.columns, -1)
        patches = self.unembed(embedded).unflatten(-1, (self.patch, -1))
        return patches.transpose(2, 3).reshape(len(core), *self.shape)


def build_image_decoder(
    core_size: int, shape: tuple[int, ...], network: NetworkOptions
) -> ResNetDecoder | ShallowDecoder | PatchDecoder:
    """The mirror image of the network that reads images of that shape."""
    if isinstance(network, ResNetOptions):
        return ResNetDecoder(core_size, shape, network)
    if isinstance(network, ShallowOptions):
        return ShallowDecoder(core_size, shape, network)
    patch = network.patch or largest_patch(shape[0], shape[1])
    return PatchDecoder(core_size, shape, patch, network.channels)


class InstructionDecoder(nn.Module):
    """Predicts each word from the memory's output and the words before it.

    An LSTM of 32 units over embeddings of 32 (Hill et al. 2020 as published again), which begins in
    a state made from the memory's output and is told the true words so far.
    """

    def __init__(self, core_size: int, vocabulary: int):
        super().__init__()
        self.state = nn.Linear(core_size, 2 * 32)
        self.embedding = nn.Embedding(vocabulary, 32)  # padding's stands before the first word
        self.lstm = nn.LSTM(32, 32, batch_first=True)
        self.words = nn.Linear(32, vocabulary)

    def forward(self, core: Tensor, instruction: Tensor) -> Tensor:
        """`[N, core]` and int64 `[N, L]` -> logits `[N, L, vocabulary]`."""
        hidden, cell = self.state(core).unsqueeze(0).chunk(2, -1)
        before = F.pad(instruction[:, :-1], (1, 0))
        told = self.embedding(before).to(hidden.dtype)
        outputs, _ = self.lstm(told, (hidden.contiguous(), cell.contiguous()))
        return self.words(outputs)


class BYOL(Auxiliary):
    """The codes of coming frames, from the memory's output and the actions in between.

    With f the encoder, g the projector, q the predictor, F the forward map, and f', g' the slow
    copies, the loss is the mean over rows t and distances k within an episode of

        2 - 2 cos(q(g(F_k(core_t, a_t .. a_{t+k-1}))), g'(f'(o_{t+k})))

    The paper gives the sizes and nothing else. `byol` is the plainest reading, one step and no
    augmentation. `byol_horizon` goes several steps (Guo et al. 2022) towards frames that are
    shifted (Schwarzer et al. 2021): the memory has read them as they are, so that the target's
    view alone differs.
    """

    def __init__(
        self,
        encoder: Encoder,
        core_size: int,
        actions: int,
        options: BYOLOptions | BYOLHorizonOptions,
        *,
        seed: int,
    ):
        super().__init__(seed)
        o = self.options = options
        self.actions = actions
        sizes = core_size, actions, o.forward_hidden, encoder.size
        self.forward_map: OneStepMap | HorizonMap
        if isinstance(o, BYOLHorizonOptions):
            self.forward_map = HorizonMap(*sizes, o.horizon)
        else:
            self.forward_map = OneStepMap(*sizes)
        self.projector = NormalisedMLP(encoder.size, o.projection_hidden, o.projection_size)
        self.predictor = NormalisedMLP(o.projection_size, o.prediction_hidden, o.projection_size)
        self.target_encoder = copy.deepcopy(encoder).requires_grad_(False)
        self.target_projector = copy.deepcopy(self.projector).requires_grad_(False)

    def forward(self, inputs: Inputs, core: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted `auxiliary_byol`, in [0, 4].

        `auxiliary_byol_spread` says how much the targets differ from frame to frame: the root of
        the mean squared distance of their directions from the mean direction, 0 where they have
        collapsed and near 1 where they point everywhere.
        """
        generator = self.generator()
        if self.options.fraction < 1:
            worlds = sample(core.shape[1], self.options.fraction, generator).to(core.device)
            core = core[:, worlds]
            inputs = Inputs(
                {name: part[:, worlds] for name, part in inputs.observation.items()},
                *(part[:, worlds] for part in inputs[1:]),
            )
        targets = F.normalize(self.targets(inputs, generator), dim=-1)
        # The action between two rows of an episode; -1, no action, where an episode begins.
        actions = F.one_hot(inputs.previous_action[1:] + 1, self.actions + 1)[..., 1:]
        total = torch.zeros((), device=core.device)
        pairs = torch.zeros((), device=core.device)
        same_episode = torch.ones_like(inputs.is_first)
        for k, features in enumerate(self.forward_map(core[:-1], actions.to(core.dtype)), start=1):
            same_episode = same_episode[:-1] & ~inputs.is_first[k:]
            projected = self.projector(features, same_episode)
            predicted = F.normalize(self.predictor(projected, same_episode), dim=-1)
            distance = 2 - 2 * (predicted * targets[k - 1 :]).sum(-1)
            total = total + distance.masked_fill(~same_episode, 0.0).sum()
            pairs = pairs + same_episode.sum()
        loss = total / pairs.clamp(min=1)
        later = ~inputs.is_first[1:]
        mean = (targets * later.unsqueeze(-1)).sum((0, 1)) / later.sum().clamp(min=1)
        spread = (1 - mean.square().sum()).clamp(min=0).sqrt()  # as directions have length 1
        metrics = {"auxiliary_byol": loss.detach(), "auxiliary_byol_spread": spread.detach()}
        return self.options.weight * loss, metrics

    @torch.no_grad()
    def targets(self, inputs: Inputs, generator: torch.Generator) -> Tensor:
        """The slow copies' codes of rows 1 to T: [T, B, projection size]."""
        o = self.options
        later = ~inputs.is_first[1:]
        observation = {name: part[1:].flatten(0, 1) for name, part in inputs.observation.items()}
        if isinstance(o, BYOLHorizonOptions) and o.shift:
            observation["image"] = random_shift(
                observation["image"], o.shift, o.unshifted, generator
            )
        return self.target_projector(
            self.target_encoder(observation).unflatten(0, later.shape), later
        )

    @torch.no_grad()
    def after_update(self, encoder: Encoder) -> None:
        """Moves the slow copies: target <- rate * target + (1 - rate) * online."""
        super().after_update(encoder)
        pairs = (self.target_encoder, encoder), (self.target_projector, self.projector)
        for target, online in pairs:
            for slow, fast in zip(target.parameters(), online.parameters(), strict=True):
                slow.lerp_(fast, 1 - self.options.target_rate)


class NormalisedMLP(nn.Module):
    """A hidden layer with batch normalisation: projector and predictor of Grill et al. 2020.

    Without it (Richemond et al. 2020) the codes begin all alike and become more so. Statistics are
    always of the rows at hand, those of `mask` alone, so that no other row changes the result.
    """

    def __init__(self, inputs: int, hidden: int, outputs: int):
        super().__init__()
        self.enter = nn.Linear(inputs, hidden)
        self.scale = nn.Parameter(torch.ones(hidden))
        self.offset = nn.Parameter(torch.zeros(hidden))
        self.leave = nn.Linear(hidden, outputs, bias=False)

    def forward(self, inputs: Tensor, mask: Tensor) -> Tensor:
        """`[T, B, inputs]`, bool `[T, B]` -> float32 `[T, B, outputs]`; unmasked rows are free."""
        hidden = self.enter(inputs).float()
        weight = (mask / mask.sum().clamp(min=1)).unsqueeze(-1)
        hidden = hidden - (weight * hidden).sum((0, 1))
        variance = (weight * hidden.square()).sum((0, 1))
        hidden = self.scale * hidden * (variance + 1e-5).rsqrt() + self.offset
        return self.leave(hidden.relu()).float()


class OneStepMap(nn.Module):
    """From the memory's output and an action to the next frame's features."""

    def __init__(self, core_size: int, actions: int, hidden: int, features: int):
        super().__init__()
        self.layers = head(core_size + actions, hidden, features)

    def forward(self, core: Tensor, actions: Tensor) -> Iterator[Tensor]:
        """`[T, B, core]`, one-hot `[T, B, actions]` -> `[T, B, features]`, once."""
        yield self.layers(torch.cat([core, actions], -1))


class HorizonMap(nn.Module):
    """The same several steps ahead: a GRU that begins in the memory's output and reads actions."""

    def __init__(self, core_size: int, actions: int, hidden: int, features: int, horizon: int):
        super().__init__()
        self.horizon = horizon
        self.begin = nn.Linear(core_size, hidden)
        self.gru = nn.GRUCell(actions, hidden)
        self.end = nn.Linear(hidden, features)

    def forward(self, core: Tensor, actions: Tensor) -> Iterator[Tensor]:
        """`[T, B, core]`, one-hot `[T, B, actions]` -> `[T - k + 1, B, features]` for each k.

        Row t is k steps after row t of `core`; k goes from 1 to the horizon or to T.
        """
        state = self.begin(core).tanh()
        for k in range(min(self.horizon, len(core))):
            state = state[: len(core) - k]
            flat = self.gru(actions[k:].flatten(0, 1), state.flatten(0, 1))
            state = flat.view_as(state)
            yield self.end(state)


def random_shift(image: Tensor, most: int, unshifted: int, generator: torch.Generator) -> Tensor:
    """Shifts every image by up to `most` pixels each way; its edges are drawn out (Kostrikov 2020).

    The square of `unshifted` pixels in the top left corner stays, whole and in its place, and no
    copy of it appears beside it: where one would, the image is not shifted. uint8 [N, H, W, C].
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
    down, right = torch.randint(0, 2 * most + 1, (2, n), generator=generator).to(device)
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


def build_auxiliary(
    options: AuxiliaryOptions,
    space: gym.spaces.Dict,
    network: NetworkOptions,
    torso: Torso,
    *,
    seed: int,
) -> Auxiliary:
    """The auxiliary loss that the options name, for an agent.

    Args:
        space: of its observations.
        network: what its encoder was made from.
        torso: its encoder and memory, which stay its own.
        seed: of what the loss draws at random.

    Raises:
        ValueError: the observations lack what the loss is about.
    """
    if isinstance(options, NoAuxiliaryOptions):
        return Auxiliary(seed)
    if isinstance(options, BYOLOptions):
        needed: set[str] = set()
    elif isinstance(options, VisionLanguageOptions):
        needed = {"image", "instruction"}
    else:
        needed = {"image"}
    if missing := needed - set(space):
        raise ValueError(
            f"auxiliary={options.name} needs an {' and an '.join(sorted(missing))}, and the "
            f"observations here have only {', '.join(sorted(space))}; "
            + (
                "auxiliary=vision reconstructs the image alone"
                if missing == {"instruction"}
                else "auxiliary=byol reads whatever the network does"
            )
        )
    if isinstance(options, VisionOptions | VisionLanguageOptions):
        return Reconstruction(space, network, torso.memory.size, options, seed=seed)
    return BYOL(torso.encoder, torso.memory.size, torso.actions, options, seed=seed)
