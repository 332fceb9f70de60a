"""Encoders: one observation in, one vector out. They read `[N, ...]` and know nothing of time.

An observation is a Dict of parts. Which encoder reads a part follows from its space:

    image    uint8 Box [H, W, C], H and W at least 7,     the network chosen, one for each image
             or with C = 1, 3 or 4
    text     int64 Box [L] from 0, or any integer Box     word embeddings and an LSTM, one for each
             [L] from 0 named `instruction`
    codes    Discrete, MultiDiscrete, integer Box from    embeddings and a dense layer, one for all
             0 to less than 255
    vector   any other Box, MultiBinary                   an MLP, one for all

What they compute is concatenated. What may be an image and does not have its channels last is
refused: it would go through the MLP.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from torch import Tensor, nn

from zipf.agents.image_networks import (
    ComparingEncoder,
    PatchEncoder,
    ResNet,
    ShallowNet,
    compute_dtype,
)
from zipf.agents.instructed_networks import (
    AttentionNet,
    FiLMNet,
    InstructedNet,
    Matcher,
    MatchingNet,
)
from zipf.agents.network_options import (
    AttentionOptions,
    CompactOptions,
    ComparingOptions,
    FiLMOptions,
    InstructedOptions,
    MatchingOptions,
    NetworkOptions,
    ResNetOptions,
    ShallowOptions,
)
from zipf.registry import Registry

SMALLEST_SIDE = 7  # ours: of an image; MiniGrid's are 7 x 7
DTYPES = [
    np.dtype(kind)
    for kind in (
        np.bool_,
        np.uint8,
        np.uint16,
        np.uint32,
        np.int8,
        np.int16,
        np.int32,
        np.int64,
        np.float16,
        np.float32,
        np.float64,
    )
]
"""What PyTorch reads, and encoders make floats or indices of."""
LARGEST_VOCABULARY = 2**16  # ours: integers beyond that are quantities rather than words
LARGEST_RANGE = 1e4  # ours: wider bounds stand for none, as float32's largest number does


class CodeEncoder(nn.Module):
    """Codes, each embedded by one table, then a dense layer: integers [N, ...] each -> [N, F].

    With the cells of an image as codes this is `PatchEncoder` without its first product.
    """

    offsets: Tensor

    def __init__(self, parts: list[gym.Space], options: NetworkOptions):
        super().__init__()
        counts = [number_of_codes(space) for space in parts]
        offsets = np.concatenate([_offsets(space) for space in parts])
        self.size = options.code_size
        self.register_buffer("offsets", torch.tensor(offsets, dtype=torch.int32), persistent=False)
        self.embed = nn.Embedding(max(counts), options.code_channels)
        self.mix = nn.Linear(len(offsets) * options.code_channels, options.code_size)

    def forward(self, *parts: Tensor) -> Tensor:
        codes = torch.cat([part.reshape(len(part), -1).int() for part in parts], -1) - self.offsets
        return self.mix(self.embed(codes).relu().flatten(1)).relu()


def number_of_codes(space: gym.Space) -> int:
    """How many codes a part has that `is_codes`, or words one that `is_text`, padding included."""
    if isinstance(space, gym.spaces.Discrete):
        return int(space.n)
    if isinstance(space, gym.spaces.MultiDiscrete):
        return int(space.nvec.max())
    assert isinstance(space, gym.spaces.Box)
    return int(space.high.max()) + 1


def _offsets(space: gym.Space) -> np.ndarray:
    """The least code of each entry of a part, int64 [entries]."""
    if isinstance(space, gym.spaces.Discrete):
        return np.array([space.start])
    if isinstance(space, gym.spaces.MultiDiscrete):
        return space.start.reshape(-1)
    return np.zeros(math.prod(space.shape or ()), np.int64)


class VectorEncoder(nn.Module):
    """Numbers of any kind, brought to a common scale, then an MLP: [N, ...] each -> [N, F].

    An entry with finite bounds is scaled from them to [-1, 1]. Any other becomes
    sign(x) log(1 + |x|) (symlog, Hafner et al. 2023), which leaves small numbers nearly as they are
    and needs no statistics of the data. Both are computed in float64: bounds may be far from 0.
    """

    low: Tensor
    width: Tensor
    bounded: Tensor

    def __init__(self, parts: list[gym.Space], options: NetworkOptions):
        super().__init__()
        bounds = [_bounds(space) for space in parts]
        low = np.concatenate([one for one, _ in bounds])
        high = np.concatenate([other for _, other in bounds])
        with np.errstate(over="ignore", invalid="ignore"):
            width = high - low
        bounded = width <= LARGEST_RANGE
        low, width = np.where(bounded, low, 0.0), np.where(bounded & (width > 0), width, 1.0)
        self.register_buffer("low", torch.tensor(low), persistent=False)
        self.register_buffer("width", torch.tensor(width), persistent=False)
        self.register_buffer("bounded", torch.tensor(bounded), persistent=False)
        layers: list[nn.Module] = []
        inputs = len(low)
        for outputs in options.vector_layers:
            layers += [nn.Linear(inputs, outputs), nn.ReLU()]
            inputs = outputs
        self.layers = nn.Sequential(*layers)
        self.size = inputs

    def forward(self, *parts: Tensor) -> Tensor:
        x = torch.cat([part.reshape(len(part), -1).double() for part in parts], -1)
        scaled = 2 * (x - self.low) / self.width - 1
        return self.layers(torch.where(self.bounded, scaled, x.sign() * x.abs().log1p()).float())


def _bounds(space: gym.Space) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper bound of each entry, float64 [entries]."""
    if isinstance(space, gym.spaces.MultiBinary):
        entries = math.prod(space.shape)
        return np.zeros(entries), np.ones(entries)
    assert isinstance(space, gym.spaces.Box)
    low, high = space.low.astype(np.float64), space.high.astype(np.float64)
    return low.reshape(-1), high.reshape(-1)


class InstructionEncoder(nn.Module):
    """Word embeddings and an LSTM, its output at the last word: integers [N, L] -> [N, 32].

    Sizes 32 and 32 from the paper's architecture table. Zeros behind the last other word are
    padding; a zero before it is a word like any other, whose embedding is zero. Under autocast the
    LSTM computes in float32: not all CPUs have one in bfloat16.
    """

    size = 32

    def __init__(self, vocabulary: int):
        super().__init__()
        self.embedding = nn.Embedding(vocabulary, 32, padding_idx=0)
        self.lstm = nn.LSTM(32, self.size, batch_first=True)

    def forward(self, instruction: Tensor) -> Tensor:
        instruction = instruction.long()
        with torch.autocast(instruction.device.type, enabled=False):
            outputs, _ = self.lstm(self.embedding(instruction))
        outputs = outputs.to(compute_dtype(instruction))
        place = torch.arange(instruction.shape[-1], device=outputs.device)
        last = torch.where(instruction != 0, place, 0).amax(-1)
        return outputs[torch.arange(len(outputs), device=outputs.device), last]


NETWORKS: Registry[nn.Module] = Registry("network")
"""Each is built from its options, the shape [H, W, C] of the images that it reads, and the sizes of
the texts' vocabularies, () for none. It has the `size` of its outputs, and computes uint8
[N, H, W, C] -> [N, size]; an `InstructedNet` reads the encoded texts [N, instruction], too, and a
`MatchingNet` their words. It raises ValueError for images that it cannot read."""


def _plain(network: Callable[..., nn.Module]) -> Callable[..., nn.Module]:
    """What builds a network that does not read the instruction."""
    return lambda options, shape, vocabularies: network(shape, options)


def _instructed(network: Callable[..., nn.Module]) -> Callable[..., nn.Module]:
    """What builds a network that reads the encoded instruction."""
    return lambda options, shape, vocabularies: network(
        shape, options, InstructionEncoder.size * len(vocabularies)
    )


NETWORKS.register(ResNetOptions, _plain(ResNet))
NETWORKS.register(ShallowOptions, _plain(ShallowNet))
NETWORKS.register(FiLMOptions, _instructed(FiLMNet))
NETWORKS.register(AttentionOptions, _instructed(AttentionNet))
NETWORKS.register(MatchingOptions, lambda options, shape, words: MatchingNet(shape, options, words))
NETWORKS.register(CompactOptions, _plain(PatchEncoder))
NETWORKS.register(ComparingOptions, _plain(ComparingEncoder))


def is_image(space: gym.Space) -> bool:
    """Whether a part is an image: uint8 [H, W, C] with H and W of at least 7, or C = 1, 3 or 4."""
    if not isinstance(space, gym.spaces.Box) or space.dtype != np.uint8 or len(space.shape) != 3:
        return False
    height, width, channels = space.shape
    return channels in (1, 3, 4) or (min(height, width) >= SMALLEST_SIDE and not is_codes(space))


def _check_readable(name: str, space: gym.Space) -> None:
    """Raises ValueError for a part whose numbers PyTorch has not, or that may be an image with
    other axes."""
    numbers = gym.spaces.Box | gym.spaces.Discrete | gym.spaces.MultiDiscrete
    if isinstance(space, numbers) and space.dtype not in DTYPES:
        raise ValueError(
            f"no encoder reads {name!r} of the observations, which is {space.dtype}: give it as "
            f"one of {', '.join(dtype.name for dtype in DTYPES)}"
        )
    if not isinstance(space, gym.spaces.Box) or space.dtype not in (np.uint8, np.bool_):
        return
    image = is_image(space) or sum(n >= SMALLEST_SIDE for n in space.shape) < 2
    if not image and (space.dtype == np.bool_ or not is_codes(space)):
        raise ValueError(
            f"{name!r} of the observations is {space.dtype} {list(space.shape)}: give an image as "
            f"uint8 [H, W, C], with H and W of at least {SMALLEST_SIDE}, and what is none with a "
            "single axis"
        )


def has_image(space: gym.spaces.Dict) -> bool:
    """Whether there is an image of that name."""
    return "image" in space.spaces and is_image(space["image"])


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

    With `remember_instruction` False texts are left out of the result: the images' network reads
    them. Raises ValueError: a part is of a kind that no encoder reads, or there is no image for a
    network that reads images by an instruction.

    Attributes:
        encoders: for each of `names`, the parts it reads, an encoder of [N, ...] -> [N, its size].
        texts: the names of the parts that are texts.
        size: of the result.
    """

    def __init__(self, space: gym.spaces.Dict, options: NetworkOptions):
        super().__init__()
        images, codes, vectors, texts = [], [], [], []
        for name, part in space.items():
            _check_readable(name, part)
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
        if isinstance(options, InstructedOptions) and not images:
            raise ValueError(
                f"network={options.name} reads images by an instruction, and the observations have "
                "no image; choose network=compact"
            )
        if isinstance(options, InstructedOptions) and not texts:
            raise ValueError(
                f"network={options.name} reads images by an instruction, and the observations have "
                "none; choose network=shallow"
            )
        # The largest first: the gridworld's tiles before its cue, and not by name.
        codes.sort(key=lambda name: (-math.prod(space[name].shape or ()), name))

        self.size = 0
        self.network = options.name
        self.texts = texts
        self.names: list[tuple[str, ...]] = []
        self.encoders = nn.ModuleList()
        words = [number_of_codes(space[name]) for name in texts]
        for name in images:
            self._add([name], NETWORKS.build(options, space[name].shape or (), words))
        self._images = len(images)  # theirs are the first of the encoders
        if codes:
            self._add(codes, CodeEncoder([space[name] for name in codes], options))
        if vectors:
            self._add(vectors, VectorEncoder([space[name] for name in vectors], options))
        if not isinstance(options, MatchingOptions) or options.remember_instruction:
            for name, count in zip(texts, words, strict=True):
                self._add([name], InstructionEncoder(count))
        if not self.names:
            raise ValueError(f"the observations are {space}: there is nothing to read")

    def _add(self, names: list[str], encoder: Any) -> None:
        self.names.append(tuple(names))
        self.encoders.append(encoder)
        self.size += encoder.size

    def reader(self, name: str) -> nn.Module:
        """The encoder that reads a part."""
        return next(e for n, e in zip(self.names, self.encoders, strict=True) if name in n)

    def parts(self) -> dict[str, nn.Module]:
        """The encoders by what they read, such as `instruction`, and the matcher of an image's,
        such as `image.matcher`."""
        named = zip(self.names, self.encoders, strict=True)
        matchers = {f"{name}.matcher": matcher for name, matcher in self._matchers().items()}
        return {"+".join(names): encoder for names, encoder in named} | matchers

    def describe(self, space: gym.spaces.Dict) -> str:
        """Which encoder reads each part of these observations, in one line."""
        lines = []
        for names, encoder in zip(self.names, self.encoders, strict=True):
            how = _NAMES.get(type(encoder), f"network={self.network}")
            lines += [
                f"{name} {space[name].dtype} {list(space[name].shape or ())}" for name in names
            ]
            lines[-1] += f" by {how}"
        return "observations: " + "; ".join(lines)

    def compile_images(self, *, fixed: bool) -> int:
        """Compiles the networks that read images (`torch.compile`), for each number of images anew
        if `fixed`; returns how many there are."""
        for network in self.encoders[: self._images]:
            network.compile(dynamic=False if fixed else None)
        return self._images

    def match(self, observation: dict[str, Tensor], asked: dict[str, Tensor]) -> Tensor:
        """How well the places of images show what instructions name, by `network=matching`: the
        images of `{name: [N, ...]}` and the texts of `{name: [G, ...]}` -> float32 [N, P, G]."""
        texts = [asked[name] for name in self.texts]
        scores = [matcher(observation[name], texts) for name, matcher in self._matchers().items()]
        return torch.cat(scores, 1)

    def places(self) -> Tensor:
        """The centres of the places of `match`, float32 [P, 2]: down and to the right, in sides of
        the image."""
        return torch.cat([matcher.centres for matcher in self._matchers().values()])

    def _matchers(self) -> dict[str, Matcher]:
        """The matchers by the images that they read."""
        return {
            names[0]: network.matcher
            for names, network in zip(self.names, self.encoders, strict=True)
            if isinstance(network, MatchingNet)
        }

    def forward(self, observation: dict[str, Tensor]) -> Tensor:
        """`{name: [N, ...]}` -> `[N, size]`."""
        texts = [observation[name] for name in self.texts]
        named = list(zip(self.names, self.encoders, strict=True))
        told = [
            encode(observation[names[0]])
            for names, encode in named
            if isinstance(encode, InstructionEncoder)
        ]
        encoded = []
        for names, encode in named:
            if isinstance(encode, MatchingNet):
                encoded.append(encode(observation[names[0]], texts))
            elif isinstance(encode, InstructedNet):
                encoded.append(encode(observation[names[0]], torch.cat(told, -1)))
            elif not isinstance(encode, InstructionEncoder):
                encoded.append(encode(*(observation[name] for name in names)))
        return torch.cat([*encoded, *told], -1)


_NAMES = {
    CodeEncoder: "embeddings of codes",
    VectorEncoder: "an MLP",
    InstructionEncoder: "an LSTM over words",
}
