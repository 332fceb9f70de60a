"""What is collected from tensor environments is what the host's collector collects."""

from functools import partial

import numpy as np
import pytest
import torch
from conftest import assert_equal, call, metrics_of
from fake_cuda import DEVICE as FAKE
from fake_cuda import backward, capture_safe, fake_cuda
from host_env import Host
from tape import Tape

from zipf import envs
from zipf.agents.capture import CaptureFailed
from zipf.agents.learner import Learner
from zipf.agents.unroll import changed
from zipf.errors import UserError
from zipf.experiments.building import checkpoint, factory, loading
from zipf.experiments.building.factory import build_agent
from zipf.experiments.hooks.augmentation import RandomAugmentation
from zipf.experiments.hooks.tensor import View
from zipf.experiments.options import schema
from zipf.experiments.training import runner
from zipf.experiments.training.build_collector import build_collector, build_tensor_collector
from zipf.experiments.training.rollouts import (
    BackgroundRollouts,
    SynchronousRollouts,
    TensorRollouts,
)
from zipf.experiments.training.tensor_collector import Tally

pytestmark = pytest.mark.usefixtures("all_patches")

ENVS, STEPS, LIMIT = 6, 9, 7
SMALL = {"num_maps": 5, "num_rooms": [2, 2], "num_objects": 5, "max_steps": LIMIT}
TINY = [
    "name=x",
    "experiment=demo",
    f"collector.num_envs={ENVS}",
    f"collector.unroll_length={STEPS}",
    "environment.num_maps=5",
    "environment.num_rooms=[2,2]",
    "environment.num_objects=5",
    f"environment.max_steps={LIMIT}",
    "memory.size=16",
]
R2D2 = ("agent=r2d2", "agent.burn_in=2", "agent.replay_min=6", "agent.replay_capacity=24")
SHOWN_LAST = ("observation", "previous_action", "previous_reward", "is_first", "draw")


def both(*overrides, reports_success=True):
    """The host's collector, and that of tensors over an equal batch, with equal agents."""
    config = loading.load([*TINY, *overrides])
    made = partial(envs.make_vec, config.split.train[0].level, ENVS, **SMALL)
    plain, batch = made(), made()
    plain.reports_success = batch.reports_success = reports_success
    goal = envs.family_of_split(config.split.name).make_goal(batch)
    tensors = Host(batch, goal, envs.symmetries(config.split, batch), LIMIT)
    host = build_collector(config, plain, build_agent(config, plain))
    return host, build_tensor_collector(config, tensors, build_agent(config, tensors))


def fields(unroll):
    """What an unroll's rows hold, the rows that are valid."""
    steps = unroll.steps
    rows = {name: len(steps) if name in SHOWN_LAST else len(steps) - 1 for name in steps.keys()}
    found = {name: steps[name][: rows[name]] for name in rows}
    return found | {"observation": found["observation"].to_dict()}


@pytest.mark.parametrize(
    "chosen",
    [
        ("memory=mlp", "exploration=count"),
        ("memory=lstm",),
        ("memory=gtrxl", "memory.memory_length=4", "memory.heads=2", "memory.layers=1"),
        ("agent=vmpo",),
        R2D2,
        ("collector.bootstrap_at_time_limit=false",),
        ("collector.reward_clipping=soft_asymmetric",),
    ],
    ids=lambda chosen: chosen[0],
)
def test_unrolls_are_those_of_the_host(chosen):
    host, tensors = both(*chosen)
    truncated = ended = 0
    for _ in range(4):
        one, other = host.collect(), tensors.collect()
        here, there = fields(one), fields(other)
        truncated += int(here["truncated"].sum())
        ended += int((here["truncated"] | here["terminated"]).sum())
        torch.testing.assert_close(
            here.pop("truncation_value"), there.pop("truncation_value"), rtol=1e-5, atol=1e-6
        )
        assert_equal(here, there)
        assert_equal(one.memory, other.memory)
        assert_equal(one.late_memory or {}, other.late_memory or {})
        assert (one.final is None) == (other.final is None)
        if one.final is not None:
            assert_equal(one.final.to_dict(), other.final.to_dict())
    assert ended > 0
    assert (truncated > 0) == ("collector.bootstrap_at_time_limit=false" not in chosen)


def test_envs_may_have_no_success():
    _, tensors = both("memory=mlp", reports_success=False)
    tally = Tally(tensors)
    for _ in range(3):
        tensors.collect()
        tally.add(tensors.outcomes, tensors.met)
    found = tally.metrics()
    assert list(found) == ["episode_return", "episode_length"]
    assert 1 <= found["episode_length"] <= LIMIT


class Readings(Host):
    """Codes of floats and truth values."""

    def observe(self):
        shown = super().observe()
        return {"light": shown["image"].float().mean((1, 2, 3)), "lit": shown["image"][:, 0] > 9}


def test_codes_may_be_of_any_numbers():
    env = Readings(envs.make_vec("gridworld/uniform", 2, **SMALL))
    space = factory._space(env)
    assert {name: (part.dtype, part.shape) for name, part in space.items()} == {
        "light": (np.float32, ()),
        "lit": (np.bool_, env.observe()["lit"].shape[1:]),
    }


def test_bonuses_and_their_counts_are_those_of_the_host():
    host, tensors = both("exploration=count")
    for _ in range(3):
        bonus = [collector.collect().steps["bonus"][:-1] for collector in (host, tensors)]
        assert (bonus[0] > 0).all()
        assert_equal(*bonus)
    counts = [
        next(hook for hook in collector.hooks if hook.name == "exploration").visits
        for collector in (host, tensors)
    ]
    np.testing.assert_array_equal(counts[0], counts[1].numpy())
    assert counts[0].max() > 5


def episodes_of(unroll):
    """The relabelled episodes of an unroll, each as bytes, in any order."""
    found, episodes = [], unroll.episodes
    for e in range(0 if episodes is None else episodes.shape[1]):
        rows = episodes[:, e][episodes["mask"][:, e]]
        flat = {"observation": rows["observation"].to_dict(), **rows.exclude("observation")}
        parts = [rows["observation", name] for name in flat["observation"]]
        parts += [rows[name] for name in sorted(flat) if name != "observation"]
        if len(rows):
            found.append(b"".join(part.contiguous().numpy().tobytes() for part in parts))
    return sorted(found)


@pytest.mark.parametrize("length", ["null", "3"])
def test_relabelled_episodes_are_those_of_the_host(length):
    """All of them, where there is room for as many."""
    host, tensors = both(
        "hindsight=achieved", "hindsight.episodes=50", f"hindsight.length={length}"
    )
    # Draws of its own, so that actions are the host's.
    next(hook for hook in tensors.hooks if hook.name == "hindsight")._generator = torch.Generator()
    count = 0
    for _ in range(12):
        one, other = episodes_of(host.collect()), episodes_of(tensors.collect())
        assert one == other
        count += len(one)
    assert count > 20


def test_fewer_relabelled_episodes_are_drawn_alike():
    """Each of those of an unroll is as likely to be among them."""
    _, tensors = both("hindsight=achieved", "hindsight.episodes=50")
    hook = next(hook for hook in tensors.hooks if hook.name == "hindsight")
    unroll = tensors.collect()
    all_of_them = episodes_of(unroll)
    assert len(all_of_them) > 3
    hook.episodes = 2
    drawn = dict.fromkeys(all_of_them, 0)
    for seed in range(300):
        keys = torch.rand(hook._keys.shape, generator=torch.Generator().manual_seed(seed))
        hook._keys.copy_(torch.where(hook._keys >= 0, keys, hook._keys))
        hook.finish(unroll)
        for one in episodes_of(unroll):
            drawn[one] += 1
    expected = 600 / len(drawn)
    assert sum(drawn.values()) == 600
    assert all(0.6 * expected < count < 1.4 * expected for count in drawn.values())


@pytest.mark.parametrize("parts", [["symmetries"], ["channels"], ["symmetries", "channels"]])
def test_a_view_is_the_augmentation_of_what_is_decoded(parts):
    config = loading.load(
        [*TINY, "augmentation=random"]
        + [
            f"augmentation.{name}={str(name in parts).lower()}"
            for name in ("symmetries", "channels")
        ]
    )
    env = envs.make_tensor(config.split, 200, "cpu", **SMALL)
    env.reset(0)
    batch = envs.make_vec(config.split.train[0].level, 1, **SMALL)
    plain = RandomAugmentation(
        config.augmentation,
        env.single_observation_space,
        symmetries=envs.symmetries(config.split, batch),
    )
    view = View(env, plain)
    draw = view.draw(torch.Generator().manual_seed(1), 200)
    assert (draw[:, 0].unique().numel() > 20) == ("symmetries" in parts)
    assert (draw[:, 1:4].unique(dim=0).shape[0] == 6) == ("channels" in parts)
    codes = env.observe()
    assert_equal(view(codes, draw), plain(env.decode(codes), draw))
    assert_equal(view(codes, None), env.decode(codes))
    actions = torch.randint(-1, 8, (200,))
    expected = plain.to_env(actions.numpy(), draw.numpy())
    np.testing.assert_array_equal(view.to_env(actions, draw), expected)


def test_an_agent_sees_an_augmented_env_and_acts_in_the_plain_one():
    """What it learns from is what it saw when it acted; its actions are of the turned view."""
    config = loading.load([*TINY, "augmentation=random", "memory=mlp", "network=compact"])
    env = envs.make_tensor(config.split, ENVS, "cpu", **SMALL)
    agent = build_agent(config, env)
    collector = build_tensor_collector(config, env, agent)
    for _ in range(3):
        unroll = collector.collect()
        seen = changed(unroll.steps, agent.augmentation)
        flat = {"image": seen["observation", "image"][:-1].flatten(0, 1)}
        assert flat["image"].shape[1:] == (63, 63, 3)
        begins, draw = unroll.steps["is_first"][1:], unroll.steps["draw"]
        stays = (draw[1:] == draw[:-1]).all(-1)
        assert stays[~begins].all()
        assert not stays[begins].all()


@pytest.mark.parametrize("chosen", [(), ("memory=lstm", "hindsight=achieved"), R2D2])
def test_a_collector_goes_on_where_its_state_was_saved(chosen):
    config = loading.load([*TINY, "augmentation=random", "exploration=count", *chosen])

    def build():
        env = envs.make_tensor(config.split, ENVS, "cpu", **SMALL)
        return build_tensor_collector(config, env, build_agent(config, env))

    one, other = build(), build()
    for _ in range(2):
        one.collect()
    state = one.state_dict()
    expected = [one.collect().clone().state_dict() for _ in range(2)]
    other.collect()
    other.load_state_dict(state)
    for unroll in expected:
        assert_equal(other.collect().state_dict(), unroll)


@pytest.mark.parametrize("parts", [1, 3])
@pytest.mark.parametrize("lag", [0, 1])
def test_updates_are_those_of_host_rollouts(lag, parts):
    """Also where an update learns from a part of an unroll, bit for bit."""
    chosen = [
        f"collector.envs_per_update={ENVS // parts}",
        "collector.bootstrap_at_time_limit=false",
    ]
    chosen += ["updates=12", "evaluation.every=12", "schedule.checkpoint_every=12"]
    host, tensors = both(*chosen, "memory=lstm")
    agents = host.agent, tensors.agent
    if lag:
        plain = BackgroundRollouts(host, agents[0], parts)
    else:
        plain = SynchronousRollouts(host, parts)
    try:
        rollouts = plain, TensorRollouts(tensors, parts, lag)
        for _ in range(12):
            steps = [one.step(agent.update) for one, agent in zip(rollouts, agents, strict=True)]
            assert_equal(*(fields(unroll) for unroll, _ in steps))
        assert_equal(*(agent.network.state_dict() for agent in agents))
        met = [one.visits.state_dict() for one in rollouts]
        assert sorted(counts(met[0])) == sorted(counts(met[1]))
        assert_equal(*(dict(sorted(one.metrics().items())) for one in rollouts))
    finally:
        plain.close()


def counts(state):
    return [(*map(int, one), int(n)) for one, n in zip(*state.values(), strict=True)]


def test_parts_are_all_envs_and_take_turns():
    """Every update of an unroll learns from other envs, and each comes first in its turn."""
    _, tensors = both("collector.envs_per_update=2", "updates=9", "evaluation.every=9",
                      "schedule.checkpoint_every=9")  # fmt: skip
    rollouts = TensorRollouts(tensors, 3)
    first = []
    for _ in range(3):
        offsets = []
        for _ in range(3):
            part, whole = rollouts.step(lambda unroll: None)[0], rollouts._unroll
            found = [
                k
                for k in range(3)
                if torch.equal(part.steps["action"], whole.steps["action"][:, k::3])
            ]
            offsets += found[:1]
        first.append(offsets[0])
        assert sorted(offsets) == [0, 1, 2]
    assert sorted(first) == [0, 1, 2]


@pytest.mark.parametrize(
    "chosen",
    [
        ("memory=mlp",),
        ("memory=lstm", "augmentation=random", "hindsight=achieved", "exploration=count"),
        ("memory=gtrxl", "memory.memory_length=4", "memory.heads=2", "memory.layers=1"),
        ("agent=vmpo", "memory=lstm"),
        R2D2,
    ],
    ids=lambda chosen: "-".join(chosen)[:40],
)
def test_captured_unrolls_are_those_of_the_function(chosen):
    """From the first, and after a state was loaded; with other weights in every unroll."""
    config = loading.load([*TINY, *chosen])

    def build():
        env = envs.make_tensor(config.split, ENVS, "cpu", **SMALL)
        return build_tensor_collector(config, env, build_agent(config, env))

    plain, captured = build(), build()
    captured.capture(Tape)
    state = None
    for unroll in range(6):
        if unroll == 3:
            state = plain.state_dict()
        if unroll == 4:
            for collector in (plain, captured):
                collector.load_state_dict(state)
        for collector in (plain, captured):
            with torch.no_grad():
                for weight in collector.agent.actor.parameters():
                    weight.mul_(1.1)
        one, other = (collector.collect().state_dict() for collector in (plain, captured))
        assert_equal(one, other)
        assert_equal(plain.outcomes, captured.outcomes)
        assert_equal(plain.met, captured.met)
    assert captured._captured.graph.replays == 6


@pytest.mark.parametrize(
    "chosen",
    [
        ("memory=mlp", "exploration=count", "collector.reward_clipping=soft_asymmetric"),
        ("memory=lstm", "augmentation=random", "hindsight=achieved", "network=comparing"),
        ("memory=gtrxl", "memory.memory_length=4", "memory.heads=2", "memory.layers=1"),
        ("agent=vmpo", "collector.bootstrap_at_time_limit=false"),
        ("agent=impala", "auxiliary=vision"),
        ("agent=r2d2", "agent.burn_in=2", "augmentation=random"),
    ],
    ids=lambda chosen: "-".join(chosen)[:40],
)
def test_unrolls_and_losses_never_wait_for_the_device(chosen, monkeypatch):
    """On a device that there is not, where reading a number, a shape that depends on numbers, and a
    tensor of the host are errors."""
    config = loading.load([*TINY, *chosen])
    monkeypatch.setattr(schema, "find_device", lambda _: FAKE)
    with fake_cuda():
        env = envs.make_tensor(config.split, ENVS, FAKE, **SMALL)
        agent = build_agent(config, env)
        collector = build_tensor_collector(config, env, agent)
        with capture_safe():
            unroll = collector._play()
            if config.agent.name != "r2d2":  # whose loss reads what replay holds
                backward(agent.loss(agent.seen(unroll)).loss)
    assert unroll.steps.batch_size == (STEPS + 1, ENVS)


DEVICE = [*TINY, "collector.envs=device", "device=cpu", "evaluation.episodes=2", "updates=4",
          "schedule.log_every=1", "schedule.checkpoint_every=2"]  # fmt: skip


def test_a_run_on_the_device_is_resumed_bit_for_bit(tmp_path):
    chosen = [*DEVICE, "exploration=count", "augmentation=random", "hindsight=achieved"]
    whole = loading.load([*chosen, f"run_root={tmp_path}/whole"])
    assert runner.train(whole) == 0
    for updates in (2, 4):
        config = loading.load([*chosen, f"run_root={tmp_path}/halves", f"updates={updates}"])
        assert runner.train(config) == 0
    states = [checkpoint.load(one.folder / "checkpoint.pt") for one in (whole, config)]
    for part in ("agent", "source"):
        assert_equal(*(state[part] for state in states))
    assert metrics_of(whole.folder)["episode_length"].notna().all()


def moves(chosen, plan, capsys):
    """A run whose envs are stepped here and there, up to these updates: where, what is said, and
    what its checkpoint has of the envs."""
    for updates, where in plan:
        config = loading.load([*chosen, f"updates={updates}", f"collector.envs={where}"])
        assert runner.train(config) == 0
        shown = capsys.readouterr()
        source = checkpoint.load(config.folder / "checkpoint.pt")["source"]
        yield updates, where, shown.out + shown.err, source


def test_a_run_goes_on_on_the_host_and_back(tmp_path, capsys):
    """With its weights, visits and counts, and with new episodes, and says so."""
    chosen = [*TINY, "device=cpu", "evaluation.episodes=2", "exploration=count",
              f"run_root={tmp_path}"]  # fmt: skip
    met = []
    plan = (2, "host"), (4, "device"), (6, "host")
    for updates, where, said, source in moves(chosen, plan, capsys):
        assert (f"envs are stepped on the {where} now" in said) == (updates > 2)
        if where == "device":
            visits = source["tally"]["visits"]
            table = source["tensor_envs"]["hooks"]["exploration"]["visits"]
        else:
            visits = source.get("visits", source["collector"]["visits"])
            table = source["collector"]["exploration"]["visits"]
        met.append((int(visits["episodes"].sum()), int(table.sum())))
    assert met[0][0] < met[1][0] < met[2][0]
    # Lag 1: an unroll is collected ahead, and given up where a run moves.
    assert [total for _, total in met] == [3 * ENVS * STEPS, 6 * ENVS * STEPS, 9 * ENVS * STEPS]


@pytest.mark.parametrize("first", [1, 3])
def test_a_replay_is_left_behind_where_envs_move(tmp_path, capsys, first):
    """It holds images on the host and codes on the device, and so does the burn-in that waits for
    the first sequences. New episodes are others."""
    chosen = [*TINY, *R2D2, "agent.storage=ram", "device=cpu", "evaluation.episodes=2",
              f"run_root={tmp_path}"]  # fmt: skip
    episodes = []
    plan = (first, "host"), (6, "device"), (9, "host")
    for updates, where, said, source in moves(chosen, plan, capsys):
        assert ("the replay was left behind" in said) == (updates > first)
        if where == "host":
            episodes.append(source["collector"]["environment"]["streams"])
    assert not np.array_equal(*episodes)


def test_a_run_whose_replay_was_left_behind_begins_with_a_checkpoint(tmp_path, monkeypatch):
    """Its first sequences take the place of the files that the checkpoint before refers to."""
    chosen = [*TINY, *R2D2, "agent.storage=memmap", "device=cpu", "evaluation.episodes=2",
              f"run_root={tmp_path}"]  # fmt: skip
    assert runner.train(loading.load([*chosen, "updates=4", "collector.envs=host"])) == 0
    config = loading.load([*chosen, "updates=8", "collector.envs=device"])
    with monkeypatch.context() as patched:
        patched.setattr(runner.Run, "step", lambda self: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            runner.train(config)
    saved = checkpoint.load(config.folder / "checkpoint.pt")
    assert saved["update"] == 4
    assert "tensor_envs" in saved["source"]
    assert runner.train(config) == 0


def test_a_stored_memory_is_that_before_its_sequence():
    """Also without lag, where the next unroll is written over the one before."""
    late = []
    _, tensors = both(*R2D2, "agent.storage=ram", "memory=lstm", "agent.replay_capacity=240")
    agent = tensors.agent
    agent.begin_learning(None, 1)
    rollouts = TensorRollouts(tensors, 1, 0)

    def learn(unroll):
        late.append({name: part.clone() for name, part in unroll.late_memory.items()})
        return agent.update(unroll)

    for _ in range(4):
        rollouts.step(learn)
    stored = agent.replay._items["memory"][: 3 * ENVS]
    for k in range(3):  # a run's first unroll has no burn-in, and is not stored
        assert_equal(stored[k * ENVS : (k + 1) * ENVS].to_dict(), late[k])


def test_envs_without_a_tensor_form_are_named(tmp_path):
    where = ["collector.envs=device", "device=cpu", f"run_root={tmp_path}"]
    with pytest.raises(UserError) as error:
        loading.load(["experiment=playroom_lift_compact", *where])
    assert str(error.value) == (
        "collector.envs=device: environment.split=playroom_lift takes envs on the host; choose "
        "host or auto"
    )


@pytest.mark.parametrize(
    ("chosen", "said"),
    [
        ("exploration=rnd", "exploration=rnd takes envs on the host"),
        ("agent=imitation", "agent=imitation takes envs on the host"),
        ("hindsight=achieved hindsight.kept_per_goal=2", "hindsight.kept_per_goal=2 takes envs"),
        ("augmentation=random augmentation.shift=2", "augmentation.shift=2 takes envs on the host"),
    ],
)
def test_what_takes_the_host_is_named(chosen, said, tmp_path):
    finished = call(*DEVICE, *chosen.split(), f"run_root={tmp_path}")
    assert finished.returncode != 0
    assert said in finished.stderr
    assert "Traceback" not in finished.stderr


@pytest.mark.parametrize(
    ("chosen", "said"),
    [
        ("collector.envs_per_update=4", "should divide collector.num_envs=6"),
        ("collector.envs_per_update=3 updates=5", "updates=5: should be a multiple of 2"),
        (" ".join(("collector.envs_per_update=3", *R2D2)), "agent=r2d2 learns from all envs"),
        ("collector.envs_per_update=3 agent=vmpo agent.target_period=5", "agent.target_period=5"),
    ],
)
def test_parts_that_do_not_divide_are_named(chosen, said, tmp_path):
    finished = call(*DEVICE, *chosen.split(), f"run_root={tmp_path}")
    assert finished.returncode != 0
    assert said in finished.stderr


def test_more_than_the_device_holds_is_refused_before_anything_is_built(tmp_path):
    given = [*DEVICE, "collector.num_envs=100000000", f"run_root={tmp_path}"]
    finished = call(*given)
    assert finished.returncode != 0
    assert "unrolls and the images of an update take" in finished.stderr
    # Codes of as many fit, and the images of a part of them.
    parts = ["collector.num_envs=100000", "collector.envs_per_update=100", "updates=4000"]
    parts += ["evaluation.every=1000", "schedule.checkpoint_every=1000", f"run_root={tmp_path}"]
    assert loading.load([*DEVICE, *parts]).updates_per_unroll == 1000


def test_what_cannot_be_captured_ends_a_run_with_a_line(tmp_path, monkeypatch):
    def fail(self):
        raise CaptureFailed("the loss of an update cannot be captured; choose capture=false")

    monkeypatch.setattr(runner, "captures", lambda config: True)
    monkeypatch.setattr(Learner, "capture", fail)
    finished = call(*DEVICE, f"run_root={tmp_path}")
    assert finished.returncode != 0
    assert finished.stderr.strip().splitlines()[-1].endswith("choose capture=false")
    assert "Traceback" not in finished.stderr
