"""The bonuses that count, against dictionaries and sets of visits."""

from collections import Counter

import numpy as np

from zipf.agents.exploration import CountBonus, CountOptions, FirstVisitBonus, FirstVisitOptions

OPTIONS = CountOptions(name="count", scale=0.3, table_size=2**20)
FIRST_VISIT = FirstVisitOptions(name="first_visit", scale=0.25)


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


def test_the_first_visit_bonus_equals_first_visits_of_an_episode():
    rng = np.random.default_rng(1)
    bonus, seen = FirstVisitBonus(FIRST_VISIT), [set() for _ in range(8)]
    paid = 0
    for _ in range(60):
        image = rng.integers(2, size=(8, 2, 2), dtype=np.uint8)
        mask, ended = rng.random(8) < 0.7, rng.random(8) < 0.1
        result = bonus({"image": image}, mask)
        assert result.dtype == np.float32
        for i in range(8):
            new = bool(mask[i]) and image[i].tobytes() not in seen[i]
            np.testing.assert_allclose(result[i], 0.25 if new else 0.0)
            paid += new
            if mask[i]:
                seen[i].add(image[i].tobytes())
            if ended[i]:
                seen[i] = set()
        bonus.end(ended)
    assert 100 < paid < 300  # of 336: some were seen before, and again new after an episode's end


def test_the_first_visit_bonus_continues_bit_for_bit():
    rng = np.random.default_rng(2)
    one, other = FirstVisitBonus(FIRST_VISIT), FirstVisitBonus(FIRST_VISIT)
    everywhere = np.ones(4, np.bool_)
    for _ in range(5):
        one({"image": rng.integers(3, size=(4, 2), dtype=np.uint8)}, everywhere)
        one.end(np.array([True, False, False, False]))
    other.load_state_dict(one.state_dict())
    again = {"image": np.repeat(rng.integers(3, size=(9, 1, 2), dtype=np.uint8), 4, 1)}
    results = [[b({"image": image}, everywhere) for image in again["image"]] for b in (one, other)]
    np.testing.assert_array_equal(*results)
    assert np.unique(np.stack(results[0])).size == 2
    nothing = FirstVisitBonus(FIRST_VISIT)
    nothing.load_state_dict(FirstVisitBonus(FIRST_VISIT).state_dict())
    assert nothing({"image": again["image"][0]}, everywhere).all()
