"""Training as a user does it: every shipped configuration, resume, signals, errors."""

import dataclasses
import importlib
import itertools
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch
from conftest import (
    ANNOUNCED,
    TINY,
    assert_equal,
    call,
    command,
    contents,
    learned,
    metrics_of,
    slow_but,
    untimed,
)
from envs_of import pairs_once

import zipf.envs.family
from zipf import envs, evaluate
from zipf.errors import UserError
from zipf.experiments.building import checkpoint, loading, run_folder
from zipf.experiments.building.factory import build_agent
from zipf.experiments.evaluation import trained as run_trained
from zipf.experiments.evaluation.trained import evaluate_run, load_agent
from zipf.experiments.options.schema import EvaluateOptions
from zipf.experiments.training import runner


def folder_of(arguments: list[str]) -> Path:
    return loading.load(arguments).folder


@pytest.mark.parametrize(("experiment", "condition"), pairs_once())
def test_conditions_train_resume_and_are_scored(experiment, condition, tmp_path):
    """Two updates; the same from a checkpoint after the first, bit for bit; a score of the last."""
    arguments = [
        f"experiment={experiment}",
        f"condition={condition}",
        f"name={condition}",
        "updates=2",
        "device=cpu",
        "collector.num_envs=3",
        "collector.unroll_length=4",
        "evaluation.episodes=2",
        "schedule.log_every=1",
        "memory.size=8",
        "environment.max_steps=6",
    ]
    if condition.startswith("r2d2"):
        arguments += ["agent.burn_in=2", "agent.replay_min=3", "agent.replay_capacity=6"]
        arguments += ["agent.storage=ram"]
    if condition == "ppo":
        arguments += ["agent.minibatches=3"]
    if "transformer" in condition:
        arguments += ["memory.heads=2", "memory.mlp_size=8", "memory.memory_length=6"]
    whole = loading.load([*arguments, f"run_root={tmp_path / 'whole'}"])
    cut = loading.load([*arguments, f"run_root={tmp_path / 'cut'}"])
    assert runner.train(whole) == 0
    train_until_gone(cut, update=1)
    assert runner.train(cut) == 0
    assert_equal(learned(whole.folder), learned(cut.folder))
    for name in ("metrics.csv", "evaluations.csv", "situations.csv"):
        one, other = (untimed(run.folder / name) for run in (whole, cut))
        pd.testing.assert_frame_equal(last(one), last(other))

    assert run_folder.read_config(whole.folder) == whole
    metrics = metrics_of(whole.folder)
    assert list(metrics["update"]) == [1, 2]
    assert list(metrics["frames"]) == [12, 24]
    assert metrics["loss"].notna().iloc[-1]
    split = envs.split(whole.environment.split)
    scored = [(kind, level.name) for kind in envs.KINDS for level in split.levels(kind)]
    evaluations = pd.read_csv(whole.folder / "evaluations.csv")
    assert list(evaluations["update"]) == [0] * len(scored) + [2] * len(scored)
    assert list(zip(evaluations["level_kind"], evaluations["level"], strict=True)) == scored * 2
    assert (evaluations["episodes"] == 2).all()
    situations = pd.read_csv(whole.folder / "situations.csv")
    played = situations.groupby(["update", "level_kind"])["episodes"].sum()
    for (_, kind), episodes in played.items():
        assert episodes == 2 * len(split.levels(kind))
    description = run_folder.read_description(whole.folder)
    assert [(one["level_kind"], one["level"]) for one in description["levels"]] == scored
    assert description["experiment"] == experiment
    assert description["condition"] == condition
    names = [baseline.name for baseline in envs.BASELINES]
    assert all(one["references"].keys() <= set(names) for one in description["levels"])
    assert list((whole.folder / "tensorboard").iterdir())

    update, results = evaluate_run(EvaluateOptions(run=str(cut.folder), episodes=2))
    assert update == 2
    assert [(result.kind, result.level) for result in results] == scored

    (whole.folder / "checkpoint.pt").unlink()  # then it is loaded from its weights
    one, other = (load_agent(run.folder, "cpu") for run in (whole, cut))
    assert one.update == other.update
    assert_equal(one.agent.weights(), other.agent.weights())


def train_until_gone(config, update):
    """A run with a checkpoint after an update, and nothing of what came later."""
    run_folder.make(config.folder)
    with runner.Run(config) as run:
        run.evaluate()
        while run.update < update:
            run.log(*run.step())
        run.save()


def last(table):
    return table[table["update"] == table["update"].max()].reset_index(drop=True)


def use_train_levels(monkeypatch, train, **options):
    """Lets the gridworld's split train on these levels."""
    split = envs.Split("gridworld", train, "gridworld/uniform", "gridworld/rare", **options)
    changed = dataclasses.replace(envs.find_family("gridworld"), splits=(split,))
    monkeypatch.setitem(zipf.envs.family._FAMILIES, "gridworld", changed)


def test_a_run_that_must_be_there_leaves_no_folder(tmp_path):
    config = loading.load([*TINY, "resume=must", f"run_root={tmp_path}/runs"])
    with pytest.raises(UserError, match="resume=must: there is no checkpoint"):
        runner.train(config)
    assert list(tmp_path.iterdir()) == []


def test_several_levels_are_trained_on_at_once(tmp_path, monkeypatch, capsys):
    train = ("gridworld/zipf_2", "gridworld/zipf_1")
    use_train_levels(monkeypatch, train)
    arguments = [*TINY, "updates=6", f"run_root={tmp_path}"]
    assert runner.train(loading.load(arguments)) == 0
    assert runner.train(loading.load([*arguments, "updates=8", "resume=must"])) == 0
    folder = folder_of(arguments)

    metrics = metrics_of(folder)
    for name in ("episode_return", "episode_length", "episode_success"):
        assert {f"{name}/{level}" for level in train} < set(metrics.columns)
        each = metrics[[f"{name}/{level}" for level in train]].dropna()
        assert len(each)
        mean = metrics.loc[each.index, name]
        assert (each.min(axis=1) <= mean + 1e-9).all()
        assert (mean <= each.max(axis=1) + 1e-9).all()
    evaluations = pd.read_csv(folder / "evaluations.csv")
    levels_of_train = evaluations[evaluations["level_kind"] == "train"]["level"]
    assert list(levels_of_train) == [*train] * 3  # at updates 0, 4 and 8, no longer at 6

    described = run_folder.read_description(folder)
    assert [one["level"] for one in described["levels"]] == [
        *train,
        "gridworld/uniform",
        "gridworld/rare",
    ]
    each = [one["references"]["chance"]["score"] for one in described["levels"]]
    assert {
        kind: run_folder.mean_of_levels(described["levels"], kind, "chance")
        for kind in envs.PAPER_KINDS
    } == {
        "train": pytest.approx((each[0] + each[1]) / 2),
        "uniform": each[2],
        "rare": each[3],
    }
    assert run_folder.mean_of_levels(described["levels"], "train", "generalist") is None
    monkeypatch.setattr(sys, "argv", ["zipf.evaluate", f"run={folder}", "episodes=5"])
    evaluate.main()
    shown = capsys.readouterr().out
    assert all(f"│ {level} " in shown for level in (*train, "gridworld/rare"))
    experts = (
        run_folder.mean_of_levels(described["levels"], kind, "expert") for kind in envs.PAPER_KINDS
    )
    assert re.search(rf"│ expert +│ {' +│ +'.join(f'{mean:.3f}' for mean in experts)} ", shown)
    assert re.search(r"┃ level +┃ score ┃ chance ┃ blind ┃ expert ┃", shown)


def test_levels_are_drawn_at_every_reset_in_proportion_to_their_weights(tmp_path, monkeypatch):
    """Trained, resumed bit for bit, and scored level by level with the ranks of training."""
    seldom, often = envs.SplitLevel("gridworld/zipf_1", 1.0), envs.SplitLevel("gridworld/zipf_2", 9)
    use_train_levels(monkeypatch, (seldom, often), draw="resets")
    whole = [*TINY, "updates=4", f"run_root={tmp_path / 'whole'}"]
    cut = [*TINY, f"run_root={tmp_path / 'cut'}"]
    assert runner.train(loading.load(whole)) == 0
    assert runner.train(loading.load([*cut, "updates=2"])) == 0
    assert runner.train(loading.load([*cut, "updates=4", "resume=must"])) == 0
    assert_equal(learned(folder_of(whole)), learned(folder_of([*cut, "updates=4"])))

    described = run_folder.read_description(folder_of(whole))
    assert described["situation"] == {"level": 4, "map": 20, "target": 5}
    assert [one["weight"] for one in described["levels"]] == [1.0, 9.0, 1.0, 1.0]
    chance = {one["level"]: one["references"]["chance"]["score"] for one in described["levels"]}
    weighted = 0.1 * chance["gridworld/zipf_1"] + 0.9 * chance["gridworld/zipf_2"]
    mean = run_folder.mean_of_levels(described["levels"], "train", "chance")
    assert mean == pytest.approx(weighted)
    situations = pd.read_csv(folder_of(whole) / "situations.csv")
    ranks = situations.groupby("level_kind")["level"].unique().map(set).to_dict()
    assert ranks == {"train": {0, 1}, "uniform": {2}, "rare": {3}}


def test_a_world_for_each_train_level(monkeypatch):
    train = ("gridworld/zipf_2", "gridworld/zipf_1", "gridworld/zipf_3")
    use_train_levels(monkeypatch, train)
    with pytest.raises(UserError) as error:
        loading.load([*TINY, "collector.num_envs=2"])
    assert str(error.value) == (
        "collector.num_envs=2: should be at least 3, an env for each train level of gridworld"
    )


@pytest.mark.parametrize("lag", slow_but([0, 1], 0))
def test_twenty_updates_equal_ten_a_kill_and_ten_more(lag, tmp_path):
    """SIGKILL somewhere after update 10, then the same command again: the same to the last bit."""
    arguments = [*TINY, "updates=20", f"collector.lag={lag}"]
    whole = [*arguments, f"run_root={tmp_path / 'whole'}"]
    cut = [*arguments, f"run_root={tmp_path / 'cut'}"]
    assert runner.train(loading.load(whole)) == 0

    process = subprocess.Popen(command(*cut), stdout=subprocess.DEVNULL)
    metrics = folder_of(cut) / "metrics.csv"
    while process.poll() is None:
        if metrics.exists() and "\n12," in metrics.read_text():
            process.kill()
            break
        time.sleep(0.001)
    assert process.wait() == -signal.SIGKILL, "finished before it could be killed"
    interrupted = checkpoint.load(folder_of(cut) / "checkpoint.pt")["update"]
    assert 10 <= interrupted < 20

    assert runner.train(loading.load([*cut, "resume=must"])) == 0
    assert_equal(learned(folder_of(whole)), learned(folder_of(cut)))
    for name in ("metrics.csv", "evaluations.csv", "situations.csv"):
        pd.testing.assert_frame_equal(
            untimed(folder_of(whole) / name), untimed(folder_of(cut) / name)
        )


def test_evaluation_does_not_disturb_training(tmp_path):
    often = loading.load([*TINY, "updates=6", f"run_root={tmp_path / 'a'}", "evaluation.every=1"])
    never = loading.load([*TINY, "updates=6", f"run_root={tmp_path / 'b'}", "evaluation.every=99"])
    assert runner.train(often) == 0
    assert runner.train(never) == 0
    one, other = learned(often.folder), learned(never.folder)
    assert (one.pop("evaluated"), other.pop("evaluated")) == (6, 0)  # the rest ends the run
    assert_equal(one, other)


def test_seeds_differ_and_repeat(tmp_path):
    states = []
    for root, seed in (("a", 0), ("b", 0), ("c", 1)):
        loaded = loading.load([*TINY, "updates=2", f"run_root={tmp_path / root}", f"seed={seed}"])
        assert runner.train(loaded) == 0
        states.append(learned(loaded.folder)["agent"]["network"])
    assert_equal(states[0], states[1])
    assert not torch.equal(states[0]["policy.weight"], states[2]["policy.weight"])


@pytest.mark.parametrize(
    ("number", "lag"),
    slow_but(
        [(signal.SIGINT, 0), (signal.SIGTERM, 1), (signal.SIGUSR1, 0), (signal.SIGXCPU, 0)],
        (signal.SIGINT, 0),
    ),
)
def test_a_run_that_a_signal_stopped_resumes_bit_for_bit(number, lag, tmp_path):
    common = [*TINY, "updates=100000", "schedule.checkpoint_every=99999", f"collector.lag={lag}"]
    arguments = [*common, "evaluation.every=99999", f"run_root={tmp_path / 'cut'}"]
    process = subprocess.Popen(command(*arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    metrics = folder_of(arguments) / "metrics.csv"
    while not metrics.exists() or "\n2," not in metrics.read_text():
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    assert errors.replace(ANNOUNCED.encode(), b"") == b""
    update = checkpoint.load(folder_of(arguments) / "checkpoint.pt")["update"]
    assert update >= 2
    assert list(metrics_of(metrics.parent)["update"]) == list(range(1, update + 1))
    cut = loading.load([*arguments, f"updates={update + 2}", "resume=must"])
    assert runner.train(cut) == 0
    assert list(metrics_of(metrics.parent)["update"]) == list(range(1, update + 3))
    whole = cut.model_copy(update={"run_root": str(tmp_path / "whole"), "resume": "never"})
    assert runner.train(whole) == 0
    assert_equal(learned(whole.folder), learned(cut.folder))


@pytest.mark.parametrize("lag", slow_but([0, 1], 0))
def test_a_run_that_its_time_has_stopped_resumes_bit_for_bit(lag, tmp_path, monkeypatch, capsys):
    """The first command has time for three updates, the second for none and makes one, the third is
    not limited."""
    arguments = [*TINY, "updates=6", f"collector.lag={lag}"]
    whole = loading.load([*arguments, f"run_root={tmp_path / 'whole'}"])
    assert runner.train(whole) == 0
    clock = SimpleNamespace(monotonic=itertools.count().__next__)
    monkeypatch.setattr(runner, "time", clock)
    for limit, update in ((3, 3), (0.5, 4)):
        cut = loading.load(
            [*arguments, f"run_root={tmp_path / 'cut'}", f"schedule.stop_after={limit}"]
        )
        assert runner.train(cut) == 0
        stopped = f"stopped at update {update}; the same command resumes"
        assert capsys.readouterr().out.splitlines()[-1] == stopped
        assert checkpoint.load(cut.folder / "checkpoint.pt")["update"] == update
        assert not run_folder.is_finished(cut)
    cut = loading.load([*arguments, f"run_root={tmp_path / 'cut'}", "resume=must"])
    assert runner.train(cut) == 0
    assert_equal(learned(whole.folder), learned(cut.folder))
    for name in ("metrics.csv", "evaluations.csv", "situations.csv"):
        one, other = (untimed(run.folder / name) for run in (whole, cut))
        pd.testing.assert_frame_equal(one, other)


def test_a_run_in_a_thread(tmp_path, capsys):
    config = loading.load([*TINY, "updates=2", f"run_root={tmp_path}"])
    with ThreadPoolExecutor() as pool:
        assert pool.submit(runner.train, config).result() == 0
    assert "signals save no checkpoint here: this is not the main thread" in capsys.readouterr().out
    assert run_folder.is_finished(config)


def test_the_end_of_a_run_is_told(tmp_path, capsys):
    arguments = [*TINY, f"run_root='{tmp_path / 'my runs'}'"]
    assert runner.train(loading.load([*arguments, "updates=2"])) == 0
    told = capsys.readouterr().out.splitlines()[-1]
    folder = folder_of([*arguments, "updates=2"])
    command = ["python", "-m", "zipf.report", str(folder.parent.parent), "window=last"]
    assert shlex.split(told) == ["finished;", *command]
    assert (folder / "train.log").read_text().endswith(" finished at update 2\n")
    with runner.Run(loading.load([*arguments, "updates=3"])):
        pass
    stopped = "stopped at update 2; the same command resumes"
    assert capsys.readouterr().out.splitlines()[-1] == stopped
    assert (folder / "train.log").read_text().endswith(f" {stopped}\n")


def test_a_checkpoint_is_written_once(tmp_path, monkeypatch):
    written = []
    save = checkpoint.save

    def spy(path, state):
        written.append((path.name, state["update"]))
        save(path, state)

    monkeypatch.setattr(checkpoint, "save", spy)
    given = [*TINY, "updates=4", "schedule.checkpoint_every=2", f"run_root={tmp_path}"]
    assert runner.train(loading.load(given)) == 0
    names = "checkpoint.pt", "checkpoint.pt", "weights.pt", "checkpoint.pt"
    assert written == list(zip(names, (0, 2, 4, 4), strict=True))


def test_a_run_leaves_the_process_as_it_was(tmp_path):
    before = sys.getswitchinterval()
    given = [*TINY, "updates=2", "collector.lag=1", f"run_root={tmp_path}"]
    assert runner.train(loading.load(given)) == 0
    assert sys.getswitchinterval() == before
    (loading.load(given).folder / "evaluations.csv").write_text("nothing\n")
    with pytest.raises(UserError, match=r"evaluations\.csv"):
        runner.train(loading.load(given))
    assert sys.getswitchinterval() == before


def test_resume_modes(trained, tmp_path):
    with pytest.raises(UserError, match="holds a run already"):
        runner.train(loading.load([*trained, "resume=never"]))
    assert runner.train(loading.load([*trained, "resume=must"])) == 0
    with pytest.raises(UserError, match="no checkpoint"):
        runner.train(loading.load([*trained, "resume=must", "seed=5"]))


def test_a_checkpoint_of_another_configuration_is_refused(trained):
    folder = folder_of(trained)
    before = (folder / "checkpoint.pt").read_bytes()
    with pytest.raises(UserError, match=r"agent\.discount=0\.99 there, 0\.5 here"):
        runner.train(loading.load([*trained, "agent.discount=0.5", f"name='{folder.parent.name}'"]))
    assert (folder / "checkpoint.pt").read_bytes() == before


def test_a_damaged_checkpoint_is_an_error_and_never_a_fresh_start(trained):
    path = folder_of(trained) / "checkpoint.pt"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    result = call(*trained)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert str(path) in result.stderr
    assert "damaged" in result.stderr
    assert path.read_bytes() == content


def test_a_checkpoint_of_another_version_is_refused(trained):
    path = folder_of(trained) / "checkpoint.pt"
    state = checkpoint.load(path)
    state["agent"]["network"]["renamed"] = state["agent"]["network"].pop("policy.weight")
    checkpoint.save(path, state)
    with pytest.raises(UserError, match="does not fit this version"):
        runner.train(loading.load(trained))
    checkpoint.save(path, {"update": 2})
    with pytest.raises(UserError, match="does not fit this version"):
        runner.train(loading.load(trained))


def test_weights_that_are_damaged_or_of_another_network_are_refused(trained):
    folder = folder_of(trained)
    (folder / "checkpoint.pt").unlink()
    path = folder / "weights.pt"
    whole = path.read_bytes()
    assert load_agent(folder, "cpu").update == checkpoint.load(path)["update"] > 0
    path.write_bytes(whole[:-1] + b"x")
    with pytest.raises(UserError, match=r"weights\.pt: is damaged"):
        load_agent(folder, "cpu")
    checkpoint.save(path, {"update": 2, "weights": {"policy.bias": torch.zeros(3)}})
    with pytest.raises(UserError, match=r"weights\.pt: does not fit this version"):
        load_agent(folder, "cpu")


@pytest.mark.parametrize("has", [True, False])
def test_agents_act_in_a_precision_that_the_device_has(has, tmp_path, monkeypatch):
    options = [*TINY, "updates=1", "precision=bfloat16", f"run_root={tmp_path}"]
    config = loading.load(options)
    assert runner.train(config) == 0
    monkeypatch.setattr(run_trained, "has_bfloat16", lambda device: has)
    for _ in ("checkpoint.pt", "weights.pt"):
        agent = load_agent(config.folder, "cpu").agent
        assert agent.precision == ("bfloat16" if has else "float32")
        (config.folder / "checkpoint.pt").unlink(missing_ok=True)


def test_training_does_not_go_on_from_weights_alone(trained):
    (folder_of(trained) / "checkpoint.pt").unlink()
    with pytest.raises(UserError, match="their checkpoint is missing"):
        runner.train(loading.load(trained))


def test_evaluate_scores_a_run(trained, monkeypatch, capsys):
    folder = folder_of(trained)
    monkeypatch.setattr(sys, "argv", ["zipf.evaluate", f"run={folder}", "episodes=20"])
    capsys.readouterr()
    evaluate.main()
    shown = capsys.readouterr().out
    table = pd.read_csv(folder / "evaluation-2-episodes20-seed0.csv")
    assert list(table["level_kind"]) == [*envs.KINDS]
    assert (table["episodes"] == 20).all()
    evaluate.main()
    assert capsys.readouterr().out == shown


def test_evaluate_shows_scores_also_where_it_cannot_write(trained, monkeypatch, capsys):
    folder = folder_of(trained)
    moved = folder.parent / "[old] [" / "b]"
    moved.parent.mkdir()
    folder.rename(moved)
    monkeypatch.setattr(sys, "argv", ["zipf.evaluate", f"run={moved}", "episodes=20"])
    evaluate.main()
    shown = capsys.readouterr().out
    assert f"written: {moved}/evaluation-2-episodes20-seed0.csv\n" in shown
    (moved / "evaluation-2-episodes20-seed0.csv").unlink()
    (moved / "evaluation-2-episodes20-seed0.csv").mkdir()
    with pytest.raises(SystemExit):
        evaluate.main()
    told = capsys.readouterr()
    assert told.out == shown[: shown.index("written: ")]
    assert told.err.endswith("seed0.csv: cannot be written: Is a directory\n")


def test_a_closing_evaluation_that_was_dropped_is_made_again(tmp_path):
    """Where a run that was to go on is stopped before its first update."""
    every = [*TINY, "evaluation.every=2", f"run_root={tmp_path}"]
    ended = loading.load([*every, "updates=3"])
    assert runner.train(ended) == 0
    evaluations = ended.folder / "evaluations.csv"
    rows = evaluations.read_text()
    with runner.Run(loading.load([*every, "updates=5"])) as begun:
        begun.save()
    assert sorted(set(pd.read_csv(evaluations)["update"])) == [0, 2]
    assert runner.train(ended) == 0
    seconds = re.compile(r"(?m)^(3,[0-9]+),[0-9.]+")
    assert seconds.sub(r"\1", evaluations.read_text()) == seconds.sub(r"\1", rows)


def test_a_run_that_is_asked_to_stop_in_its_last_evaluation_has_finished(tmp_path, monkeypatch):
    config = loading.load([*TINY, "updates=2", f"run_root={tmp_path}"])
    evaluated = runner.Run.evaluate

    def stopped(run):
        evaluated(run)
        if run.update == 2:
            signal.raise_signal(signal.SIGTERM)

    monkeypatch.setattr(runner.Run, "evaluate", stopped)
    assert runner.train(config) == 0
    assert run_folder.is_finished(config)


@pytest.mark.parametrize("lag", [0, 1])
@pytest.mark.parametrize("update", [0, 2, 3])
def test_a_run_that_is_asked_to_stop_gives_its_evaluation_up(update, lag, tmp_path, monkeypatch):
    """Before the first update, between updates and after the last. The resumed run makes it, and
    ends as one that was not stopped."""
    options = [*TINY, "updates=3", "evaluation.every=2", f"collector.lag={lag}"]
    cut, whole = (
        loading.load([*options, f"run_root={tmp_path / name}"]) for name in ("cut", "whole")
    )
    watch = runner.Run._watch_evaluation

    def stopped(run, ended, episodes):
        if run.update == update and ended:
            signal.raise_signal(signal.SIGTERM)
        watch(run, ended, episodes)

    with monkeypatch.context() as patch:
        patch.setattr(runner.Run, "_watch_evaluation", stopped)
        assert runner.train(cut) == signal.SIGTERM
    assert checkpoint.load(cut.folder / "checkpoint.pt")["update"] == update
    evaluations = cut.folder / "evaluations.csv"
    scored = set(pd.read_csv(evaluations)["update"]) if evaluations.exists() else set()
    assert scored == {0, 2, 3} & set(range(update))
    for config in (cut, whole):
        assert runner.train(config) == 0
    assert_equal(learned(whole.folder), learned(cut.folder))
    for name in ("metrics.csv", "evaluations.csv", "situations.csv"):
        one, other = (untimed(run.folder / name) for run in (whole, cut))
        pd.testing.assert_frame_equal(one, other)


@pytest.mark.parametrize("name", envs.SCRIPTED)
def test_evaluate_scores_a_script(name, monkeypatch, capsys):
    arguments = [f"policy={name}", "split=gridworld", "episodes=50"]
    monkeypatch.setattr(sys, "argv", ["zipf.evaluate", *arguments])
    evaluate.main()
    shown = capsys.readouterr().out
    expected = evaluate.score(name, "gridworld", episodes=50)
    assert f"policy={name}\n" in shown
    for score in expected.values():
        assert f" {score:.3f} " in shown
    assert (min(expected.values()) == 1) == (name == "expert")


@pytest.mark.parametrize(
    ("module", "arguments", "told"),
    [
        ("zipf.train", ["experiment=gridwrld"], "gridworld"),
        ("zipf.train", ["-m", "experiment=demo", "seed=0,-1"], "seed=-1"),
        ("zipf.train", ["experiment=demo", "device=cuda:99"], "device=cuda:99"),
        ("zipf.evaluate", ["run=nowhere"], "nowhere: is no run's folder"),
        ("zipf.evaluate", ["rn=x"], "run"),
        ("zipf.evaluate", ["run=nowhere", "episodes=0"], "episodes=0"),
        ("zipf.evaluate", ["episodes=5"], "choose run=<a run's folder>, or policy=expert"),
        ("zipf.evaluate", ["policy=expert"], "with split=<a split's name>"),
        ("zipf.evaluate", ["run=x", "split=gridworld"], "with split=<a split's name>"),
        ("zipf.evaluate", ["policy=expert", "split=gridworld", "run=x"], "run=x: does not go with"),
        ("zipf.evaluate", ["policy=expert", "split=gridwrld"], "did you mean 'gridworld'"),
        ("zipf.evaluate", ["policy=best", "split=gridworld"], "policy=best"),
        ("zipf.report", ["nowhere"], "nowhere"),
        ("zipf.train", ["experiment=demo", "-m", "seed=0,-1"], "seed=-1"),
        ("zipf.train", ["experiment=demo", "hydra/launcher=joblib"], "is for the jobs of a sweep"),
        ("zipf.train", ["experiment=demo", "hydra.launcher.n_jobs=2"], "add -m"),
        ("zipf.train", ["--experiment", "demo"], "options have no dashes: experiment=<value>"),
        ("zipf.train", ["experiment=demo", "--seed=1"], "options have no dashes: seed=1"),
        ("zipf.train", ["--resolve"], "--resolve: goes with --cfg job"),
        ("zipf.train", ["--run", "--cfg", "job", "experiment=demo"], "--run and --cfg: choose one"),
        ("zipf.train", ["--help", "experiment=nope"], "nope"),
        ("zipf.train", ["--cfg", "job", "experiment=demo", "seed=0,1"], "options of one run"),
        ("zipf.train", ["experiment=demo", "--config-dir", "x" * 5000], "no such folder"),
        ("zipf.evaluate", [f"run={'x' * 5000}"], "File name too long"),
        ("zipf.report", ["x" * 5000], "File name too long"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(
    module, arguments, told, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [module, *arguments])
    with pytest.raises(SystemExit) as exited:
        sys.exit(importlib.import_module(module).main())
    assert exited.value.code == 2
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_family_without_a_scripted_player_is_named(monkeypatch, capsys):
    monkeypatch.setitem(envs.find_family("gridworld").__dict__, "generalist", None)
    arguments = ["policy=generalist", "split=gridworld", "num_envs=1", "episodes=1"]
    monkeypatch.setattr(sys, "argv", ["zipf.evaluate", *arguments])
    with pytest.raises(SystemExit) as exited:
        evaluate.main()
    assert exited.value.code == 2
    assert "policy=generalist: gridworld/" in capsys.readouterr().err


def test_a_run_whose_checkpoint_is_gone_is_not_written_over(trained):
    folder = folder_of(trained)
    (folder / "checkpoint.pt").unlink()
    before = (folder / "metrics.csv").read_text()
    for mode in ("auto", "never"):
        with pytest.raises(UserError, match="up to update 2"):
            runner.train(loading.load([*trained, f"resume={mode}"]))
    assert (folder / "metrics.csv").read_text() == before


def test_a_kill_before_the_first_checkpoint_starts_again(trained):
    folder = folder_of(trained)
    (folder / "checkpoint.pt").unlink()
    rows = pd.read_csv(folder / "evaluations.csv")
    rows[rows["update"] == 0].to_csv(folder / "evaluations.csv", index=False)
    (folder / "metrics.csv").write_text("")
    (folder / "situations.csv").write_text("update,level_k")
    assert runner.train(loading.load(trained)) == 0
    assert list(metrics_of(folder)["update"]) == [1, 2]
    assert sorted(pd.read_csv(folder / "evaluations.csv")["update"]) == [0] * 5 + [2] * 5


def test_a_run_stopped_at_its_start_is_not_scored_there_twice(tmp_path):
    arguments = [*TINY, "updates=2", f"run_root={tmp_path}"]
    run_folder.make(folder_of(arguments))
    with runner.Run(loading.load(arguments)) as begun:
        begun.evaluate()
        begun.save()
    assert runner.train(loading.load(arguments)) == 0
    rows = pd.read_csv(folder_of(arguments) / "evaluations.csv")
    assert list(rows["update"]) == [0] * 5 + [2] * 5


def test_a_finished_run_is_left_as_it_is(trained):
    before = contents(folder_of(trained))
    assert runner.train(loading.load(trained)) == 0
    assert contents(folder_of(trained)) == before


@pytest.mark.parametrize("every", [2, 4])
def test_more_updates_give_the_same_tables_as_if_they_had_been_asked_for_at_once(every, tmp_path):
    """An evaluation that was due only because the run ended is dropped; also where the run is
    killed after that, before its next checkpoint."""
    common = [*TINY, f"evaluation.every={every}"]
    whole = [*common, "updates=8", f"run_root={tmp_path / 'whole'}"]
    cut = [*common, f"run_root={tmp_path / 'cut'}"]
    assert runner.train(loading.load(whole)) == 0
    assert runner.train(loading.load([*cut, "updates=6"])) == 0
    for _ in range(2):
        with runner.Run(loading.load([*cut, "updates=8"])):
            pass  # nothing is saved
    assert runner.train(loading.load([*cut, "updates=8"])) == 0
    assert_equal(learned(folder_of(whole)), learned(folder_of([*cut, "updates=8"])))
    for name in ("metrics.csv", "evaluations.csv", "situations.csv"):
        one, other = (untimed(folder_of(run) / name) for run in (whole, [*cut, "updates=8"]))
        pd.testing.assert_frame_equal(one, other)


def test_an_interrupted_run_that_ends_where_it_stopped_is_still_scored(trained):
    longer = loading.load([*trained, "updates=4", "evaluation.every=9"])
    with runner.Run(longer) as run:
        run.step()
        run.save()
    assert runner.train(loading.load([*trained, "updates=3", "evaluation.every=9"])) == 0
    assert list(pd.read_csv(longer.folder / "evaluations.csv")["update"])[-3:] == [3, 3, 3]


def test_a_resumed_run_describes_how_it_went_on(trained):
    folder = folder_of(trained)
    began = run_folder.read_description(folder)
    longer = [*trained, "updates=3", "schedule.window=[1,3]"]
    assert runner.train(loading.load(longer)) == 0
    now = run_folder.read_description(folder)
    assert now["started"] == began["started"]
    assert (now["window"], now["num_updates"]) == ([1, 3], 3)
    assert [again["update"] for again in now["resumed"]] == [2]


def test_a_run_of_other_images_says_so(trained, monkeypatch, capsys, caplog):
    """When it is resumed and when its agent is loaded, also after it went on with the new ones."""
    folder = folder_of(trained)
    assert run_folder.other_images(folder) is None
    changed = dataclasses.replace(
        envs.find_family("gridworld"), id="zipf/Gridworld-v1", image_changes=("red walls",)
    )
    monkeypatch.setitem(zipf.envs.family._FAMILIES, "gridworld", changed)
    line = (
        f"{folder}: was trained on the images of zipf/Gridworld-v0, and zipf/Gridworld-v1 has "
        "others (red walls): scores on them differ"
    )
    load_agent(folder, "cpu")
    assert caplog.messages == [line]
    longer = [*trained, "updates=3", "schedule.window=[1,3]"]
    capsys.readouterr()
    assert runner.train(loading.load(longer)) == 0
    assert "scores on them differ" in capsys.readouterr().out
    assert run_folder.other_images(folder) == line
    assert runner.train(loading.load([*trained, "seed=7"])) == 0
    assert run_folder.other_images(loading.load([*trained, "seed=7"]).folder) is None


@pytest.mark.parametrize("name", ["gridworld", "playroom", "labyrinth"])
def test_an_id_counts_the_changes_of_the_images(name):
    found = envs.find_family(name)
    assert found.id.endswith(f"-v{len(found.image_changes)}")


def test_two_processes_do_not_train_in_one_folder(trained):
    with run_folder.lock(folder_of(trained)):
        result = call(*trained)
    assert result.returncode == 2
    assert "another process" in result.stderr


def test_divergence_is_an_error_and_the_checkpoint_is_kept(trained):
    with pytest.raises(UserError, match="diverged"):
        runner.train(loading.load([*trained, "seed=1", "agent.learning_rate=1e30"]))


WORKSPACE = "CUBLAS_WORKSPACE_CONFIG"


@pytest.fixture
def kernels(monkeypatch):
    """A function that chooses kernels as a run on this device does, with CUDA started or not;
    returns PyTorch's two flags and cuBLAS's variable."""
    monkeypatch.delenv(WORKSPACE, raising=False)
    monkeypatch.setattr(torch.backends.cudnn, "benchmark", True)

    def choose(device, deterministic=True, started=False):
        monkeypatch.setattr(torch.cuda, "is_initialized", lambda: started)
        runner._choose_kernels(SimpleNamespace(deterministic=deterministic, torch_device=device))
        flags = torch.are_deterministic_algorithms_enabled(), torch.backends.cudnn.benchmark
        return *flags, os.environ.get(WORKSPACE)

    yield choose
    torch.use_deterministic_algorithms(False)


def test_deterministic_kernels_are_chosen_on_cuda_alone(kernels):
    assert kernels("cpu") == (False, True, None)
    assert kernels("cuda", deterministic=False) == (False, True, None)
    assert kernels("cuda:1") == (True, False, ":4096:8")
    assert kernels("cuda:1", started=True) == (True, False, ":4096:8")
    assert kernels("cuda", deterministic=False) == (False, False, ":4096:8")


@pytest.mark.parametrize(("value", "started"), [(None, True), (":0:0", False)])
def test_deterministic_kernels_that_come_too_late_are_refused(value, started, kernels, monkeypatch):
    if value:
        monkeypatch.setenv(WORKSPACE, value)
    with pytest.raises(UserError, match=f"{WORKSPACE} is {value}; should be :4096:8 or :16:8"):
        kernels("cuda", started=started)


def test_a_run_goes_on_with_or_without_deterministic_kernels(trained):
    assert runner.train(loading.load([*trained, "updates=3", "deterministic=true"])) == 0


compiler = pytest.mark.skipif(shutil.which("c++") is None, reason="torch.compile calls a compiler")


@pytest.mark.slow
@compiler
def test_what_is_compiled_learns_the_same(tmp_path):
    plain = loading.load([*TINY, "agent=vmpo", "updates=3", f"run_root={tmp_path / 'plain'}"])
    compiled = loading.load(
        [*TINY, "agent=vmpo", "updates=3", "compile=true", f"run_root={tmp_path / 'compiled'}"]
    )
    assert plain.condition == compiled.condition
    env = envs.make_vec(compiled.split.train[0], 1, **compiled.level_options)
    agent = build_agent(compiled, env)
    for network in (agent.network, agent.target):
        assert network.encoder.reader("image")._compiled_call_impl is not None
    for config in (plain, compiled):
        assert runner.train(config) == 0
    one, other = (metrics_of(config.folder) for config in (plain, compiled))
    for name in ("loss", "baseline_loss", "gradient_norm", "value"):
        np.testing.assert_allclose(one[name], other[name], rtol=1e-3, atol=1e-6)
    assert evaluate_run(EvaluateOptions(run=str(compiled.folder), episodes=2))[0] == 3


@pytest.mark.parametrize("has", [True, False])
def test_a_run_tells_its_precision_and_where_that_is_slow(has, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(runner, "has_bfloat16", lambda device: has)
    arguments = [*TINY, "updates=1", "precision=bfloat16", f"run_root={tmp_path}"]
    config = loading.load(arguments)
    assert runner.train(config) == 0
    for told in (capsys.readouterr().out, (config.folder / "train.log").read_text()):
        assert "a new run, on cpu in bfloat16" in told
        assert ("several times as long as with precision=float32" in told) == (not has)


def test_what_cannot_be_compiled_is_one_line(trained, monkeypatch):
    import torch._inductor.config as inductor

    monkeypatch.setattr(inductor, "force_disable_caches", True)
    monkeypatch.setattr(inductor.cpp, "cxx", ("no-such-compiler",))
    torch._dynamo.reset()
    with pytest.raises(UserError, match=r"^compile=true: .*; choose compile=false$"):
        runner.train(loading.load([*trained, "seed=1", "compile=true"]))


FULL_DISK = """
import resource, sys
from zipf.experiments.building import loading
from zipf.experiments.training import runner
from zipf.errors import UserError

resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), int(sys.argv[1])))
try:
    runner.train(loading.load(sys.argv[2:]))
except UserError as error:
    print(error)
"""


@pytest.mark.parametrize("size", slow_but([0, 300, 2000, 20_000], 2000))
def test_a_full_disk_is_one_line_and_loses_nothing(size, trained):
    """A limit on file sizes stands for the disk: writes fail in the same way, at every file."""
    before = learned(folder_of(trained))
    arguments = [str(size), *trained, "updates=400", "evaluation.every=1"]
    process = [sys.executable, "-c", FULL_DISK, *arguments]
    result = subprocess.run(process, capture_output=True, text=True, timeout=120)
    assert "cannot be written" in result.stdout, result.stderr
    assert result.stderr == ""
    after = learned(folder_of(trained))
    assert after["update"] >= before["update"]
    assert runner.train(loading.load([*trained, f"updates={after['update'] + 1}"])) == 0
