"""Encoders: one observation in, one vector out. They read `[N, ...]` and know nothing of time."""

from __future__ import annotations

import math
from typing import Annotated, Literal

import gymnasium as gym
import torch
import torch.nn.functional as F
from pydantic import Field
from torch import Tensor, nn

from zipf.options import Options

Size = Annotated[int, Field(ge=1)]


class ResNetOptions(Options):
    """The paper's vision encoder (its architecture table)."""

    name: Literal["resnet"]
    channels: Annotated[list[Size], Field(min_length=1)]
    blocks: Annotated[int, Field(ge=0)]
    head_size: Annotated[int, Field(ge=0)]


class CompactOptions(Options):
    """One convolution whose patches do not overlap, then a dense layer: made for CPUs.

    `patch` None is the largest common divisor of the picture's sides up to 12.
    """

    name: Literal["compact"]
    patch: Size | None
    channels: Size
    size: Size
    head_size: Annotated[int, Field(ge=0)]


class ShallowOptions(Options):
    """The shallow network of Espeholt et al. 2018: strided convolutions, then a dense layer."""

    name: Literal["shallow"]
    channels: Annotated[list[Size], Field(min_length=1)]
    kernels: Annotated[list[Size], Field(min_length=1)]
    strides: Annotated[list[Size], Field(min_length=1)]
    size: Size
    head_size: Annotated[int, Field(ge=0)]


NetworkOptions = Annotated[
    ResNetOptions | ShallowOptions | CompactOptions, Field(discriminator="name")
]


class ResidualBlock(nn.Module):
    """ReLU, convolution, ReLU, convolution, add (Espeholt et al. 2018, figure 3)."""

    def __init__(self, channels: int):
        super().__init__()
        self.layers = nn.Sequential(
            nn.ReLU(),
            nn.Conv2d(channels, channels, 3, padding=1),
            nn.ReLU(),
            nn.Conv2d(channels, channels, 3, padding=1),
        )

    def forward(self, inputs: Tensor) -> Tensor:
        return inputs + self.layers(inputs)


class ResNet(nn.Module):
    """Sections of convolution, max-pool and residual blocks: uint8 [N, H, W, 3] -> [N, F].

    Every section halves the picture, rounding up.
    """

    def __init__(self, shape: tuple[int, ...], options: ResNetOptions):
        super().__init__()
        height, width, channels = shape
        layers: list[nn.Module] = []
        for outputs in options.channels:
            layers += [nn.Conv2d(channels, outputs, 3, padding=1), nn.MaxPool2d(3, 2, padding=1)]
            layers += [ResidualBlock(outputs) for _ in range(options.blocks)]
            height, width, channels = (height + 1) // 2, (width + 1) // 2, outputs
        self.layers = nn.Sequential(*layers, nn.ReLU(), nn.Flatten())
        self.layers.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.size = height * width * channels

    def forward(self, image: Tensor) -> Tensor:
        return self.layers(image.permute(0, 3, 1, 2) / 255.0)


class ShallowNet(nn.Module):
    """Strided convolutions without padding, then a dense layer: uint8 [N, H, W, 3] -> [N, F]."""

    def __init__(self, shape: tuple[int, ...], options: ShallowOptions):
        super().__init__()
        height, width, channels = shape
        convolutions = zip(options.channels, options.kernels, options.strides, strict=True)
        layers: list[nn.Module] = []
        for outputs, kernel, stride in convolutions:
            layers += [nn.Conv2d(channels, outputs, kernel, stride), nn.ReLU()]
            height, width = (height - kernel) // stride + 1, (width - kernel) // stride + 1
            channels = outputs
            if min(height, width) < 1:
                raise ValueError(
                    f"network=shallow leaves nothing of an image of {shape[0]} x {shape[1]} "
                    "pixels; choose smaller network.kernels or network.strides"
                )
        self.size = options.size
        dense = nn.Linear(height * width * channels, options.size)
        self.layers = nn.Sequential(*layers, nn.Flatten(), dense, nn.ReLU())
        self.layers.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, image: Tensor) -> Tensor:
        return self.layers(image.permute(0, 3, 1, 2) / 255.0)


class PatchEncoder(nn.Module):
    """Patches, each embedded alike, then a dense layer: uint8 [N, H, W, 3] -> [N, F].

    The stride-`patch` convolution is written as the matrix product it is, which is several times
    faster on CPUs than the convolution routine.
    """

    def __init__(self, shape: tuple[int, ...], options: CompactOptions):
        super().__init__()
        height, width, channels = shape
        self.patch = options.patch or largest_patch(height, width)
        if height % self.patch or width % self.patch:
            raise ValueError(
                f"network.patch={self.patch} does not divide the image of {height} x {width} "
                "pixels; choose a common divisor, or network=resnet"
            )
        self.size = options.size
        rows, columns = height // self.patch, width // self.patch
        self.embed = nn.Linear(self.patch**2 * channels, options.channels)
        self.mix = nn.Linear(rows * columns * options.channels, options.size)

    def forward(self, image: Tensor) -> Tensor:
        n, height, width, channels = image.shape
        p = self.patch
        patches = image.view(n, height // p, p, width // p, p * channels).transpose(2, 3)
        patches = patches.reshape(n, -1, p * p * channels).to(_compute_dtype(image))
        # Scaling the weights instead of the pixels saves a pass over the largest tensor there is.
        embedded = F.linear(patches, self.embed.weight / 255.0, self.embed.bias)
        return self.mix(embedded.relu().flatten(1)).relu()


def largest_patch(height: int, width: int) -> int:
    """The largest common divisor of an image's sides up to 12."""
    return max(size for size in range(1, 13) if height % size == 0 and width % size == 0)


def _compute_dtype(tensor: Tensor) -> torch.dtype:
    kind = tensor.device.type
    return torch.get_autocast_dtype(kind) if torch.is_autocast_enabled(kind) else torch.float32


class TileEncoder(nn.Module):
    """Cell codes in the place of pixels, each embedded alike: uint8 [N, ...] each -> [N, F].

    The arithmetic of `PatchEncoder` without its first product.
    """

    def __init__(self, spaces: list[gym.Space], options: CompactOptions):
        super().__init__()
        self.size = options.size
        boxes = [space for space in spaces if isinstance(space, gym.spaces.Box)]
        codes = max(int(box.high.max()) for box in boxes) + 1
        cells = sum(math.prod(box.shape) for box in boxes)
        self.embed = nn.Embedding(codes, options.channels)
        self.mix = nn.Linear(cells * options.channels, options.size)

    def forward(self, parts: list[Tensor]) -> Tensor:
        cells = torch.cat([part.flatten(1) for part in parts], -1)
        return self.mix(self.embed(cells.int()).relu().flatten(1)).relu()


class InstructionEncoder(nn.Module):
    """Word embeddings and an LSTM, its output at the last word: int64 [N, L] -> [N, 32].

    Sizes 32 and 32 from the paper's architecture table; word 0 is padding.
    """

    def __init__(self, vocabulary: int):
        super().__init__()
        self.size = 32
        self.embedding = nn.Embedding(vocabulary, 32, padding_idx=0)
        self.lstm = nn.LSTM(32, self.size, batch_first=True)

    def forward(self, instruction: Tensor) -> Tensor:
        outputs, _ = self.lstm(self.embedding(instruction))
        last = (instruction != 0).sum(-1).clamp(min=1) - 1
        return outputs[torch.arange(len(outputs), device=outputs.device), last]


class Encoder(nn.Module):
    """Encodes every part of a dictionary observation and concatenates ("flatten+concat").

    An observation has an `image`, or `tiles` and `cue` in its place, and may have an `instruction`.

    Raises:
        ValueError: no encoder reads such observations.
    """

    def __init__(self, space: gym.spaces.Dict, options: NetworkOptions):
        super().__init__()
        names = set(space) - {"instruction"}
        self.image: ResNet | ShallowNet | PatchEncoder | TileEncoder  # what sees, pixels or tiles
        if names == {"image"}:
            shape = space["image"].shape
            assert shape is not None
            if isinstance(options, ResNetOptions):
                self.image = ResNet(shape, options)
            elif isinstance(options, ShallowOptions):
                self.image = ShallowNet(shape, options)
            else:
                self.image = PatchEncoder(shape, options)
        elif names == {"tiles", "cue"} and isinstance(options, CompactOptions):
            self.image = TileEncoder([space["tiles"], space["cue"]], options)
        else:
            raise ValueError(
                f"network={options.name} does not read observations of {', '.join(sorted(space))}; "
                "resnet and shallow read an image, compact an image or tiles"
            )
        self.size = self.image.size
        self.instruction = None
        if "instruction" in space.spaces:
            words = space["instruction"]
            assert isinstance(words, gym.spaces.Box)
            self.instruction = InstructionEncoder(int(words.high.max()) + 1)
            self.size += self.instruction.size

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """`{name: [N, ...]}` -> `[N, size]`."""
        if "image" in observation:
            parts = [self.image(observation["image"])]
        else:
            parts = [self.image([observation["tiles"], observation["cue"]])]
        if self.instruction is not None:
            parts.append(self.instruction(observation["instruction"]))
        return torch.cat(parts, -1)
