"""The observations of Gymnasium environments as parts that agents read."""

import hashlib
import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from zipf.envs.arguments import whole
from zipf.envs.errors import EnvError

SMALLEST_SIDE = 7  # ours: of an image; MiniGrid's are 7 x 7
MOST_CHANNELS = 16  # ours: of an image whose axes are not given
LARGEST_VOCABULARY = 2**16  # beyond that agents take whole numbers for quantities


@dataclass(frozen=True)
class Words:
    """Texts as codes of their words, by a hash.

    Attributes:
        length: codes of a text.
        size: number of different codes, 0 included.
        cut: whether longer texts are cut.

    Raises:
        ValueError: `length` is below 1, or `size` not in 2 .. 65536.
    """

    length: int
    size: int
    cut: bool = False

    def __post_init__(self) -> None:
        whole("text_length", self.length, 1)
        whole("vocabulary", self.size, 2, LARGEST_VOCABULARY)

    def space(self) -> spaces.Box:
        """The space of `encode`, that of an instruction in the benchmark's families."""
        return spaces.Box(0, self.size - 1, (self.length,), dtype=np.int64)

    def encode(self, text: str) -> NDArray[np.int64]:
        """The codes of a text's words, int64 [length], 0 after the last one.

        Raises:
            ValueError: the text has more words than `length`, and is not to be cut.
        """
        return _encoded(text, self.length, self.size, self.cut)


@lru_cache(maxsize=4096)
def _encoded(text: str, length: int, size: int, cut: bool) -> NDArray[np.int64]:
    words = re.findall(r"\w+|[^\w\s]", text.lower())
    if len(words) > length and not cut:
        raise ValueError(
            f"{text!r} has {len(words)} words, more than text_length={length}: give a larger one, "
            "or cut_texts=True, which leaves out the words after it and with which a run goes on "
            "from its checkpoint"
        )
    hashes = [hashlib.blake2b(word.encode(), digest_size=8).digest() for word in words[:length]]
    codes = np.zeros(length, np.int64)
    codes[: len(hashes)] = [1 + int.from_bytes(one, "little") % (size - 1) for one in hashes]
    codes.flags.writeable = False  # it is given out again
    return codes


@dataclass(frozen=True)
class Part:
    """A part of an environment's observation.

    Attributes:
        id: of the environment.
        name: of the part, as agents see it.
        path: the keys and indices that lead to it in the environment's observation.
        space: its space, as agents see it.
        given: its space, as the environment gives it.
        start: subtracted from what the environment gives, None for 0.
        codes: how many codes its values are, None where they are not checked.
        words: for texts.
        order: for images whose channels are not last, the axes in the order of `space`.
        scale: what the environment gives is multiplied by it.
    """

    id: str
    name: str
    path: tuple[Any, ...]
    space: spaces.Space
    given: spaces.Space
    start: Any = None
    codes: int | None = None
    words: Words | None = None
    order: tuple[int, ...] | None = None
    scale: int = 1

    @cached_property
    def shape(self) -> tuple[int, ...]:
        """What the environment gives."""
        return self.given.shape or ()

    @cached_property
    def _is_reshaped(self) -> bool:
        return self.words is None and self.shape != self.space.shape

    @cached_property
    def bounds(self) -> tuple[Any, Any] | None:
        """The least and the greatest whole number that the environment may give, scalars or of the
        space's shape. None: of floats."""
        given = self.given
        if self.codes is not None:
            return 0, self.codes - 1
        if isinstance(given, spaces.Discrete):
            return given.start, given.start + given.n - 1
        if isinstance(given, spaces.MultiDiscrete):
            return given.start, given.start + given.nvec - 1
        if isinstance(given, spaces.Box):
            return None if given.dtype.kind == "f" else (given.low, given.high)
        return 0, 1

    @cached_property
    def _in_bounds(self) -> np.dtype[Any] | None:
        """The dtype whose values are all in the bounds, as those of most images; None: there is
        none."""
        dtype = self.given.dtype
        if self.bounds is None or dtype is None or dtype.kind not in "iu":
            return None
        low, high = self.bounds
        limits = np.iinfo(dtype)
        whole = (low == limits.min) & (high == limits.max)
        return dtype if np.all(whole) else None

    def read(self, observation: Any) -> NDArray[Any]:
        """The part of an observation of the environment, in the shape of `space`.

        Raises:
            EnvError: there is no such part, or it is of another shape, has values that the space
                does not have, or too many words.
        """
        for key in self.path:
            try:
                observation = observation[key]
            except (LookupError, TypeError):
                raise EnvError(
                    f"{self.id}: an observation lacks {self.name!r}, which its observation space "
                    f"has; it is {short(observation)}"
                ) from None
        if self.words is not None:
            return self.read_text(observation)
        try:
            value = np.asarray(observation)
        except (TypeError, ValueError, RuntimeError) as error:  # ragged lists, tensors on a GPU
            raise EnvError(
                f"{self.id}: observation {self.name!r} is {short(observation)}, which is no array "
                f"({short(error)})"
            ) from None
        if value.shape != self.shape:
            raise EnvError(
                f"{self.id}: observation {self.name!r} has shape {value.shape}, its space "
                f"{self.shape}"
            )
        if self._in_bounds is None or value.dtype != self._in_bounds:
            self._check(value)
        if self.start is not None:
            value = value - self.start
        if self.order is not None:
            value = value.transpose(self.order)
        if self._is_reshaped:
            value = value.reshape(self.space.shape or ())
        return value if self.scale == 1 else value * self.scale

    def read_text(self, text: Any) -> NDArray[np.int64]:
        """The codes of a text. Raises EnvError as `read`."""
        assert self.words is not None
        if not isinstance(text, str):
            raise EnvError(
                f"{self.id}: observation {self.name!r} is {short(text)}, which is no text"
            )
        try:
            return self.words.encode(text)
        except ValueError as error:
            raise EnvError(f"{self.id}: observation {self.name!r}: {error}") from None

    def _check(self, value: NDArray[Any]) -> None:
        """Raises EnvError for values that cannot be kept in `space` as they are, but for floats
        that are rounded."""
        if value.dtype.kind not in "biuf":
            raise self._error(value, "no number")
        if self.bounds is None:
            return
        low, high = self.bounds
        inside = (value >= low) & (value <= high)
        if not inside.all():
            raise self._error(value[~inside], "out of range")
        if value.dtype.kind == "f":
            whole = value.astype(self.given.dtype) == value
            if not whole.all():
                raise self._error(value[~whole], "no whole number")

    def _error(self, wrong: NDArray[Any], what: str) -> EnvError:
        """About the first of these values."""
        if self.codes is not None:
            space = f"codes says {self.codes}: whole numbers in 0 .. {self.codes - 1}"
        else:
            space = f"its space is {short(self.given)}"
        return EnvError(
            f"{self.id}: observation {self.name!r} has the value {wrong.flat[0]}, {what}: {space}"
        )


def short(value: Any) -> str:
    """A value in one line."""
    text = str(value) if isinstance(value, spaces.Space | Exception) else repr(value)
    return textwrap.shorten(text, 200, placeholder=" ...")


@dataclass(frozen=True)
class Reading:
    """How the parts of an observation are read: arguments of `GymnasiumVectorEnv`."""

    codes: Mapping[str, int]
    image_axes: Mapping[str, str | None]
    words: Words


def parts_of(id: str, space: spaces.Space, reading: Reading) -> tuple[Part, ...]:
    """The parts of an observation space.

    Raises:
        ValueError: one of them cannot be read, or `reading` is of parts that there are not.
    """
    name = ""
    if not isinstance(space, spaces.Dict):
        shape = space.shape or ()
        picture = isinstance(space, spaces.Box) and space.dtype == np.uint8
        name = "image" if picture and len(shape) == 3 and shape[2] == 3 else "observation"
    parts = tuple(_flattened(id, space, name, (), reading))
    names = [part.name for part in parts]
    if not names:
        raise ValueError(f"{id}: the observations are {space}: there is nothing to read")
    for option in ("codes", "image_axes"):
        if unknown := getattr(reading, option).keys() - set(names):
            raise ValueError(
                f"{id} has no observation {sorted(unknown)} for {option}, only {names}"
            )
    if both := reading.codes.keys() & reading.image_axes.keys():
        raise ValueError(f"{id}: {sorted(both)} cannot be both codes and an image: choose one")
    if len(set(names)) < len(names):
        raise ValueError(f"{id} has two observations of the same name: {names}")
    return parts


_KEPT: Mapping[Any, np.dtype[Any]] = {
    np.dtype(np.uint16): np.dtype(np.int32),
    np.dtype(np.uint32): np.dtype(np.int64),
    np.dtype(np.uint64): np.dtype(np.int64),
    np.dtype(np.longdouble): np.dtype(np.float64),
}
"""PyTorch does not calculate with the former."""


def _flattened(
    id: str, space: spaces.Space, name: str, path: tuple[Any, ...], reading: Reading
) -> Iterator[Part]:
    if isinstance(space, spaces.Dict | spaces.Tuple):
        inner = space.items() if isinstance(space, spaces.Dict) else enumerate(space)
        for key, part in inner:
            full = f"{name}.{key}" if name else str(key)
            yield from _flattened(id, part, full, (*path, key), reading)
        return
    if not name.isprintable() or not name:
        raise ValueError(
            f"{id}: an observation is called {name!r}: give the parts names of one line"
        )
    if name in reading.codes:
        yield _coded(id, space, name, path, reading.codes[name])
    elif isinstance(space, spaces.Discrete):
        start = space.start or None
        yield Part(id, name, path, spaces.Discrete(int(space.n)), space, start=start)
    elif isinstance(space, spaces.MultiDiscrete):
        counted = spaces.MultiDiscrete(space.nvec, dtype=_KEPT.get(space.dtype, space.dtype))
        start = space.start if space.start.any() else None
        yield Part(id, name, path, counted, space, start=start)
    elif isinstance(space, spaces.Box):
        yield _boxed(id, space, name, path, reading)
    elif isinstance(space, spaces.MultiBinary):
        yield Part(id, name, path, space, space)
    elif space.dtype is not None and space.dtype.kind == "U":  # Text, and MiniGrid's MissionSpace
        yield Part(id, name, path, reading.words.space(), space, words=reading.words)
    else:
        raise ValueError(
            f"{id}: observation {name!r} is {short(space)}: expected Box, Discrete, "
            "MultiDiscrete, MultiBinary, Text, or a Dict or Tuple of these; give a wrapper that "
            "changes it as `wrap`"
        )


def _coded(id: str, space: spaces.Space, name: str, path: tuple[Any, ...], n: Any) -> Part:
    """A part whose numbers are codes in 0 .. n - 1."""
    number = isinstance(n, int | np.integer) and not isinstance(n, bool) and n >= 1
    integers = isinstance(space, spaces.Box) and np.issubdtype(space.dtype, np.integer)
    if not number or not integers:
        raise ValueError(
            f"codes={{{name!r}: {n!r}}} of {id}: expected a number >= 1, for a Box of "
            f"integers; the observation is {short(space)}"
        )
    coded: spaces.Space = spaces.Discrete(n)
    if space.shape:
        dtype = np.uint8 if n < 256 else np.int64
        coded = spaces.MultiDiscrete(np.full(space.shape, n), dtype=dtype)
    return Part(id, name, path, coded, space, codes=n)


def _boxed(id: str, space: spaces.Box, name: str, path: tuple[Any, ...], reading: Reading) -> Part:
    """An image, or an array of numbers."""
    if not space.low.size:
        raise ValueError(f"{id}: observation {name!r} is {short(space)}, which has no entries")
    if name in reading.image_axes:
        axes = reading.image_axes[name]
        _check_axes(id, space, name, axes)
        if axes is None:  # with one axis nothing takes it for an image
            flat = spaces.Box(space.low.ravel(), space.high.ravel(), dtype=space.dtype.type)
            return Part(id, name, path, flat, space)
    else:
        axes = axes_of(id, space, name)
    if axes is not None:
        return _image(id, space, name, path, axes)
    dtype = _KEPT.get(space.dtype, space.dtype).newbyteorder("=")
    if space.dtype in (np.uint32, np.uint64) and space.high.max() <= np.iinfo(np.int32).max:
        dtype = np.dtype(np.int32)  # int64 would be read as words
    if dtype.kind == "i" and space.high.max() > np.iinfo(dtype).max:
        raise ValueError(
            f"{id}: observation {name!r} is {short(space)}: agents compute with whole numbers up "
            "to 2^63 - 1; give a wrapper that changes it as `wrap`"
        )
    kept = space
    if dtype != space.dtype:
        with np.errstate(over="ignore"):  # bounds that float64 does not have are infinite
            kept = spaces.Box(space.low.astype(dtype), space.high.astype(dtype), dtype=dtype.type)
    return Part(id, name, path, kept, space)


def axes_of(id: str, space: spaces.Box, name: str) -> str | None:
    """What the axes of an image are, such as "HWC"; None for what is no image.

    An image is uint8 or bool with two or three axes, of which two are at least 7 long. Of three
    axes the channels are the first or the last, if that one is the shortest and at most 16 long.
    Bytes from 0 to some number in 2 .. 254 are codes, but for those with 1, 3 or 4 channels last,
    which networks read as an image unless `codes` names them.

    Raises:
        ValueError: it may be an image and its axes are not clear.
    """
    shape = space.shape
    if space.dtype not in (np.uint8, np.bool_) or sum(n >= SMALLEST_SIDE for n in shape) < 2:
        return None
    if space.dtype == np.uint8 and not space.low.any() and 1 < space.high.max() < 255:
        return None
    if len(shape) == 2:
        return "HW"
    first, *_, last = shape
    if len(shape) == 3 and min(shape) <= MOST_CHANNELS and shape.count(min(shape)) == 1:
        if first == min(shape):
            return "CHW"
        if last == min(shape):
            return "HWC"
    raise ValueError(
        f"{id}: observation {name!r} is {space.dtype} {list(shape)}, and which axes are an image's "
        f"is not clear: give image_axes={{{name!r}: {_example(shape)!r}}}, in the order in which "
        f"the axes are height, width and channels, or image_axes={{{name!r}: None}} if it is none"
    )


def _example(shape: tuple[int, ...]) -> str:
    """Axes that it might have: the two longest are height and width."""
    sides = sorted(sorted(range(len(shape)), key=lambda k: (-shape[k], k))[:2])
    return "".join("HW"[sides.index(k)] if k in sides else "C" for k in range(len(shape)))


def _check_axes(id: str, space: spaces.Box, name: str, axes: Any) -> None:
    """Raises ValueError for what cannot be the axes of a part."""
    if axes is None:
        return
    named = isinstance(axes, str) and set(axes) <= set("HWC") and len(axes) == len(space.shape)
    if not named or axes.count("H") != 1 or axes.count("W") != 1:
        raise ValueError(
            f"image_axes={{{name!r}: {axes!r}}} of {id}: expected None or a letter for each axis "
            f"of {list(space.shape)}, H and W once and C for the others, such as "
            f"{_example(space.shape)!r}"
        )
    if space.dtype not in (np.uint8, np.bool_):
        raise ValueError(
            f"image_axes={{{name!r}: {axes!r}}} of {id}: images are uint8 or bool, and this is "
            f"{short(space)}; give a wrapper that changes it as `wrap`"
        )


def _image(id: str, space: spaces.Box, name: str, path: tuple[Any, ...], axes: str) -> Part:
    """An image as agents see it, uint8 [H, W, C]."""
    if axes == "HWC" and space.dtype == np.uint8 and space.high.max() > 1:
        return Part(id, name, path, space, space)
    order = (axes.index("H"), axes.index("W"), *(k for k, axis in enumerate(axes) if axis == "C"))
    height, width = (space.shape[k] for k in order[:2])
    binary = space.dtype == np.bool_ or space.high.max() <= 1
    shape = height, width, space.low.size // (height * width)
    low, high = (bound.transpose(order).reshape(shape) for bound in (space.low, space.high))
    scale = 255 if binary else 1  # 1 is white
    low, high = (bound.astype(np.uint8) * np.uint8(scale) for bound in (low, high))
    seen = spaces.Box(low, high, dtype=np.uint8)
    return Part(id, name, path, seen, space, order=order, scale=scale)
