"""Configurations: every shipped one composes, and every mistake is told at once."""

import re

import pytest

from zipf.agents.encoders import Encoder
from zipf.envs import levels
from zipf.experiments import command_line, config
from zipf.experiments.errors import UserError


@pytest.mark.parametrize("experiment", command_line.choices("experiment"))
@pytest.mark.parametrize("memory", command_line.choices("memory"))
@pytest.mark.parametrize("network", command_line.choices("network"))
@pytest.mark.parametrize("exploration", command_line.choices("exploration"))
def test_every_combination_composes(experiment, memory, network, exploration):
    loaded = command_line.load(
        [
            f"experiment={experiment}",
            f"memory={memory}",
            f"network={network}",
            f"exploration={exploration}",
        ]
    )
    assert loaded.experiment == experiment
    assert loaded.memory.name == memory
    assert loaded.network.name == network
    assert loaded.exploration.name == exploration


def test_the_papers_values():
    """Its IMPALA table (third column) and architecture table, as printed."""
    paper = command_line.load(["experiment=gridworld"])
    assert paper.agent.learning_rate == 3e-4
    assert paper.agent.entropy_cost == 9.4e-5
    assert paper.agent.baseline_cost == 0.59
    assert paper.agent.discount == 0.99
    assert paper.collector.unroll_length == 128
    assert paper.network.channels == [16, 32, 32]
    assert paper.network.blocks == 2
    assert paper.memory.name == "lstm"
    assert paper.memory.size == 512
    assert paper.exploration.name == "none"
    assert paper.evaluation.episodes == 1000
    assert paper.schedule.window == [2_000_000, 3_000_000]
    assert paper.is_released_benchmark
    assert not command_line.load(["experiment=demo"]).is_released_benchmark


@pytest.mark.parametrize(
    ("experiment", "window"),
    [
        ("playroom_lift", [300_000, 400_000]),
        ("playroom_put", [300_000, 400_000]),
        ("playroom_find", [2_000_000, 3_000_000]),
    ],
)
def test_the_papers_values_in_the_playroom(experiment, window):
    """Its IMPALA table, whose first column is the Playroom's by the order of the others."""
    paper = command_line.load([f"experiment={experiment}"])
    assert paper.environment.split == experiment
    assert paper.environment.image_size == [72, 96]
    assert paper.agent.learning_rate == 3e-4
    assert paper.agent.entropy_cost == 1e-4
    assert paper.agent.baseline_cost == 0.6
    assert paper.collector.unroll_length == 128
    assert paper.schedule.window == window
    assert paper.updates == window[1]
    assert paper.is_released_benchmark
    for other in ("object_order=alternate", "image_size=[36,48]", "max_steps=100"):
        changed = command_line.load([f"experiment={experiment}", f"environment.{other}"])
        assert not changed.is_released_benchmark


@pytest.mark.parametrize(("experiment", "patch"), [("demo", 9), ("playroom_lift_compact", 12)])
def test_the_compact_network_fits_every_family(experiment, patch):
    loaded = command_line.load([f"experiment={experiment}", "network=compact"])
    env = levels.make_vec(levels.split(loaded.environment.split).uniform, 1)
    encoder = Encoder(env.single_observation_space, loaded.network)
    assert encoder.image.patch == patch


MISTAKES = [
    (["experiment=gridwrld"], ["experiment=gridwrld", "gridworld"]),
    (["experiment=demo", "agent=impla"], ["agent=impla", "impala"]),
    ([], ["experiment", "demo", "gridworld_compact"]),
    (["experiment=demo", "agent.learning_rat=1"], ["agent.learning_rat:", "agent.learning_rate"]),
    (["experiment=demo", "seeed=1"], ["seeed", "seed"]),
    (["experiment=demo", "foo"], ["foo", "option=value"]),
    (["experiment=demo", "seed=-1"], ["seed=-1", "greater than or equal to 0"]),
    (["experiment=demo", "updates=many"], ["updates=many", "integer"]),
    (["experiment=demo", "updates=0"], ["updates=0", "greater"]),
    (["experiment=demo", "agent.learning_rate=fast"], ["agent.learning_rate=fast", "number"]),
    (["experiment=demo", "precision=half"], ["precision=half", "bfloat16"]),
    (["experiment=demo", "resume=perhaps"], ["resume=perhaps", "must"]),
    (["experiment=demo", "device=gpu"], ["device=gpu"]),
    (["experiment=demo", "device=cuda:99"], ["device=cuda:99", "CUDA", "device=cpu"]),
    (["experiment=demo", "collector.num_envs=0"], ["collector.num_envs=0", "greater"]),
    (["experiment=demo", "evaluation.episodes=0"], ["evaluation.episodes=0", "greater"]),
    (
        ["experiment=demo", "environment.split=gridwrld"],
        ["environment.split=gridwrld: should be one of", "'gridworld'", "'playroom_lift'"],
    ),
    (["experiment=playroom_put", "collector.num_envs=2"], ["collector.num_envs=2", "at least 3"]),
    (["experiment=playroom_put", "environment.num_maps=2"], ["environment.num_maps", "no such"]),
    (["experiment=demo", "environment.num_objects=90"], ["num_objects = 90", "at most 25"]),
    (["experiment=demo", "environment.num_rooms=[2]"], ["environment.num_rooms"]),
    (["experiment=demo", "schedule.window=[3,1]"], ["schedule.window", "begin before"]),
    (["experiment=demo", "condition=a/b"], ["condition=a/b", "folder"]),
    (["experiment=demo", "condition=''"], ["condition=", "folder"]),
    (["experiment=demo", "condition=1"], ["condition=1", "quote"]),
    (["experiment=demo", f"condition={'x' * 300}"], ["too long", "condition=<name>"]),
    (["experiment=demo", "seed=100000000000000000000"], ["seed=1", "less than"]),
    (["experiment=demo", "agent.learning_rate=inf"], ["agent.learning_rate=inf", "finite"]),
    (["experiment=demo", "network.patch=8"], ["network.patch=8", "63 x 63", "resnet"]),
    (["experiment=demo", "run_root=/dev/null"], ["run_root=/dev/null", "folder"]),
    (["experiment=demo", "~memory"], ["~memory", "cannot be deleted"]),
    (["experiment=demo", "resume='"], ["resume='"]),
    (["experiment=demo", "agent.lr=1"], ["agent.lr", "agent.learning_rate"]),
    (["experiment=demo", "run_root=/tmp/a=b"], ["quotes"]),
    (["experiment=demo", "+agent.momentum=1"], ["agent.momentum", "no such option"]),
]


@pytest.mark.parametrize(("overrides", "told"), MISTAKES, ids=[str(m[0]) for m in MISTAKES])
def test_a_mistake_is_one_clear_line(overrides, told):
    with pytest.raises(UserError) as error:
        command_line.load(overrides)
    message = str(error.value)
    assert len(message.splitlines()) == 1
    for words in told:
        assert words in message


def test_all_mistakes_are_told_at_once():
    with pytest.raises(UserError) as error:
        command_line.load(
            ["experiment=demo", "seeed=1", "memory=lstn", "seed=-1", "updates=many", "~network"]
        )
    assert len(str(error.value).splitlines()) == 5


def test_a_sweep_is_checked_before_it_starts():
    six = ["experiment=demo", "seed=0,1,2", "memory=mlp,lstm"]
    assert len(command_line.check_command_line(six)) == 6
    jobs = command_line.check_command_line(["experiment=demo", "seed=range(4)"])
    assert [job.seed for job in jobs] == [0, 1, 2, 3]
    with pytest.raises(UserError) as error:
        command_line.check_command_line(["experiment=demo,gridwrld", "seed=0,-1"])
    lines = str(error.value).splitlines()
    assert any("seed=-1" in line for line in lines)
    assert any("gridwrld" in line for line in lines)


CONDITIONS = [
    (["experiment=gridworld"], "impala"),
    (["experiment=gridworld", "memory=mlp"], "impala_mlp"),
    (["experiment=demo"], "impala_mlp"),
    (["experiment=demo", "memory=lstm"], "impala"),
    (["experiment=gridworld", "network=compact"], "impala,network=compact"),
    (["experiment=gridworld_compact", "exploration=none"], "impala_mlp,exploration=none"),
    (["experiment=gridworld", "agent.discount=0.9"], "impala,agent.discount=0.9"),
    (["experiment=gridworld", "agent.discount=0.99"], "impala"),
    (["experiment=gridworld", "seed=3", "updates=7", "evaluation.every=2", "device=cpu"], "impala"),
    (["experiment=gridworld", "condition=mine", "agent.discount=0.9"], "mine"),
]


@pytest.mark.parametrize(("overrides", "condition"), CONDITIONS)
def test_a_condition_is_named_after_what_differs(overrides, condition):
    loaded = command_line.load([*overrides, "run_root=here"])
    assert loaded.condition == condition
    assert loaded.folder.parts == ("here", loaded.experiment, condition, f"seed{loaded.seed}")


def test_the_shipped_environment_is_the_released_benchmark():
    assert command_line.load(["experiment=gridworld"]).environment == config.GridworldOptions(
        split="gridworld"
    )
    assert command_line.load(["experiment=gridworld_compact"]).is_released_benchmark
    assert not command_line.load(
        ["experiment=gridworld", "environment.num_maps=6"]
    ).is_released_benchmark


def test_every_number_has_a_source():
    for path in command_line.CONFIG_DIR.glob("*/*.yaml"):
        for number, line in enumerate(path.read_text().splitlines(), 1):
            setting = line.split("#")[0]
            if re.search(r"\b\d", setting):  # a number; r2d2 is a name
                assert "#" in line, f"{path.name}, line {number}: where does the value come from?"
