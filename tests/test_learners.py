"""Several learners: what they learn together, what they write, how they stop and go on."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest
import torch
from conftest import PACKAGE, TINY, assert_equal, learned, metrics_of, random_unroll, untimed
from networks import compact

from zipf.agents import averaging
from zipf.agents.agent import AgentSpec, agents
from zipf.agents.auxiliary import AUXILIARIES
from zipf.agents.memory import LSTMOptions
from zipf.agents.unroll import Unroll
from zipf.errors import UserError
from zipf.experiments.building import checkpoint, loading, run_folder
from zipf.experiments.cluster import runtime_of, torchrun
from zipf.experiments.evaluation.trained import load_agent
from zipf.experiments.hooks.visits import Visits
from zipf.experiments.sweeping import sweep
from zipf.experiments.training import runner

STEPS, BATCH, WORDS = 6, 4, 5
TORCHRUN = ["runtime=torchrun", "runtime.learners=2"]
OPTIONS = [*TINY, *TORCHRUN, "schedule.checkpoint_every=2", "name=row", "plugins=[spy]"]
FRAMES = 6 * 5  # of an update
TABLES = ("metrics.csv", "evaluations.csv", "situations.csv")


# Gradients


class Together:
    """Two learners in threads of this process, in the place of two processes."""

    def __init__(self, monkeypatch):
        self._barrier = threading.Barrier(2, timeout=60)
        self._here = threading.local()
        self._parts = [None, None]
        monkeypatch.setattr(averaging, "_group", "two threads")
        over = SimpleNamespace(all_reduce=self._all_reduce, get_world_size=lambda group: 2)
        monkeypatch.setattr(averaging, "dist", over)

    def _all_reduce(self, tensor, group):
        self._parts[self._here.rank] = tensor.clone()
        self._barrier.wait()
        total = self._parts[0] + self._parts[1]
        self._barrier.wait()
        tensor.copy_(total)

    def run(self, work):
        """What `work(rank)` returns in each of them."""

        def one(rank):
            self._here.rank = rank
            return work(rank)

        with ThreadPoolExecutor(2) as threads:
            return list(threads.map(one, range(2)))


options_of = cache(lambda *overrides: loading.read([*TINY, *overrides]))


def build(name, *overrides):
    """An agent of this name; its Adam takes steps that are nearly proportional to gradients."""
    config = options_of(f"agent={name}", *overrides)
    actions = 2 if agents()[name].answers_questions else 3
    spec = AgentSpec(
        gym.spaces.Dict(
            image=gym.spaces.Box(0, 255, (9, 9, 3), np.uint8),
            instruction=gym.spaces.Box(0, WORDS - 1, (4,), np.int64),
        ),
        gym.spaces.Discrete(actions),
        compact(),
        LSTMOptions(name="lstm", size=16, layers=1),
        config.auxiliary,
        num_envs=BATCH,
        unroll_length=STEPS,
    )
    options = config.agent.model_copy(update={"adam_epsilon": 1e-2, "max_gradient_norm": 0.1})
    return agents()[name](options, spec)


def unroll(seed, actions):
    drawn = random_unroll(STEPS, BATCH, actions, seed)
    shape = STEPS + 1, BATCH
    generator = torch.Generator().manual_seed(seed)
    words = torch.randint(1, WORDS, (*shape, 4), generator=generator)
    drawn.steps["observation", "instruction"] = words
    drawn.steps["label"] = torch.randint(0, actions, shape, generator=generator)
    return drawn


def share(whole, rank):
    envs = slice(rank * BATCH // 2, (rank + 1) * BATCH // 2)
    memory = {name: part[envs] for name, part in whole.memory.items()}
    return Unroll(whole.steps[:, envs], memory)


ABLE = [name for name, agent in agents().items() if agent.averages_gradients]


@pytest.mark.parametrize(
    "of",
    [
        # V-MPO learns from the best half of a batch; PPO normalises advantages in a minibatch.
        *([name] for name in ABLE if name not in ("ppo", "vmpo")),
        ["impala", "auxiliary=vision", "auxiliary.fraction=1.0"],
    ],
    ids=" ".join,
)
def test_two_learners_learn_what_one_learns_from_both_batches(of, monkeypatch):
    one, first, second = (build(*of) for _ in range(3))
    actions = first.network.actions
    batches = [unroll(seed, actions) for seed in range(3)]
    initial = {name: part.clone() for name, part in one.network.state_dict().items()}
    for batch in batches:
        metrics = one.update(batch)
    assert metrics["gradient_norm"] > 0.1  # so that the bound on it matters
    halves = first, second

    def learn(rank):
        for batch in batches:
            halves[rank].update(share(batch, rank))

    Together(monkeypatch).run(learn)
    moved = 0.0
    for name, part in one.network.state_dict().items():
        torch.testing.assert_close(halves[0].network.state_dict()[name], part, rtol=0, atol=1e-6)
        moved = max(moved, float((part - initial[name]).abs().max()))
    assert moved > 1e-4
    assert_equal(first.state_dict(), second.state_dict())


@pytest.mark.parametrize(
    "of",
    [
        *([name] for name in ABLE),
        *(["impala", f"auxiliary={one}"] for one in AUXILIARIES.options if one != "none"),
    ],
    ids=" ".join,
)
def test_all_that_is_learned_stays_the_same_in_all_learners(of, monkeypatch):
    both = [build(*of) for _ in range(2)]

    def learn(rank):
        for number in range(3):
            both[rank].update(unroll(2 * number + rank, both[rank].network.actions))

    Together(monkeypatch).run(learn)
    assert_equal(both[0].state_dict(), both[1].state_dict())


def test_a_gradient_of_one_learner_alone_is_halved(monkeypatch):
    """And what has none in either keeps none."""
    shapes = (2, 3), (4,), ()
    parameters = [[torch.nn.Parameter(torch.zeros(shape)) for shape in shapes] for _ in range(2)]
    for rank, (both, _, one) in enumerate(parameters):
        both.grad = torch.full((2, 3), 1.0 + rank)
        one.grad = torch.tensor(3.0) if rank else None
    Together(monkeypatch).run(lambda rank: averaging.average_gradients(parameters[rank]))
    for both, neither, one in parameters:
        assert torch.equal(both.grad, torch.full((2, 3), 1.5))
        assert neither.grad is None
        assert one.grad == 1.5


def test_a_gradient_keeps_the_order_of_its_elements_in_ram(monkeypatch):
    """That of its weight, as optimisers want it."""
    weights = torch.nn.Parameter(torch.zeros(4, 3, 2, 2).to(memory_format=torch.channels_last))
    gradient = torch.randn(4, 3, 2, 2).to(memory_format=torch.channels_last)
    weights.grad = gradient.clone(memory_format=torch.preserve_format)
    over = SimpleNamespace(all_reduce=lambda tensor, group: None, get_world_size=lambda group: 1)
    monkeypatch.setattr(averaging, "_group", "one")
    monkeypatch.setattr(averaging, "dist", over)
    averaging.average_gradients([weights])
    assert torch.equal(weights.grad, gradient)
    assert weights.grad.stride() == weights.stride()


# What learners tell each other


class Rows(torchrun.Learner):
    """The first of learners that have these values."""

    rank, is_first = 0, True

    def __init__(self, *values):
        self.values = list(values)

    def _gather(self, value):
        return self.values

    @staticmethod
    def of_first(value):
        return value


def test_metrics_are_means_over_those_that_have_them():
    nan = float("nan")
    rows = {"a": 1.0, "b": nan, "c": nan}, {"a": 2.0, "b": 4.0, "c": nan, "d": 5.0}
    mean = Rows(*rows).mean(rows[0])
    assert (mean["a"], mean["b"], mean["d"]) == (1.5, 4.0, 5.0)
    assert np.isnan(mean["c"])


def test_visits_are_of_all_learners():
    states = []
    for episodes in ([1, 0], [2, 5]):
        visits = Visits(("rank",))
        situations = np.array([[3], [7]])
        visits.add_those({"situations": situations, "episodes": np.array(episodes)})
        states.append(visits.state_dict())
    total = Rows(*states).total(Visits(("rank",)))
    met = total.beside(pd.DataFrame({"rank": [3, 7]}))
    assert list(met["visits"]) == [3, 5]


def test_learners_that_start_again_do_not_meet_those_before_them():
    """Torchrun's store still holds what these have told."""
    store = torch.distributed.HashStore()

    def meet(rank):
        time.sleep(0.2 * rank)  # so that the first would find the names of those before
        return torchrun.of_these(store, rank, 3)

    for attempt in range(2):
        with ThreadPoolExecutor(3) as threads:
            first, second, third = threads.map(meet, range(3))
        assert not first.check(["said"])
        third.set("said", str(attempt))
        assert first.get("said") == second.get("said") == str(attempt).encode()


def test_what_is_sent_arrives():
    """Generators of envs have states of this type, tensors after they were read from a file."""
    state = {
        "array": np.arange(3, dtype=np.uint64),
        "tensor": torch.tensor([2**63], dtype=torch.uint64),
    }
    assert_equal(*map(checkpoint.arrays, (torchrun._unpacked(torchrun._packed(state)), state)))


def test_learners_that_differ_are_told():
    states = [{"weight": torch.tensor([1.0, 2.0]), "updates": 3} for _ in range(3)]
    digests = [torchrun._digest(state) for state in states]
    Rows(*digests).check_same("the agent", None)
    states[2]["weight"][1] += 1e-6
    digests[2] = torchrun._digest(states[2])
    with pytest.raises(UserError, match=r"^runtime=torchrun: the agent of learner 2 of 3 "):
        Rows(*digests).check_same("the agent", None)


# What is refused, and how runs are named


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["runtime.learners=4"], r"collector\.num_envs=6: should be a multiple of .*=4, which "),
        (["runtime.learners=12"], r"collector\.num_envs=6: should be a multiple of "),
        (["agent=r2d2", "agent.burn_in=2"], rf"runtime=torchrun: agent=r2d2 .*{' or '.join(ABLE)}"),
        (["episodic=dictionary"], r"episodic=dictionary: each learner .* choose episodic=none"),
        (["runtime.learners=0"], r"runtime\.learners=0: "),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(overrides, told, tmp_path):
    with pytest.raises(UserError, match=f"^{told}") as error:
        loading.load([*TINY, *TORCHRUN, f"run_root={tmp_path}", *overrides])
    assert "\n" not in str(error.value)


def test_a_device_is_of_one_learner(monkeypatch, tmp_path):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "mem_get_info", lambda device: (2**40, 2**40))
    options = [one for one in TINY if not one.startswith("device=")]
    options += [*TORCHRUN, f"run_root={tmp_path}"]
    monkeypatch.setenv("LOCAL_RANK", "1")
    for device in ("auto", "cuda"):
        assert loading.load([*options, f"device={device}"]).torch_device == "cuda:1"
    with pytest.raises(UserError, match=r"^device=cuda:0: is one for all learners; .*=cuda, "):
        loading.load([*options, "device=cuda:0"])


@pytest.mark.parametrize(
    ("overrides", "started", "told"),
    [
        (TORCHRUN, 0, r"runtime=torchrun: start it with torchrun --nproc-per-node=2 -m zipf\.t"),
        (TORCHRUN, 3, r"runtime\.learners=2: torchrun has started 3 processes; should be 3, or "),
        ([], 2, r"runtime=local: is of one .* choose runtime=torchrun runtime\.learners=2$"),
    ],
)
def test_what_was_not_started_so_is_told_how_to(overrides, started, told, monkeypatch, tmp_path):
    config = loading.load([*TINY, *overrides, f"run_root={tmp_path}"])
    for name, value in (("RANK", 0), ("WORLD_SIZE", started)):
        monkeypatch.delenv(name, raising=False)
        if started:
            monkeypatch.setenv(name, str(value))
    with pytest.raises(UserError, match=f"^{told}"):
        runner.train(config, runtime_of(config))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("rank", "error", "late"),
    [
        (None, UserError("no space"), 0),
        ("0", UserError("no space"), 0),
        ("1", UserError("no space"), 1),
        ("0", torchrun.LearnerLost("gone"), 2),
        ("1", torchrun.LearnerLost("gone"), 3),
    ],
)
def test_the_learner_that_is_at_fault_tells_before_the_others(rank, error, late, monkeypatch):
    """And of those that find the same mistake the first; torchrun ends the others meanwhile."""
    waited = []
    monkeypatch.setattr(torchrun.time, "sleep", waited.append)
    monkeypatch.delenv("RANK", raising=False)
    if rank:
        monkeypatch.setenv("RANK", rank)
        monkeypatch.setenv("WORLD_SIZE", "2")
    torchrun.let_others_tell(error)
    assert sum(waited) == late * torchrun.HEAD_START


def test_the_command_of_a_run_has_the_learners_of_a_machine(monkeypatch):
    config = options_of(*TORCHRUN)
    monkeypatch.delenv("LOCAL_WORLD_SIZE", raising=False)
    assert run_folder._started_by(config) == ["torchrun", "--nproc-per-node=2"]
    monkeypatch.setenv("LOCAL_WORLD_SIZE", "1")
    assert run_folder._started_by(config) == ["torchrun", "--nproc-per-node=1"]


def test_a_sweep_is_refused(tmp_path):
    with pytest.raises(UserError, match=r"^runtime=torchrun: a sweep starts each job as one "):
        sweep.run([*TINY, *TORCHRUN, f"run_root={tmp_path}", "seed=0,1"])
    assert not list(tmp_path.iterdir())


def test_the_number_of_learners_is_part_of_what_is_learned():
    options = [*TINY, "runtime=torchrun"]
    local, two, three = (
        loading.load(one) for one in (TINY, options, [*options, "runtime.learners=3"])
    )
    assert "-runtime_torchrun-" in two.condition
    assert len({one.condition for one in (local, two, three)}) == 3
    assert len({str(one.what_is_learned) for one in (local, two, three)}) == 3


def test_a_local_run_joins_nobody(monkeypatch, tmp_path):
    monkeypatch.setattr(torch.distributed, "init_process_group", None)
    assert runner.train(loading.load([*TINY, "updates=1", f"run_root={tmp_path}"])) == 0


# Runs of two processes

SPY = '''
"""What each process had at its end; and signals, at a step or an evaluation that the environment
names."""
import os, signal, time, types, torch
from zipf.experiments.training import runner

RANK, STARTED = os.environ.get("RANK"), os.environ.get("TORCHELASTIC_RESTART_COUNT", "0")
step, close = runner.Run.step, runner.Run.close
watch = runner.Run._watch_evaluation
if os.environ.get("SPY") == f"0 {RANK} 0 clock":
    runner.time = types.SimpleNamespace(monotonic=lambda: 1e6 * time.monotonic())

def kill(run, during):
    number, rank, update, when = [*os.environ.get("SPY", "0 0 0").split(), "step"][:4]
    if (RANK, run.update, STARTED, during) == (rank, int(update), "0", when) and number != "0":
        os.kill(os.getpid(), int(number))

def watched_step(run):
    kill(run, "step")
    return step(run)

def watched_evaluation(run, *told):
    kill(run, "evaluation")
    watch(run, *told)

def watched_close(run):
    if run.is_finished or run.update:
        weights = {name: part.clone() for name, part in run.agent.network.state_dict().items()}
        record = {"weights": weights, "update": run.update, "worlds": run.env.num_envs}
        record["image"] = torch.as_tensor(run.rollouts._pending.steps["observation", "image"])
        torch.save(record, f"{os.environ['SPY_FOLDER']}/{RANK}.pt")
    close(run)

runner.Run.step, runner.Run.close = watched_step, watched_close
runner.Run._watch_evaluation = watched_evaluation
'''


class Runs:
    """Runs of two learners in a folder, with a plugin that watches them, and with the weights of a
    run of one learner to begin with."""

    def __init__(self, folder):
        self.folder = folder
        (folder / "spy.py").write_text(SPY)
        before = [*TINY, "updates=1", f"run_root={folder}", "name=before", "seed=1"]
        self.before = loading.load(before).folder
        assert runner.train(loading.load(before)) == 0

    def options(self, name, *overrides):
        begins = f"pretrained.run={self.before}"
        return [*OPTIONS, f"run_root={self.folder / name}", "updates=7", begins, *overrides]

    def config(self, name):
        return loading.load(self.options(name))

    def torchrun(self, name, *overrides, restarts=0, spy="0 0 0"):
        command = [sys.executable, "-m", "torch.distributed.run", "--standalone"]
        command += ["--nproc-per-node=2", f"--max-restarts={restarts}", "--monitor-interval=0.1"]
        command += ["-m", "zipf.train", *self.options(name, *overrides)]
        return subprocess.run(
            command, env=self._env(name, spy), capture_output=True, text=True, timeout=200
        )

    def processes(self, name, *overrides, spy):
        """The two processes as torchrun would start them; their exit codes and outputs."""
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        running = []
        for rank in range(2):
            where = {"RANK": str(rank), "LOCAL_RANK": str(rank), "WORLD_SIZE": "2"}
            where |= {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port)}
            command = [sys.executable, "-m", "zipf.train", *self.options(name, *overrides)]
            env = self._env(name, spy) | where
            pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
            running.append(subprocess.Popen(command, env=env, **pipes))
        outputs = [one.communicate(timeout=200) for one in running]
        return [(one.returncode, *output) for one, output in zip(running, outputs, strict=True)]

    def _env(self, name, spy):
        seen = self.folder / f"seen-{name}"
        seen.mkdir(exist_ok=True)
        paths = f"{PACKAGE}{os.pathsep}{self.folder}"
        spied = {"SPY": spy, "SPY_FOLDER": str(seen), "PYTHONPATH": paths, "OMP_NUM_THREADS": "1"}
        return {**os.environ, **spied}

    def seen(self, name):
        """What each process had at its end."""
        return [torch.load(self.folder / f"seen-{name}/{rank}.pt") for rank in range(2)]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("learners")
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(folder))
        made = Runs(folder)
        # Imported here for its name alone: `spy` watches the processes that it is loaded in.
        patch.setitem(sys.modules, "spy", SimpleNamespace())
        yield made


@pytest.fixture(scope="module")
def whole(runs):
    """A run that nothing has stopped, started by torchrun."""
    return runs.torchrun("whole")


@pytest.mark.slow
def test_two_processes_train_one_run(whole, runs):
    config = runs.config("whole")
    assert whole.returncode == 0, whole.stderr
    metrics = metrics_of(config.folder)
    assert list(metrics["update"]) == list(range(1, 8))
    assert list(metrics["frames"]) == [FRAMES * update for update in range(1, 8)]
    assert metrics["loss"].notna().all()
    log = (config.folder / "train.log").read_text()
    assert log.count("a new run") == 1
    assert len(list((config.folder / "tensorboard").glob("events*"))) == 1
    assert whole.stdout.count("a new run") == whole.stdout.count("finished; ") == 1

    first, second = runs.seen("whole")
    assert first["update"] == second["update"] == 7
    assert first["worlds"] == second["worlds"] == 3
    assert_equal(first["weights"], second["weights"])
    assert not torch.equal(first["image"], second["image"])
    trained = load_agent(config.folder, "cpu", ["spy"])
    assert_equal(dict(trained.agent.network.state_dict()), first["weights"])


@pytest.mark.slow
def test_a_checkpoint_holds_what_each_learner_has_of_its_own(whole, runs):
    config = runs.config("whole")
    state = checkpoint.load(config.folder / "checkpoint.pt")
    assert len(state["learners"]) == 2
    visits = [one["source"]["visits"]["episodes"] for one in state["learners"]]
    assert all(part.sum() for part in visits)
    table = pd.read_csv(config.folder / "situations.csv")
    last = table[(table["update"] == 7) & (table["level_kind"] == "train")]
    assert 0 < last["visits"].sum() <= sum(int(part.sum()) for part in visits)


@pytest.mark.slow
def test_learners_agree_that_the_last_evaluation_is_given_up(runs):
    config = runs.config("given_up")
    ended = runs.processes("given_up", "updates=1", spy=f"{signal.SIGTERM:d} 0 1 evaluation")
    assert [code for code, _, _ in ended] == [128 + signal.SIGTERM] * 2, ended
    assert "stopped at update 1; the same command resumes" in ended[0][1]
    assert set(pd.read_csv(config.folder / "evaluations.csv")["update"]) == {0}
    assert checkpoint.load(config.folder / "checkpoint.pt")["evaluated"] == 0


@pytest.mark.slow
def test_a_run_that_was_stopped_and_then_lost_a_learner_ends_as_one_that_was_not(whole, runs):
    """A SIGTERM of one learner stops both after the same update. Then one is killed; torchrun ends
    the other and starts both again."""
    config = runs.config("cut")
    ended = runs.processes("cut", spy=f"{signal.SIGTERM:d} 1 2")
    assert [code for code, _, _ in ended] == [128 + signal.SIGTERM] * 2, ended
    assert "stopped at update 3; the same command resumes" in ended[0][1]
    assert ended[1][1] == ""
    assert [one["update"] for one in runs.seen("cut")] == [3, 3]
    assert checkpoint.load(config.folder / "checkpoint.pt")["update"] == 3

    resumed = runs.torchrun("cut", "resume=must", restarts=3, spy=f"{signal.SIGKILL:d} 1 5")
    assert resumed.returncode == 0, resumed.stderr
    assert "resumes at update 3," in resumed.stdout
    assert "resumes at update 4," in resumed.stdout
    assert "error: " not in resumed.stderr  # torchrun tells of the signal
    assert_equal(learned(runs.config("whole").folder), learned(config.folder))
    for name in TABLES:
        one, other = (untimed(run.folder / name) for run in (runs.config("whole"), config))
        pd.testing.assert_frame_equal(one, other)


@pytest.mark.slow
def test_the_time_of_one_learner_stops_both(whole, runs):
    """By the clock of one the time is over after the first update, by the other's never."""
    config = runs.config("timed")
    ended = runs.processes("timed", "schedule.stop_after=1000", spy="0 1 0 clock")
    assert [code for code, _, _ in ended] == [0, 0], ended
    assert "stopped at update 1; the same command resumes" in ended[0][1]
    assert [one["update"] for one in runs.seen("timed")] == [1, 1]
    resumed = runs.processes("timed", "resume=must", spy="0 0 0")
    assert [code for code, _, _ in resumed] == [0, 0], resumed
    assert_equal(learned(runs.config("whole").folder), learned(config.folder))


@pytest.mark.slow
def test_a_finished_run_is_left_as_it_is(whole, runs):
    (first, shown, _), (second, hidden, _) = runs.processes("whole", spy="0 0 0")
    assert (first, second) == (0, 0)
    assert "is finished at update 7" in shown
    assert hidden == ""
