"""The scores of policies that do not learn: of random actions, and of a blind policy."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from zipf import envs
from zipf.envs.random_play import Chance, measure, measured


def test_what_was_measured_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "family_of_this_test"
    package.mkdir()
    (package / "__init__.py").write_text("")
    figures = [
        {"score": 0.25, "episodes": 400, "options": {"max_steps": 900, "order": "usual"}},
        {"score": 0.1, "episodes": 300, "options": {"max_steps": 90, "order": "usual"}},
    ]
    (package / "chance.json").write_text(json.dumps({"lift/easy": figures}))
    monkeypatch.syspath_prepend(tmp_path)
    chance = measured(package.name)
    assert chance("lift/easy") == Chance(0.25, 400)
    assert chance("lift/easy", max_steps=900, order="usual") == Chance(0.25, 400)
    assert chance("lift/easy", max_steps=90) == Chance(0.1, 300)
    assert chance("lift/easy", max_steps=10) is None
    assert chance("lift/easy", gravity=0) is None
    assert chance("lift/hard") is None
    sys.modules.pop(package.name)


# A blind policy


def test_what_a_blind_policy_scores() -> None:
    """In the gridworld it goes to the most frequent target; in the playroom to any toy."""
    expected = {
        "gridworld/zipf_2": 1 / sum(1 / rank**2 for rank in range(1, 21)),
        "gridworld/uniform": 1 / 20,
        "gridworld/rare": 0.0,
        "playroom/lift/lift_shape_zipf3": 1 / 3,
        "playroom/put/lift_shape_many_zipf1": 1 / 6,
        "playroom/put/put_on_bed_tray_rare": 1 / 3 / 2,
        "playroom/supervised/find_shape_uniform": 1 / 2 + 1 / 50 / 2,
        "playroom/supervised/find_shape_uniform_rare": 1 / 2 + 1 / 10 / 2,
    }
    for level, score in expected.items():
        blind = envs.blind(level)
        assert blind is not None
        assert blind.score == pytest.approx(score)
        assert blind.episodes is None
    zipf3 = np.arange(1, 51) ** -3.0 / (np.arange(1, 51) ** -3.0).sum()
    coin = envs.blind("playroom/supervised/find_shape_zipf3", max_steps=100, image_size=(9, 9))
    assert coin is not None
    assert coin.score == pytest.approx(0.5 + (zipf3**2).sum() / 2)
    assert coin.score == pytest.approx(0.852, abs=5e-4)
    assert envs.blind(envs.SplitLevel("gridworld/uniform", options={"num_objects": 5})) == Chance(
        0.2, by_rank={"map": (0.2,) * 20, "target": (1.0, 0.0, 0.0, 0.0, 0.0)}
    )


@pytest.mark.parametrize(
    ("level", "episodes"),
    [
        ("lift/lift_shape_uniform", 120),
        ("put/put_on_bed_tray_all", 60),
        ("supervised/find_shape_zipf3", 120),
    ],
)
def test_the_expert_without_the_instruction_scores_as_a_blind_policy(
    level: str, episodes: int
) -> None:
    from zipf.envs.playroom.blind import BlindExpert  # compiles the expert

    played = measure(
        BlindExpert, f"playroom/{level}", episodes=episodes, num_envs=episodes, image_size=(1, 1)
    )
    blind = envs.blind(f"playroom/{level}")
    assert blind is not None
    sigma = np.sqrt(blind.score * (1 - blind.score) / episodes)
    assert abs(played.score - blind.score) < 3 * sigma


@pytest.mark.parametrize("name", sorted(envs.families()))
@pytest.mark.parametrize("reference", [envs.chance, envs.blind])
def test_what_is_known_by_rank_agrees_with_the_score(name: str, reference) -> None:
    """Weighted by how often a rank is drawn, where all are drawn alike."""
    family = envs.find_family(name)
    for level in family.levels:
        known = reference(f"{name}/{level}")
        if known is None or "uniform" not in level:
            continue
        env = envs.make_vec(f"{name}/{level}", 1)
        for rank, values in known.by_rank.items():
            assert len(values) == env.situation[rank]
            if "rare" not in level:
                assert np.mean(values) == pytest.approx(known.score)
        env.close()
