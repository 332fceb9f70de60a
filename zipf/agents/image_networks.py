"""The networks that read images alone, uint8 [N, H, W, C] -> [N, F]."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zipf.agents.network_options import (
    CompactOptions,
    ComparingOptions,
    ResNetOptions,
    ShallowOptions,
)


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
                    f"network={options.name} leaves nothing of an image of {shape[0]} x {shape[1]} "
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

    The weights are scaled instead of the pixels: this saves passes over the largest tensor, and
    bfloat16 represents every byte exactly. Centred pixels are not padded.
    """
    assert isinstance(convolution, nn.Conv2d)
    assert convolution.bias is not None
    weight, bias = convolution.weight / 255.0, convolution.bias
    if centred:  # W (2 p / 255 - 1) + b
        weight, bias = 2 * weight, bias - convolution.weight.sum((1, 2, 3))
    pixels = image.permute(0, 3, 1, 2).to(compute_dtype(image))
    return F.conv2d(pixels, weight, bias, convolution.stride, convolution.padding)


def convolve_image(image: Tensor, convolutions: nn.ModuleList, *, centred: bool) -> Tensor:
    """Convolutions of images one after another, each with its ReLU; the first as
    `convolve_pixels`."""
    first, *others = convolutions
    seen = convolve_pixels(image, first, centred=centred).relu()
    for convolution in others:
        seen = convolution(seen).relu()
    return seen


class PatchEncoder(nn.Module):
    """Patches, each embedded alike, then a dense layer: uint8 [N, H, W, C] -> [N, F].

    The stride-`patch` convolution is written as the matrix product it is, which is several times
    faster on CPUs than the convolution routine. There, patches that show the same, as most do in a
    world of tiles, are embedded once.
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
        patches, place = self.cut(image)
        embedded = self.embedded(patches)
        if place is not None and 2 * len(patches) <= len(image):
            return self._mix_once(embedded, place).relu()
        return self.mix(self.placed(embedded, place).flatten(1)).relu()

    def cut(self, image: Tensor) -> tuple[Tensor, Tensor | None]:
        """The patches of images [N, H, W, C], 0 .. 255, one image after another, and None; or, on a
        CPU where they repeat, those that differ, and which of them is where, int64 [N, patches].

        Patches are [K, pixels * C], in the dtype that the network computes in.
        """
        plain = image.device.type == "cpu" and not image.requires_grad
        if plain and not torch.compiler.is_compiling():
            distinct = distinct_patches(image, self.patch)
            if distinct is not None:
                return distinct[0].to(compute_dtype(image)), distinct[1]
        n, height, width, channels = image.shape
        p = self.patch
        grid = image.view(n, height // p, p, width // p, p * channels).transpose(2, 3)
        return grid.reshape(-1, p * p * channels).to(compute_dtype(image)), None

    def placed(self, values: Tensor, place: Tensor | None) -> Tensor:
        """What was computed of patches that were `cut`, where they are: [K, ...] -> [N, patches,
        ...]."""
        if place is not None:
            values = values.index_select(0, place.flatten())
        return values.unflatten(0, (-1, self.patches))

    def embedded(self, patches: Tensor) -> Tensor:
        """[K, pixels * C] -> [K, channels]."""
        # Scaling the weights instead of the pixels saves a pass over the largest tensor there is.
        return F.linear(patches, self.embed.weight / 255.0, self.embed.bias).relu()

    def _mix_once(self, embedded: Tensor, place: Tensor) -> Tensor:
        """`mix`, [K, channels] and [N, patches] -> [N, F]: what each patch adds at each place is
        computed once, in float32, and summed."""
        with torch.autocast("cpu", enabled=False):
            weight = self.mix.weight.view(self.size, self.patches, -1).permute(1, 2, 0)
            added = embedded.float() @ weight  # [patches, K, F]
            rows = place + torch.arange(self.patches) * len(embedded)
            summed = F.embedding_bag(rows, added.flatten(0, 1), mode="sum")
            return (summed + self.mix.bias).to(embedded.dtype)


def distinct_patches(image: Tensor, patch: int) -> tuple[Tensor, Tensor] | None:
    """The patches of images on a CPU that differ, and which of them is where: [N, H, W, C] of any
    dtype -> [K, patch * patch * C], int64 [N, patches]; None where more than half of them differ.

    They are found by a hash, and compared byte by byte: None, too, where different patches have the
    same hash, which they hardly ever have.
    """
    n, height, width, channels = image.shape
    rows, columns = height // patch, width // patch
    line = patch * channels * image.itemsize  # bytes
    # Lines of a patch are copied as items of as many bytes, which is three times as fast as bytes
    # one by one. Words of 8 bytes are hashed and compared; the last is padded with zeros.
    padded = np.zeros((n, rows, columns, -(-patch * line // 8)), np.int64)
    shape, strides = (*padded.shape[:3], patch), (*padded.strides[:3], line)
    lines = np.ndarray(shape, f"V{line}", padded, strides=strides)
    pixels = image.contiguous().view(torch.uint8).numpy().reshape(n, rows, patch, columns * line)
    lines[...] = pixels.view(f"V{line}").swapaxes(2, 3)
    words = padded.reshape(n * rows * columns, -1)
    weights = np.random.default_rng(0).integers(2**63, size=words.shape[1]) * 2 + 1
    hashes, place = torch.unique(torch.from_numpy(words @ weights), return_inverse=True)
    if 2 * len(hashes) > len(words):
        return None
    one = torch.empty_like(hashes)  # of each hash
    one[place] = torch.arange(len(place))
    found = words[one.numpy()]
    if not np.array_equal(found[place.numpy()], words):
        return None
    distinct = np.ascontiguousarray(found.view(np.uint8)[:, : patch * line])
    return torch.from_numpy(distinct).view(image.dtype), place.view(n, -1)


class ComparingEncoder(PatchEncoder):
    """Patches that are compared with each other: uint8 [N, H, W, C] -> [N, F].

    Each patch is described by a small embedding and by its similarity to every patch. A dense layer
    that all patches share reads this, followed by 3 x 3 convolutions over the grid of patches and a
    dense layer. With a cue among the patches, the similarities show the convolutions where else in
    view the cued object is, whichever it is. The embedding is small so that the network relies on
    similarities rather than on appearance, which it would have to learn separately for every rare
    object: a relational bottleneck (Webb et al. 2024; Kerg et al. 2022).

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
        patches, place = self.cut(image)
        embedded = self.placed(self.embedded(patches), place)
        if self.key is None:
            codes = self.placed(self.look(patches), place)
            alike = (codes.unsqueeze(1) == codes.unsqueeze(2)) & (codes != 0).unsqueeze(1)
        else:
            keys = self.placed(self.keys(patches, self.key), place)
            alike = ((keys @ keys.transpose(1, 2) - 1) * self.sharpness).exp()
        described = self.describe(torch.cat([embedded, alike.to(embedded.dtype)], -1)).relu()
        grid = described.unflatten(1, (self.rows, self.columns)).permute(0, 3, 1, 2)
        for convolution in self.convolutions:
            grid = convolution(grid).relu()
        return self.mix(grid.permute(0, 2, 3, 1).flatten(1)).relu()

    def keys(self, patches: Tensor, key: nn.Linear) -> Tensor:
        """The keys of patches, [K, pixels * C] -> [K, key_size], of length 1; near 0 for patches of
        one colour."""
        weight = key.weight / 255.0
        # Without the weights' mean keys do not depend on the patch's mean.
        keys = F.linear(patches, weight - weight.mean(1, keepdim=True))
        scale = keys.float().square().sum(-1, keepdim=True).clamp(min=_FAINT**2).rsqrt()
        return keys * scale.to(keys.dtype)

    def look(self, patches: Tensor) -> Tensor:
        """What patches show, [K, pixels * C] -> float64 [K]: equal numbers where it is the same, 0
        where it is nothing."""
        with torch.autocast(patches.device.type, enabled=False):
            low, high = F.linear(patches.float(), self.codes).double().unbind(-1)
        return low + 2**24 * high  # exact: both are whole numbers below 2^23


def _codes_of_colours(patch: int, channels: int) -> Tensor:
    """Weights float32 [2, pixels * C] of whole numbers, whose sum over a pixel's first three
    channels is 0: two patches get the same code only if their pixels differ by greys alone, apart
    from rare collisions."""
    random = torch.Generator().manual_seed(0)
    most = max(1, 2**21 // (255 * patch**2))  # keeps sums below 2^23
    codes = torch.randint(-most, most + 1, (2, patch**2, channels), generator=random)
    codes[..., min(channels, 3) - 1] -= codes[..., :3].sum(-1)
    return codes.flatten(1).float()


_FAINT = 0.1  # ours: shorter keys are not stretched to length 1; bfloat16's rounding is about 0.01


def largest_patch(height: int, width: int) -> int:
    """The largest common divisor of an image's sides up to 12."""
    return max(size for size in range(1, 13) if height % size == 0 and width % size == 0)


def compute_dtype(tensor: Tensor) -> torch.dtype:
    kind = tensor.device.type
    return torch.get_autocast_dtype(kind) if torch.is_autocast_enabled(kind) else torch.float32
