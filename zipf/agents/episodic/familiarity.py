"""Momentum Boosted Episodic Memory: unfamiliar rows are kept for longer.

After Fernandes, Kaushik, Shukla and Bapi, "Momentum Boosted Episodic Memory for Improving Learning
in Long-Tailed RL Environments" (Deep RL workshop 2022, arXiv 2504.05840). We know the abstract and
summaries of the method, not its equations, sizes or code. By these it adds to IMPALA

- a circular *familiarity buffer* of frames with the image, a key, the embedding p of the image by
  IMPALA's encoder, and the LSTM's hidden state;
- the contrastive loss NT-Xent between p and the embedding of the same image with Gaussian noise and
  a random cutout, learned from for some epochs over the buffer;
- for each frame a *momentum loss*, the moving average of its loss over the epochs, of Boosted
  Contrastive Learning (Zhou et al. 2022): what is rare is learned later, so its loss stays high;
- an episodic memory in which frames of a high momentum loss are kept longer, and from which the
  hidden states of the nearest keys are reinstated, weighted by similarity.

That is what is here. The momentum is that of the loss: no momentum encoder is spoken of. Our
reading, where we know of no text:

- The buffer has one row of every episode rather than all frames (`zipf.agents.episodic.recorder`).
- Epochs and collection are not in turns: every update learns from `batch` rows, in the order of the
  buffer, beginning again at its end. The loss is added to the agent's, with a weight.
- When a new row replaces a row of the buffer, the old row is offered to the dictionary. Its
  priority is the number of the update plus `longer` times the fraction of the buffer's rows with a
  lower momentum loss. Ranks are used because losses fall as the encoder learns. Rows that no update
  learned from yet are dropped.
- Rows whose images differ nowhere by more than two noisy copies of one image would are not each
  other's negatives. What is frequent is several times in a batch; as a negative of itself its loss
  would be the highest, and the dictionary would keep what is frequent. `tests/test_episodic.py`
  shows both.
- What is reinstated is added behind the memory (`zipf.agents.episodic.dictionary`).

Left out: a memory of trajectories, of which the abstract of 2025 speaks.
"""

from __future__ import annotations

import gymnasium as gym
import torch
import torch.nn.functional as F
from torch import Tensor

from zipf.agents.encoders import Encoder, has_image
from zipf.agents.episodic.dictionary import Dictionary
from zipf.agents.episodic.options import DictionaryOptions, MemOptions, NoEpisodicOptions
from zipf.agents.episodic.recorder import DictionaryRecorder, Recorder, Rows
from zipf.agents.unroll import no_observations
from zipf.registry import Registry

BLOCK = 8
"""Pixels, the sides of the blocks that images are compared in. Ours: objects are that small."""


class MemRecorder(DictionaryRecorder):
    """Rows stay in the familiarity buffer first; see `DictionaryRecorder` for the arguments.
    Raises ValueError: the observations have no image."""

    options: MemOptions
    cores: Tensor
    values: Tensor
    losses: Tensor
    learned_from: Tensor
    place: Tensor
    filled: Tensor
    next: Tensor

    def __init__(
        self,
        options: MemOptions,
        space: gym.spaces.Dict,
        envs: int,
        core_size: int,
        actions: int,
        seed: int,
    ):
        if not has_image(space):
            raise ValueError(
                f"episodic={options.name} needs an image named 'image', and the observations here "
                f"have only {', '.join(sorted(space))}; episodic=dictionary reads whatever the "
                "network does"
            )
        super().__init__(options, envs, core_size, actions, seed, no_observations(space, envs))
        size = options.familiarity_capacity
        value_size = core_size + 2 * actions * options.outcome
        self.register_buffer("cores", torch.zeros(size, core_size))
        self.register_buffer("values", torch.zeros(size, value_size))
        self.register_buffer("losses", torch.zeros(size))  # momentum losses
        self.register_buffer("learned_from", torch.zeros(size, dtype=torch.bool))
        for name in ("place", "filled", "next"):  # of the next row; of rows; of the next batch
            self.register_buffer(name, torch.zeros((), dtype=torch.int64))
        self._register("buffer", no_observations(space, size))
        self._latest: tuple[Tensor, Tensor] | None = None  # rows that were learned from, and losses

    def forward(self, encoder: Encoder) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted `episodic_contrastive`, a mean over rows; 0 while there is one."""
        o = self.options
        filled = int(self.filled)
        self._latest = None
        loss = torch.zeros((), device=self.core.device)
        if filled >= 2:
            rows = int(self.next) + torch.arange(min(o.batch, filled), device=self.core.device)
            rows %= filled
            seen = {name: part[rows] for name, part in self._registered("buffer").items()}
            changed = augment(seen["image"], o.noise, o.cutout, self.generator())
            both = {name: torch.cat([part, part]) for name, part in seen.items()}
            both["image"] = torch.cat([seen["image"], changed])
            same = alike(seen["image"], o.noise)
            embedded, embedded_copies = encoder(both).float().chunk(2)
            losses = contrastive_losses(embedded, embedded_copies, same, o.temperature)
            self._latest = rows, losses.detach()
            loss = losses.mean()
        return o.weight * loss, {"episodic_contrastive": loss.detach()}

    def write(self, dictionary: Dictionary, rows: Rows) -> None:
        """Updates momentum losses, puts rows into the buffer, and offers the dictionary those that
        make place for them."""
        if self._latest is not None:
            learned, losses = self._latest
            beta = self.options.loss_momentum
            old = torch.where(self.learned_from[learned], self.losses[learned], losses)
            self.losses[learned] = beta * old + (1 - beta) * losses
            self.learned_from[learned] = True
            self.next.copy_((learned[-1] + 1) % self.filled)
        size = self.options.familiarity_capacity
        rows = Rows(
            rows.cores[-size:],
            rows.values[-size:],
            {name: part[-size:] for name, part in rows.observations.items()},
        )
        count = len(rows.cores)
        places = (self.place + torch.arange(count, device=self.place.device)) % size
        leaves = places[self.learned_from[places]]
        priorities = self.updates + self.options.longer * self.unfamiliarity(leaves)
        dictionary.write(self.cores[leaves], self.values[leaves], priorities)
        self.cores[places] = rows.cores
        self.values[places] = rows.values
        for name, buffer in self._registered("buffer").items():
            buffer[places] = rows.observations[name]
        self.learned_from[places] = False
        self.place.copy_((self.place + count) % size)
        self.filled.copy_((self.filled + count).clamp(max=size))

    def unfamiliarity(self, rows: Tensor) -> Tensor:
        """The share of the rows that were learned from whose momentum loss is lower: float64 [N] in
        [0, 1), for rows int64 [N] among them."""
        known = self.losses[self.learned_from].sort().values
        lower = torch.searchsorted(known, self.losses[rows])
        return lower.double() / max(len(known), 1)


def contrastive_losses(
    embedded: Tensor, changed: Tensor, same: Tensor, temperature: float
) -> Tensor:
    """NT-Xent of each row (Chen et al. 2020, from the images to their changed copies): float32 [N].

    -log exp(s_ii / temperature) / sum_k exp(s_ik / temperature), s_ik the cosine of embedding i and
    of changed copy k, where k leaves out the rows that are the `same` as row i, bool [N, N]. In
    float32 under autocast, too.
    """
    with torch.autocast(embedded.device.type, enabled=False):
        scores = F.normalize(embedded, dim=-1) @ F.normalize(changed, dim=-1).T / temperature
    rows = torch.arange(len(scores), device=scores.device)
    others = same & (rows != rows[:, None])
    return F.cross_entropy(scores.masked_fill(others, -torch.inf), rows, reduction="none")


def alike(image: Tensor, noise: float) -> Tensor:
    """Which images, uint8 [N, H, W, C], could be noisy copies of one image: bool [N, N], True where
    in every block of 8 x 8 pixels the mean squared difference is at most what two copies with noise
    of this standard deviation are expected to have.

    In the mean over the whole image, two goals of an env would often be the same: they may differ
    in few pixels. In float32 under autocast, too: bfloat16 rounds by more than such a difference.
    """
    rows, columns = (_blocks(size, image.device) for size in image.shape[1:3])
    pixels = image[:, rows][:, :, :, columns].float() / 255  # [N, blocks, 8, blocks, 8, C]
    blocks = pixels.permute(1, 3, 0, 2, 4, 5).flatten(3).flatten(0, 1)  # [blocks, N, pixels]
    size = blocks.square().mean(2)
    with torch.autocast(image.device.type, enabled=False):
        products = blocks @ blocks.mT / blocks.shape[2]
    difference = size[:, :, None] + size[:, None] - 2 * products
    return (difference <= 2 * noise**2 + 1e-6).all(0)  # beside rounding


def _blocks(size: int, device: torch.device) -> Tensor:
    """The pixels of a row of blocks that cover an image's side, and overlap where they have to:
    int64 [blocks, 8]; of a smaller image, [1, size]."""
    side, count = min(BLOCK, size), -(-size // BLOCK)
    starts = torch.arange(count, device=device) * (size - side) // max(count - 1, 1)
    return starts[:, None] + torch.arange(side, device=device)


def augment(image: Tensor, noise: float, cutout: float, generator: torch.Generator) -> Tensor:
    """Gaussian noise, and a grey square cut out at random (DeVries and Taylor 2017), whose centre
    is anywhere in the image, uint8 [N, H, W, C]. `noise` is its standard deviation, as a share of
    the range of pixels, `cutout` the square's sides, as a share of the image's."""
    n, height, width, _ = image.shape
    normal = torch.randn(image.shape, generator=generator).to(image.device)
    noisy = (image + 255 * noise * normal).round().clamp(0, 255).to(torch.uint8)
    centres = torch.rand(2, n, 1, generator=generator).to(image.device)

    def covered(centre: Tensor, pixels: int) -> Tensor:
        place = (torch.arange(pixels, device=image.device) + 0.5) / pixels
        return (place - centre).abs() < cutout / 2

    rows, columns = covered(centres[0], height), covered(centres[1], width)
    return noisy.masked_fill((rows[:, :, None] & columns[:, None, :]).unsqueeze(-1), 128)


RECORDERS: Registry[Recorder] = Registry("episodic")
"""Each is built from its options, the space of observations, B of the unrolls, the size of the
memory's outputs, the number of actions, and the seed of its draws; it raises ValueError where the
observations lack what it needs."""
build_recorder = RECORDERS.build

RECORDERS.register(NoEpisodicOptions, lambda options, *others: Recorder())
RECORDERS.register(
    DictionaryOptions, lambda options, space, *others: DictionaryRecorder(options, *others)
)
RECORDERS.register(MemOptions, MemRecorder)
