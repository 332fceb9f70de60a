"""How often training met each situation: counted, kept in checkpoints, and written."""

from collections import Counter

import numpy as np
import pandas as pd
from test_collector import build

from zipf.experiments.hooks.visits import Visits


def random_episodes(rng, steps=50, envs=7):
    for _ in range(steps):
        ended = rng.random(envs) < 0.4
        ranks = {name: rng.integers(0, 3, envs) for name in ("map", "target")}
        yield ranks | {"return": rng.random(envs)}, ended


def test_visits_against_an_oracle():
    visits, met = Visits(("map", "target")), []
    for final_info, ended in random_episodes(np.random.default_rng(0)):
        visits.add(final_info, ended)
        met += [
            (int(final_info["map"][i]), int(final_info["target"][i])) for i in np.flatnonzero(ended)
        ]
    every = pd.DataFrame(
        {"level_kind": "rare", "map": [0, 2, 7], "target": [1, 2, 0], "episodes": 1}
    )
    beside = visits.beside(every)
    assert list(beside.columns[-3:]) == ["visits", "visits_map", "visits_target"]
    for row in beside.to_dict("records"):
        assert row["visits"] == Counter(met)[row["map"], row["target"]]
        assert row["visits_map"] == sum(one == row["map"] for one, _ in met)
        assert row["visits_target"] == sum(other == row["target"] for _, other in met)
    assert len(met) > 100


def test_visits_continue_from_their_state():
    whole, first = Visits(("map", "target")), Visits(("map", "target"))
    every = pd.DataFrame({"map": [0, 1, 2], "target": [0, 1, 2]})
    rng = np.random.default_rng(1)
    for final_info, ended in random_episodes(rng):
        whole.add(final_info, ended)
        first.add(final_info, ended)
    again = Visits(("map", "target"))
    again.add({"map": np.array([0]), "target": np.array([0])}, np.array([True]))
    again.load_state_dict(first.state_dict())
    for final_info, ended in random_episodes(rng):
        whole.add(final_info, ended)
        again.add(final_info, ended)
    pd.testing.assert_frame_equal(again.beside(every), whole.beside(every))
    empty = Visits(("map", "target"))
    empty.load_state_dict(empty.state_dict())
    assert empty.beside(every)["visits"].tolist() == [0, 0, 0]


def test_one_rank_has_one_column_and_other_ranks_have_none():
    one = pd.DataFrame({"level": [0, 1]})
    assert list(Visits(("level",)).beside(one).columns) == ["level", "visits"]
    assert list(Visits(("map",)).beside(one).columns) == ["level"]


def test_the_collector_counts_the_episodes_that_end():
    _, collector = build()
    ended = 0
    for _ in range(6):
        steps = collector.collect().steps
        ended += int((steps["terminated"] | steps["truncated"])[:-1].sum())
    state = collector.visits.state_dict()
    assert ended > 10
    assert state["episodes"].sum() == ended
    assert collector.state_dict()["visits"]["episodes"].tolist() == state["episodes"].tolist()
