"""`--explain`: every option of a run, with the line or the rule that its value comes from."""

import json
import re
import shlex
import sys

import pytest
from omegaconf import OmegaConf

import zipf.train
from zipf.errors import UserError
from zipf.experiments.building import run_folder
from zipf.experiments.options import config_files, explaining
from zipf.experiments.options.command_line import choices
from zipf.experiments.options.schema import has_bfloat16
from zipf.experiments.records.descriptions import read_description

RULES = {
    "experiment": "command line: experiment=",
    "condition": "command line: condition=",
    "environment.split": "the first split of ",
    "collector.lag": "null: what agent=",
    "precision": "auto: what is fast on this device",
}
"""Options whose value a rule makes, alone or from what a line says."""


def value_in(line, name):
    """The value that a line of a YAML file, or of a class, has for a name."""
    value = r"\[[^]]*\]|\"[^\"]*\"|[^#,}\n]*"
    if in_class := re.match(rf" +{name}: \S.* = (?:Field\(default=)?({value})", line):
        found = in_class[1].rstrip(") ").replace("None", "null")
    else:
        (found,) = re.findall(rf"(?:^|[\s/{{]){name}: *({value})", line)
    return OmegaConf.create(f"value: {found.strip()}").value


@pytest.mark.parametrize("condition", ["impala", "r2d2", "vmpo", "supervised_matching"])
@pytest.mark.parametrize("experiment", choices("experiment"))
def test_the_named_line_has_the_option_and_its_value(experiment, condition):
    words = [f"experiment={experiment}", f"condition={condition}", "device=cpu"]
    try:
        origins = explaining.explain(words)
    except UserError:
        assert condition == "supervised_matching"  # which is for some environments
        return
    assert len(origins) > 60
    for one in origins:
        if one.option in RULES and (one.rule or one.option == "experiment"):
            assert one.rule.startswith(RULES[one.option])
            continue
        if one.option == "device":
            assert one.where == "command line: device=cpu"
            continue
        assert not one.rule or one.rule.startswith("default of "), one
        line = one.place.file.read_text(encoding="utf-8").splitlines()[one.place.line - 1]
        group, _, name = one.option.rpartition(".")
        if group.startswith("loggers.") and name == "name":
            assert one.value in value_in(line, "loggers")
            continue
        there = value_in(line, group if name == "name" else name)
        assert there == one.value, (one, line)
        if isinstance(one.value, (int, float)) and not isinstance(one.value, bool):
            assert one.comment, one


def test_what_a_rule_makes_of_a_line():
    words = ["experiment=gridworld_compact", "device=cpu"]
    found = {one.option: one for one in explaining.explain([*words, "condition=impala"])}
    assert found["collector.lag"].value == 1
    assert found["collector.lag"].rule == "null: what agent=impala corrects for"
    assert found["precision"].value == ("bfloat16" if has_bfloat16("cpu") else "float32")
    changed = [*words, "condition=impala", "agent.discount=0.5", "collector.lag=0"]
    found = {one.option: one for one in explaining.explain(changed)}
    assert found["agent.discount"].where == "command line: agent.discount=0.5"
    assert found["agent.discount"].comment.startswith("instead of 0.99, configs/agent")
    assert found["collector.lag"].where == "command line: collector.lag=0"
    assert found["condition"].value == "impala-lag_0-discount_0.5"
    assert found["condition"].rule.startswith("name: null")
    assert found["row.title"].rule == "and what differs"
    assert found["row.line"].rule == ""
    named = [*words, "name=mine", "row.order=3", "+row={colour: '#123456'}"]
    found = {one.option: one for one in explaining.explain(named)}
    assert found["condition"].where == "command line: name=mine"
    assert found["row.title"].where == "name"
    assert found["row.order"].where == "command line: row.order=3"
    assert found["row.line"].rule == "default of RowOptions"


def test_the_choice_for_environments_without_an_instruction():
    words = ["experiment=demo", "condition=impala_transformer_vision_language"]
    (found,) = (one for one in explaining.explain(words) if one.option == "auxiliary.name")
    assert (found.value, found.rule) == ("vision", "there is no instruction")
    line = found.place.file.read_text().splitlines()[found.place.line - 1]
    assert value_in(line, "auxiliary") == "vision"


def test_options_from_outside_the_package_have_a_line_too(tmp_path, monkeypatch):
    monkeypatch.setattr(config_files, "_user_folder", None)
    file = tmp_path / "condition.yaml"
    file.write_text(
        "mine:\n  choose:\n    memory: gtrxl  # why\n"
        "  memory:\n    gtrxl:\n      layers: 3  # tried\n"
    )
    config_files.use_folder(tmp_path)
    found = explaining.explain(["experiment=demo_conditions", "condition=mine"])
    known = {one.option: one for one in found}
    for option, line, comment in (("memory.layers", 6, "tried"), ("memory.name", 3, "why")):
        assert (known[option].place.file, known[option].place.line) == (file, line)
        assert known[option].comment == comment


def command(monkeypatch, capsys, *words):
    """What the command prints, to both streams."""
    monkeypatch.setattr(sys, "argv", ["zipf.train", *words])
    monkeypatch.setattr(config_files, "_user_folder", None)
    with pytest.raises(SystemExit) as ended:
        zipf.train.main()
    return ended.value.code, *capsys.readouterr()


def test_the_command_explains_a_run_and_a_part(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["experiment=demo", "condition=impala", "agent.discount=0.5", "--explain"]
    code, whole, error = command(monkeypatch, capsys, *words)
    assert (code, error) == (0, "")
    code, part, _ = command(monkeypatch, capsys, *words, "agent")
    assert code == 0
    assert [line.split() for line in part.splitlines()] == [
        line.split() for line in whole.splitlines() if line.startswith("agent.")
    ]
    assert "instead of 0.99" in part
    _, one, _ = command(monkeypatch, capsys, "--explain", "memory.size", *words[:-1])
    assert len(one.splitlines()) == 1
    assert not list(tmp_path.iterdir())


@pytest.fixture
def recorded(trained, tmp_path):
    """The folder of a run that says by which command it was made."""
    (folder,) = tmp_path.glob("demo/*/seed0")
    described = json.loads((folder / "run.json").read_text())
    described["command"] = shlex.join(["python", "-m", "zipf.train", *trained])
    (folder / "run.json").write_text(json.dumps(described))
    return folder


def explained(folder):
    config = run_folder.read_config(folder)
    command = read_description(folder / "run.json").last_command
    return explaining.explain_run(config, command, folder / "config.yaml")


def test_a_runs_folder_is_explained(recorded):
    found = {one.option: one for one in explained(recorded)}
    assert found["agent.name"].value == "impala"
    assert found["network.patch"].place.file.is_relative_to(config_files.CONFIG_DIR)
    assert found["memory.size"].where == "command line: memory.size=16"
    config = OmegaConf.load(recorded / "config.yaml")
    config.agent.discount = 0.7
    OmegaConf.save(config, recorded / "config.yaml")
    changed = {one.option: one for one in explained(recorded)}
    assert changed["agent.discount"].value == 0.7
    assert changed["agent.discount"].comment.startswith("now 0.99, configs/agent")
    place = changed["agent.discount"].place
    assert place.file == recorded / "config.yaml"
    assert place.file.read_text().splitlines()[place.line - 1] == "  discount: 0.7"
    described = json.loads((recorded / "run.json").read_text())
    described["command"] = "python -m zipf.train experiment=gone"
    (recorded / "run.json").write_text(json.dumps(described))
    lost = explained(recorded)
    assert {one.place.file for one in lost if one.place} == {recorded / "config.yaml"}
    assert all("experiment=gone: no such experiment" in one.comment for one in lost)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["experiment=demo", "--explain", "agnt"], "--explain agnt: no such option; did you mean"),
        (["experiment=demo", "--explain", "a", "b"], "name one group or option, or one run"),
        (["experiment=demo", "seed=0,1", "--explain"], "this is a sweep of 2 jobs"),
        (["--explain", "{folder}", "seed=1"], "leave out seed=1"),
        (["--explain", "{folder}"], "is no run's folder"),
    ],
)
def test_mistakes_are_one_line(words, told, tmp_path, monkeypatch, capsys):
    given = [word.format(folder=tmp_path) for word in words]
    code, _, error = command(monkeypatch, capsys, *given)
    assert code == 2
    assert told in error
    assert len(error.splitlines()) == 1


def test_the_command_explains_a_folder(recorded, monkeypatch, capsys):
    code, printed, error = command(monkeypatch, capsys, "--explain", str(recorded), "critic")
    assert (code, error) == (0, "")
    assert printed.split()[:2] == ["critic.name", "scalar"]


def test_loggers_are_explained_by_who_chose_them():
    words = ["experiment=demo", "loggers=[tensorboard,wandb]", "loggers.wandb.mode=offline"]
    found = {one.option: one for one in explaining.explain(words)}
    assert found["loggers.wandb.name"].rule == "command line: loggers=[tensorboard,wandb]"
    assert found["loggers.wandb.project"].where.startswith("configs/loggers.yaml:")
    assert found["loggers.wandb.mode"].comment.startswith("instead of online, configs/loggers.yaml")
    usual = {one.option: one for one in explaining.explain(["experiment=demo"])}
    assert usual["loggers.tensorboard.name"].where.startswith("configs/train.yaml:")
