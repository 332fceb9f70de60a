"""Encoders: one observation in, one vector out. They read `[N, ...]` and know nothing of time.

An observation is a Dict of parts. Which encoder reads a part follows from its space:

    image    uint8 Box [H, W, C] with C = 1, 3 or 4       the network chosen, one for each image
    text     int64 Box [L] from 0, or any integer Box     word embeddings and an LSTM, one for each
             [L] from 0 named `instruction`
    codes    Discrete, MultiDiscrete, integer Box from    embeddings and a dense layer, one for all
             0 to less than 255
    vector   any other Box, MultiBinary                   an MLP, one for all

What they compute is concatenated.
"""

from __future__ import annotations

import math
from typing import Annotated, Literal

import gymnasium as gym
import numpy as np
import torch
import torch.nn.functional as F
from pydantic import Field
from torch import Tensor, nn

from zipf.options import Options

Size = Annotated[int, Field(ge=1)]

LARGEST_VOCABULARY = 2**16  # ours: integers beyond that are quantities rather than words
LARGEST_RANGE = 1e4  # ours: wider bounds stand for none, as float32's largest number does


class EncoderOptions(Options):
    """Options that all networks have.

    `code_channels` is the size of a code's embedding, `code_size` that of the dense layer over all
    of them; `vector_layers` are the layers of the MLP for vectors; `head_size` is the hidden layer
    of policy and value, 0 for linear heads.
    """

    code_channels: Size
    code_size: Size
    vector_layers: Annotated[list[Size], Field(min_length=1)]
    head_size: Annotated[int, Field(ge=0)]


class ResNetOptions(EncoderOptions):
    """The paper's image encoder (its architecture table)."""

    name: Literal["resnet"]
    channels: Annotated[list[Size], Field(min_length=1)]
    blocks: Annotated[int, Field(ge=0)]


class CompactOptions(EncoderOptions):
    """One convolution whose patches do not overlap, then a dense layer: made for CPUs.

    `patch` None is the largest common divisor of the image's sides up to 12.
    """

    name: Literal["compact"]
    patch: Size | None
    channels: Size
    size: Size


class ComparingOptions(CompactOptions):
    """As compact, and every patch is compared with every other.

    With `comparison` "learned" by the cosine of two learned keys of `key_size`, with "given" by
    whether their coloured pixels are the same.
    """

    name: Literal["comparing"]  # type: ignore[assignment]
    comparison: Literal["learned", "given"]
    key_size: Size


class ShallowOptions(EncoderOptions):
    """The shallow network of Espeholt et al. 2018: strided convolutions, then a dense layer."""

    name: Literal["shallow"]
    channels: Annotated[list[Size], Field(min_length=1)]
    kernels: Annotated[list[Size], Field(min_length=1)]
    strides: Annotated[list[Size], Field(min_length=1)]
    size: Size


NetworkOptions = Annotated[
    ResNetOptions | ShallowOptions | CompactOptions | ComparingOptions, Field(discriminator="name")
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
    """Sections of convolution, max-pool and residual blocks: uint8 [N, H, W, C] -> [N, F].

    Every section halves the image, rounding up.
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
    """Strided convolutions without padding, then a dense layer: uint8 [N, H, W, C] -> [N, F]."""

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
                    "pixels; choose smaller network.kernels or network.strides, or network=compact"
                )
        self.size = options.size
        dense = nn.Linear(height * width * channels, options.size)
        self.layers = nn.Sequential(*layers, nn.Flatten(), dense, nn.ReLU())
        self.layers.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, image: Tensor) -> Tensor:
        return self.layers(image.permute(0, 3, 1, 2) / 255.0)


class PatchEncoder(nn.Module):
    """Patches, each embedded alike, then a dense layer: uint8 [N, H, W, C] -> [N, F].

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
                "pixels; choose a common divisor (null is the largest up to 12), or network=resnet"
            )
        self.size = options.size
        rows, columns = height // self.patch, width // self.patch
        self.patches = rows * columns
        self.embed = nn.Linear(self.patch**2 * channels, options.channels)
        self.mix = nn.Linear(self.patches * options.channels, options.size)

    def forward(self, image: Tensor) -> Tensor:
        patches = self.cut(image).to(_compute_dtype(image))
        return self.mix(self.embedded(patches)).relu()

    def cut(self, image: Tensor) -> Tensor:
        """The patches of images: uint8 [N, H, W, C] -> [N, patches, pixels * C]."""
        n, height, width, channels = image.shape
        p = self.patch
        patches = image.view(n, height // p, p, width // p, p * channels).transpose(2, 3)
        return patches.reshape(n, -1, p * p * channels)

    def embedded(self, patches: Tensor) -> Tensor:
        """[N, patches, pixels * C] -> [N, patches * channels]."""
        # Scaling the weights instead of the pixels saves a pass over the largest tensor there is.
        embedded = F.linear(patches, self.embed.weight / 255.0, self.embed.bias)
        return embedded.relu().flatten(1)


class ComparingEncoder(PatchEncoder):
    """A `PatchEncoder` whose dense layer also reads how alike any two patches are.

    "learned": the cosine of their keys, k = W (p - mean(p)), one W for all patches. It begins as a
    random rotation, which leaves cosines of pixels nearly as they are. Self-similarities: Shechtman
    and Irani 2007; one metric for both of a pair: Bromley et al. 1993.

    "given": 1 where two patches show the same, else 0. Grey pixels, whose channels are equal, count
    as background, and patches of nothing else show nothing.
    """

    pairs: Tensor
    codes: Tensor

    def __init__(self, shape: tuple[int, ...], options: ComparingOptions):
        super().__init__(shape, options)
        self.channels = shape[2]
        pixels = self.patch**2 * self.channels
        first, second = torch.triu_indices(self.patches, self.patches, 1)
        self.register_buffer("pairs", first * self.patches + second, persistent=False)
        inputs = self.patches * options.channels + len(self.pairs)
        self.mix = nn.Linear(inputs, options.size)
        self.key: nn.Linear | None = None
        if options.comparison == "learned" and self.patches > 1:
            self.key = nn.Linear(pixels, options.key_size, bias=False)
            nn.init.orthogonal_(self.key.weight)
        else:
            random = torch.Generator().manual_seed(0)
            codes = torch.randint(1, 2**40, (pixels,), generator=random)
            self.register_buffer("codes", codes, persistent=False)

    def forward(self, image: Tensor) -> Tensor:
        cut = self.cut(image)
        patches = cut.to(_compute_dtype(image))
        alike = self.same(cut) if self.key is None else self.cosines(patches, self.key)
        compared = alike.flatten(1)[:, self.pairs].to(patches.dtype)
        return self.mix(torch.cat([self.embedded(patches), compared], 1)).relu()

    def cosines(self, patches: Tensor, key: nn.Linear) -> Tensor:
        """The cosines of the keys of any two patches, [N, patches, pixels * C] -> [N, patches,
        patches]; near 0 for patches of one colour."""
        weight = key.weight / 255.0
        # Without the weights' mean keys do not depend on the patch's mean.
        keys = F.linear(patches, weight - weight.mean(1, keepdim=True))
        keys = keys / keys.norm(dim=-1, keepdim=True).clamp(min=_FAINT)
        return keys @ keys.transpose(1, 2)

    def same(self, cut: Tensor) -> Tensor:
        """Whether any two patches show the same, uint8 [N, patches, pixels * C] -> bool [N,
        patches, patches]."""
        pixels = cut.unflatten(2, (-1, self.channels))
        colours = pixels[..., :3]
        grey = (colours == colours[..., :1]).all(-1, keepdim=True)
        shown = pixels.masked_fill(grey, 0).flatten(2)
        codes = (shown.long() * self.codes).sum(-1)  # equal for equal patches, and hardly else
        return (codes.unsqueeze(1) == codes.unsqueeze(2)) & (codes != 0).unsqueeze(1)


_FAINT = 0.1  # ours: the norm below which keys are taken for shorter; rounding in bfloat16 has 0.01


def largest_patch(height: int, width: int) -> int:
    """The largest common divisor of an image's sides up to 12."""
    return max(size for size in range(1, 13) if height % size == 0 and width % size == 0)


def _compute_dtype(tensor: Tensor) -> torch.dtype:
    kind = tensor.device.type
    return torch.get_autocast_dtype(kind) if torch.is_autocast_enabled(kind) else torch.float32


def image_network(
    shape: tuple[int, ...], options: NetworkOptions
) -> ResNet | ShallowNet | PatchEncoder | ComparingEncoder:
    """The network that the options name, for images [H, W, C].

    Raises:
        ValueError: it cannot read images of that size.
    """
    match options:
        case ResNetOptions():
            return ResNet(shape, options)
        case ShallowOptions():
            return ShallowNet(shape, options)
        case ComparingOptions():
            return ComparingEncoder(shape, options)
        case CompactOptions():
            return PatchEncoder(shape, options)


class CodeEncoder(nn.Module):
    """Codes, each embedded by one table, then a dense layer: integers [N, ...] each -> [N, F].

    With the cells of an image as codes this is `PatchEncoder` without its first product.
    """

    offsets: Tensor

    def __init__(self, parts: list[gym.Space], options: EncoderOptions):
        super().__init__()
        counts, offsets = zip(*(_codes(space) for space in parts), strict=True)
        offsets = np.concatenate(offsets)
        self.size = options.code_size
        self.register_buffer("offsets", torch.tensor(offsets, dtype=torch.int32), persistent=False)
        self.embed = nn.Embedding(max(counts), options.code_channels)
        self.mix = nn.Linear(len(offsets) * options.code_channels, options.code_size)

    def forward(self, *parts: Tensor) -> Tensor:
        codes = torch.cat([part.reshape(len(part), -1).int() for part in parts], -1) - self.offsets
        return self.mix(self.embed(codes).relu().flatten(1)).relu()


def _codes(space: gym.Space) -> tuple[int, np.ndarray]:
    """How many codes a part has, and the least code of each of its entries, int64 [entries]."""
    if isinstance(space, gym.spaces.Discrete):
        return int(space.n), np.array([space.start])
    if isinstance(space, gym.spaces.MultiDiscrete):
        return int(space.nvec.max()), space.start.reshape(-1)
    assert isinstance(space, gym.spaces.Box)
    return int(space.high.max()) + 1, np.zeros(space.low.size, np.int64)


class VectorEncoder(nn.Module):
    """Numbers of any kind, brought to a common scale, then an MLP: [N, ...] each -> [N, F].

    An entry with finite bounds is scaled from them to [-1, 1]. Any other becomes
    sign(x) log(1 + |x|) (symlog, Hafner et al. 2023), which leaves small numbers nearly as they are
    and needs no statistics of the data.
    """

    low: Tensor
    width: Tensor
    bounded: Tensor

    def __init__(self, parts: list[gym.Space], options: EncoderOptions):
        super().__init__()
        bounds = [_bounds(space) for space in parts]
        low = np.concatenate([one for one, _ in bounds])
        high = np.concatenate([other for _, other in bounds])
        with np.errstate(over="ignore", invalid="ignore"):
            width = high - low
        bounded = width <= LARGEST_RANGE
        low, width = np.where(bounded, low, 0.0), np.where(bounded & (width > 0), width, 1.0)
        self.register_buffer("low", torch.tensor(low, dtype=torch.float32), persistent=False)
        self.register_buffer("width", torch.tensor(width, dtype=torch.float32), persistent=False)
        self.register_buffer("bounded", torch.tensor(bounded), persistent=False)
        layers: list[nn.Module] = []
        inputs = len(low)
        for outputs in options.vector_layers:
            layers += [nn.Linear(inputs, outputs), nn.ReLU()]
            inputs = outputs
        self.layers = nn.Sequential(*layers)
        self.size = inputs

    def forward(self, *parts: Tensor) -> Tensor:
        x = torch.cat([part.reshape(len(part), -1).float() for part in parts], -1)
        scaled = 2 * (x - self.low) / self.width - 1
        return self.layers(torch.where(self.bounded, scaled, x.sign() * x.abs().log1p()))


def _bounds(space: gym.Space) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bound of each entry, float64 [entries]."""
    if isinstance(space, gym.spaces.MultiBinary):
        entries = math.prod(space.shape)
        return np.zeros(entries), np.ones(entries)
    assert isinstance(space, gym.spaces.Box)
    low, high = space.low.astype(np.float64), space.high.astype(np.float64)
    return low.reshape(-1), high.reshape(-1)


class InstructionEncoder(nn.Module):
    """Word embeddings and an LSTM, its output at the last word: int64 [N, L] -> [N, 32].

    Sizes 32 and 32 from the paper's architecture table. Zeros behind the last other word are
    padding; a zero before it is a word like any other, whose embedding is zero.
    """

    def __init__(self, vocabulary: int):
        super().__init__()
        self.size = 32
        self.embedding = nn.Embedding(vocabulary, 32, padding_idx=0)
        self.lstm = nn.LSTM(32, self.size, batch_first=True)

    def forward(self, instruction: Tensor) -> Tensor:
        outputs, _ = self.lstm(self.embedding(instruction))
        place = torch.arange(instruction.shape[-1], device=outputs.device)
        last = torch.where(instruction != 0, place, 0).amax(-1)
        return outputs[torch.arange(len(outputs), device=outputs.device), last]


PartEncoder = ResNet | ShallowNet | PatchEncoder | CodeEncoder | VectorEncoder | InstructionEncoder


def is_image(space: gym.Space) -> bool:
    """Whether a part is an image: uint8 [H, W, C] with C = 1, 3 or 4."""
    return (
        isinstance(space, gym.spaces.Box)
        and space.dtype == np.uint8
        and len(space.shape) == 3
        and space.shape[2] in (1, 3, 4)
    )


def is_text(name: str, space: gym.Space) -> bool:
    """Whether a part is a text as codes of its words: [L], with zeros behind the last one."""
    return (
        isinstance(space, gym.spaces.Box)
        and (space.dtype == np.int64 or name == "instruction")
        and np.issubdtype(space.dtype, np.integer)
        and len(space.shape) == 1
        and bool((space.low == 0).all())
        and int(space.high.max()) < LARGEST_VOCABULARY
    )


def is_codes(space: gym.Space) -> bool:
    """Whether the numbers of a part name kinds of things. Those of an integer Box do where its
    bounds are narrower than a byte's, which would be those of a quantity."""
    if isinstance(space, gym.spaces.Discrete | gym.spaces.MultiDiscrete):
        return True
    return (
        isinstance(space, gym.spaces.Box)
        and np.issubdtype(space.dtype, np.integer)
        and bool((space.low == 0).all())
        and int(space.high.max()) < 255
    )


class Encoder(nn.Module):
    """Encodes every part of a dictionary observation and concatenates ("flatten+concat").

    Attributes:
        encoders: for each of `names`, the parts it reads, an encoder of [N, ...] -> [N, its size].
        size: of the result.

    Raises:
        ValueError: a part is of a kind that no encoder reads.
    """

    def __init__(self, space: gym.spaces.Dict, options: NetworkOptions):
        super().__init__()
        images, codes, vectors, texts = [], [], [], []
        for name, part in space.items():
            if is_image(part):
                images.append(name)
            elif is_text(name, part):
                texts.append(name)
            elif is_codes(part):
                codes.append(name)
            elif isinstance(part, gym.spaces.Box | gym.spaces.MultiBinary):
                vectors.append(name)
            else:
                raise ValueError(
                    f"no encoder reads {name!r} of the observations, {part}; they may have Box, "
                    "Discrete, MultiDiscrete and MultiBinary parts"
                )
        # The largest first: the gridworld's tiles before its cue, and not by name.
        codes.sort(key=lambda name: (-math.prod(space[name].shape or ()), name))

        self.size = 0
        self.names: list[tuple[str, ...]] = []
        self.encoders = nn.ModuleList()
        for name in images:
            self._add([name], image_network(space[name].shape or (), options))
        if codes:
            self._add(codes, CodeEncoder([space[name] for name in codes], options))
        if vectors:
            self._add(vectors, VectorEncoder([space[name] for name in vectors], options))
        for name in texts:
            self._add([name], InstructionEncoder(vocabulary(space[name])))
        if not self.names:
            raise ValueError(f"the observations are {space}: there is nothing to read")

    def _add(self, names: list[str], encoder: PartEncoder) -> None:
        self.names.append(tuple(names))
        self.encoders.append(encoder)
        self.size += encoder.size

    def reader(self, name: str) -> nn.Module:
        """The encoder that reads a part."""
        return next(e for n, e in zip(self.names, self.encoders, strict=True) if name in n)

    def compile_images(self) -> int:
        """Compiles the networks that read images (`torch.compile`); returns how many there are."""
        networks = [e for e in self.encoders if isinstance(e, ResNet | ShallowNet | PatchEncoder)]
        for network in networks:
            network.compile()
        return len(networks)

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """`{name: [N, ...]}` -> `[N, size]`."""
        parts = zip(self.names, self.encoders, strict=True)
        return torch.cat([encode(*(observation[n] for n in names)) for names, encode in parts], -1)


def vocabulary(space: gym.Space) -> int:
    """How many words a text has to choose from, padding included."""
    assert isinstance(space, gym.spaces.Box)
    return int(space.high.max()) + 1
