"""Configurations: every shipped one composes, and every mistake is told at once."""

import re
from itertools import product
from pathlib import Path
from typing import Literal

import pytest
import torch
from envs_of import chosen, kind_of_worlds, needs, pairs_once

import zipf.envs
from zipf import envs
from zipf.agents import Agent
from zipf.agents.encoders import Encoder
from zipf.agents.impala import Impala
from zipf.agents.memory import MEMORIES, MLPMemory, MLPOptions
from zipf.envs.gridworld import GridworldOptions
from zipf.errors import UserError
from zipf.experiments.building import feasibility, loading
from zipf.experiments.options import command_line, config_files, schema
from zipf.experiments.sweeping import sweeps
from zipf.options import Options, Size

EXPERIMENTS = command_line.choices("experiment")
LIFT = "experiment=playroom_lift_compact"
GROUPS = [group for group in config_files.parts() if group != "agent"]
CHOICES = [(group, choice) for group in GROUPS for choice in command_line.choices(group)]


CONDITIONS_OF_TABLES = command_line.choices("condition")
KINDS_OF_ENVS = list(
    {kind_of_worlds(experiment): experiment for experiment in EXPERIMENTS}.values()
)


def of_choices():
    """Every choice with the first kind of envs that it goes with, and the first it does not."""
    found = {}
    for experiment, (group, choice) in product(KINDS_OF_ENVS, CHOICES):
        goes = needs(experiment, **{group: choice}) is None
        found.setdefault((group, choice, goes), experiment)
    return [(experiment, *one) for (*one, _), experiment in found.items()]


def of_conditions():
    """Every condition and every experiment once, and each condition with the first kind of envs
    that it does not go with."""
    refused = {}
    for experiment, condition in product(KINDS_OF_ENVS, CONDITIONS_OF_TABLES):
        if needs(experiment, **chosen(experiment, condition)) is not None:
            refused.setdefault(condition, experiment)
    return [*pairs_once(), *((experiment, one) for one, experiment in refused.items())]


@pytest.mark.parametrize(("experiment", "group", "choice"), of_choices())
def test_every_choice_goes_with_some_envs(experiment, group, choice):
    """Its network is built, too, without weights. Conditions are composed with all experiments."""
    overrides = [f"experiment={experiment}", f"{group}={choice}"]
    if lacking := needs(experiment, **{group: choice}):
        with pytest.raises(UserError, match=lacking):
            loading.load(overrides)
        return
    loaded = loading.load(overrides)
    assert loaded.experiment == experiment
    assert getattr(loaded, group).name == choice


def test_every_condition_says_how_tables_show_it():
    files = [config_files.find("condition", name).values for name in CONDITIONS_OF_TABLES]
    rows = [schema.RowOptions(**file["row"]) for file in files]
    assert len({row.title for row in rows}) == len({row.order for row in rows}) == len(rows)
    assert len({(row.colour, row.line) for row in rows}) == len(rows)


@pytest.mark.parametrize(("experiment", "condition"), of_conditions())
def test_every_condition_goes_with_every_experiment(experiment, condition):
    """And where it cannot, a line for each part says why and what can be."""
    overrides = [f"experiment={experiment}", f"condition={condition}"]
    parts = chosen(experiment, condition)
    if lacking := needs(experiment, **parts):
        with pytest.raises(UserError, match=lacking) as error:
            loading.load(overrides)
        lines = str(error.value).splitlines()
        assert len({line.partition("=")[0].partition(".")[0] for line in lines}) == len(lines)
        return
    loaded = loading.load(overrides)
    assert loaded.condition == condition
    assert {part: getattr(loaded, part).name for part in parts} == parts
    plain = loading.load([f"experiment={experiment}", "condition=impala"])
    others = set(config_files.parts()) - {"agent", "memory", "auxiliary", *parts}
    for part in ("environment", "evaluation", "schedule", *others):
        assert getattr(loaded, part) == getattr(plain, part)
    collector = plain.collector.model_dump()
    file = config_files.find("experiment", experiment).values
    like = config_files.find("experiment", file.get("like", experiment)).values
    agents = like.get("agent", {}) | file.get("agent", {})
    collector |= agents.get(parts["agent"], {}).get("/collector", {})
    assert loaded.collector.model_dump() == collector
    if parts["agent"] == "impala":
        assert loaded.agent == plain.agent


@pytest.mark.parametrize(
    ("experiment", "condition", "options"),
    [
        # learning_rate, discount, trace_lambda, target_period, epsilon, burn_in, max weight
        ("playroom_lift", "r2d2", (5e-4, 0.99, 0.8, 400, 0.125, 20, 0.5)),
        ("playroom_put", "r2d2", (5e-5, 0.99, 0.8, 400, 0.15, 20, 0.9)),
        ("gridworld", "r2d2", (3e-4, 0.9, 0.3, 10, 0.1, 3, 0.9)),
        ("gridworld", "r2d2_uniform_replay", (3e-4, 0.9, 0.3, 10, 0.1, 3, 0.9)),
        ("labyrinth_forward", "r2d2", (3e-4, 0.997, 0.8, 400, 1e-3, 20, 0.9)),
        ("labyrinth_reversed", "r2d2", (3e-4, 0.997, 0.8, 400, 1e-3, 20, 0.9)),
    ],
)
def test_the_papers_values_of_r2d2(experiment, condition, options):
    """Its tables, as printed."""
    agent = loading.load([f"experiment={experiment}", f"condition={condition}"]).agent
    assert (
        agent.learning_rate,
        agent.discount,
        agent.trace_lambda,
        agent.target_period,
        agent.epsilon,
        agent.burn_in,
        agent.priority_max_weight,
    ) == options
    assert agent.weight_decay == 1e-4
    assert agent.replay_capacity == 10**5
    assert not agent.epsilon_ladder
    uniform = condition == "r2d2_uniform_replay"
    assert (agent.priority_exponent, agent.importance_exponent) == (
        (0, 0) if uniform else (0.9, 0.6)
    )


@pytest.mark.parametrize(
    "experiment",
    ["gridworld", "playroom_lift", "playroom_put", "labyrinth_forward", "labyrinth_reversed"],
)
def test_the_papers_values_of_vmpo(experiment):
    """Its table, as printed."""
    loaded = loading.load([f"experiment={experiment}", "condition=vmpo"])
    assert loaded.memory.layers == 2
    assert loaded.agent.discount == 0.995
    assert loaded.agent.learning_rate == 3e-5
    assert loaded.agent.dual_learning_rate == 3e-3
    assert loaded.agent.epsilon_eta == loaded.agent.epsilon_alpha == 0.1
    assert loaded.agent.top_fraction == 0.5  # the table's T_target is read as this


def test_the_papers_values():
    """Its IMPALA table (third column) and architecture table, as printed."""
    paper = loading.load(["experiment=gridworld"])
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
    assert not loading.load(["experiment=demo"]).is_released_benchmark


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
    paper = loading.load([f"experiment={experiment}"])
    assert paper.environment.split == experiment
    assert paper.environment.image_size == [72, 96]
    assert paper.agent.learning_rate == 3e-4
    assert paper.agent.entropy_cost == 1e-4
    assert paper.agent.baseline_cost == 0.6
    assert paper.collector.unroll_length == 128
    assert paper.schedule.window == window
    assert paper.updates == window[1]
    assert paper.is_released_benchmark
    for other in (
        "object_order=alternate", "image_size=[36,48]", "looks=varied", "max_steps=100",
        "reach=1.8", "frequent_exponent=2", "near_failure=true",
    ):  # fmt: skip
        changed = loading.load([f"experiment={experiment}", f"environment.{other}"])
        assert not changed.is_released_benchmark


@pytest.mark.parametrize("experiment", ["labyrinth_forward", "labyrinth_reversed"])
def test_the_papers_values_in_the_labyrinth(experiment):
    """Its IMPALA table, whose second column is the Labyrinth's."""
    paper = loading.load([f"experiment={experiment}"])
    assert paper.environment.split == experiment
    assert paper.environment.image_size == [72, 96]
    assert paper.environment.action_repeat == 4
    assert paper.agent.learning_rate == 1e-4
    assert paper.agent.entropy_cost == 0.01
    assert paper.agent.baseline_cost == 0.5
    assert paper.agent.discount == 0.99
    assert paper.collector.unroll_length == 128
    assert paper.evaluation.episodes == 1000
    assert paper.schedule.window == [200_000, 380_000]
    assert paper.updates == 380_000
    assert paper.is_released_benchmark
    for other in ("image_size=[48,64]", "num_actions=9", "action_repeat=8", "max_steps=450"):
        changed = loading.load([f"experiment={experiment}", f"environment.{other}"])
        assert not changed.is_released_benchmark


@pytest.mark.parametrize(
    ("experiment", "patch"),
    [("demo", 9), ("playroom_lift_compact", 12), ("labyrinth_forward", 12)],
)
def test_the_compact_network_fits_every_family(experiment, patch):
    loaded = loading.load([f"experiment={experiment}", "network=compact"])
    env = envs.make_vec(envs.split(loaded.environment.split).train[0], 1)
    encoder = Encoder(env.single_observation_space, loaded.network)
    assert encoder.reader("image").patch == patch


MISTAKES = [
    (["experiment=gridwrld"], ["experiment=gridwrld", "gridworld"]),
    (["experiment=demo", "agent=impla"], ["agent=impla", "impala"]),
    ([], ["experiment", "demo", "gridworld_compact"]),
    (["experiment=demo", "agent.learning_rat=1"], ["agent.learning_rat:", "agent.learning_rate"]),
    (["experiment=demo", "seeed=1"], ["seeed", "seed"]),
    (["experiment=demo", "foo"], ["foo", "option=value"]),
    (["experiment=demo", "seed=-1"], ["seed=-1", "greater than or equal to 0"]),
    (["experiment=demo", "updates=many"], ["updates=many", "whole number"]),
    (["experiment=demo", "updates=0"], ["updates=0", "greater"]),
    (["experiment=demo", "agent.learning_rate=fast"], ["agent.learning_rate=fast", "number"]),
    (["experiment=demo", "precision=half"], ["precision=half", "auto", "bfloat16"]),
    (["experiment=demo", "resume=perhaps"], ["resume=perhaps", "must"]),
    (
        ["experiment=playroom_lift", "environment.backend=docker"],
        ["environment.backend=docker", "'own'"],
    ),
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
    (["experiment=demo", "schedule.stop_after=0"], ["schedule.stop_after=0", "greater than 0"]),
    (["experiment=demo", "schedule.stop_after=1h"], ["schedule.stop_after=1h", "valid number"]),
    (["experiment=demo", "name=a/b"], ["name=a/b", "folder"]),
    (["experiment=demo", "name=''"], ["name=", "folder"]),
    (["experiment=demo", "name=1"], ["name=1", "quote"]),
    (["experiment=demo", f"name='{'é' * 200}'"], ["at most 255 bytes"]),
    (["experiment=demo", "seed=1,"], ["seed=1,: ends in a comma"]),
    (["experiment=demo", "seed='1'"], ["seed='1': is text; should be a whole number, without q"]),
    (["sweep=demo"], ["sweep: is of many runs: python -m zipf.train -m sweep=<name>"]),
    (
        ["experiment=playroom_lift_compact", "runtime=ray", "threads=2"],
        ["threads=2: with runtime=ray each actor steps its envs; leave it out"],
    ),
    (
        [
            "experiment=demo",
            "pretrained.run=results/gridworld_conditions/impala_mlp/seed1",
            "pretrained.parts=[encodr]",
        ],
        ["pretrained.parts: no part 'encodr'; the network has encoder, memory"],
    ),
    (["experiment=demo", f"name={'x' * 300}"], ["too long", "name=<name>"]),
    (["experiment=demo", "condition=impla"], ["condition=impla", "impala", "name=<name>"]),
    (["experiment=demo", "values=demo"], ["values", "no such option"]),
    (["experiment=demo", "without_instruction=abc"], ["without_instruction=abc", "groups"]),
    (["experiment=demo", "condition=supervised"], ["agent=supervised", "playroom_find"]),
    (
        ["experiment=playroom_find", "condition=supervised", "exploration=count"],
        ["exploration=count", "exploration=none"],
    ),
    (["experiment=gridworld_compact", "agent=imitation"], ["exploration=count", "rewards"]),
    (["experiment=demo", "condition=vmpo", "agent=r2d2", "auxiliary=byol"], ["auxiliary=byol"]),
    (["experiment=demo", "agent=r2d2", "episodic=mem"], ["episodic=mem", "agent=imitation or imp"]),
    (["experiment=demo", "seed=100000000000000000000"], ["seed=1", "less than"]),
    (["experiment=demo", "agent.learning_rate=inf"], ["agent.learning_rate=inf", "finite"]),
    (["experiment=demo", "critic.risk=averse"], ["critic.risk"]),
    (["experiment=demo", "critic=quantile", "critic.risk_level=0"], ["critic.risk_level=0"]),
    (["experiment=demo", "critic=hl_gauss", "critic.bins=70000"], ["critic.bins=70000", "65536"]),
    (["experiment=demo", "exploration=rnd", "exploration.hidden=70000"], ["exploration.hidden"]),
    (["experiment=demo", "network.patch=8"], ["network.patch=8", "63 x 63", "resnet"]),
    (["experiment=demo", "run_root=/dev/null"], ["run_root=/dev/null", "folder"]),
    (["experiment=demo", "~memory"], ["~memory", "cannot be deleted"]),
    (["experiment=demo", "resume='"], ["resume='"]),
    (["experiment=demo", "agent.lr=1"], ["agent.lr", "agent.learning_rate"]),
    (["experiment=demo", "run_root=/tmp/a=b"], ["quotes"]),
    (["experiment=demo", "+agent.momentum=1"], ["agent.momentum", "no such option"]),
    (["experiment=demo", "agent.burn_in=3"], ["agent.burn_in: no such option; agent=r2d2 has it"]),
    (
        ["experiment=demo", "exploration.scale=3"],
        ["exploration.scale: no such option; exploration=count|first_visit|rnd has it"],
    ),
    (["experiment=demo", "hydrax=1"], ["hydrax: no such option"]),
    (
        ["experiment=demo", "replay.capacity=10"],
        ["replay.capacity: no such option; should be one of agent.*, augmentation.*, "],
    ),
    (["experiment=demo", "run_root="], ["run_root=: should not be empty"]),
    (["gridworld"], ["environment=gridworld or experiment=gridworld?"]),
    (["experiment=demo", 'updates="1'], ["check its quotes"]),
    (["experiment=demo", "seed=range(3"], ["check its quotes and brackets"]),
    (["experiment=demo", "collector.envs_per_update=7"], ["should divide collector.num_envs=256"]),
    (["experiment=demo", "experiment=gridworld"], ["choose one", "experiment=demo,gridworld"]),
    (["experiment=demo", f"run_root={'x' * 300}"], ["run_root=", "File name too long"]),
    (["experiment=demo", 'run_root="~no-such/x"'], ["run_root=~no-such/x", "home directory"]),
    (["experiment=demo", "memory.size=1000000000"], ["memory.size=1000000000", "at most 65536"]),
    (["experiment=demo", "memory.size=65536", "memory.layers=60"], ["memory=mlp", "of RAM"]),
    (["experiment=demo", "memory=lstm", "memory.layers=60000"], ["memory=lstm", "too many"]),
    (
        ["experiment=playroom_lift_compact", "network.strides=[4,2,1]"],
        ["network.strides=[4, 2, 1]: should have as many numbers as network.channels"],
    ),
    (
        ["experiment=playroom_find_compact", "network=matching", "network.match_strides=[4,2]"],
        ["network.match_strides=[4, 2]: should have as many numbers as network.match_channels"],
    ),
    (
        ["experiment=demo", "augmentation=random", "augmentation.scale=[2,1]"],
        ["augmentation.scale=[2, 1]: the first should not be larger"],
    ),
    (["experiment=demo", "network.channels=70000"], ["network.channels=70000", "at most 65536"]),
    (["experiment=demo", "collector.num_envs=1000000000"], ["collector.num_envs", "TB of RAM"]),
    (
        ["experiment=demo", "evaluation.num_envs=1000000000", "evaluation.episodes=1000000000"],
        ["evaluation.num_envs=1000000000", "TB of RAM"],
    ),
    (
        ["experiment=demo", "environment.num_maps=1000000000"],
        ["environment.num_maps=1000000000", "less than or equal to 10000"],
    ),
    (
        ["experiment=demo", "environment.max_steps=99999999999999999999"],
        ["environment.max_steps=99999999999999999999: should be less"],
    ),
    (["experiment=demo", "schedule.window=3"], ["schedule.window=3: should be a list in square"]),
    (
        ["experiment=demo", "exploration.weight=1"],
        [
            "exploration.weight",
            "exploration=none has none; choose exploration=count|first_visit|rnd",
        ],
    ),
    (["experiment=demo", "seed.x=1"], ["seed.x: no such option"]),
    (
        ["experiment=playroom_lift_compact", "agent=r2d2", "hindsight=achieved"]
        + ["hindsight.length=9", "hindsight.fade=9"],
        ["hindsight.fade=9: agent=r2d2 has no costs that fall; choose null"],
    ),
    (
        ["experiment=demo", "hindsight=achieved", "hindsight.kept_per_goal=9", "episodic=mem"],
        ["hindsight.kept_per_goal=9", "choose null, or episodic=none"],
    ),
    (
        ["experiment=demo", "environment.observation=tiles", "network=film"],
        ["network=film reads images by an instruction, and the observations have no image"],
    ),
]


@pytest.mark.parametrize("has", [True, False])
def test_automatic_precision_is_what_the_device_computes_fast(has, monkeypatch):
    """In the checked options, which is what files tell, and only where it was asked for."""
    monkeypatch.setattr(schema, "has_bfloat16", lambda device: has and device == "cpu")
    overrides = ["experiment=playroom_lift_compact", "device=cpu"]
    loaded = loading.load(overrides)
    assert loaded.condition == "impala"
    assert loaded.precision == loaded.what_is_learned["precision"]
    assert loaded.precision == ("bfloat16" if has else "float32")
    for precision in ("float32", "bfloat16"):
        chosen = loading.load([*overrides, f"precision={precision}"])
        assert chosen.precision == precision
        assert chosen.folder == loaded.folder  # so that the run goes on on another machine
    fixed = ["experiment=demo", "precision=bfloat16"]
    assert loading.load(fixed).condition == "impala_mlp-precision_bfloat16"


@pytest.mark.parametrize(
    ("capabilities", "has"),
    [
        ({"architecture": "x86_64", "avx2": True, "avx512_bf16": False, "amx_bf16": False}, False),
        ({"architecture": "x86_64", "avx2": True, "avx512_bf16": True, "amx_bf16": False}, True),
        ({"architecture": "aarch64", "neon": True, "bf16": True}, True),
        ({"architecture": "aarch64", "neon": True, "bf16": False}, False),
    ],
)
def test_instructions_for_bfloat16_are_asked_for(capabilities, has, monkeypatch):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: capabilities)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert schema.has_bfloat16("cpu") == schema.has_bfloat16("auto") == has
    assert not schema.has_bfloat16("cuda:0")


def test_what_may_be_of_two_kinds_is_named_by_its_option():
    with pytest.raises(UserError) as error:
        loading.load(["experiment=demo", "compile=maybe"])
    assert str(error.value).splitlines() == [
        "compile=maybe: should be a valid boolean",
        "compile=maybe: should be 'auto'",
    ]


@pytest.mark.parametrize(("overrides", "told"), MISTAKES, ids=[str(m[0]) for m in MISTAKES])
def test_a_mistake_is_one_clear_line(overrides, told):
    with pytest.raises(UserError) as error:
        loading.load(overrides)
    message = str(error.value)
    assert len(message.splitlines()) == 1
    for words in told:
        assert words in message


def test_options_of_other_worlds_are_told_one_by_one():
    with pytest.raises(UserError) as error:
        loading.load(["experiment=labyrinth_compact", "environment.split=gridworld"])
    assert str(error.value).splitlines() == [
        f"environment.{option}: the envs of split=gridworld have no such option; "
        "experiment=labyrinth_compact, which is for other envs, sets it: choose another experiment"
        for option in ("backend", "image_size", "num_actions", "action_repeat")
    ]


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("updates=glob(*)", "list the values, as in updates=a,b"),
        ("condition=glob(*)", "list the values, as in condition=a,b"),
        ("agent.discount=interval(0,1)", "list the values"),
        ("seed=range(1000000000)", "more than 10,000 jobs"),
    ],
)
def test_a_sweep_is_over_lists_that_are_not_endless(override, told):
    with pytest.raises(UserError, match=told):
        sweeps.check(["experiment=demo", override])


def test_the_agent_that_was_chosen_is_tried(monkeypatch):
    """And no other: an agent without a network cannot be refused for one."""

    def refuse(self, options, setting):
        raise ValueError("this agent needs something else")

    monkeypatch.setattr(feasibility, "_tried", {})  # other tests have the same options
    monkeypatch.setattr(Impala, "__init__", refuse)
    with pytest.raises(UserError, match=r"^this agent needs something else$"):
        loading.load(["experiment=demo", "agent.discount=0.5"])
    monkeypatch.setattr(Impala, "__init__", Agent.__init__)
    loading.load(["experiment=demo", "agent.discount=0.4", "network.patch=8"])


def test_how_much_ram_is_free_is_asked_each_time(monkeypatch):
    with monkeypatch.context() as context:
        context.setattr(feasibility, "free_ram", lambda: 1000)
        with pytest.raises(UserError, match=r"1\.0 kB are free"):
            loading.load(["experiment=demo"])
    loading.load(["experiment=demo"])


def test_a_memory_needs_no_option_that_is_its_size(monkeypatch):
    class WideOptions(Options):
        name: Literal["wide"]
        width: Size = 8

    def build(options, inputs):
        return MLPMemory(inputs, MLPOptions(name="mlp", size=options.width, layers=1))

    monkeypatch.setitem(MEMORIES._options, "wide", WideOptions)
    monkeypatch.setitem(MEMORIES._builds, "wide", build)
    assert loading.load(["experiment=demo", "memory=wide"]).memory.width == 8
    with pytest.raises(UserError, match=r"^memory\.width=70000: should be at most 65536$"):
        loading.load(["experiment=demo", "memory=wide", "memory.width=70000"])


@pytest.mark.parametrize(
    "wrong",
    [
        ["seeed=1", "memory=lstn", "seed=-1", "updates=many", "~network"],
        ["seeed=1", "precision=16"],
        ["device=cuda:99", "schedule.window=[9,1]"],
    ],
)
def test_all_mistakes_are_told_at_once(wrong):
    with pytest.raises(UserError) as error:
        loading.load(["experiment=demo", *wrong])
    assert len(str(error.value).splitlines()) == len(wrong)


def test_a_sweep_is_checked_before_it_starts():
    six = ["experiment=demo", "seed=0,1,2", "memory=mlp,lstm"]
    assert len(sweeps.check(six).jobs) == 6
    jobs = sweeps.check(["experiment=demo", "seed=range(4)"]).jobs
    assert [job.config.seed for job in jobs] == [0, 1, 2, 3]
    with pytest.raises(UserError) as error:
        sweeps.check(["experiment=demo,gridwrld", "seed=0,-1"])
    lines = str(error.value).splitlines()
    assert any("seed=-1" in line for line in lines)
    assert any("gridwrld" in line for line in lines)


def test_the_command_line_changes_parts_of_a_row():
    start = ["experiment=gridworld", "condition=impala_byol"]
    usual = loading.load(start).row
    asked = loading.load([*start, 'row.title="Ours, longer"', "row.line=dashed"]).row
    assert asked == usual.model_copy(update={"title": "Ours, longer", "line": "dashed"})
    assert loading.load([*start, "name=ours", 'row.title="Ours"']).row.title == "Ours"
    assert loading.load([*start, "name=ours"]).row.title == "ours"
    for given in (['row.title="Ours"', "row.order=3"], ["row={title: Ours, order: 3}"]):
        for plain in (["experiment=demo"], start):
            row = loading.load([*plain, "name=ours", *given]).row
            assert (row.title, row.order, row.colour) == ("Ours", 3, None)
    for plain in (start, ["experiment=demo"]):
        with pytest.raises(UserError, match=r"row.titel: no such option; did you mean row.title"):
            loading.load([*plain, "row.titel=Ours"])


def test_the_last_seed_counts():
    assert loading.load(["experiment=demo", "seed=1", "++seed=2"]).seed == 2
    assert loading.load(["experiment=demo", "++seed=2"]).seed == 2


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("row=Mine", "row=Mine: should be row.title="),
        ("pretrained.parts=[memory]", "pretrained.parts: are of another run; give pretrained.run="),
        ('row.title="a\\nb"', "row.title="),
        ("row.order=inf", "row.order=inf"),
        ("schedule.window=[0,1000000000000000]", "schedule.window"),
    ],
)
def test_what_a_run_could_not_describe_or_would_ignore_is_refused(given, told):
    with pytest.raises(UserError, match=re.escape(told)):
        loading.load(["experiment=demo", given.replace("\\n", "\n")])


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (
            ["processes=1"],
            "processes=1: the envs of gridworld are stepped by one thread; leave",
        ),
        (["processes=0"], "processes=0"),
        ([LIFT, "processes=9", "collector.num_envs=4"], "processes=9: should be at most 4, the"),
        ([LIFT, "processes=2000", "collector.num_envs=4000"], "processes=2000: should be at most "),
        ([LIFT, "processes=1", "threads=1"], "processes=1, threads=1: step the same envs; leave"),
    ],
)
def test_processes_that_cannot_step_the_envs_are_refused(given, told):
    start = [] if LIFT in given else ["experiment=demo"]
    with pytest.raises(UserError, match=re.escape(told)):
        loading.load([*start, *given])


def test_an_option_without_its_group_is_found_in_all_groups():
    with pytest.raises(UserError, match=r"lag: no such option; did you mean collector.lag\?"):
        loading.load(["experiment=gridworld", "lag=0"])
    with pytest.raises(UserError, match=r"did you mean memory.size or network.size\?"):
        loading.load(["experiment=gridworld_compact", "size=64"])


CONDITIONS = [
    (["experiment=gridworld"], "impala"),
    (["experiment=gridworld", "memory=mlp"], "impala_mlp"),
    (["experiment=demo"], "impala_mlp"),
    (["experiment=demo", "memory=lstm"], "impala"),
    (["experiment=gridworld", "network=compact"], "impala-network_compact"),
    (["experiment=gridworld_compact", "exploration=none"], "impala_mlp-exploration_none"),
    (["experiment=gridworld", "agent.discount=0.9"], "impala-discount_0.9"),
    (["experiment=gridworld", "agent.discount=0.99"], "impala"),
    (["experiment=gridworld", "seed=3", "updates=7", "evaluation.every=2", "device=cpu"], "impala"),
    (["experiment=gridworld", "name=mine", "agent.discount=0.9"], "mine"),
    (["experiment=gridworld", "condition=r2d2", "name=mine"], "mine"),
    (["experiment=gridworld", "memory=gtrxl"], "impala_transformer"),
    (["experiment=gridworld", "auxiliary=byol_horizon"], "impala_byol_horizon"),
    (["experiment=gridworld", "critic=hl_gauss"], "impala_hl_gauss"),
    (
        ["experiment=gridworld", "critic=quantile", "critic.kappa=1"],
        "impala_quantile-kappa_1",
    ),
    (["experiment=gridworld", "agent=r2d2", "critic=quantile"], "r2d2_quantile"),
    (["experiment=gridworld", "condition=r2d2", "critic=quantile"], "r2d2-critic_quantile"),
    (["experiment=gridworld_compact", "condition=impala_rnd"], "impala_rnd"),
    (["experiment=gridworld", "episodic=dictionary"], "impala_dictionary"),
    (["experiment=demo", "episodic=mem"], "impala_mlp_mem"),
    (["experiment=gridworld", "condition=impala_mem", "episodic=none"], "impala_mem-episodic_none"),
    (["experiment=gridworld", "agent=vmpo"], "vmpo-layers_1"),
    (["experiment=gridworld", "agent=vmpo", "memory.layers=2"], "vmpo"),
    (["experiment=gridworld", "condition=r2d2", "agent.epsilon=0.2"], "r2d2-epsilon_0.2"),
    (["experiment=gridworld", "condition=r2d2", "memory=mlp"], "r2d2-memory_mlp"),
    (
        ["experiment=gridworld", "agent=r2d2", "agent.priority_exponent=0.0"],
        "r2d2-priority_exponent_0.0",
    ),
    (["experiment=demo", "condition=impala_mlp"], "impala_mlp"),
    (["experiment=playroom_lift_compact"], "impala"),
    (["experiment=gridworld", "precision=auto"], "impala-precision_auto"),
    (["experiment=demo", "condition=impala", "network=resnet"], "impala-network_resnet"),
    (
        ["experiment=demo", "condition=impala_mlp", "agent.discount=0.9"],
        "impala_mlp-discount_0.9",
    ),
]


@pytest.mark.parametrize(("overrides", "condition"), CONDITIONS)
def test_a_condition_is_named_after_what_differs(overrides, condition):
    loaded = loading.load([*overrides, "run_root=here"])
    assert loaded.condition == condition
    assert loaded.folder.parts == ("here", loaded.experiment, condition, f"seed{loaded.seed}")


def test_the_shipped_environment_is_the_released_benchmark():
    environment = loading.load(["experiment=gridworld"]).environment.model_dump()
    assert environment == {"split": "gridworld", **GridworldOptions().model_dump()}
    assert loading.load(["experiment=gridworld_compact"]).is_released_benchmark
    assert not loading.load(
        ["experiment=gridworld", "environment.num_maps=6"]
    ).is_released_benchmark


# The paper, the release, another paper by its year or name, a default of one, or ourselves.
SOURCE = re.compile(
    r"\b(paper|ours|released|same|default|(19|20)\d\d|FARM|SPR|BYOL-Explore)\b", re.IGNORECASE
)


def without_source(text):
    """The lines of a YAML file, or of a class of options, with a number whose comment, on the same
    line, does not say where it comes from."""
    lines = (line.partition("#") for line in text.splitlines())
    return [
        setting.strip()
        for setting, _, comment in lines
        if re.search(r"\b\d", setting) and not SOURCE.search(comment)  # r2d2 is a name
    ]


def test_a_number_needs_more_than_a_comment():
    lines = (
        "a: 1",
        "b: 2  # fast",
        "c: 3  # ours: fast",
        "d: [4]  # Adam 2015",
        "e: 0.5  # papers",
    )
    assert without_source("\n".join((*lines, "name: r2d2"))) == ["a: 1", "b: 2", "e: 0.5"]


def test_every_number_has_a_source():
    for path in config_files.CONFIG_DIR.glob("**/*.yaml"):
        text, _, _ = path.read_text().partition("\nhydra:\n")  # what follows is about the command
        assert without_source(text) == [], path
    for path in Path(zipf.envs.__file__).parent.glob("*/__init__.py"):
        classes = re.findall(r"^class \w+Options.*?(?=^\S)", path.read_text(), re.M | re.S)
        fields = (line for line in "".join(classes).splitlines() if "= " in line)
        assert without_source("\n".join(fields)) == [], path


@pytest.mark.parametrize(
    ("given", "threads"),
    [([], 8), (["collector.lag=0", "collector.num_envs=512"], 16), (["collector.num_envs=512"], 15),
     (["collector.num_envs=8"], 1), (["threads=2"], 2), (["processes=2"], 1)],
)  # fmt: skip
def test_as_many_threads_step_envs_as_slices_are_worth(given, threads, monkeypatch):
    monkeypatch.setattr(torch, "get_num_threads", lambda: 16)
    config = loading.load(["experiment=playroom_lift_compact", *given])
    assert config.env_threads == threads
