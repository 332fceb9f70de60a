"""The count bonus against a dictionary of visits."""

from collections import Counter

import numpy as np

from zipf.agents.exploration import CountBonus, CountOptions

OPTIONS = CountOptions(name="count", scale=0.3, table_size=2**20)


def test_the_bonus_equals_counting_visits():
    rng = np.random.default_rng(0)
    bonus, visits = CountBonus(OPTIONS), Counter()
    for _ in range(50):
        image = rng.integers(3, size=(8, 5, 3), dtype=np.uint8) * (rng.random((8, 1, 1)) < 0.5)
        instruction = rng.integers(2, size=(8, 2))
        mask = rng.random(8) < 0.7
        result = bonus({"image": image, "instruction": instruction}, mask)
        assert result.dtype == np.float32
        for i in range(8):
            expected = 0.0
            if mask[i]:
                key = image[i].tobytes(), instruction[i].tobytes()
                visits[key] += 1
                expected = 0.3 / np.sqrt(visits[key])
            np.testing.assert_allclose(result[i], expected, rtol=1e-6)
    assert max(visits.values()) > 3


def test_state_dict_continues_bit_for_bit():
    image = {"image": np.arange(12, dtype=np.uint8).reshape(4, 3)}
    mask = np.ones(4, np.bool_)
    one, other = CountBonus(OPTIONS), CountBonus(OPTIONS)
    one(image, mask)
    other.load_state_dict(one.state_dict())
    np.testing.assert_array_equal(other(image, mask), np.float32(0.3 / np.sqrt(2)))
