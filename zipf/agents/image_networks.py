"""The networks that read images, uint8 [N, H, W, C] -> [N, F], and their options."""

from __future__ import annotations

from typing import Annotated, Literal

import torch
import torch.nn.functional as F
from pydantic import Field, ValidationInfo, field_validator
from torch import Tensor, nn

from zipf.options import Options

Size = Annotated[int, Field(ge=1)]


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
    """As compact, and every patch is compared with every other before `convolutions` convolutions
    of `width` channels.

    With `comparison` "learned" by the cosine of two learned keys of `key_size`, with "given" by
    whether their coloured pixels are the same.
    """

    name: Literal["comparing"]  # type: ignore[assignment]
    comparison: Literal["learned", "given"]
    key_size: Size
    width: Size
    convolutions: Annotated[int, Field(ge=0)]


class ShallowOptions(EncoderOptions):
    """The shallow network of Espeholt et al. 2018: strided convolutions, then a dense layer.

    With `normalise` pixels are scaled to [-1, 1] instead of [0, 1], and the dense layer's outputs
    are normalised (Ba et al. 2016) before their ReLU.
    """

    name: Literal["shallow"]
    channels: Annotated[list[Size], Field(min_length=1)]
    kernels: Annotated[list[Size], Field(min_length=1)]
    strides: Annotated[list[Size], Field(min_length=1)]
    size: Size
    normalise: bool

    @field_validator("kernels", "strides", "match_channels", check_fields=False)
    @classmethod
    def _as_many(cls, numbers: list[int], info: ValidationInfo) -> list[int]:
        """Every convolution has channels, a kernel and a stride."""
        if len(numbers) != len(info.data.get("channels", numbers)):
            raise ValueError("should have as many numbers as network.channels")
        return numbers


class FiLMOptions(ShallowOptions):
    """As shallow, and the instruction scales and shifts the channels of every convolution."""

    name: Literal["film"]  # type: ignore[assignment]


class AttentionOptions(ShallowOptions):
    """As shallow, and the instruction attends to places of the image: `heads` heads, whose keys
    have `key_size` numbers."""

    name: Literal["attention"]  # type: ignore[assignment]
    heads: Size
    key_size: Size


class MatchingOptions(ShallowOptions):
    """As shallow, and places of the image are matched with the instruction.

    `match_channels` are those of the convolutions whose keys are matched, with the kernels and
    strides of the others; one of 3 x 3 follows. Keys and queries have `key_size` numbers. With
    `matcher` "fixed" the matcher and the encoder of the instruction stay as they begin.
    """

    name: Literal["matching"]  # type: ignore[assignment]
    match_channels: Annotated[list[Size], Field(min_length=1)]
    key_size: Size
    matcher: Literal["learned", "fixed"] = "learned"


NetworkOptions = Annotated[
    ResNetOptions
    | ShallowOptions
    | FiLMOptions
    | AttentionOptions
    | MatchingOptions
    | CompactOptions
    | ComparingOptions,
    Field(discriminator="name"),
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
        return self.layers[1:](convolve_pixels(image, self.layers[0], centred=False))


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
        self.centred = options.normalise
        dense = dense_layer(height * width * channels, options)
        self.layers = nn.Sequential(*layers, nn.Flatten(), *dense)
        self.layers.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    def forward(self, image: Tensor) -> Tensor:
        return self.layers[1:](convolve_pixels(image, self.layers[0], centred=self.centred))


def dense_layer(inputs: int, options: ShallowOptions) -> nn.Sequential:
    """A dense layer, normalised where the options say so, and its ReLU."""
    norm = [nn.LayerNorm(options.size)] if options.normalise else []
    return nn.Sequential(nn.Linear(inputs, options.size), *norm, nn.ReLU())


def convolve_pixels(image: Tensor, convolution: nn.Module, *, centred: bool) -> Tensor:
    """A convolution of images uint8 [N, H, W, C] whose pixels are scaled to [0, 1], or to [-1, 1]
    if `centred`: [N, F, h, w].

    Its weights are scaled in the place of the pixels, which saves passes over the largest tensor
    there is, and bfloat16 holds every byte as it is. Centred pixels are not padded.
    """
    assert isinstance(convolution, nn.Conv2d)
    assert convolution.bias is not None
    weight, bias = convolution.weight / 255.0, convolution.bias
    if centred:  # W (2 p / 255 - 1) + b
        weight, bias = 2 * weight, bias - convolution.weight.sum((1, 2, 3))
    pixels = image.permute(0, 3, 1, 2).to(_compute_dtype(image))
    return F.conv2d(pixels, weight, bias, convolution.stride, convolution.padding)


def convolve_image(image: Tensor, convolutions: nn.ModuleList, *, centred: bool) -> Tensor:
    """Convolutions of images one after another, each with its ReLU; the first as
    `convolve_pixels`."""
    first, *others = convolutions
    seen = convolve_pixels(image, first, centred=centred).relu()
    for convolution in others:
        seen = convolution(seen).relu()
    return seen


class InstructedNet(nn.Module):
    """The base of networks that read an image by an instruction: strided convolutions, then a dense
    layer, as `ShallowNet`: uint8 [N, H, W, C], [N, instruction size] -> [N, F].

    Attributes:
        convolutions: without padding; a ReLU follows each.
        grid: channels, rows and columns after the last.
    """

    def __init__(self, shape: tuple[int, ...], options: ShallowOptions):
        super().__init__()
        plain = ShallowNet(shape, options)
        self.convolutions = nn.ModuleList(m for m in plain.layers if isinstance(m, nn.Conv2d))
        with torch.no_grad():
            seen = torch.zeros(1, shape[2], *shape[:2])
            for convolution in self.convolutions:
                seen = convolution(seen)
        self.grid = seen.shape[1:]
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
    """How well each place of an image shows what an instruction names.

    A place has a key, what convolutions find there, and an instruction a query, linear in its code:
    score = e^s cos(key, query) + offset, where s is learned and the offset, linear in what
    convolutions find, is the place's own, whatever is asked for. Images and texts that meet in
    cosines: Radford et al. 2021. `zipf.agents.hindsight` has a loss for it.
    """

    def __init__(self, shape: tuple[int, ...], options: MatchingOptions, instruction: int):
        super().__init__()
        inputs = [shape[2], *options.match_channels]
        layers = zip(inputs[:-1], inputs[1:], options.kernels, options.strides, strict=True)
        self.convolutions = nn.ModuleList(nn.Conv2d(*layer) for layer in layers)
        self.convolutions.append(nn.Conv2d(inputs[-1], inputs[-1], 3, padding=1))
        self.convolutions.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.key = nn.Linear(inputs[-1], options.key_size)
        self.query = nn.Linear(instruction, options.key_size)
        self.offset = nn.Linear(inputs[-1], 1)
        self.sharpness = nn.Parameter(torch.tensor(2.0))
        self.centred = options.normalise

    def forward(self, image: Tensor, instruction: Tensor) -> Tensor:
        """The scores of all G instructions in all places: uint8 [N, H, W, C], [G, instruction size]
        -> float32 [N, places, G]."""
        keys, offset = self._read(image)
        queries = self._queries(instruction)
        with torch.autocast(image.device.type, enabled=False):
            return self.sharpness.exp() * (keys @ queries.T) + offset

    def each(self, image: Tensor, instruction: Tensor) -> Tensor:
        """The scores of each image's own instruction: uint8 [N, H, W, C], [N, instruction size] ->
        float32 [N, places]."""
        keys, offset = self._read(image)
        queries = self._queries(instruction)
        with torch.autocast(image.device.type, enabled=False):
            return (self.sharpness.exp() * (keys @ queries.unsqueeze(-1)) + offset).squeeze(-1)

    def _read(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """Keys of length 1 [N, places, key size] and offsets [N, places, 1], float32."""
        seen = convolve_image(image, self.convolutions, centred=self.centred)
        places = seen.flatten(2).transpose(1, 2)
        return F.normalize(self.key(places).float(), dim=-1), self.offset(places).float()

    def _queries(self, instruction: Tensor) -> Tensor:
        return F.normalize(self.query(instruction).float(), dim=-1)


class MatchingNet(InstructedNet):
    """Convolutions that do not read the instruction, and a `Matcher` that tells where to look.

    The dense layer reads what the convolutions found, the matcher's score in every place, and of
    softmax(scores) the mean place (x, y in [-1, 1]; a spatial soft argmax, Levine et al. 2016) and
    the mean score. So all that it makes of the instruction is where things are, which is the same
    for one goal and for any other.
    """

    places: Tensor

    def __init__(self, shape: tuple[int, ...], options: MatchingOptions, instruction: int):
        super().__init__(shape, options)
        self.matcher = Matcher(shape, options, instruction)
        self.matcher.requires_grad_(options.matcher == "learned")
        _, rows, columns = self.grid
        y, x = torch.linspace(-1, 1, rows), torch.linspace(-1, 1, columns)
        places = torch.stack([x.repeat(rows), y.repeat_interleave(columns)], -1)
        self.register_buffer("places", places, persistent=False)
        self.dense = dense_layer(self.grid.numel() + rows * columns + 3, options)

    def forward(self, image: Tensor, instruction: Tensor) -> Tensor:
        seen = convolve_image(image, self.convolutions, centred=self.centred)
        scores = self.matcher.each(image, instruction)
        with torch.autocast(image.device.type, enabled=False):
            weights = scores.softmax(-1)
            mean = (weights * scores).sum(-1, keepdim=True)
            parts = (seen.flatten(1), _TAMED * scores, weights @ self.places, _TAMED * mean)
        return self.dense(torch.cat([part.to(seen.dtype) for part in parts], 1))


_TAMED = 0.25  # ours: scores reach 10 and more, what convolutions find is near 1


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
    """Patches that are compared with each other: uint8 [N, H, W, C] -> [N, F].

    What is known of a patch is a small embedding, and how alike it and each of all patches are. One
    dense layer for all patches reads this, then 3 x 3 convolutions over the grid of patches, then a
    dense layer. With a cue among the patches, the convolutions are told where else in view is what
    the cue shows, whatever that is. The embedding is small so that relations tell more than looks,
    which would have to be learned anew for everything that is rarely seen: a relational bottleneck
    (Webb et al. 2024; Kerg et al. 2022).

    "learned": exp(s (c - 1)), where c is the cosine of two patches' keys, k = W (p - mean(p)), one
    W for all patches, and s a learned number. W begins as a random rotation, which leaves cosines
    of pixels nearly as they are. Self-similarities: Shechtman and Irani 2007; one metric for both
    of a pair: Bromley et al. 1993.

    "given": 1 where two patches show the same, else 0. Two colours count as the same if they
    differ by a grey, so that grey pixels are background; patches of nothing else show nothing.
    """

    codes: Tensor

    def __init__(self, shape: tuple[int, ...], options: ComparingOptions):
        super().__init__(shape, options)
        height, width, self.channels = shape
        self.rows, self.columns = height // self.patch, width // self.patch
        width = options.width
        self.describe = nn.Linear(options.channels + self.patches, width)
        self.convolutions = nn.ModuleList(
            nn.Conv2d(width, width, 3, padding=1) for _ in range(options.convolutions)
        )
        self.convolutions.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.mix = nn.Linear(self.patches * width, options.size)
        pixels = self.patch**2 * self.channels
        self.key: nn.Linear | None = None
        if options.comparison == "learned":
            self.key = nn.Linear(pixels, options.key_size, bias=False)
            nn.init.orthogonal_(self.key.weight)
            self.sharpness = nn.Parameter(torch.tensor(3.0))
        else:
            self.register_buffer("codes", _codes_of_colours(self.patch, shape[2]), persistent=False)

    def forward(self, image: Tensor) -> Tensor:
        patches = self.cut(image).to(_compute_dtype(image))
        if self.key is None:
            alike = self.same(patches)
        else:
            alike = ((self.cosines(patches, self.key) - 1) * self.sharpness).exp()
        embedded = self.embedded(patches).unflatten(1, (self.patches, -1))
        described = self.describe(torch.cat([embedded, alike.to(embedded.dtype)], -1)).relu()
        grid = described.unflatten(1, (self.rows, self.columns)).permute(0, 3, 1, 2)
        for convolution in self.convolutions:
            grid = convolution(grid).relu()
        return self.mix(grid.permute(0, 2, 3, 1).flatten(1)).relu()

    def cosines(self, patches: Tensor, key: nn.Linear) -> Tensor:
        """The cosines of the keys of any two patches, [N, patches, pixels * C] -> [N, patches,
        patches]; near 0 for patches of one colour."""
        weight = key.weight / 255.0
        # Without the weights' mean keys do not depend on the patch's mean.
        keys = F.linear(patches, weight - weight.mean(1, keepdim=True))
        scale = keys.float().square().sum(-1, keepdim=True).clamp(min=_FAINT**2).rsqrt()
        keys = keys * scale.to(keys.dtype)
        return keys @ keys.transpose(1, 2)

    def same(self, patches: Tensor) -> Tensor:
        """Whether any two patches show the same, [N, patches, pixels * C] -> bool [N, patches,
        patches]."""
        with torch.autocast(patches.device.type, enabled=False):
            low, high = F.linear(patches.float(), self.codes).double().unbind(-1)
        codes = low + 2**24 * high  # exact: both are whole numbers below 2^23
        return (codes.unsqueeze(1) == codes.unsqueeze(2)) & (codes != 0).unsqueeze(1)


def _codes_of_colours(patch: int, channels: int) -> Tensor:
    """Weights float32 [2, pixels * C] of whole numbers, whose sum over a pixel's first three
    channels is 0: what they make of two patches is hardly ever the same unless their pixels are, up
    to greys."""
    random = torch.Generator().manual_seed(0)
    most = max(1, 2**21 // (255 * patch**2))  # keeps sums below 2^23
    codes = torch.randint(-most, most + 1, (2, patch**2, channels), generator=random)
    codes[..., min(channels, 3) - 1] -= codes[..., :3].sum(-1)
    return codes.flatten(1).float()


_FAINT = 0.1  # ours: the norm below which keys are taken for shorter; rounding in bfloat16 has 0.01


def largest_patch(height: int, width: int) -> int:
    """The largest common divisor of an image's sides up to 12."""
    return max(size for size in range(1, 13) if height % size == 0 and width % size == 0)


def _compute_dtype(tensor: Tensor) -> torch.dtype:
    kind = tensor.device.type
    return torch.get_autocast_dtype(kind) if torch.is_autocast_enabled(kind) else torch.float32


ImageNetwork = ResNet | ShallowNet | InstructedNet | PatchEncoder


def image_network(
    shape: tuple[int, ...], options: NetworkOptions, instruction: int = 0
) -> ImageNetwork:
    """The network that the options name, for images [H, W, C].

    Args:
        shape: of the images.
        options: which network.
        instruction: size of the encoded instruction, 0 for none.

    Raises:
        ValueError: it cannot read images of that size, or needs an instruction.
    """
    match options:
        case FiLMOptions() | AttentionOptions() | MatchingOptions() if not instruction:
            raise ValueError(
                f"network={options.name} reads images by an instruction, and the observations have "
                "none; choose network=shallow"
            )
        case FiLMOptions():
            return FiLMNet(shape, options, instruction)
        case AttentionOptions():
            return AttentionNet(shape, options, instruction)
        case MatchingOptions():
            return MatchingNet(shape, options, instruction)
        case ResNetOptions():
            return ResNet(shape, options)
        case ShallowOptions():
            return ShallowNet(shape, options)
        case ComparingOptions():
            return ComparingEncoder(shape, options)
        case CompactOptions():
            return PatchEncoder(shape, options)
