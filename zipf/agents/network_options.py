"""Options of the networks that read observations (`network=`)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from zipf.options import Options, Size


class NetworkOptions(Options):
    """Options that all networks have.

    `code_channels` is the size of a code's embedding, `code_size` that of the dense layer over all
    of them; `vector_layers` are the layers of the MLP for vectors; `head_size` is the hidden layer
    of policy and value, 0 for linear heads.
    """

    name: str
    code_channels: Size
    code_size: Size
    vector_layers: Annotated[list[Size], Field(min_length=1)]
    head_size: Annotated[int, Field(ge=0)]


class ResNetOptions(NetworkOptions):
    """The paper's image encoder (its architecture table)."""

    name: Literal["resnet"]
    channels: Annotated[list[Size], Field(min_length=1)]
    blocks: Annotated[int, Field(ge=0)]


class CompactOptions(NetworkOptions):
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


class ShallowOptions(NetworkOptions):
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

    @field_validator("kernels", "strides")
    @classmethod
    def _as_many(cls, numbers: list[int], info: ValidationInfo) -> list[int]:
        """Every convolution has channels, a kernel and a stride."""
        if len(numbers) != len(info.data.get("channels", numbers)):
            raise ValueError("should have as many numbers as network.channels")
        return numbers


class InstructedOptions(ShallowOptions):
    """Options of networks that read images by an instruction."""


class FiLMOptions(InstructedOptions):
    """As shallow, and the instruction scales and shifts the channels of every convolution."""

    name: Literal["film"]  # type: ignore[assignment]


class AttentionOptions(InstructedOptions):
    """As shallow, and the instruction attends to places of the image: `heads` heads, whose keys
    have `key_size` numbers."""

    name: Literal["attention"]  # type: ignore[assignment]
    heads: Size
    key_size: Size


class MatchingOptions(InstructedOptions):
    """As shallow, and places of the image are matched with the instruction.

    `match_channels`, `match_kernels` and `match_strides` are those of the convolutions whose keys
    are matched (None: kernels and strides of the others); one of 3 x 3 follows. Keys and queries
    have `key_size` numbers. With `matcher` "fixed" the matcher stays as it begins, the words that
    it reads included. Without `remember_instruction` the memory does not read the instruction: the
    matcher alone does.
    """

    name: Literal["matching"]  # type: ignore[assignment]
    match_channels: Annotated[list[Size], Field(min_length=1)]
    match_kernels: list[Size] | None = Field(default=None, validate_default=True)
    match_strides: list[Size] | None = Field(default=None, validate_default=True)
    key_size: Size
    matcher: Literal["learned", "fixed"] = "learned"
    remember_instruction: bool = True

    @field_validator("match_kernels", "match_strides")
    @classmethod
    def _as_many_matched(cls, numbers: list[int] | None, info: ValidationInfo) -> list[int] | None:
        matched = info.data.get("match_channels", ())
        others = info.data.get("channels", ())
        if len(matched) != len(others if numbers is None else numbers):
            raise ValueError("should have as many numbers as network.match_channels")
        return numbers
