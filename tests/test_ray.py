"""Actors in a Ray cluster: what is learned from, and what is lost with a process or a node."""

import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from types import SimpleNamespace

import pandas as pd
import pytest
import torch
from conftest import PACKAGE, TINY, assert_equal, learned, metrics_of

from zipf import envs
from zipf.agents.agent import agents
from zipf.errors import UserError
from zipf.experiments.building import loading, run_folder
from zipf.experiments.building.factory import build_agent
from zipf.experiments.cluster import runtime_of
from zipf.experiments.cluster.ray_actors import RayActors
from zipf.experiments.options import runtime
from zipf.experiments.training import runner
from zipf.experiments.training.build_collector import build_collector

OPTIONS = [*TINY, "exploration=none", "schedule.checkpoint_every=2", "name=row"]
FRAMES = 6 * 5  # of an update
R2D2 = ["agent.storage=ram", "agent.burn_in=2", "agent.replay_min=12", "agent.replay_capacity=24"]
MORE = {"r2d2": R2D2, "imitation": ["episodic=dictionary"], "impala": ["episodic=dictionary"]}


def load(folder, *overrides):
    return loading.load([*OPTIONS, f"run_root={folder}", *overrides])


def test_a_task_of_the_launcher_that_failed_says_why():
    """Ray's message begins with where the task was, and ends with the cause."""
    from zipf.experiments.cluster.ray_launcher import _result

    class RayError(Exception): ...

    class RayTaskError(RayError):
        cause: Exception | None = ModuleNotFoundError("No module named 'mine'")

    def told(error):
        def get(_):
            raise error

        errors = SimpleNamespace(RayError=RayError, RayTaskError=RayTaskError)
        return str(_result(SimpleNamespace(get=get, exceptions=errors), None)._return_value)

    failed = RayTaskError("ray::task (pid=7)\nTraceback\nValueError: 3")
    assert told(failed) == "ModuleNotFoundError: No module named 'mine'"
    failed.cause = None
    assert told(failed) == "ValueError: 3"
    assert told(RayError("The node died.\nIts disk was full.")) == "The node died."


# What is refused, and how runs are named


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["agent=vmpo"], r"runtime=ray: agent=vmpo does not correct for older weights; choose "),
        (["collector.lag=1"], r"collector\.lag=1: is of runtime=local; .* runtime\.ahead$"),
        (["runtime.ahead=3"], r"runtime\.ahead=3: "),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(overrides, told, tmp_path):
    with pytest.raises(UserError, match=f"^{told}") as error:
        load(tmp_path, "runtime=ray", *overrides)
    assert "\n" not in str(error.value)


@pytest.mark.slow
@pytest.mark.parametrize("address", ["127.0.0.1:1", "nonsense"])
def test_a_cluster_that_is_not_there_is_told_at_once(address, tmp_path):
    config = load(tmp_path, "runtime=ray", f"runtime.address={address}")
    with pytest.raises(UserError, match=rf"^runtime\.address={address}: no cluster there: "):
        runner.train(config, runtime_of(config))


def test_without_ray_it_is_said_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setattr(runtime, "find_spec", lambda name: None)
    wrong = r'^runtime=ray: needs Ray: pip install "\.\[ray\]" in a clone of zipf$'
    with pytest.raises(UserError, match=wrong):
        load(tmp_path, "runtime=ray")
    load(tmp_path)


def test_ray_is_imported_where_it_is_used():
    """Commands work without it, and a local run does not pay for it."""
    for path in (PACKAGE / "zipf").rglob("*.py"):
        assert not re.search(r"^(import|from) ray\b", path.read_text(), re.M), path


def test_a_run_in_a_cluster_is_a_row_of_its_own(tmp_path):
    """Wherever the cluster is; and neither runtime resumes the other."""
    unnamed = [option for option in OPTIONS if not option.startswith("name=")]
    names = [
        loading.load([*unnamed, *more]).condition
        for more in ([], ["runtime=ray"], ["runtime=ray", "runtime.address=auto"])
    ]
    assert names[1].replace("-runtime_ray", "") == names[0] != names[1] == names[2]
    local, cluster, elsewhere = (
        load(tmp_path, *more).what_is_learned
        for more in ([], ["runtime=ray"], ["runtime=ray", "runtime.address=auto"])
    )
    assert local != cluster == elsewhere


@pytest.mark.slow
def test_an_actor_that_never_plays_ends_the_run(tmp_path, monkeypatch):
    """But not one that dies now and then after it has played."""
    config = load(tmp_path, "runtime=ray", "runtime.actors=1")
    env = envs.make_train(config.split, 6, **config.level_options)
    source = RayActors(config, config.runtime, env, build_agent(config, env))
    monkeypatch.setattr(source, "_tell", lambda line: None)
    begun = []
    monkeypatch.setattr(source, "_begin", begun.append)
    monkeypatch.setattr("ray.kill", lambda handle: None)
    (actor,) = source.actors
    for _ in range(5):
        actor.has_played = True
        source._replace(actor, RuntimeError("gone. See the manual"))
    actor.has_played = False
    for _ in range(2):
        source._replace(actor, RuntimeError("gone. See the manual"))
    with pytest.raises(UserError, match=r"^runtime=ray: actor 0 died 3 times .*: gone$"):
        source._replace(actor, RuntimeError("gone. See the manual"))
    assert len(begun) == 7


def test_a_run_that_waits_for_actors_stops_with_a_checkpoint(tmp_path, monkeypatch):
    """A signal comes while no actor answers."""
    config = load(tmp_path, "runtime=ray", "runtime.actors=1", "updates=4")
    monkeypatch.setattr(RayActors, "_connect", lambda self: None)
    monkeypatch.setattr(
        RayActors, "_begin", lambda self, actor: self._calls.update({"call": actor})
    )

    def wait(references, timeout, **_):
        if timeout == 0:  # the first of two calls
            os.kill(os.getpid(), signal.SIGTERM)
        return [], references

    monkeypatch.setattr("ray.wait", wait)
    monkeypatch.setattr(RayActors, "close", lambda self: None)
    assert runner.train(config, runtime_of(config)) == signal.SIGTERM
    assert (config.folder / "checkpoint.pt").is_file()


# What agents carry from an unroll to the next of the same envs


@pytest.mark.parametrize("name", [name for name, one in agents().items() if one.largest_lag])
def test_what_is_carried_is_that_of_the_worlds(name, tmp_path):
    """It is the same whatever was learned from other envs in between, and goes on from there."""
    if agents()[name].answers_questions:
        pytest.skip("its episodes are a frame long")
    config = load(tmp_path, f"agent={name}", "collector.lag=0", *MORE.get(name, []))
    unrolls = []
    for player in (0, 0, 1):  # the first two are the same
        env = envs.make_train(config.split, 6, **config.level_options)
        collector = build_collector(config, env, build_agent(config, env), (player,))
        first = collector.collect()
        kept = type(first).of_state(clone(first.state_dict()))
        unrolls.append((kept, collector.collect()))
    (first, second), (same, _), (other, _) = unrolls
    assert_equal(first.steps.to_dict(), same.steps.to_dict())
    assert (first.steps["observation"] != other.steps["observation"]).any()
    alone, between = (build_agent(config, env) for _ in range(2))
    for agent in (alone, between):
        agent.begin_learning()
        agent.update(first)
    carried = between.carried()
    assert carried
    kept = clone(carried)
    between.carry({})
    between.update(other)
    assert_equal(carried, kept)
    between.carry(carried)
    assert_equal(between.carried(), alone.carried())
    for agent in (alone, between):
        agent.update(second)
    if name == "r2d2":  # others have learned from the other envs, or draw by the update
        assert_equal(between.state_dict(), alone.state_dict())


def clone(state):
    if isinstance(state, dict):
        return {name: clone(part) for name, part in state.items()}
    return state.clone() if isinstance(state, torch.Tensor) else state


# Runs in a cluster of several node processes


class Learned:
    """Watches what a run learns from: every unroll once, its frames counted."""

    def __init__(self, monkeypatch):
        self.unrolls = Counter()
        learn = runner.Run._learn

        def watched(run, unroll):
            steps = unroll.steps[:-1]
            content = (steps["observation", "image"], steps["action"], steps["logits"])
            self.unrolls[b"".join(part.numpy().tobytes() for part in content)] += 1
            self.frames += steps.numel()
            self.episodes += int((steps["terminated"] | steps["truncated"]).sum())
            return learn(run, unroll)

        self.frames = self.episodes = 0
        monkeypatch.setattr(runner.Run, "_learn", watched)


@pytest.fixture(scope="module")
def patch():
    with pytest.MonkeyPatch.context() as patched:
        yield patched


@pytest.fixture(scope="module")
def cluster(patch):
    """A head and two further nodes, with room for an actor each."""
    patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    patch.setenv("PYTHONPATH", str(PACKAGE))
    from ray.cluster_utils import Cluster

    memory = {"object_store_memory": 80 * 2**20}
    cluster = Cluster(
        initialize_head=True,
        head_node_args={"num_cpus": 0, "include_dashboard": False, **memory},
    )
    cluster.memory = memory
    cluster.extra = [cluster.add_node(num_cpus=1, **memory) for _ in range(2)]
    yield cluster
    cluster.shutdown()


@pytest.fixture(scope="module")
def watched(cluster, patch, tmp_path_factory):
    """A run with two actors, each on a node of its own, and what it has learned from."""
    config = load(
        tmp_path_factory.mktemp("runs"),
        *("runtime=ray", "runtime.actors=2", f"runtime.address={cluster.address}"),
        *("updates=100000", "evaluation.every=100000"),
    )
    run_folder.make(config.folder)
    learned_from = Learned(patch)
    with runner.Run(config, runtime_of(config)) as run:
        yield run, learned_from


def step(run, until):
    """Steps until something holds; the metrics of each step."""
    rows, end = [], time.monotonic() + 600
    while not until(rows):
        assert time.monotonic() < end
        run.step()
        rows.append(run.rollouts.metrics())
    return rows


def lag_bound(run):
    return 4 * run.config.runtime.actors * run.config.runtime.ahead


def check(run, learned_from, rows):
    """Frames counted are frames learned from, each unroll once, none by weights too old."""
    assert learned_from.frames == run.update * FRAMES == run.rollouts.version * FRAMES
    assert set(learned_from.unrolls.values()) == {1}
    assert len(learned_from.unrolls) == run.update
    assert max(row["lag_max"] for row in rows) <= lag_bound(run)


def both_contribute(run):
    """A condition for `step`: every actor's process has had an unroll learned from."""
    before = {actor.number: (actor.incarnation, actor.learned) for actor in run.rollouts.actors}
    return lambda rows: all(
        (actor.incarnation, actor.learned) > before[actor.number] and actor.learned > 0
        for actor in run.rollouts.actors
    )


def process_of(actor):
    import ray

    return ray.get(actor.handle.__ray_call__.remote(lambda player: os.getpid()))


@pytest.mark.slow
def test_actors_play_other_worlds_and_nothing_is_learned_from_twice(watched):
    run, learned_from = watched
    rows = step(run, both_contribute(run))
    rows += step(run, lambda rows: len(rows) == 10)
    check(run, learned_from, rows)
    assert any(row["lag_max"] > 0 for row in rows)
    assert all(row["actors_replaced"] == 0 for row in rows)
    visits = run.rollouts.visits.state_dict()["episodes"].sum()
    assert visits == learned_from.episodes > 0


@pytest.mark.slow
def test_a_slow_actor_holds_nobody_up(watched):
    """Stopped in the midst of an unroll, whose lag is too large when it goes on."""
    run, learned_from = watched
    step(run, both_contribute(run))
    slow, other = run.rollouts.actors
    process = process_of(slow)
    os.kill(process, signal.SIGSTOP)
    try:
        bound = lag_bound(run)
        rows = step(run, lambda rows: len(rows) > 3 * bound)
    finally:
        os.kill(process, signal.SIGCONT)
    played = slow.learned, other.learned
    rows += step(run, lambda rows: slow.learned > played[0])
    check(run, learned_from, rows)
    assert other.learned > 3 * bound
    assert sum(row["unrolls_discarded"] for row in rows) == 1
    assert all(row["actors_replaced"] == 0 for row in rows)


@pytest.mark.slow
def test_an_actor_that_dies_is_replaced(watched):
    run, learned_from = watched
    step(run, both_contribute(run))
    killed = run.rollouts.actors[0]
    incarnation = killed.incarnation
    os.kill(process_of(killed), signal.SIGKILL)
    rows = step(run, lambda rows: killed.incarnation > incarnation and killed.learned > 0)
    check(run, learned_from, rows)
    assert sum(row["actors_replaced"] for row in rows) == 1
    text = (run.folder / "train.log").read_text()
    assert len(re.findall(r"actor 0 is lost and replaced: ", text)) == 1


@pytest.mark.slow
def test_actors_of_a_node_that_is_lost_go_on_elsewhere(watched, cluster):
    run, learned_from = watched
    step(run, both_contribute(run))
    before = [actor.incarnation for actor in run.rollouts.actors]
    cluster.add_node(num_cpus=1, **cluster.memory)
    cluster.remove_node(cluster.extra.pop())

    def replaced(rows):
        now = [(actor.incarnation, actor.learned) for actor in run.rollouts.actors]
        return [number for number, _ in now] != before and all(learned for _, learned in now)

    rows = step(run, replaced)
    check(run, learned_from, rows)
    assert sum(row["actors_replaced"] for row in rows) == 1


@pytest.mark.slow
def test_more_actors_than_cores_and_another_cluster_are_refused(watched, cluster, tmp_path):
    address = f"runtime.address={cluster.address}"
    config = load(tmp_path, "runtime=ray", "runtime.actors=9", address)
    with pytest.raises(UserError, match=r"^runtime\.actors=9: the cluster has 2 cores, .*most 2$"):
        runner.train(config, runtime_of(config))
    config = load(tmp_path, "runtime=ray", "runtime.address=127.0.0.1:1")
    with pytest.raises(UserError, match=rf"^runtime\.address=127\.0\.0\.1:1: .*{cluster.address}"):
        runner.train(config, runtime_of(config))


# The command, with Ray on this machine


def begin(folder):
    """The command, leading a group of processes as one from a terminal does."""
    command = [
        *(sys.executable, "-m", "zipf.train", *OPTIONS, f"run_root={folder}", "updates=1000000"),
        *("runtime=ray", "runtime.actors=1", "evaluation.every=1000000"),
    ]
    return subprocess.Popen(
        command,
        env={**os.environ, "PYTHONPATH": str(PACKAGE)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def processes(marker):
    """Those whose environment has a variable of this value."""
    found = []
    for entry in os.scandir("/proc"):
        if entry.name.isdigit():
            try:
                with open(f"/proc/{entry.name}/environ", "rb") as file:
                    if marker.encode() in file.read():
                        found.append(int(entry.name))
            except OSError:
                pass
    return found


def wait(condition, seconds=400):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.1)


def rows_of(folder):
    """How many updates were logged."""
    path = folder / "metrics.csv"
    rows = path.read_text().splitlines()[1:] if path.exists() else []
    return len({row.split(",")[0] for row in rows})


@pytest.mark.slow
def test_the_driver_is_killed_and_the_same_command_goes_on(tmp_path, monkeypatch):
    """From its last checkpoint, until Ctrl-C. Neither leaves a process, and Ray says nothing."""
    monkeypatch.setenv("ZIPF_TEST_MARKER", marker := f"zipf-{os.getpid()}-driver")
    config = load(tmp_path, "runtime=ray", "runtime.actors=1", "updates=1000000")
    saved = []
    for number in (signal.SIGKILL, signal.SIGINT):
        rows = rows_of(config.folder)
        driver = begin(tmp_path)
        try:
            wait(lambda rows=rows: rows_of(config.folder) > rows + 4)
            if number == signal.SIGKILL:
                driver.kill()
            else:
                os.killpg(driver.pid, number)
            output, _ = driver.communicate(timeout=100)
            wait(lambda: not processes(marker))
        finally:
            driver.kill()
        assert len(output.splitlines()) < 8, output
        saved.append(learned(config.folder))
    assert driver.returncode == 128 + signal.SIGINT
    assert f"resumes at update {saved[0]['update']}, " in output
    update = saved[1]["update"]
    assert update > saved[0]["update"] >= 4
    for incarnation, state in enumerate(saved):
        source = state["source"]
        assert (source["version"], source["incarnations"]) == (state["update"], [incarnation])
    metrics = metrics_of(config.folder)
    assert list(metrics["update"]) == list(range(1, update + 1))
    assert list(metrics["frames"]) == [FRAMES * one for one in range(1, update + 1)]
    files_of_a_local_run(config, tmp_path / "local")


def files_of_a_local_run(config, folder):
    """A run in a cluster has the same files, with the same columns, and more metrics. Only one
    that is finished has its weights."""
    local = load(folder, "updates=3", "evaluation.every=3")
    assert runner.train(local) == 0
    there, here = (
        {path.name for path in one.folder.iterdir()} - {"tensorboard", "weights.pt"}
        for one in (local, config)
    )
    assert there == here
    for name in ("metrics.csv", "evaluations.csv", "situations.csv"):
        there, here = (list(pd.read_csv(one.folder / name).columns) for one in (local, config))
        assert there == here
    there, here = (set(metrics_of(one.folder).columns) for one in (local, config))
    assert here - there == {"lag_mean", "lag_max", "unrolls_discarded", "actors_replaced"}
    assert there <= here
