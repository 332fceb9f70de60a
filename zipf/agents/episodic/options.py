"""Options of episodic memory; `configs/episodic.yaml` has the sources of their values."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from zipf.options import BelowOne, NotNegative, Options, Positive, Share

Size = Annotated[int, Field(ge=1, le=2**16)]  # ours: far more than was ever tried
Rows = Annotated[int, Field(ge=1, le=2**20)]  # ours: a gigabyte of the compact network's values


class NoEpisodicOptions(Options):
    """No episodic memory."""

    name: Literal["none"]


class DictionarySizes(Options):
    """Options of the dictionary itself.

    `capacity` rows, of which a look-up reads the `neighbours` nearest by keys of `key_size`
    numbers; `kernel_delta` is the delta of the inverse-distance kernel. With `outcome` a value
    holds, beside the memory's output, the action and the return that followed, discounted by
    `discount`.
    """

    name: str
    capacity: Rows
    neighbours: Size
    key_size: Size
    kernel_delta: Positive
    outcome: bool
    discount: Share


class DictionaryOptions(DictionarySizes):
    """The latest rows."""

    name: Literal["dictionary"]


class MemOptions(DictionarySizes):
    """Unfamiliar rows are kept for longer.

    Rows are in a buffer of `familiarity_capacity` first. Every update a contrastive loss with that
    `temperature` and `weight` learns from `batch` of them, against copies with Gaussian noise (of
    `noise` times the range of pixels) and a square cut out (of `cutout` times the sides).
    `loss_momentum` is that of each row's loss. `longer` is how many updates longer the least
    familiar row stays in the dictionary than the most familiar one.
    """

    name: Literal["mem"]
    familiarity_capacity: Size
    batch: Annotated[int, Field(ge=2, le=2**16)]
    weight: NotNegative
    temperature: Positive
    noise: NotNegative
    cutout: Share
    loss_momentum: BelowOne
    longer: NotNegative


EpisodicOptions = NoEpisodicOptions | DictionarySizes
NO_EPISODIC = NoEpisodicOptions(name="none")
