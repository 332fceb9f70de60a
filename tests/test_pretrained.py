"""Weights of another run: what takes them, where they come from, and what a run says of them."""

import json
import shutil

import gymnasium as gym
import pytest
import torch
from conftest import TINY, assert_equal, call, learned
from networks import compact
from test_agent import NAMES, SPACE, build, unrolls
from test_auxiliary import BYOL

from zipf.agents.network import Torso
from zipf.errors import UserError
from zipf.experiments.building import loading, run_folder
from zipf.experiments.training import runner


def networks_of(agent):
    return [part for part in vars(agent).values() if isinstance(part, Torso)]


def parts_of(network):
    return {name: part.state_dict() for name, part in network.named_children()}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("names", [["encoder"], ["encoder", "memory"]], ids=str)
def test_every_network_of_an_agent_takes_the_parts_that_are_asked_for(name, names):
    made, other = build(name, seed=0), build(name, seed=1)
    own, taken = parts_of(made.actor), parts_of(other.actor)
    assert not torch.equal(*(next(iter(p["encoder"].values())) for p in (own, taken)))
    made.begin_with({part: taken[part] for part in names})
    for network in networks_of(made):
        for part, weights in parts_of(network).items():
            assert_equal(weights, taken[part] if part in names else own[part])
    for unroll in unrolls(made, 3):
        made.update(unroll)
    assert_equal(parts_of(other.actor), taken)  # they are copies


def test_the_target_encoder_of_byol_follows():
    made = build("impala", auxiliary=BYOL)
    made.begin_with({"encoder": parts_of(build("impala", seed=1).actor)["encoder"]})
    assert_equal(made.auxiliary.target_encoder.state_dict(), made.network.encoder.state_dict())


def test_what_does_not_fit_is_an_error():
    made = build("impala")
    taken = parts_of(build("r2d2").actor)
    with pytest.raises(ValueError, match="no part 'mind': the network has encoder, memory, "):
        made.begin_with({"mind": {}})
    wider = build("impala", network=compact(size=24))
    with pytest.raises(ValueError, match=r"encoder: .* is \[24.*\] here and \[16.*\] there"):
        wider.begin_with({"encoder": taken["encoder"]})
    space = gym.spaces.Dict(SPACE.spaces, code=gym.spaces.Discrete(3))
    with pytest.raises(ValueError, match=r"encoder: .* is \[.*\] here and none there"):
        build("impala", space=space).begin_with({"encoder": taken["encoder"]})


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """The root and the folder of a run that others begin with."""
    root = tmp_path_factory.mktemp("runs")
    assert train([*TINY, "updates=3", "name=first", f"run_root={root}"]) == 0
    return root, root / "demo" / "first" / "seed0"


def train(arguments):
    return runner.train(loading.load(arguments))


def asked(first, *options):
    root, folder = first
    start = f"pretrained.run={folder}"
    return [*TINY, "updates=3", "seed=5", f"run_root={root}", start, *options]


def test_a_new_run_begins_with_the_weights_of_another(first):
    everything = "pretrained.parts=[encoder,memory,policy,baseline]"
    begun = runner.Run(loading.load(asked(first, "name=all", everything)))
    last = learned(first[1])["agent"]["network"]
    assert_equal(dict(begun.agent.network.state_dict()), dict(last))
    begun.close()
    part = runner.Run(
        loading.load(asked(first, "name=part", "agent=imitation", "exploration=none"))
    )
    for name, weights in part.agent.network.state_dict().items():
        assert torch.equal(weights, last[name]) == name.startswith("encoder."), name
    part.close()


def test_a_run_says_where_its_weights_are_from_and_resumes_without_it(first, capsys):
    root, folder = first
    asking = asked(first, "schedule.checkpoint_every=1")
    assert train([*asking, "name=whole"]) == 0
    assert "begins with the encoder of demo first seed 0 at update 3" in capsys.readouterr().out
    whole, halves = (root / "demo" / name / "seed5" for name in ("whole", "halves"))
    assert json.loads((whole / "run.json").read_text())["pretrained"] == {
        "experiment": "demo",
        "condition": "first",
        "seed": 0,
        "update": 3,
        "frames": 3 * 6 * 5,
        "parts": ["encoder"],
    }
    assert train([*asking, "name=halves", "updates=2"]) == 0
    away = root / "away"
    shutil.move(folder, away)
    try:
        assert train([*asking, "name=halves"]) == 0
    finally:
        shutil.move(away, folder)
    assert_equal(learned(halves)["agent"], learned(whole)["agent"])
    described = [json.loads((one / "run.json").read_text()) for one in (halves, whole)]
    assert described[0]["pretrained"] == described[1]["pretrained"]
    capsys.readouterr()
    shown = call(str(whole), "window=last", module="zipf.report", folder=root).stdout
    told = "Seed 5 of whole began with the encoder of demo first, seed 0, trained on 90 frames"
    assert told in " ".join(shown.split())
    assert train(asked((root, whole), "name=following")) == 0
    following = json.loads((root / "demo" / "following" / "seed5" / "run.json").read_text())
    assert following["pretrained"]["condition"] == "whole"
    assert following["pretrained"]["frames"] == 90 + 90


def test_runs_that_began_with_another_go_on_in_another_folder(first, tmp_path):
    _, folder = first
    old, new = tmp_path / "old", tmp_path / "new"
    shutil.copytree(folder, old / "demo" / "first" / "seed0")

    def options(root, *more):
        begins = f"pretrained.run={root}/demo/first/seed0"
        return [*TINY, "updates=2", "name=moved", f"run_root={root}", begins, *more]

    assert train(options(old)) == 0
    saved = learned(old / "demo" / "moved" / "seed0")["options"]
    assert saved["pretrained.run"] == "demo/first/seed0"
    old.rename(new)
    assert run_folder.is_finished(loading.load(options(new)))
    assert train(options(new, "updates=3")) == 0
    with pytest.raises(UserError, match=r"pretrained\.run=demo/first/seed0 there"):
        run_folder.check_options(
            new,
            {"options": saved},
            loading.load(options(new, f"pretrained.run={new}/demo/moved/seed0")),
        )


def test_seeds_that_begin_with_seeds_of_a_condition_are_one_row(first, capsys):
    root, folder = first
    assert train([*TINY, "updates=3", "name=first", "seed=1", f"run_root={root}"]) == 0
    options = [*TINY, "updates=1", "agent=imitation", "exploration=none", f"run_root={root}"]
    begins = f"pretrained.run={folder.parent}/seed${{seed}}"
    configs = [loading.load([*options, begins, f"seed={seed}"]) for seed in (0, 1)]
    assert [runner.train(config) for config in configs] == [0, 0]
    (row,) = {config.condition for config in configs}
    assert "-pretrained_demo_first" in row
    shown = call(str(root / "demo" / row), "window=last", module="zipf.report", folder=root).stdout
    told = " ".join(shown.split())
    assert "were not trained with the same settings" not in told
    title = configs[0].row.title
    assert f"Seeds 0, 1 of {title} began with the encoder of demo first, the same seed" in told


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["pretrained.run=nowhere"], "pretrained.run=nowhere: nowhere: is no run's folder"),
        (["pretrained.parts=[mind]"], "no part 'mind'; the network has encoder, memory, "),
        (
            ["pretrained.parts=[encoder.words]"],
            "no part 'encoder.words'; the network has ",
        ),
        (["pretrained.parts=[]"], "pretrained.parts=[]: "),
        (["network.size=24"], "is [24"),
        (
            ["critic=quantile", "pretrained.parts=[baseline]"],
            "baseline of {run} is for critic=scalar, and this run has critic=quantile quantiles=",
        ),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_a_mistake_is_told_before_anything_is_written(first, options, message):
    with pytest.raises(UserError) as told:
        train(asked(first, *options, "name=wrong"))
    assert message.format(run=first[1]) in str(told.value)
    assert not (first[0] / "demo" / "wrong" / "seed5" / "run.json").exists()


def test_a_run_without_checkpoint_and_weights_is_refused(first, tmp_path):
    shutil.copytree(first[1], tmp_path / "copy")
    (tmp_path / "copy" / "checkpoint.pt").unlink()
    (tmp_path / "copy" / "weights.pt").unlink()
    with pytest.raises(UserError, match=r"has no agent \(neither checkpoint\.pt nor weights\.pt\)"):
        loading.load(asked(first, "name=without", f"pretrained.run={tmp_path / 'copy'}"))


@pytest.mark.slow
def test_a_fixed_matcher_stays_what_another_run_has_learned(tmp_path):
    """Also after a run is resumed, which reads the other run no more."""
    _, *tiny = TINY  # without its experiment
    small = [*tiny, "environment.image_size=[36,48]", f"run_root={tmp_path}"]
    finding = ["experiment=playroom_find_compact", "condition=supervised_matching", "updates=3"]
    network = ["network=matching", "memory=mlp", "exploration=none"]
    assert train([*small, *finding, *network, "name=names"]) == 0
    names = tmp_path / "playroom_find_compact" / "names" / "seed0"
    lifting = ["experiment=playroom_lift_compact", "name=lift", "network=matching"]
    fixed = ["network.matcher=fixed", f"pretrained.run={names}"]
    taken = learned(names)["agent"]["network"]
    for parts in ("encoder.instruction", "memory"):
        with pytest.raises(UserError, match=rf"parts=\[{parts}\]: .*; add encoder.image.matcher$"):
            loading.load([*small, *lifting, *fixed, f"pretrained.parts=[{parts}]"])
    alone = "pretrained.parts=[encoder.image.matcher]"
    for learner in (["agent=vmpo"], ["agent=vmpo", "network.matcher=learned"]):
        loading.load([*small, *lifting, *fixed, alone, *learner])
    begun = runner.Run(loading.load([*small, *lifting, *fixed, alone, "updates=2"]))
    for name, weights in begun.agent.network.encoder.state_dict().items():
        assert torch.equal(weights, taken[f"encoder.{name}"]) == ("matcher" in name), name
    begun.close()
    for updates in (2, 4):
        assert train([*small, *lifting, *fixed, f"updates={updates}"]) == 0
        if names.exists():
            shutil.rmtree(names)
    ours = learned(tmp_path / "playroom_lift_compact" / "lift" / "seed0")["agent"]["network"]
    kept = [name for name in taken if "matcher" in name]
    assert len(kept) > 10
    assert_equal({name: ours[name] for name in kept}, {name: taken[name] for name in kept})
    name = "encoder.encoders.0.dense.0.weight"
    assert not torch.equal(ours[name], taken[name])
