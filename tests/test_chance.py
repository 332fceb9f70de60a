"""Baselines: the scores of policies that do not learn."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from zipf import envs
from zipf.envs import BaselineScore, baseline, baselines
from zipf.envs.baselines import measured
from zipf.envs.episodes import measure


def test_what_was_measured_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "family_of_this_test"
    package.mkdir()
    (package / "__init__.py").write_text(
        "from zipf.envs.family import Family\n"
        "from zipf.options import Options\n"
        "class Sizes(Options):\n"
        "    max_steps: int = 900\n"
        "    order: str = 'usual'\n"
        "FAMILY = Family(name='a', summary='', levels=(), make_vec='', options=Sizes)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    assert measured(package.name, "expert")("lift/easy") is None
    baselines._figures.cache_clear()
    figures = [
        {"score": 0.25, "error": 0.02, "episodes": 400, "options": {}},
        {"score": 0.1, "error": 0.01, "episodes": 300, "options": {"max_steps": 90}},
    ]
    (package / "baselines.json").write_text(json.dumps({"chance": {"lift/easy": figures}}))
    chance = measured(package.name, "chance")
    by_default = BaselineScore(0.25, 400, error=0.02)
    assert chance("lift/easy") == by_default
    assert chance("lift/easy", max_steps=900, order="usual") == by_default
    assert chance("lift/easy", max_steps=90) == BaselineScore(0.1, 300, error=0.01)
    assert chance("lift/easy", max_steps=90, order="other") is None
    assert measured(package.name, "expert")("lift/easy") is None
    assert chance("lift/easy", max_steps=10) is None
    assert chance("lift/easy", gravity=0) is None
    assert chance("lift/hard") is None
    sys.modules.pop(package.name)


def test_a_measured_reference_is_found_however_it_is_asked_for() -> None:
    known = baseline("generalist", "gridworld/zipf_2")
    assert known is not None
    assert baseline("generalist", "gridworld/zipf_2.0") == known
    assert baseline("generalist", "gridworld/zipf_2", num_rooms=(3, 3)) == known
    small = {"num_objects": 5}
    expected = baseline("generalist", "gridworld/rare", num_rooms=[2, 2], **small)
    assert expected is not None
    assert expected != baseline("generalist", "gridworld/rare")
    assert baseline("generalist", "gridworld/uniform_rare", num_rooms=(2, 2), **small) == expected
    assert baseline("generalist", "gridworld/zipf_2", num_rooms=(3, 4)) is None


def test_an_unknown_reference_is_refused() -> None:
    with pytest.raises(ValueError, match=r"unknown baseline 'expart' \(did you mean 'expert'\?\)"):
        baseline("expart", "gridworld/uniform")
    family = envs.Family(
        name="oracles", summary="", levels=("a",), make_vec="a:b", baselines={"oracle": "a:b"}
    )
    with pytest.raises(ValueError, match="unknown baseline 'oracle': expected one of chance, "):
        envs.register(family)
    assert "oracles" not in envs.families()


def test_every_reference_that_a_family_names_is_known_of_a_level() -> None:
    for family in envs.families().values():
        for of in family.baselines:
            levels = (f"{family.name}/{level}" for level in family.levels)
            assert any(baseline(of, level) for level in levels), (family.name, of)


# A blind policy


def test_what_a_blind_policy_scores() -> None:
    """In the gridworld it goes to the most frequent target; in the playroom to any toy."""
    expected = {
        "gridworld/zipf_2": 1 / sum(1 / rank**2 for rank in range(1, 21)),
        "gridworld/uniform": 1 / 20,
        "playroom/lift/lift_shape_zipf3": 1 / 3,
        "playroom/put/lift_shape_many_zipf1": 1 / 6,
        "playroom/put/put_on_bed_tray_rare": 1 / 3 / 2,
        "playroom/supervised/find_shape_uniform": 1 / 2 + 1 / 50 / 2,
        "playroom/supervised/find_shape_uniform_rare": 1 / 2 + 1 / 10 / 2,
    }
    for level, score in expected.items():
        blind = baseline("blind", level)
        assert blind is not None
        assert blind.score == pytest.approx(score)
        assert blind.episodes is None
    for steps in (5, 20):  # it is no faster than the expert
        short, expert = (
            baseline(n, "gridworld/zipf_2", max_steps=steps) for n in ("blind", "expert")
        )
        assert short is not None
        assert expert is not None
        assert 0 < short.score < min(expert.score, expected["gridworld/zipf_2"])
    zipf3 = np.arange(1, 51) ** -3.0 / (np.arange(1, 51) ** -3.0).sum()
    coin = baseline(
        "blind", "playroom/supervised/find_shape_zipf3", max_steps=100, image_size=(9, 9)
    )
    assert coin is not None
    assert coin.score == pytest.approx(0.5 + (zipf3**2).sum() / 2)
    assert coin.score == pytest.approx(0.852, abs=5e-4)
    five = envs.SplitLevel("gridworld/uniform", options={"num_objects": 5})
    by_rank = {"map": (0.2,) * 20, "target": (1.0, 0.0, 0.0, 0.0, 0.0)}
    assert baseline("blind", five) == BaselineScore(
        0.2, by_rank=by_rank, policy="expert of the most frequent target"
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
    blind = baseline("blind", f"playroom/{level}")
    assert blind is not None
    sigma = np.sqrt(blind.score * (1 - blind.score) / episodes)
    assert abs(played.score - blind.score) < 3 * sigma


@pytest.mark.parametrize("name", sorted(envs.families()))
@pytest.mark.parametrize("of", [one.name for one in envs.BASELINES])
def test_what_is_known_by_rank_agrees_with_the_score(name: str, of: str) -> None:
    """Weighted by how often a rank is drawn, where all are drawn alike."""
    family = envs.find_family(name)
    for level in family.levels:
        known = baseline(of, f"{name}/{level}")
        if known is None or "uniform" not in level:
            continue
        env = envs.make_vec(f"{name}/{level}", 1)
        for rank, values in known.by_rank.items():
            assert len(values) == env.situation[rank]
            if "rare" not in level:
                assert np.mean(values) == pytest.approx(known.score)
        env.close()
