"""The networks that read images by an instruction: uint8 [N, H, W, C] and the encoded instruction
[N, instruction size], or for matching its words, -> [N, F]."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zipf.agents.image_networks import ShallowNet, convolve_image, convolve_pixels, dense_layer
from zipf.agents.network_options import (
    AttentionOptions,
    FiLMOptions,
    MatchingOptions,
    ShallowOptions,
)


class InstructedNet(nn.Module):
    """The base of networks that read an image by an instruction: strided convolutions, then a dense
    layer, as `ShallowNet`: uint8 [N, H, W, C], [N, instruction size] -> [N, F]."""

    def __init__(self, shape: tuple[int, ...], options: ShallowOptions):
        super().__init__()
        plain = ShallowNet(shape, options)
        self.convolutions = nn.ModuleList(m for m in plain.layers if isinstance(m, nn.Conv2d))
        with torch.no_grad():
            seen = torch.zeros(1, shape[2], *shape[:2])
            for convolution in self.convolutions:
                seen = convolution(seen)
        self.grid = seen.shape[1:]  # channels, rows and columns after the last
        self.size = options.size
        self.centred = options.normalise


class FiLMNet(InstructedNet):
    """Feature-wise linear modulation (Perez et al. 2018): after each convolution, and before its
    ReLU, channel c becomes (1 + g_c) x_c + b_c, where g and b are linear in the encoded
    instruction. They begin as zeros, which makes it a `ShallowNet`."""

    def __init__(self, shape: tuple[int, ...], options: FiLMOptions, instruction: int):
        super().__init__(shape, options)
        modulations = [nn.Linear(instruction, 2 * channels) for channels in options.channels]
        for modulation in modulations:
            nn.init.zeros_(modulation.weight)
            nn.init.zeros_(modulation.bias)
        self.modulations = nn.ModuleList(modulations)
        self.dense = dense_layer(self.grid.numel(), options)

    def forward(self, image: Tensor, instruction: Tensor) -> Tensor:
        seen = convolve_pixels(image, self.convolutions[0], centred=self.centred)
        for layer, modulation in enumerate(self.modulations):
            if layer > 0:
                seen = self.convolutions[layer](seen)
            scale, shift = modulation(instruction)[:, :, None, None].chunk(2, 1)
            seen = ((1 + scale) * seen + shift).relu()
        return self.dense(seen.flatten(1))


class AttentionNet(InstructedNet):
    """Cross-attention (Vaswani et al. 2017) of the instruction over the places of the image.

    Each head has a query, linear in the encoded instruction. Keys are linear in what the
    convolutions found in a place; weights are softmax_p(q . k_p / sqrt(key size)). The dense layer
    reads what the convolutions found everywhere, the mean of it under each head's weights, and the
    weights: what is there, and where. `ShallowNet` is this without heads.
    """

    def __init__(self, shape: tuple[int, ...], options: AttentionOptions, instruction: int):
        super().__init__(shape, options)
        self.heads, self.key_size = options.heads, options.key_size
        channels, rows, columns = self.grid
        self.query = nn.Linear(instruction, options.heads * options.key_size)
        self.key = nn.Linear(channels, options.key_size)
        read = options.heads * (channels + rows * columns)
        self.dense = dense_layer(self.grid.numel() + read, options)

    def forward(self, image: Tensor, instruction: Tensor) -> Tensor:
        seen = convolve_image(image, self.convolutions, centred=self.centred)
        weights = self.weights(seen, instruction)
        found = weights @ seen.flatten(2).transpose(1, 2).to(weights.dtype)
        parts = (seen.flatten(1), found.flatten(1), weights.flatten(1))
        return self.dense(torch.cat([part.to(seen.dtype) for part in parts], 1))

    def weights(self, seen: Tensor, instruction: Tensor) -> Tensor:
        """The heads' weights of the places: [N, channels, rows, columns], [N, instruction size] ->
        [N, heads, rows * columns]."""
        keys = self.key(seen.flatten(2).transpose(1, 2))
        queries = self.query(instruction).unflatten(1, (self.heads, self.key_size))
        return (queries @ keys.transpose(1, 2) / self.key_size**0.5).softmax(-1)


class Matcher(nn.Module):
    """How well each of P places of an image shows what an instruction names.

    A place has a key, what convolutions find there, and an instruction a query, the sum of its
    words' embeddings and of a vector that is learned, too: score = e^s cos(key, query) + offset,
    where s is learned and the offset, linear in what convolutions find, is the place's own,
    whatever is asked for. Words begin as zeros, and those that training does not have stay so: "put
    a pear on a bed" is read as "find a pear" is. Images and texts that meet in cosines: Radford et
    al. 2021; a map of them as the policy's input: Jiang and Lu 2024 (COPL, arXiv 2408.01942).
    `zipf.agents.hindsight` has a loss for it.
    """

    centres: Tensor  # of the places, float32 [P, 2]: down and to the right, in sides of the image

    def __init__(
        self, shape: tuple[int, ...], options: MatchingOptions, vocabularies: Sequence[int]
    ):
        super().__init__()
        kernels = options.match_kernels or options.kernels
        strides = options.match_strides or options.strides
        rows, columns = (_centres(side, kernels, strides) for side in shape[:2])
        self.grid = len(rows), len(columns)
        self.register_buffer("centres", torch.cartesian_prod(rows, columns), persistent=False)
        inputs = [shape[2], *options.match_channels]
        layers = zip(inputs[:-1], inputs[1:], kernels, strides, strict=True)
        self.convolutions = nn.ModuleList(nn.Conv2d(*layer) for layer in layers)
        self.convolutions.append(nn.Conv2d(inputs[-1], inputs[-1], 3, padding=1))
        self.convolutions.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.key = nn.Linear(inputs[-1], options.key_size)
        words = [nn.Embedding(count, options.key_size, padding_idx=0) for count in vocabularies]
        for table in words:
            nn.init.zeros_(table.weight)
        self.words = nn.ModuleList(words)
        self.query = nn.Parameter(_FIRST_QUERY * torch.randn(options.key_size))
        self.offset = nn.Linear(inputs[-1], 1)
        self.sharpness = nn.Parameter(torch.tensor(2.0))
        self.centred = options.normalise

    def forward(self, image: Tensor, texts: Sequence[Tensor]) -> Tensor:
        """The scores of all G instructions in all places: uint8 [N, H, W, C], integers [G, L] each
        -> float32 [N, P, G]."""
        keys, offset = self._read(image)
        queries = self._queries(texts)
        with torch.autocast(image.device.type, enabled=False):
            return self.sharpness.exp() * (keys @ queries.T) + offset

    def each(self, image: Tensor, texts: Sequence[Tensor]) -> Tensor:
        """The scores of each image's own instruction: uint8 [N, H, W, C], integers [N, L] each ->
        float32 [N, P]."""
        keys, offset = self._read(image)
        queries = self._queries(texts)
        with torch.autocast(image.device.type, enabled=False):
            return (self.sharpness.exp() * (keys @ queries.unsqueeze(-1)) + offset).squeeze(-1)

    def _read(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Keys of length 1 [N, P, key size] and offsets [N, P, 1], float32."""
        seen = convolve_image(image, self.convolutions, centred=self.centred)
        places = seen.flatten(2).transpose(1, 2)
        return F.normalize(self.key(places).float(), dim=-1), self.offset(places).float()

    def _queries(self, texts: Sequence[Tensor]) -> Tensor:
        """Queries of length 1, float32 [G, key size]."""
        tables = zip(self.words, texts, strict=True)
        words = (table(text.long()).sum(-2) for table, text in tables)
        return F.normalize(sum(words, start=self.query), dim=-1)


_FIRST_QUERY = 0.02  # ours: short, so that words, which grow by the learning rate, soon turn it


def _centres(side: int, kernels: Sequence[int], strides: Sequence[int]) -> Tensor:
    """The centres of what strided convolutions read along a side of so many pixels, in sides."""
    centre, apart, places = 0.5, 1, side
    for kernel, stride in zip(kernels, strides, strict=True):
        centre += apart * (kernel - 1) / 2
        apart *= stride
        places = (places - kernel) // stride + 1
    return (centre + apart * torch.arange(places)) / side


class MatchingNet(InstructedNet):
    """Convolutions that do not read the instruction, and a `Matcher` that tells where to look.

    The dense layer reads what the convolutions found, the matcher's score in every place, and of
    softmax(scores) the mean place (x, y in [-1, 1]; a spatial soft argmax, Levine et al. 2016) and
    the mean score. The instruction therefore reaches the dense layer only through scores and
    places, which are computed alike for every goal.
    """

    places: Tensor

    def __init__(
        self, shape: tuple[int, ...], options: MatchingOptions, vocabularies: Sequence[int]
    ):
        super().__init__(shape, options)
        self.matcher = Matcher(shape, options, vocabularies)
        self.matcher.requires_grad_(options.matcher == "learned")
        rows, columns = self.matcher.grid
        y, x = torch.linspace(-1, 1, rows), torch.linspace(-1, 1, columns)
        places = torch.stack([x.repeat(rows), y.repeat_interleave(columns)], -1)
        self.register_buffer("places", places, persistent=False)
        self.dense = dense_layer(self.grid.numel() + rows * columns + 3, options)

    def forward(self, image: Tensor, texts: Sequence[Tensor]) -> Tensor:
        """uint8 [N, H, W, C], integers [N, L] of each text -> [N, size]."""
        seen = convolve_image(image, self.convolutions, centred=self.centred)
        scores = self.matcher.each(image, texts)
        with torch.autocast(image.device.type, enabled=False):
            weights = scores.softmax(-1)
            mean = (weights * scores).sum(-1, keepdim=True)
            parts = (seen.flatten(1), _TAMED * scores, weights @ self.places, _TAMED * mean)
        return self.dense(torch.cat([part.to(seen.dtype) for part in parts], 1))


_TAMED = 0.25  # ours: scores reach 10 and more, what convolutions find is near 1
