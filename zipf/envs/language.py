"""Closed vocabularies: instructions as sequences of whole words, padded to a fixed length."""

from collections.abc import Iterable

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

PADDING = 0


class Vocabulary:
    """The words that a family's instructions are made of.

        vocabulary = Vocabulary(["lift", "a", "duck"], length=4)
        vocabulary.encode("lift a duck")  # array([1, 2, 3, 0])

    A word's code is its place in `words`, counted from 1; 0 is padding.
    Raises ValueError for a word that is there twice, or is none (empty, or with white space).

    Args:
        words: in an order that never changes, since trained networks depend on it.
        length: codes of an encoded text.

    Attributes:
        size: how many codes there are, padding included.
    """

    def __init__(self, words: Iterable[str], length: int) -> None:
        self.words = tuple(words)
        self.length = length
        self.size = len(self.words) + 1
        self._codes = {word: code for code, word in enumerate(self.words, PADDING + 1)}
        if len(self._codes) < len(self.words):
            twice = sorted({word for word in self.words if self.words.count(word) > 1})
            raise ValueError(f"a vocabulary has every word once, got {', '.join(twice)} twice")
        if wrong := [word for word in self.words if word.split() != [word]]:
            raise ValueError(f"words are not empty and hold no white space, got {wrong}")

    def encode(self, text: str) -> NDArray[np.int64]:
        """Codes of the words of a text, int64 [length], 0 behind the last one.
        Raises ValueError for an unknown word, or more words than `length`."""
        words = text.split()
        if unknown := [word for word in words if word not in self._codes]:
            raise ValueError(f"unknown word {', '.join(map(repr, unknown))} in {text!r}")
        if len(words) > self.length:
            raise ValueError(f"{text!r} has {len(words)} words: at most {self.length} are encoded")
        codes = np.full(self.length, PADDING, dtype=np.int64)
        codes[: len(words)] = [self._codes[word] for word in words]
        return codes

    def decode(self, codes: ArrayLike) -> str:
        """The text that was encoded, its words one space apart.
        Raises ValueError for a code out of range."""
        codes = np.asarray(codes)
        if (codes < 0).any() or (codes >= self.size).any():
            raise ValueError(f"codes must be in 0 .. {self.size - 1}, got {codes.tolist()}")
        return " ".join(self.words[code - 1] for code in codes.tolist() if code != PADDING)

    def space(self) -> spaces.Box:
        """What `encode` returns, as part of an observation space."""
        return spaces.Box(0, self.size - 1, (self.length,), dtype=np.int64)
