"""Where configurations are: files of groups with blocks, and files of experiments."""

import subprocess
import sys
import textwrap

import pytest

from zipf.errors import UserError
from zipf.experiments.building import loading
from zipf.experiments.options import composing, config_files, explaining, written
from zipf.registry import registries

FILES = {
    "condition.yaml": """
        # IMPALA with a wide LSTM.
        wide:
          choose: {agent: impala, memory: lstm, auxiliary: none}
          row: {title: Wide, order: 1.5}
          memory: {lstm: {size: 1024}}
        """,
    "sweep.yaml": """
        # Both.
        both:
          - {experiments: mine, conditions: [wide, impala], seeds: [0]}
        """,
    "experiments/mine.yaml": """
        # Mine.
        like: demo
        updates: 7
        agent:
          impala: {discount: 0.5, /collector: {num_envs: 32}}
        memory:
          gtrxl: {layers: 1}
        """,
    "experiments/further.yaml": """
        like: mine
        memory:
          mlp: {layers: 3}
        """,
}
OWN_CHOICES = {
    "memory.yaml": """
        short: {name: lstm, size: 64, layers: 1}
        mlp: {size: 5, layers: 1}
        """,
    "environment.yaml": "small: {split: gridworld, num_rooms: [2, 2], num_objects: 5}\n",
    "experiments/gridworld.yaml": """
        like: demo
        updates: 9
        memory: {short: {layers: 2}}
        """,
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A function that fills a folder of one's own."""
    monkeypatch.setattr(config_files, "_user_folder", None)

    def fill(files):
        for name, text in files.items():
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(textwrap.dedent(text))
        config_files.use_folder(tmp_path)
        return tmp_path

    return fill


def test_one_folder_takes_the_place_of_another(tmp_path, monkeypatch):
    monkeypatch.setattr(config_files, "_user_folder", None)
    usual = config_files.folders()
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        config_files.use_folder(tmp_path / name)
        assert config_files.folders() == [(tmp_path / name).resolve(), *usual]
    config_files.use_folder(None)
    assert config_files.folders() == usual


def values(*overrides):
    return composing.composed(*overrides).values


def test_every_choice_has_a_block_that_its_class_accepts():
    loading.load(["experiment=demo"])  # what is chosen from is registered
    for group in config_files.parts():
        for name in config_files.choices(group):
            found = config_files.find(group, name)
            assert found.values["name"] == name
            if group in registries():
                registries()[group].options[name].model_validate(found.values)


def test_sections_are_of_choices_that_there_are():
    for group, known in (("experiment", "experiments"), ("condition", "condition")):
        for name in composing.choices(group):
            found = config_files.find(group, name).values
            for part in config_files.parts():
                assert found.get(part, {}).keys() <= config_files.choices(part), (known, name)


def test_a_value_does_not_reach_another_choice(folder):
    assert values("experiment=demo", "condition=vmpo")["memory"]["layers"] == 2
    assert (
        values("experiment=demo", "condition=vmpo", "memory=gtrxl")["memory"]
        == (values("experiment=demo", "memory=gtrxl")["memory"])
    )
    achieved = ["experiment=playroom_lift_compact", "condition=imitation_hindsight_augmented"]
    assert values(*achieved)["hindsight"]["episodes"] == 64
    assert values(*achieved, "hindsight=none")["hindsight"] == {"name": "none"}
    folder(OWN_CHOICES)
    for experiment in ("demo", "gridworld_compact", "labyrinth_compact", "playroom_lift_compact"):
        sizes = {
            one: values(f"experiment={experiment}", f"memory={one}")["memory"]["size"]
            for one in ("lstm", "mlp", "short")
        }
        assert sizes == {"lstm": 256, "mlp": 256, "short": 64}


def test_a_folder_of_ones_own(folder):
    folder(FILES)
    wide = loading.load(["experiment=mine", "condition=wide"])
    assert (wide.condition, wide.row.title, wide.memory.size) == ("wide", "Wide", 1024)
    assert (wide.updates, wide.agent.discount, wide.collector.num_envs) == (7, 0.5, 32)
    assert wide.agent.learning_rate == 1e-3  # of demo
    other = loading.load(["experiment=mine", "agent=vmpo", "memory=gtrxl"])
    assert (other.collector.num_envs, other.memory.layers, other.memory.heads) == (256, 1, 2)
    further = loading.load(["experiment=further"])
    assert (further.memory.size, further.memory.layers) == (256, 3)
    assert (further.agent.discount, further.collector.num_envs) == (0.5, 32)
    assert "both" in composing.choices("sweep")
    assert config_files.find("condition", "wide").place.comment == "IMPALA with a wide LSTM."


def test_what_has_the_name_of_one_of_ours_takes_its_place(folder):
    folder(OWN_CHOICES)
    short = values("experiment=gridworld", "memory=short")
    assert (short["memory"], short["updates"]) == ({"name": "lstm", "size": 64, "layers": 2}, 9)
    assert values("experiment=gridworld_compact", "memory=mlp")["memory"]["size"] == 256
    assert values("experiment=labyrinth_forward", "memory=mlp")["memory"]["size"] == 5
    known = {one.option: one.place for one in explaining.explain(["experiment=gridworld"])}
    assert known["updates"].file.parent.name == "experiments"
    small = loading.load(["experiment=gridworld_compact", "environment=small"]).environment
    assert (small.split, small.num_objects) == ("gridworld", 5)


def test_what_a_choice_has_of_other_options_counts_for_every_group(folder):
    text = "like: demo\ncollector: {num_envs: 8}\nmemory: {mlp: {/collector: {num_envs: 4}}}\n"
    folder({"experiments/mine.yaml": text})
    assert values("experiment=mine")["collector"]["num_envs"] == 4
    assert values("experiment=mine", "memory=lstm")["collector"]["num_envs"] == 8


def test_a_file_that_was_edited_is_read_again(folder):
    path = folder(FILES) / "experiments" / "mine.yaml"
    assert values("experiment=mine", "seed=3")["updates"] == 7
    path.write_text(path.read_text().replace("updates: 7", "updates: 71"))
    assert values("experiment=mine", "seed=3")["updates"] == 71


def test_the_name_of_a_block_may_have_a_dot(folder):
    folder({"condition.yaml": "# Short.\nimpala_0.9: {agent: {impala: {discount: 0.9}}}\n"})
    assert values("experiment=demo", "condition=impala_0.9")["agent"]["discount"] == 0.9
    assert config_files.find("condition", "impala_0.9").place.comment == "Short."


def test_files_in_hydras_layout_are_told_their_places(folder):
    places = {
        "condition/a.yaml": "the block 'a' of {}/condition.yaml",
        "experiment/b.yaml": "{}/experiments/b.yaml",
        "sweep/c.yaml": "the block 'c' of {}/sweep.yaml",
    }
    here = folder(dict.fromkeys(places, "# @package _global_\n") | {"hydra/launcher/e.yaml": ""})
    with pytest.raises(UserError) as error:
        loading.load(["experiment=demo"])
    told = [f"{here / file}: should be {place.format(here)}" for file, place in places.items()]
    assert str(error.value).splitlines() == told


@pytest.mark.parametrize(
    ("file", "text", "told"),
    [
        (
            "experiments/bad.yaml",
            "like: demo\nmemory:\n  size: 3\n",
            "bad.yaml:2: memory: values of",
        ),
        (
            "experiments/bad.yaml",
            "like: demo\nmemory: 3\n",
            "bad.yaml:2: memory: values of a group",
        ),
        (
            "condition.yaml",
            "bad:\n  choose: {memory: mlp}\n  agent: {discount: 1}\n",
            ":3: agent: ",
        ),
        ("condition.yaml", "- bad\n", "condition.yaml: should have a block for each choice"),
        ("condition.yaml", "bad:\n  a: 1\n  a: 2\n", "found duplicate key a"),
        ("memory.yaml", "bad: [\n", "memory.yaml: is not a configuration: while parsing"),
        ("experiments/bad.yaml", "- 1\n", "bad.yaml:1: should be options"),
        ("experiments/bad.yaml", "like: bad\n", "bad.yaml:1: like: bad would be like itself"),
        (
            "experiments/bad.yaml",
            "like: demo\nchoose: {memry: mlp}\n",
            "bad.yaml:2: choose: memry is no group; should be one of agent, memory, ",
        ),
        ("experiments/bad.yaml", "like: dmo\n", "dmo"),
        ("experiments/bad.yaml", "like: [demo]\n", "bad.yaml:1: like: should be the name of an"),
        ("experiments/bad.yaml", "choose: mlp\n", "bad.yaml:1: choose: should be names of"),
        ("condition.yaml", "bad:\n  choose: {memory: 3}\n", "yaml:2: choose: should be names of"),
        ("experiments/bad.yaml", "updates: 1\ndefaults: [demo]\n", "bad.yaml:2: defaults: are Hyd"),
        ("memory.yaml", "mlp: 3\n", "memory.yaml:1: mlp: should be options"),
        ("memory.yaml", "3: {size: 4}\n", "memory.yaml: 3 is no name of a block"),
        ("memory.yaml", "~: 4\n", "found a key that is no name"),
        ("memory.yaml", "? [1, 2]\n: 4\n", "found a key that is no name"),
        ("memory.yaml", "a: !!set {b, c}\n", "could not determine a constructor for the tag"),
        ("experiments/bad.yaml", "like: demo\ncondition: ppo\n", "bad.yaml:2: condition: is cho"),
        ("experiments/bad.yaml", "like: demo\nexperiment: x\n", "bad.yaml:2: experiment: is the"),
        (
            "experiments/bad.yaml",
            "like: demo\nagent:\n  impla: {discount: 0.5}\n",
            "bad.yaml:3: agent: there is no impla; did you mean impala?",
        ),
        (
            "condition.yaml",
            "bad:\n  row: {title: x}\n  memory: {lsmt: {size: 7}}\n",
            ":3: memory: there is no lsmt; did you mean lstm?",
        ),
        ("memmory.yaml", "a: {size: 3}\n", "memmory.yaml: should be memory.yaml"),
        ("train.yaml", "updates: 3\n", "train.yaml: is read from zipf's own folder alone"),
        ("experiments/a.yml", "like: demo\n", "a.yml: should be a.yaml"),
    ],
)
def test_mistakes_in_files_are_one_line(file, text, told, folder):
    folder({file: text})
    words = ["experiment=bad" if "bad" in file else "experiment=demo"]
    with pytest.raises(UserError) as error:
        loading.load([*words, "condition=bad"] if file.startswith("condition") else words)
    assert told in str(error.value)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("text", ["updates: 3\n", "environment: {size: 3}\n"])
def test_an_experiment_without_an_environment_says_so(text, folder):
    folder({"experiments/bare.yaml": text})
    condition = "condition=impala_transformer_vision_language"  # for envs with an instruction
    for words in ([], [condition]):
        with pytest.raises(UserError, match=r"(?m)^environment(\.split)?: is not set$"):
            loading.load(["experiment=bare", *words])


def test_hidden_files_are_not_read(folder):
    """An editor's lock is a link to nowhere."""
    here = folder({**FILES, "experiments/.old.yaml": "- 1\n", ".conditions.yaml": "- 1\n"})
    for hidden in (".#condition.yaml", "experiments/.#mine.yaml"):
        (here / hidden).symlink_to("me@here.123")
    assert loading.load(["experiment=mine"]).updates == 7
    assert not [one for one in composing.choices("experiment") if one.startswith(".")]
    (here / "experiments" / "lost.yaml").symlink_to("nowhere")
    with pytest.raises(UserError, match=r"lost\.yaml: cannot be read: No such file"):
        loading.load(["experiment=mine"])


def test_choices_are_known_without_pytorch():
    text = (
        "from zipf.experiments.options import composing\n"
        "def known():\n"
        "    return {group: composing.choices(group) for group in composing.groups()}\n"
        "before = known()\n"
        "import sys\n"
        "assert 'torch' not in sys.modules\n"
        "import zipf.agents, zipf.experiments.hooks\n"
        "assert before == known(), before\n"
    )
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_comment_that_says_same_is_that_of_the_line_above(tmp_path):
    file = tmp_path / "a.yaml"
    file.write_text(
        "# What it is.\n"
        "a: 1      # paper: one\n"
        "b: [2, 3] # same\n"
        "c: {d: '#4', e: 5}  # two lines,\n"
        "                    # of one comment\n"
        "# not of c\n"
        "f:  # of f\n"
        "  g: |\n"
        "    # text\n"
        "h: 1e-3\n"
    )
    found = written.read(file)
    assert found.values == {
        "a": 1, "b": [2, 3], "c": {"d": "#4", "e": 5}, "f": {"g": "# text\n"}, "h": 1e-3,
    }  # fmt: skip
    assert found.place.comment == "What it is."
    comments = {name: (place.line, place.comment) for name, place in found.places.items()}
    assert comments == {
        "a": (2, "paper: one"),
        "b": (3, "paper: one"),
        "c": (4, "two lines, of one comment"),
        "c.d": (4, "two lines, of one comment"),
        "c.e": (4, "two lines, of one comment"),
        "f": (7, "of f"),
        "f.g": (8, ""),
        "h": (10, ""),
    }


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16"])
def test_a_file_of_another_encoding_is_named(encoding, folder):
    path = folder({}) / "condition.yaml"
    path.write_bytes("# é\nmine: {}".encode(encoding))
    with pytest.raises(UserError) as raised:
        loading.load(["experiment=demo", "condition=mine"])
    assert str(raised.value) == f"{path}: is not UTF-8 text"


def test_a_file_of_blocks_may_begin_with_a_mark_and_have_line_ends_of_windows(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(config_files, "_user_folder", tmp_path)
    text = "# Mine.\r\nmine:\r\n  choose: {memory: mlp}\r\n  row: {title: Mine}\r\n"
    (tmp_path / "condition.yaml").write_bytes(text.encode("utf-8-sig"))
    config = loading.load(["experiment=demo", "condition=mine"])
    assert (config.memory.name, config.row.title) == ("mlp", "Mine")
