"""Reconstruction of image and instruction from the memory's output (Hill et al. 2020).

They give the losses, sigmoid cross-entropy of every pixel's channels and cross-entropy of the
words, and neither weights nor sizes. The decoder of an image mirrors the network that reads it.
"""

from __future__ import annotations

from typing import Literal

import gymnasium as gym
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zipf.agents import fixed
from zipf.agents.auxiliary.base import AUXILIARIES, Auxiliary, AuxiliaryOptions, sample
from zipf.agents.averaging import average
from zipf.agents.encoders import has_image, is_text, number_of_codes
from zipf.agents.image_networks import ResidualBlock, largest_patch
from zipf.agents.network import Inputs, Torso
from zipf.agents.network_options import (
    CompactOptions,
    NetworkOptions,
    ResNetOptions,
    ShallowOptions,
)
from zipf.options import Fraction, NotNegative


class VisionOptions(AuxiliaryOptions):
    """Reconstructs the image, in a random `fraction` of the frames."""

    averages = True
    name: Literal["vision"]
    vision_weight: NotNegative
    fraction: Fraction


class LanguageOptions(AuxiliaryOptions):
    """Reconstructs the instruction, in a random `fraction` of the frames."""

    name: Literal["language"]
    language_weight: NotNegative
    fraction: Fraction


class VisionLanguageOptions(AuxiliaryOptions):
    """Reconstructs image and instruction, in a random `fraction` of the frames."""

    averages = True
    name: Literal["vision_language"]
    vision_weight: NotNegative
    language_weight: NotNegative
    fraction: Fraction


ReconstructionOptions = VisionOptions | LanguageOptions | VisionLanguageOptions


class Reconstruction(Auxiliary):
    """Reconstructs the image, the instruction, or both, as the options say. The decoder of what is
    not reconstructed is not built.

    Both losses are means, over the channels and over the words of the frames that are drawn. Row T
    of an unroll is left out: it is the first row of the next.

    The image decoder's output is added to the mean image of the first update (of all learners, if
    there are several). Without that, the mean image is learned first, by driving memory and encoder
    into saturation, which costs what they know of a frame for a hundred updates or more.
    """

    mean_image: Tensor
    is_first: Tensor  # bool [], of the next update

    def __init__(
        self,
        space: gym.spaces.Dict,
        network: NetworkOptions,
        core_size: int,
        options: ReconstructionOptions,
        seed: int,
    ):
        super().__init__(seed)
        self.options = options
        self.image = self.instruction = None
        if not isinstance(options, LanguageOptions):
            shape = space["image"].shape
            assert shape is not None
            self.image = build_image_decoder(core_size, shape, network)
            self.register_buffer("mean_image", torch.zeros(shape))  # as logits
            self.register_buffer("is_first", torch.tensor(True), persistent=False)
        if not isinstance(options, VisionOptions):
            self.instruction = InstructionDecoder(core_size, number_of_codes(space["instruction"]))

    def forward(self, inputs: Inputs, core: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted sum of `auxiliary_vision` and `auxiliary_language`, nats each."""
        o = self.options
        frames = {name: part[:-1].flatten(0, 1) for name, part in inputs.observation.items()}
        core = core[:-1].flatten(0, 1)
        if o.fraction < 1:
            rows = sample(len(core), o.fraction, self.generator())
            core = core[rows]
            frames = {name: part[rows] for name, part in frames.items()}

        losses, metrics = [], {}
        if not isinstance(o, LanguageOptions):
            assert self.image is not None
            if self.updates == 0 or fixed.shapes(core):  # a graph is the same for all updates
                mean = average(frames["image"].float().mean(0) / 255.0)
                # Finite where pixels are always black or white.
                mean = torch.where(self.is_first, mean.logit(eps=0.01), self.mean_image)
                self.mean_image.copy_(mean)
            vision = image_cross_entropy(self.mean_image + self.image(core), frames["image"])
            losses.append(o.vision_weight * vision)
            metrics["auxiliary_vision"] = vision.detach()
        if not isinstance(o, VisionOptions):
            assert self.instruction is not None
            instruction = frames["instruction"]
            language = word_cross_entropy(self.instruction(core, instruction), instruction)
            losses.append(o.language_weight * language)
            metrics["auxiliary_language"] = language.detach()
        return torch.stack(losses).sum(), metrics

    def count(self, updates: int) -> None:
        super().count(updates)
        if self.image is not None:
            self.is_first.fill_(updates == 0)


def image_cross_entropy(logits: Tensor, image: Tensor) -> Tensor:
    """Mean sigmoid cross-entropy of channels in [0, 1]: [N, H, W, C] and uint8 [N, H, W, C] -> [].
    Its minimum is not 0 but the entropy of the values between black and white."""
    return F.binary_cross_entropy_with_logits(logits.float(), image / 255.0)


def word_cross_entropy(logits: Tensor, instruction: Tensor) -> Tensor:
    """Mean cross-entropy of the words: [N, L, vocabulary] and integers [N, L] -> [].
    0 is padding, which does not count."""
    words = instruction.flatten().long()
    total = F.cross_entropy(logits.flatten(0, 1).float(), words, ignore_index=0, reduction="sum")
    return total / (words != 0).sum().clamp(min=1)


class ResNetDecoder(nn.Module):
    """`ResNet` reversed: [N, core] -> logits [N, H, W, C].

    A transposed convolution of stride 2 takes the place of a section's convolution and max-pool.
    """

    def __init__(self, core_size: int, shape: tuple[int, ...], options: ResNetOptions):
        super().__init__()
        height, width, channels = shape
        sections = []
        for outputs in options.channels:
            # The transposed convolution turns n pixels into 2 n - 1; an even side needs one more.
            even = (1 - height % 2, 1 - width % 2)
            back = nn.ConvTranspose2d(outputs, channels, 3, 2, padding=1, output_padding=even)
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
    """`ShallowNet` reversed: [N, core] -> logits [N, H, W, C].

    Rows and columns at the lower and right edge that no filter of the encoder reads are
    reconstructed as one colour.
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
    """`PatchEncoder` reversed: [N, core] -> logits [N, H, W, C]."""

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
    """The decoder that mirrors the network for images of that shape [H, W, C]."""
    if isinstance(network, ResNetOptions):
        return ResNetDecoder(core_size, shape, network)
    if isinstance(network, ShallowOptions):
        return ShallowDecoder(core_size, shape, network)
    if not isinstance(network, CompactOptions):
        raise ValueError(
            f"network={network.name}: no decoder mirrors it, which reconstruction needs; choose "
            "network=compact, or another auxiliary loss"
        )
    patch = network.patch or largest_patch(shape[0], shape[1])
    return PatchDecoder(core_size, shape, patch, network.channels)


class InstructionDecoder(nn.Module):
    """Predicts each word from the memory's output and the words before it.

    An LSTM of 32 units over embeddings of 32 (Hill et al. 2020 in its later version). Its initial
    state is a linear map of the memory's output; it reads the true words (teacher forcing). Under
    autocast the LSTM computes in float32: not all CPUs have one in bfloat16.
    """

    def __init__(self, core_size: int, vocabulary: int):
        super().__init__()
        self.state = nn.Linear(core_size, 2 * 32)
        self.embedding = nn.Embedding(vocabulary, 32)  # of padding: the start symbol
        self.lstm = nn.LSTM(32, 32, batch_first=True)
        self.words = nn.Linear(32, vocabulary)

    def forward(self, core: Tensor, instruction: Tensor) -> Tensor:
        """`[N, core]` and integers `[N, L]` -> logits `[N, L, vocabulary]`."""
        hidden, cell = self.state(core).float().unsqueeze(0).chunk(2, -1)
        before = F.pad(instruction[:, :-1].long(), (1, 0))
        with torch.autocast(core.device.type, enabled=False):
            state = hidden.contiguous(), cell.contiguous()
            outputs, _ = self.lstm(self.embedding(before), state)
        return self.words(outputs)


def build(
    options: ReconstructionOptions,
    space: gym.spaces.Dict,
    network: NetworkOptions,
    torso: Torso,
    seed: int,
) -> Reconstruction:
    """The loss for an agent; the arguments are those of `build_auxiliary`. Raises ValueError: the
    observations have no image, or no instruction where that is reconstructed."""
    missing = set()
    if not isinstance(options, LanguageOptions) and not has_image(space):
        missing.add("image")
    if not isinstance(options, VisionOptions) and not (
        "instruction" in space.spaces and is_text("instruction", space["instruction"])
    ):
        missing.add("instruction")
    if missing:
        raise ValueError(
            f"auxiliary={options.name} needs an {' and an '.join(sorted(missing))} of that name, "
            f"and the observations here have only {', '.join(sorted(space))}; "
            + (
                "auxiliary=vision reconstructs the image alone"
                if missing == {"instruction"} and has_image(space)
                else "auxiliary=byol reads whatever the network does"
            )
        )
    return Reconstruction(space, network, torso.memory.size, options, seed)


AUXILIARIES.register(VisionOptions, build)
AUXILIARIES.register(LanguageOptions, build)
AUXILIARIES.register(VisionLanguageOptions, build)
