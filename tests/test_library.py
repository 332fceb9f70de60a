"""The package as a library: what `import zipf` gives, and what it does not bring along."""

import gc
import importlib
import inspect
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import threading

import numpy as np
import pytest
import torch
from conftest import PACKAGE, TINY, assert_equal, call, contents, learned, slow_but
from hydra.core.global_hydra import GlobalHydra

import zipf
from zipf import envs
from zipf.agents.learner import Learner
from zipf.experiments.building import checkpoint, loading
from zipf.experiments.options import command_line
from zipf.experiments.options.schema import Config
from zipf.experiments.training import runner

HEAVY = {"torch", "tensordict", "torchrl", "tensorboard", "plotly", "matplotlib", "hydra", "ray"}
"""What somebody who wants environments alone does not need."""

PLAYS = """
import sys
import gymnasium
import zipf
level, heavy = sys.argv[1], set(sys.argv[2:])
assert not heavy & sys.modules.keys(), heavy & sys.modules.keys()
env = zipf.make(level, render_mode="rgb_array")
env.reset(seed=0)
env.step(env.action_space.sample())
assert env.render().shape[2] == 3
batch = zipf.make_vec(level, 2)
batch.reset(seed=0)
batch.step(batch.action_space.sample())
assert dir(zipf.envs)
assert not heavy & sys.modules.keys(), heavy & sys.modules.keys()
"""


@pytest.mark.parametrize("family", slow_but(envs.families(), "gridworld"))
def test_an_environment_brings_no_heavy_library(family):
    level = envs.families()[family].splits[0].uniform[0].name
    command = [sys.executable, "-c", PLAYS, level, *HEAVY]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_importing_the_package_brings_little():
    code = "import sys, zipf, json; print(json.dumps([*sys.modules]))"
    found = json.loads(subprocess.run([sys.executable, "-c", code], capture_output=True).stdout)
    assert not {*HEAVY, "numba", "pandas", "scipy", "rich"} & set(found)


@pytest.mark.parametrize("module", ["zipf", "zipf.envs", "zipf.evaluate"])
def test_what_a_module_shows_is_all_there(module):
    found = importlib.import_module(module)
    public = [name for name in dir(found) if not name.startswith("_")]
    assert sorted(found.__all__) == public
    assert all(getattr(found, name) is not None for name in public)
    with pytest.raises(AttributeError, match=f"module '{module}' has no attribute 'nothing'"):
        _ = found.nothing


ORDERS = [
    "import zipf",
    "import zipf.train, zipf.report",
    "from zipf.report import report; from zipf.train import main",
    "from zipf import report, train",
    "import zipf.__main__; from zipf import evaluate, play",
]


@pytest.mark.parametrize("imports", slow_but(ORDERS, *ORDERS[1:3]))
def test_commands_are_functions_and_modules_whatever_is_imported_first(imports):
    code = f"""
{imports}
import zipf
try:
    zipf.train(experiment="no_such_experiment")
except zipf.UserError as error:
    print(error)
try:
    zipf.report("no_such_folder")
except zipf.UserError as error:
    print(error)
from zipf.evaluate import score
from zipf.report import Report
assert score is zipf.score and Report is zipf.Report
assert zipf.train.main and zipf.report.main and zipf.evaluate.main and zipf.play.main
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "no_such_experiment: no such experiment" in done.stdout
    assert "no_such_folder: no such folder" in done.stdout


@pytest.mark.parametrize("name", ["train", "report"])
def test_a_called_module_has_the_signature_of_its_function(name):
    module = getattr(zipf, name)
    assert inspect.signature(module) == inspect.signature(getattr(module, name))


# --- training --------------------------------------------------------------------------------


def tiny(root, name="x", updates=2):
    """The arguments of `zipf.train` for a run as of `TINY`."""
    parts = [word.partition("=") for word in TINY]
    words = {name: int(value) if value.isdigit() else value for name, _, value in parts}
    options = {name: value for name, value in words.items() if "." in name}
    chosen = {name: value for name, value in words.items() if "." not in name}
    return {**chosen, "run_root": root, "name": name, "updates": updates, "options": options}


def test_training_from_python_is_the_command(tmp_path, capsys):
    """The same options give the same files, and the run's description the command."""
    run = zipf.train(**tiny(tmp_path / "a"))
    assert run.is_finished
    assert "update 2/2" in capsys.readouterr().out
    assert call(*TINY, "updates=2", f"run_root={tmp_path / 'b'}", "name=x", "-q").stdout == ""
    other = zipf.Run(tmp_path / "b" / "demo" / "x" / "seed0")
    assert_equal(learned(run.folder), learned(other.folder))
    asked = json.loads((run.folder / "run.json").read_text())["command"]
    assert loading.load(shlex.split(asked)[3:]) == run.config


def test_the_same_call_goes_on(tmp_path, capsys):
    run = zipf.train(**tiny(tmp_path), quiet=True)
    assert set(run.scores["level_kind"]) >= {"train", "uniform", "rare"}
    assert repr(run).endswith("at update 2, finished)")
    before = contents(run.folder)
    again = zipf.train(**tiny(tmp_path), quiet=True)
    assert contents(run.folder) == before
    assert again.scores.equals(run.scores)
    assert zipf.train(**tiny(tmp_path, updates=3), quiet=True).scores["update"].max() == 3
    assert capsys.readouterr() == ("", "")


def test_training_tells_all_mistakes_at_once():
    with pytest.raises(zipf.UserError) as caught:
        zipf.train(experiment="demo", seeed=1, options={"agent.lerning_rate": 1e-3})
    first, second = str(caught.value).splitlines()
    assert first == "seeed: no such option; did you mean seed or sweep?"
    assert second == "agent.lerning_rate: no such option; did you mean agent.learning_rate?"
    with pytest.raises(ValueError, match="options must be a mapping, got 'seed=1'"):
        zipf.train(experiment="demo", options="seed=1")
    with pytest.raises(zipf.UserError, match=r"^hydra/launcher=joblib: is for the jobs of a sweep"):
        zipf.train(experiment="demo", options={"hydra/launcher": "joblib"})


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "null"),
        (True, "true"),
        (np.int64(3), "3"),
        (1e-3, "0.001"),
        ((0, 2), "[0,2]"),
        (["a", "b c"], "[a,'b c']"),
        ("runs/x-1", "runs/x-1"),
        ("true", "'true'"),
        ("1e3", "'1e3'"),
        ("it's, so", "'it\\'s, so'"),
        ("café", "'café'"),
        ({"title": "A"}, "{title:A}"),
    ],
)
def test_a_value_is_what_it_was_on_the_command_line(value, text):
    assert zipf.train._text(value) == text
    (parsed,) = command_line.parse([f"x={text}"])
    same = value.item() if isinstance(value, np.generic) else value
    assert parsed.value() == (list(same) if isinstance(same, tuple) else same)


def test_the_keywords_of_train_are_the_options_without_a_dot():
    nested = {"collector", "evaluation", "schedule", "pretrained", "row"}
    known = {*Config.model_fields, "name"} - nested
    assert set(zipf.train.TrainOptions.__annotations__) == known


def test_training_in_threads_one_at_a_time(tmp_path):
    """Python handles signals in the main thread alone; a second run in the same process is refused
    while one is training."""
    told = []

    def train(name):
        try:
            told.append(zipf.train(**tiny(tmp_path, name), quiet=True).is_finished)
        except zipf.UserError as error:
            told.append(str(error))

    threads = [threading.Thread(target=train, args=[name]) for name in ("one", "other")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    refused = [line for line in told if line is not True]
    assert len(told) == 2
    assert len(refused) <= 1
    assert all("another run is training in this process" in line for line in refused)
    train("one")
    assert told[-1] is True


def test_an_interrupt_leaves_a_checkpoint(tmp_path, monkeypatch):
    """A notebook's stop button sends SIGINT."""
    step = runner.Run.step

    def interrupted(run):
        if run.update == 2:
            os.kill(os.getpid(), signal.SIGINT)
        return step(run)

    handler = signal.getsignal(signal.SIGINT)
    with monkeypatch.context() as patch:
        patch.setattr(runner.Run, "step", interrupted)
        with pytest.raises(KeyboardInterrupt, match="stopped with a checkpoint"):
            zipf.train(**tiny(tmp_path, updates=50), quiet=True)
    assert signal.getsignal(signal.SIGINT) is handler
    folder = tmp_path / "demo" / "x" / "seed0"
    assert checkpoint.load(folder / "checkpoint.pt")["update"] == 3
    assert not zipf.Run(folder).is_finished
    assert zipf.train(**tiny(tmp_path, updates=4), quiet=True).is_finished


def test_training_leaves_the_process_as_it_was(tmp_path):
    """PyTorch's generator, Hydra, and no agent that holds memory."""

    def learners():
        return sum(issubclass(type(one), Learner) for one in gc.get_objects())

    drawn, before = torch.get_rng_state(), learners()
    zipf.train(**tiny(tmp_path, updates=1), quiet=True)
    assert learners() <= before
    assert torch.equal(torch.get_rng_state(), drawn)
    assert not GlobalHydra.instance().is_initialized()


# --- trained agents --------------------------------------------------------------------------


@pytest.fixture
def agent(trained_once):
    return zipf.load_agent(next(trained_once.glob("demo/*/seed0")))


def test_an_agent_is_loaded_on_a_device_that_there_may_be(agent):
    for device in ("gpu", "cpu:0", ""):
        with pytest.raises(zipf.UserError, match=f"^device={device}: should be auto, cpu, cuda"):
            zipf.load_agent(agent.folder, device)
    with pytest.raises(zipf.UserError, match="plugins: cannot import nowhere"):
        zipf.load_agent(agent.folder, plugins="nowhere")


def test_an_agent_that_was_compiled_is_loaded_where_there_is_no_compiler(agent, tmp_path):
    shutil.copytree(agent.folder, tmp_path / "seed0")
    file = tmp_path / "seed0" / "config.yaml"
    file.write_text(file.read_text().replace("compile: auto", "compile: true"))
    assert zipf.load_agent(tmp_path / "seed0").config.compile is False


def played(agent, num_envs=3, **how):
    """The actions of 12 steps, [12, N]."""
    env = zipf.make_vec("gridworld/rare", num_envs, **agent.env_options)
    observation, _ = env.reset(seed=1)
    actions = [agent.act(observation, **how)]
    for _ in range(11):
        observation, reward, terminated, truncated, _ = env.step(actions[-1])
        actions.append(agent.act(observation, reward, terminated | truncated, **how))
    return np.array(actions)


def test_an_agent_acts_as_it_is_scored(agent):
    """The same draws and memory as the evaluator's policy has, over ends of episodes."""
    agent.reset(seed=5)
    ours = played(agent)
    policy = agent.for_envs(agent.observation_space, agent.action_space, 5)
    env = zipf.make_vec("gridworld/rare", 3, **agent.env_options)
    observation, _ = env.reset(seed=1)
    policy.start(3)
    reward, first = np.zeros(3, np.float32), np.ones(3, bool)
    ended = 0
    for expected in ours:
        actions = policy(observation, reward, first)
        np.testing.assert_array_equal(actions, expected)
        observation, reward, terminated, truncated, _ = env.step(actions)
        first = terminated | truncated
        ended += first.sum()
    assert ended


def test_draws_are_from_the_seed_and_the_most_probable_action_is_not_drawn(agent):
    runs = []
    for seed in (1, 1, 2):
        agent.reset(seed=seed)
        runs.append(played(agent))
    assert (runs[0] == runs[1]).all()
    assert (runs[0] != runs[2]).any()
    chosen = []
    for seed in (1, 2):
        agent.reset(seed=seed)
        chosen.append(played(agent, deterministic=True))
    assert (chosen[0] == chosen[1]).all()


def test_one_environment_and_a_batch_of_one_are_the_same(agent):
    agent.reset(seed=3)
    batch = played(agent, num_envs=1)[:, 0]
    agent.reset(seed=3)
    env = zipf.make_vec("gridworld/rare", 1, **agent.env_options)
    observation, _ = env.reset(seed=1)
    reward, first = None, True
    for expected in batch:
        one = {name: part[0] for name, part in observation.items()}
        action = agent.act(one, reward, first)
        assert isinstance(action, int)
        assert action == expected
        observation, rewards, terminated, truncated, _ = env.step(np.array([action]))
        reward, first = rewards[0], terminated[0] | truncated[0]


def test_an_agent_refuses_what_it_cannot_act_on(agent):
    env = zipf.make_vec("gridworld/rare", 2, **agent.env_options)
    observation, _ = env.reset(seed=0)
    agent.act(observation)
    with pytest.raises(ValueError, match="needs the reward of the last action"):
        agent.act(observation)
    half = {name: part[:1] for name, part in observation.items()}
    with pytest.raises(ValueError, match="1 environments, and 2 before; reset"):
        agent.act(half, [0.0])
    with pytest.raises(ValueError, match="observation 'image' is missing; should be"):
        agent.act({})
    with pytest.raises(ValueError, match=r"'image' has shape \(2, 3\)"):
        agent.act({"image": np.zeros((2, 3))})
    with pytest.raises(ValueError, match="'image' is float64; should be uint8"):
        agent.act({"image": observation["image"] / 255})
    agent.reset(seed=0)
    mirrored = agent.act({"image": observation["image"][:, :, ::-1]})
    agent.reset(seed=0)
    assert (
        mirrored.tolist() == agent.act({"image": observation["image"][:, :, ::-1].copy()}).tolist()
    )
    agent.reset()
    assert agent.act(half).shape == (1,)


# --- what notebooks show ---------------------------------------------------------------------


def test_a_report_and_an_evaluation_show_tables(trained_once, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    made = zipf.report(trained_once, window="last")
    assert not [*tmp_path.iterdir()]
    assert made.files == ()
    assert repr(made) == "Report(1 run: demo)"
    assert set(made.to_dataframe()["level_kind"]) >= {"train", "uniform", "rare"}
    assert "\n| Chance |" in made._repr_markdown_()
    figures = made.figures()
    assert "demo_learning" in figures
    assert figures["demo_learning"]._repr_png_().startswith(b"\x89PNG")
    written = zipf.report([trained_once], "out", "last")
    assert {f"{name}.png" for name in figures} == {
        path.name for path in written.files if path.suffix == ".png"
    }
    found = zipf.score("expert", "gridworld", episodes=5, details=True)
    assert repr(found).startswith("Evaluation(gridworld: train ")
    assert "<td>rare</td>" in found._repr_html_()
    assert list(found.to_dataframe()["level_kind"]) == list(found.scores)


def test_the_notebook_is_stored_as_code_alone():
    """`.ci/run` executes it."""
    path = PACKAGE / "examples/notebook/zipf.ipynb"
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
    assert len(code) > 5
    for text in code:
        compile(text, str(path), "exec")
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)
