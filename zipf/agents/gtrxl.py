"""GTrXL (Parisotto et al. 2020): a gated Transformer-XL as a memory, top to bottom.

Layer l reads the stream x [T, B, D] of the layer below it and updates it twice, each time through a
gate that is near the identity at first, so that an agent can learn to react before it learns to
remember:

    y = ReLU(attention(norm(x)));  x <- gate(x, y);  z = ReLU(mlp(norm(x)));  x <- gate(x, z)

A frame attends to itself and to the `memory_length` frames before it, as far back as its episode
goes; each layer reaches as much further back as the one below it, `layers` x `memory_length` frames
in all. Frames are told apart by their distance (Dai et al. 2019, Transformer-XL).

The state holds the keys and values of the last `memory_length` frames, so that acting computes
only those of the current frame. Transformer-XL holds the layer's inputs instead and projects them
anew in every segment: the gradient stops at these inputs, but reaches the projections of keys and
values. Here the projections learn from the frames of the unroll alone, and the keys and values in
the state are those of older weights: for an actor-critic, of the update before or so; for R2D2, of
when the sequence was played, except for those of the `burn_in` frames before it.
"""

from __future__ import annotations

from typing import Literal

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from zipf.options import NotNegative, Options, Size


class GTrXLOptions(Options):
    """The options; `configs/memory.yaml` has the sources of their values.

    `size` is the Transformer's d_model. The state of an env takes 8 x layers x memory_length x
    size bytes.
    """

    name: Literal["gtrxl"]
    size: Size
    layers: Size
    heads: Size
    memory_length: Size
    mlp_size: Size
    gate_bias: NotNegative


class GTrXLMemory(nn.Module):
    """The memory: layers of gated attention over the frames of the episode.
    Raises ValueError: the heads do not divide the size."""

    def __init__(self, inputs: int, options: GTrXLOptions):
        super().__init__()
        if options.size % options.heads:
            raise ValueError(
                f"memory.heads={options.heads} do not divide memory.size={options.size}; every "
                "head has an equal share of it"
            )
        self.size = options.size
        self.heads = options.heads
        self.memory_length = options.memory_length
        self.embed = nn.Linear(inputs, options.size)
        self.layers = nn.ModuleList(Layer(options) for _ in range(options.layers))
        distances = sinusoids(options.memory_length + 1, options.size)
        self.register_buffer("distances", distances, persistent=False)

    def initial_state(self, batch: int) -> dict[str, Tensor]:
        """Zeros: an empty memory.

        length: int64 [B], the frames of the current episode that are remembered.
        layer0, layer1, ...: float32 [B, heads, memory_length, 2 x size / heads], their keys and
            values side by side, the latest last.
        """
        device = self.embed.weight.device
        shape = batch, self.heads, self.memory_length, 2 * self.size // self.heads
        state = {f"layer{i}": torch.zeros(shape, device=device) for i in range(len(self.layers))}
        return {"length": torch.zeros(batch, dtype=torch.int64, device=device)} | state

    def forward(
        self, inputs: Tensor, is_first: Tensor, state: dict[str, Tensor]
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """`[T, B, inputs]`, `[T, B]` -> `[T, B, size]` and the state after the last frame.
        Gradients do not reach the state, neither before nor after."""
        steps = len(inputs)
        time = torch.arange(steps, device=is_first.device)
        begins = torch.where(is_first, time[:, None], -state["length"]).cummax(0).values
        age = time[:, None] - begins  # of each frame, in frames since its episode began
        places = torch.arange(-self.memory_length, steps, device=is_first.device)
        distance = time[:, None] - places  # [T, memory_length + T]
        furthest = age.clamp(max=self.memory_length).T[:, None, :, None]
        unseen = (distance < 0) | (distance > furthest)  # [B, 1, T, memory_length + T]

        after = {"length": (age[-1] + 1).clamp(max=self.memory_length)}
        # Under autocast the stream stays float32, as weights do: bfloat16 would lose small changes.
        stream = self.embed(inputs.transpose(0, 1)).float()
        for i, layer in enumerate(self.layers):
            stream, after[f"layer{i}"] = layer(stream, state[f"layer{i}"], self.distances, unseen)
        return stream.transpose(0, 1), after


class Layer(nn.Module):
    """Attention and a two-layer perceptron, each with layer norm before, ReLU and gate after.

    The parameters are Transformer-XL's, each layer's its own: W_q, W_k and W_v in `project`, W_k,R
    in `project_distances`, u in `content_bias`, v in `distance_bias`.
    """

    def __init__(self, options: GTrXLOptions):
        super().__init__()
        size, self.heads = options.size, options.heads
        self.norm = nn.LayerNorm(size)
        self.project = nn.Linear(size, 3 * size, bias=False)
        self.project_distances = nn.Linear(size, size, bias=False)
        self.content_bias = nn.Parameter(torch.zeros(self.heads, 1, size // self.heads))
        self.distance_bias = nn.Parameter(torch.zeros(self.heads, 1, size // self.heads))
        self.mix = nn.Linear(size, size, bias=False)
        self.attention_gate = Gate(size, options.gate_bias)
        self.mlp = nn.Sequential(
            nn.LayerNorm(size),
            nn.Linear(size, options.mlp_size),
            nn.ReLU(),
            nn.Linear(options.mlp_size, size),
            nn.ReLU(),
        )
        self.mlp_gate = Gate(size, options.gate_bias)

    def forward(
        self, stream: Tensor, memory: Tensor, distances: Tensor, unseen: Tensor
    ) -> tuple[Tensor, Tensor]:
        """The stream [B, T, size] and the memory that comes after, in the memory's shape."""
        attended, memory = self.attend(self.norm(stream), memory, distances, unseen)
        stream = self.attention_gate(stream, attended.relu())
        return self.mlp_gate(stream, self.mlp(stream)), memory

    def attend(
        self, stream: Tensor, memory: Tensor, distances: Tensor, unseen: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Attention over memory and stream (Dai et al. 2019, section 3.3):
        score = (q . k + q . r + u . k + v . r) / sqrt(size / heads), r of the distance"""
        head_size = stream.shape[-1] // self.heads
        projected = self.project(stream).unflatten(-1, (self.heads, -1)).transpose(1, 2)
        query, latest = projected.split([head_size, 2 * head_size], -1)
        frames = torch.cat([memory, latest], 2)  # float32 [B, heads, memory_length + T, ...]
        key, value = frames.chunk(2, -1)
        distance_key = self.project_distances(distances).unflatten(-1, (self.heads, -1))

        by_content = (query + self.content_bias) @ key.transpose(-1, -2)
        by_distance = torch.einsum("bhtd,phd->bhtp", query + self.distance_bias, distance_key)
        scores = (by_content + align(by_distance)) * head_size**-0.5
        weights = scores.masked_fill(unseen, -torch.inf).softmax(-1, dtype=torch.float32)
        attended = (weights @ value).transpose(1, 2).flatten(2)
        return self.mix(attended), frames[:, :, -memory.shape[2] :].detach()


class Gate(nn.Module):
    """A GRU's update of x by y (Parisotto et al. 2020, section 3.2); the larger the initial bias,
    the closer to the identity of x."""

    def __init__(self, size: int, bias: float):
        super().__init__()
        self.of_y = nn.Linear(size, 3 * size, bias=False)  # W_r, W_z, W_g
        self.of_x = nn.Linear(size, 2 * size, bias=False)  # U_r, U_z
        self.of_reset_x = nn.Linear(size, size, bias=False)  # U_g
        self.bias = nn.Parameter(torch.full((size,), bias))  # b_g

    def forward(self, x: Tensor, y: Tensor) -> Tensor:
        y_reset, y_update, y_candidate = self.of_y(y).chunk(3, -1)
        x_reset, x_update = self.of_x(x).chunk(2, -1)
        reset = (y_reset + x_reset).sigmoid()
        update = (y_update + x_update - self.bias).sigmoid()
        candidate = (y_candidate + self.of_reset_x(reset * x)).tanh()
        return (1 - update) * x + update * candidate


def sinusoids(distances: int, size: int) -> Tensor:
    """Sines and cosines of the distances (Vaswani et al. 2017), the furthest first.
    Returns float32 [distances, size], rows for the distances `distances` - 1, ..., 1, 0."""
    frequencies = 10_000.0 ** -(torch.arange(0, size, 2) / size)
    angles = torch.arange(distances - 1, -1, -1)[:, None] * frequencies
    return torch.cat([angles.sin(), angles.cos()], -1)[:, :size]


def align(scores: Tensor) -> Tensor:
    """Scores by distance as scores by frame (Dai et al. 2019, appendix B).

    [..., T, M + 1], the furthest distance, M, first -> [..., T, M + T]: row i is shifted i to the
    right; entries that have no score are 0.
    """
    steps, distances = scores.shape[-2:]
    width = distances + steps - 1
    # Padded by T and read as rows that are one shorter, each row starts one further right.
    padded = F.pad(scores, (0, steps)).flatten(-2)
    return padded[..., : steps * width].unflatten(-1, (steps, width))
