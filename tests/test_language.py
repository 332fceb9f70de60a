"""Vocabularies: what is encoded can be read again, and what cannot be encoded is named."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from zipf.envs.language import Vocabulary

WORDS = ("lift", "a", "duck", "put", "on", "bed")
VOCABULARY = Vocabulary(WORDS, length=8)


def test_codes_count_from_one_and_zero_is_padding() -> None:
    codes = VOCABULARY.encode("put a duck on a bed")
    np.testing.assert_array_equal(codes, [4, 2, 3, 5, 2, 6, 0, 0])
    assert codes.dtype == np.int64
    np.testing.assert_array_equal(VOCABULARY.encode(""), np.zeros(8))
    assert VOCABULARY.size == 7


@given(st.lists(st.sampled_from(WORDS), max_size=8))
def test_a_text_survives(words: list[str]) -> None:
    text = " ".join(words)
    codes = VOCABULARY.encode(text)
    assert VOCABULARY.decode(codes) == text
    assert codes in VOCABULARY.space()


def test_the_space_holds_every_code_and_no_other() -> None:
    space = VOCABULARY.space()
    assert space.shape == (8,)
    assert space.dtype == np.int64
    assert np.full(8, 6) in space
    assert np.full(8, 7) not in space
    assert np.full(8, -1) not in space


def test_what_cannot_be_encoded_is_named() -> None:
    with pytest.raises(ValueError, match="unknown word 'goose' in 'lift a goose'"):
        VOCABULARY.encode("lift a goose")
    with pytest.raises(ValueError, match="9 words: at most 8"):
        VOCABULARY.encode("a " * 9)
    with pytest.raises(ValueError, match=r"in 0 \.\. 6"):
        VOCABULARY.decode([1, 7])
    with pytest.raises(ValueError, match="duck twice"):
        Vocabulary(["duck", "a", "duck"], length=2)
    with pytest.raises(ValueError, match="no white space"):
        Vocabulary(["a duck"], length=2)
