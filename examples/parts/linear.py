"""A network of one's own: an image's pixels, and one dense layer."""

from typing import Literal

from pydantic import Field
from torch import nn

from zipf.agents.encoders import NETWORKS
from zipf.agents.image_networks import compute_dtype
from zipf.agents.network_options import NetworkOptions


class LinearOptions(NetworkOptions):
    name: Literal["linear"]
    size: int = 128
    # Of what reads other parts of observations than images.
    code_channels: int = 16
    code_size: int = 128
    vector_layers: list[int] = Field([128])
    head_size: int = 0


class Linear(nn.Module):
    def __init__(self, options, shape, vocabularies):
        super().__init__()
        height, width, channels = shape
        self.size = options.size
        self.mix = nn.Linear(height * width * channels, options.size)

    def forward(self, image):
        pixels = image.flatten(1).to(compute_dtype(image)) / 255
        return self.mix(pixels).relu()


NETWORKS.register(LinearOptions, Linear)
