"""Agents of other programs as rows of our tables, and what such a row must not be taken for."""

import functools
import json
import shutil
import sys

import numpy as np
import pandas as pd
import pytest
import torch

from zipf import envs, evaluate, play, report
from zipf.errors import UserError
from zipf.experiments.building import loading, run_folder
from zipf.experiments.evaluation import external
from zipf.experiments.evaluation.trained import load_agent
from zipf.experiments.records import results
from zipf.experiments.training import runner

DEMO = {"num_maps": 20, "num_rooms": (2, 2), "num_objects": 5, "max_steps": 9}
PLAY = {"episodes": 12, "num_envs": 6}


def policy(observation):
    return observation["image"][:, 31, 31, 0].astype(int) % 8


def recorded(folder, frames=1000, split="gridworld", **options):
    options = {"name": "Theirs", "experiment": "demo", **PLAY, **DEMO, **options}
    return evaluate.record(policy, split, folder, frames=frames, **options)


def test_the_ranks_are_those_of_the_level_that_has_most(tmp_path):
    few = functools.partial(envs.make_vec, "gridworld/uniform", num_maps=3)
    split = envs.Split("few_maps", lambda n, num_maps, **o: few(n, **o), *["gridworld/uniform"] * 2)
    recorded(tmp_path, split=split)
    assert results.load_run(tmp_path).description.situation == {"map": 20, "target": 5}


@pytest.mark.parametrize("content", [b"update,frames\n", b"\x80\n", b"update\n1,2\n"])
def test_a_damaged_record_is_refused(tmp_path, content):
    rows = [{"update": 1, "score": 0.5}]
    path = tmp_path / "evaluations.csv"
    path.write_bytes(content)
    with pytest.raises(UserError, match=r"evaluations\.csv, line "):
        external._with_rows(path, 1, rows)
    path.write_bytes(b"")
    assert external._with_rows(path, 1, rows) == "update,score\n1,0.5\n"


def test_a_record_is_a_run_that_the_report_reads(tmp_path):
    evaluation = recorded(tmp_path / "seed0", colour="#123456", order=3)
    run = results.load_run(tmp_path / "seed0")
    description = run.description
    assert description.experiment == "demo"
    assert description.row.title == "Theirs"
    assert (description.row.colour, description.row.order) == ("#123456", 3)
    assert description.external.name == "Theirs"
    assert description.situation == {"map": 20, "target": 5}
    assert [level.level for level in description.levels] == [
        *("gridworld/zipf_2", "gridworld/uniform", "gridworld/rare"),
        *("gridworld/validation", "gridworld/fresh"),
    ]
    assert description.levels[0].baselines["chance"].score == (
        envs.baseline("chance", "gridworld/zipf_2", **DEMO).score
    )
    assert description.paper is None
    rows = run.evaluations.set_index("level_kind")
    for kind, score in evaluation.scores.items():
        assert rows.loc[kind, "score"] == score
        assert rows.loc[kind, "frames"] == rows.loc[kind, "update"] == 1000
    assert run.situations["episodes"].sum() == 5 * 12
    written = json.loads((tmp_path / "seed0" / "run.json").read_text())
    assert written["external"]["env_options"] == evaluate.env_options("gridworld", **DEMO)
    assert written["torch"] == sys.modules["torch"].__version__
    report.report([tmp_path], tmp_path / "report")
    assert "Theirs" in (tmp_path / "report" / "report.md").read_text()


def test_the_benchmarks_own_worlds_are_the_papers(tmp_path):
    evaluate.record(policy, "gridworld", tmp_path, name="Theirs", frames=1, episodes=2)
    assert json.loads((tmp_path / "run.json").read_text())["paper"] == "gridworld"


def test_how_worlds_are_stepped_is_not_recorded(tmp_path):
    recorded(tmp_path / "seed0")
    recorded(tmp_path / "seed0", copy=False, render_mode="rgb_array")
    environment = json.loads((tmp_path / "seed0" / "run.json").read_text())["environment"]
    assert not {"copy", "render_mode"} & environment.keys()


def test_a_record_of_before_the_further_kinds_goes_on(tmp_path):
    recorded(tmp_path, 1000)
    described = json.loads((tmp_path / "run.json").read_text())
    described["levels"] = described["levels"][:3]
    for name in ("gridworld/validation", "gridworld/fresh"):
        del described["external"]["env_options"][name]
    (tmp_path / "run.json").write_text(json.dumps(described))
    recorded(tmp_path, 2000)
    run = results.load_run(tmp_path)
    assert [one.level_kind for one in run.description.levels] == [*envs.KINDS]


def test_several_records_are_a_curve(tmp_path):
    for frames in (1000, 3000, 2000):
        recorded(tmp_path, frames)
    last = recorded(tmp_path, 3000, seconds=7.5, episodes=20)
    table = pd.read_csv(tmp_path / "evaluations.csv")
    assert sorted(table["update"]) == [1000] * 5 + [2000] * 5 + [3000] * 5
    again = table[table["update"] == 3000]
    assert (again["episodes"] == 20).all()
    assert (again["seconds"] == 7.5).all()
    assert list(again["score"]) == list(last.scores.values())
    situations = pd.read_csv(tmp_path / "situations.csv")
    assert situations.groupby("update")["episodes"].sum().to_dict() == {
        1000: 60,
        2000: 60,
        3000: 100,
    }
    recorded(tmp_path, 4000, update=17)
    table = pd.read_csv(tmp_path / "evaluations.csv")
    assert set(table.loc[table["update"] == 17, "frames"]) == {4000}


def test_worlds_without_success_leave_it_empty(tmp_path):
    from zipf.envs.gridworld.vector import GridworldVectorEnv

    class Quiet(GridworldVectorEnv):
        reports_success = False

    split = envs.Split("quiet", lambda n, **o: Quiet(n, **o), "gridworld/uniform", "gridworld/rare")
    evaluate.record(policy, split, tmp_path, name="Theirs", frames=1, **PLAY, **DEMO)
    evaluations = pd.read_csv(tmp_path / "evaluations.csv").set_index("level_kind")
    assert evaluations["success"].isna().to_dict() == {
        "train": True,
        "uniform": False,
        "rare": False,
    }
    assert ",," in (tmp_path / "situations.csv").read_text().splitlines()[1]
    results.load_run(tmp_path)


def test_chance_is_measured_once_on_request(tmp_path, monkeypatch):
    own = envs.Split(
        "own",
        lambda n, **o: envs.make_vec("gridworld/zipf_2", n, **o),
        "gridworld/uniform",
        "gridworld/rare",
    )
    options = {"name": "Theirs", **PLAY, **DEMO}
    evaluate.record(policy, own, tmp_path / "unknown", frames=1, **options)
    levels = json.loads((tmp_path / "unknown" / "run.json").read_text())["levels"]
    assert "chance" not in levels[0]["references"]
    assert {"chance", "blind", "expert"} == levels[1]["references"].keys()
    evaluate.record(policy, own, tmp_path / "known", frames=1, chance_episodes=20, **options)
    levels = json.loads((tmp_path / "known" / "run.json").read_text())["levels"]
    assert levels[0]["references"]["chance"]["episodes"] == 20
    assert levels[1]["references"]["chance"]["episodes"] is None
    monkeypatch.delattr(envs, "baseline")  # which is how chance is looked up
    evaluate.record(policy, own, tmp_path / "known", frames=2, chance_episodes=20, **options)
    assert json.loads((tmp_path / "known" / "run.json").read_text())["levels"] == levels


@pytest.mark.parametrize("text", ["{}", "[]", "nothing", '{"external": null}'])
def test_a_description_of_something_else_is_refused(text, tmp_path):
    (tmp_path / "run.json").write_text(text)
    with pytest.raises(UserError, match="choose another folder"):
        recorded(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["run.json"]


def test_a_folder_may_be_at_home(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    recorded("~/seed0")
    assert (tmp_path / "seed0" / "run.json").is_file()


def test_a_folder_of_something_else_is_refused(tmp_path):
    recorded(tmp_path / "seed0")
    before = (tmp_path / "seed0" / "run.json").read_text()
    for other, told in (
        ({"seed": 1}, "seed 0 there, 1 here"),
        ({"name": "Others"}, "condition Theirs there, Others here"),
        ({"max_steps": 8}, r"environment.max_steps \S+ there, 8 here; external.env_options"),
    ):
        with pytest.raises(UserError, match=f"holds another record .*{told}"):
            recorded(tmp_path / "seed0", **other)
    assert (tmp_path / "seed0" / "run.json").read_text() == before
    (tmp_path / "ours").mkdir()
    (tmp_path / "ours" / "config.yaml").write_text("")
    with pytest.raises(UserError, match=r"holds a run of zipf\.train"):
        recorded(tmp_path / "ours")
    (tmp_path / "file").write_text("")
    with pytest.raises(UserError, match="cannot be written"):
        recorded(tmp_path / "file" / "seed0")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frames": -1}, "frames must be at least 0, got -1"),
        ({"frames": 1.5}, "frames must be a whole number, got 1.5"),
        ({"frames": 10**16}, "frames must be at most"),
        ({"update": -1}, "update must be at least 0, got -1"),
        ({"update": float("inf")}, "update must be a whole number, got inf"),
        ({"seed": 1.5}, "seed must be a whole number, got 1.5"),
        ({"seed": 2**63}, "seed must be at most"),
        ({"order": "x"}, "row.order: Input should be a valid number"),
        ({"chance_episodes": -1}, "chance_episodes must be at least 0"),
        ({"name": " "}, "name=' '"),
        ({"name": "a\nb"}, "should be one line"),
        ({"seconds": float("nan")}, "seconds=nan"),
        ({"name": None}, "name=None: should be one line"),
        ({"experiment": ""}, "experiment='': should be one line"),
        ({"experiment": 3}, "experiment=3: should be one line"),
        ({"seconds": "x"}, "seconds='x': should be a number"),
        ({"num_envs": "a"}, "num_envs must be a whole number, got 'a'"),
        ({"level": "rare"}, "level='rare' is no option here"),
        ({"colour": 3}, "colour=3: should be '#rrggbb'"),
        ({"colour": "red"}, "colour='red': should be '#rrggbb'"),
        ({"line": "dotted"}, "line='dotted': should be 'solid' or 'dashed'"),
    ],
)
def test_what_cannot_be_recorded_is_not_played(options, message, tmp_path):
    played = []

    def never(observation):
        played.append(observation)
        return policy(observation)

    options = {"frames": 1000, "name": "Theirs", **PLAY, **DEMO, **options}
    with pytest.raises(ValueError, match=message):
        evaluate.record(never, "gridworld", tmp_path / "seed0", **options)
    assert played == []
    assert list(tmp_path.iterdir()) == []


def test_a_constructor_option_without_a_place_in_json_is_refused(tmp_path):
    def make(num_envs, look=None, **options):
        return envs.make_vec("gridworld/uniform", num_envs, **options)

    own = envs.Split("own", make, make, make)
    with pytest.raises(ValueError, match=r"<object object .* cannot be written to run\.json"):
        evaluate.record(policy, own, tmp_path / "a", name="A", frames=1, look=object(), **DEMO)
    assert list(tmp_path.iterdir()) == []


def test_whole_numbers_of_any_type_are_recorded_alike(tmp_path):
    numbers = {"seed": 3, "order": 2, "num_maps": 20}
    recorded(tmp_path / "plain", 1_000_000, **numbers)
    given = {name: np.int64(value) for name, value in numbers.items()}
    recorded(tmp_path / "numpy", 1e6, **given, update=np.float64(1e6))
    recorded(tmp_path / "numpy", np.int64(1_000_000), **given)
    for name in ("evaluations.csv", "situations.csv"):
        plain, numpy = ((tmp_path / one / name).read_text() for one in ("plain", "numpy"))
        assert plain == numpy
    plain, numpy = (results.load_run(tmp_path / one).description for one in ("plain", "numpy"))
    assert plain == numpy


# What is not an agent of ours


@pytest.fixture(scope="module")
def ours(tmp_path_factory):
    """A run of ours, trained for two updates."""
    root = tmp_path_factory.mktemp("runs")
    config = loading.load(
        [
            *("experiment=demo", "device=cpu", "updates=2", "schedule.window=[0,2]"),
            *("collector.num_envs=4", "collector.unroll_length=5", "evaluation.episodes=4"),
            *("network.size=16", "memory.size=16", "environment.max_steps=9"),
            f"run_root={root}",
        ]
    )
    runner.train(config)
    return config.folder


def refused(monkeypatch, capsys, main, *arguments):
    monkeypatch.setattr(sys, "argv", ["zipf", *arguments])
    with pytest.raises(SystemExit) as exited:
        main()
    assert exited.value.code == 2
    return capsys.readouterr().err


def test_there_is_no_agent_in_a_record(tmp_path, monkeypatch, capsys, ours):
    recorded(tmp_path / "seed0")
    run = f"run={tmp_path / 'seed0'}"
    told = "records the scores of an agent of another program, Theirs; the agent is not there"
    assert told in refused(monkeypatch, capsys, evaluate.main, run)
    assert told in refused(monkeypatch, capsys, play.main, run, "record=a.gif")
    with pytest.raises(UserError, match="the agent is not there"):
        load_agent(tmp_path / "seed0")
    # Nor does somebody else's configuration and checkpoint make it one.
    for name in ("config.yaml", "checkpoint.pt"):
        shutil.copy(ours / name, tmp_path / "seed0")
    assert told in refused(monkeypatch, capsys, evaluate.main, run)
    assert told in refused(monkeypatch, capsys, play.main, run, "record=a.gif")
    with pytest.raises(UserError, match=r"config.yaml: by run.json the agent is external"):
        results.load_run(tmp_path / "seed0")


def test_a_checkpoint_of_other_options_is_no_agent_of_this_run(tmp_path, monkeypatch, capsys, ours):
    folder = tmp_path / "seed0"
    shutil.copytree(ours, folder)
    config = (folder / "config.yaml").read_text()
    (folder / "config.yaml").write_text(config.replace("discount: ", "discount: 0.1  # "))
    for main, arguments in ((evaluate.main, ()), (play.main, ("record=a.gif",))):
        error = refused(monkeypatch, capsys, main, f"run={folder}", *arguments)
        assert "was made with other options (agent.discount=" in error


def test_a_runs_agent_is_scored(ours):
    drawn = torch.get_rng_state()
    policy = load_agent(str(ours))
    assert torch.equal(torch.get_rng_state(), drawn)
    config = run_folder.read_config(ours)
    from zipf.experiments.evaluation.trained import evaluate_agent

    agent = load_agent(ours, "cpu").agent
    expected = evaluate_agent(config, agent, seed=3, **PLAY)
    for _ in range(2):
        scores = evaluate.score(policy, seed=3, **PLAY, **DEMO)
        assert list(scores.values()) == [result.score for result in expected]
    with pytest.raises(ValueError, match="num_objects=5 of the policy, 20 of gridworld/zipf_2"):
        evaluate.score(policy)
    policy.env_options = {}
    with pytest.raises(ValueError, match=r"seed0: its agent was trained in .*image.*tiles"):
        evaluate.score(policy, observation="tiles", **DEMO)
    with pytest.raises(UserError, match="is no run's folder"):
        load_agent(ours.parent)


def test_episodes_are_as_many_as_the_split_says(ours, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["zipf.evaluate", f"run={ours}"])
    evaluate.main()
    table = pd.read_csv(ours / "evaluation-2-seed0.csv")
    assert (table["episodes"] == 1000).all()
    assert np.isfinite(table["score"]).all()
