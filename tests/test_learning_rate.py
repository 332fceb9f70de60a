"""Learning rates that fall to 0: which, when, and that resuming does not notice."""

import pytest
import torch
from conftest import TINY, assert_equal, learned, metrics_of
from test_agent import NAMES, build

from zipf.agents.learner import Learner
from zipf.errors import UserError
from zipf.experiments.building import loading
from zipf.experiments.training import runner


def optimisers_of(agent):
    return list(agent.optimisers.values())


def rates(agent):
    return [group["lr"] for part in optimisers_of(agent) for group in part.param_groups]


@pytest.mark.parametrize("name", NAMES)
def test_every_optimiser_of_an_agent_is_scaled_and_back(name):
    agent = build(name)
    own = rates(agent)
    agent.scale_learning_rates(0.25)
    assert rates(agent) == [0.25 * rate for rate in own]
    agent.scale_learning_rates(0.5)  # of what they were built with
    assert rates(agent) == [0.5 * rate for rate in own]


def test_the_factor_falls_linearly_and_is_never_zero_in_an_update():
    config = loading.load([*TINY, "updates=8", "learning_rate_decay=[4,8]"])
    factors = [config.learning_rate_factor(update) for update in range(8)]
    assert factors == [1, 1, 1, 1, 1, 0.75, 0.5, 0.25]
    assert loading.load([*TINY, "updates=8"]).learning_rate_factor(7) == 1


def train(root, *options):
    config = loading.load([*TINY, "name=one", f"run_root={root}", *options])
    return config.folder, runner.train(config)


def test_each_update_has_its_own_factor(tmp_path, monkeypatch):
    given, scale = [], Learner.scale_learning_rates

    def watched(agent, factor):
        given.append(factor)
        scale(agent, factor)

    monkeypatch.setattr(Learner, "scale_learning_rates", watched)
    _, rc = train(tmp_path, "updates=4", "learning_rate_decay=[1,4]")
    assert rc == 0
    assert given == pytest.approx([1, 1, 2 / 3, 1 / 3])


def test_a_stopped_run_goes_on_with_the_rates_of_one_left_alone(tmp_path):
    decay = "learning_rate_decay=[2,8]"
    whole, rc = train(tmp_path / "whole", "updates=8", decay)
    assert rc == 0
    for updates in (3, 6, 8):  # the rates fall from the second update on
        parts, rc = train(tmp_path / "parts", f"updates={updates}", decay)
        assert rc == 0
    assert_equal(learned(parts)["agent"], learned(whole)["agent"])
    factors = metrics_of(whole).set_index("update")["learning_rate_factor"]
    assert factors.round(6).to_list() == [1, 1, 1, 0.833333, 0.666667, 0.5, 0.333333, 0.166667]
    plain, rc = train(tmp_path / "plain", "updates=8")
    assert rc == 0
    assert "learning_rate_factor" not in metrics_of(plain)
    assert not torch.equal(weight_of(plain), weight_of(whole))


def weight_of(folder):
    return learned(folder)["agent"]["network"]["policy.weight"]


@pytest.mark.parametrize(
    ("decay", "wrong"),
    [
        ("[3,3]", r"learning_rate_decay=\[3, 3\]: should begin before it ends"),
        ("[0,7]", r"learning_rate_decay=\[0, 7\]: nothing would be learned from update 7 on"),
        ("[1]", "learning_rate_decay"),
        ("5", "learning_rate_decay"),
        ("[-1,8]", "learning_rate_decay"),
    ],
)
def test_a_decay_that_cannot_be_is_one_error(decay, wrong):
    with pytest.raises(UserError, match=wrong):
        loading.load([*TINY, "updates=8", f"learning_rate_decay={decay}"])


def test_it_is_in_a_runs_automatic_name():
    asked = ["experiment=demo", "updates=8", "learning_rate_decay=[4,8]"]
    assert loading.load(asked).condition.endswith("-learning_rate_decay_4+8")
