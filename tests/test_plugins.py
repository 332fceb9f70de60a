"""Envs, agents and experiments from outside the package, by `plugins` and `--config-dir`."""

import json
import sys
import textwrap

import pandas as pd
import pytest
from conftest import call, run

from zipf.envs import family
from zipf.errors import UserError
from zipf.experiments.building import loading
from zipf.experiments.options import catalogue, config_files

WORLD = """
    from functools import partial

    import numpy as np
    from gymnasium import spaces

    import zipf.envs
    from zipf.envs import Family, Split, ZipfVectorEnv, pcg64
    from zipf.envs.distributions import by_name
    from zipf.options import Options


    class CounterOptions(Options):
        size: int = 6


    class Counter(ZipfVectorEnv):
        \"\"\"Say the number that is shown.\"\"\"

        def __init__(self, num_envs, level, *, size=6, **options):
            super().__init__(
                num_envs,
                single_observation_space=spaces.Dict(image=spaces.Box(0, 255, (8, 8, 3), np.uint8)),
                single_action_space=spaces.Discrete(size),
                situation={"number": size},
                **options,
            )
            self.cdf = pcg64.cumulative(by_name(level)(size))
            self.numbers = np.zeros(num_envs, np.int64)

        def _begin(self, mask, forced):
            for i in np.flatnonzero(mask):
                drawn = pcg64.choice(self._streams[i], self.cdf)
                self.numbers[i] = drawn if forced[0, i] < 0 else forced[0, i]

        def _advance(self, actions, mask):
            success = actions == self.numbers
            ended = np.ones_like(success)
            return success.astype(np.float64), ended, ~ended, success

        def _observe(self, out, mask):
            out["image"][mask] = 0
            out["image"].reshape(self.num_envs, -1)[mask, self.numbers[mask]] = 255

        def _situations(self):
            return {"number": self.numbers.copy()}

        def _get_env_states(self):
            return {"numbers": self.numbers}

        def _set_env_states(self, state):
            self.numbers[:] = state["numbers"]


    zipf.envs.register(
        Family(
            name="counter",
            summary="say the number that is shown",
            levels=("zipf_1", "uniform", "rare"),
            check=by_name,
            options=CounterOptions,
            splits=(Split("counter", "counter/zipf_1", "counter/uniform", "counter/rare"),),
            make_vec=Counter,
        )
    )
"""

EXPERIMENT = """
    choose: {environment: counter, network: compact, memory: mlp}
    updates: 4
    memory: {mlp: {size: 16}}
    network: {compact: {size: 16}}
    collector: {num_envs: 4, unroll_length: 4}
    evaluation: {every: 2, episodes: 10, num_envs: 5}
    schedule: {window: [2, 4], log_every: 1, checkpoint_every: 2}
"""

CONDITION = """
    eager:
      choose: {agent: impala, memory: mlp}
      row: {title: Eager IMPALA, order: 0.5, colour: "#123456"}
      agent: {impala: {discount: 0.5}}
"""


@pytest.fixture
def folder(tmp_path):
    files = {
        "my_worlds.py": WORLD,
        "my_configs/experiments/counting.yaml": EXPERIMENT,
        "my_configs/condition.yaml": CONDITION,
    }
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(textwrap.dedent(text))
    return tmp_path


@pytest.fixture
def forgotten(monkeypatch):
    """The family that this process has imported is not there for other tests."""
    monkeypatch.setattr(family, "_FAMILIES", dict(family._FAMILIES))
    monkeypatch.setattr(config_files, "_user_folder", None)
    yield
    sys.modules.pop("my_worlds", None)


TRAIN = ("--config-dir", "my_configs", "plugins=[my_worlds]", "experiment=counting")


@pytest.mark.slow  # four processes
def test_a_family_of_ones_own_is_trained_resumed_scored_and_reported(folder, forgotten):
    first = run(*TRAIN, "condition=eager", "updates=2", folder=folder)
    assert first.returncode == 0, first.stderr
    again = call(*TRAIN, "condition=eager", folder=folder)
    assert again.returncode == 0, again.stderr
    assert "resumes at update 2" in again.stdout
    kept = folder / "runs" / "counting" / "eager" / "seed0"
    described = json.loads((kept / "run.json").read_text())
    assert described["row"] == {
        "title": "Eager IMPALA",
        "order": 0.5,
        "colour": "#123456",
        "line": "solid",
    }
    assert described["split"] == "counter"
    assert described["environment"] == {"size": 6}
    assert list(pd.read_csv(kept / "evaluations.csv")["update"].unique()) == [0, 2, 4]

    place = f"run={kept}"
    scored = run(place, "plugins=my_worlds", "episodes=5", module="zipf.evaluate", folder=folder)
    assert scored.returncode == 0, scored.stderr
    reported = call("runs", module="zipf.report", folder=folder)
    assert reported.returncode == 0, reported.stderr
    assert "Eager IMPALA" in reported.stdout


@pytest.mark.slow
def test_a_runs_folder_never_has_modules_imported(folder):
    assert run(*TRAIN, "updates=2", folder=folder).returncode == 0
    place = f"run={folder}/runs/counting/impala_mlp/seed0"
    (folder / "my_worlds.py").write_text("open('imported', 'w')")
    for module, options in (("zipf.evaluate", []), ("zipf.play", ["record=x.gif"])):
        refused = run(place, "seed=1", *options, module=module, folder=folder)
        assert refused.returncode == 2
        assert "plugins=[my_worlds]" in refused.stderr
        assert "Traceback" not in refused.stderr
    assert not (folder / "imported").exists()


@pytest.mark.slow
def test_a_sweep_finds_plugins_and_configurations(folder):
    swept = run(*TRAIN, "-m", "seed=0,1", "updates=2", folder=folder)
    assert swept.returncode == 0, swept.stderr
    assert len(list(folder.glob("runs/counting/impala_mlp/seed*/checkpoint.pt"))) == 2


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["plugins=[nowhere]", "experiment=demo"], "plugins: cannot import nowhere"),
        (["plugins=[nowhere]", "experiment=demo"], "in the current folder, or installed"),
        (["plugins=[broken]", "experiment=demo"], "ZeroDivisionError"),
        (["plugins=3", "experiment=demo"], "should be a list of modules"),
        (["plugins=a,b", "experiment=demo"], "plugins=a,b: should be a list: plugins=[my_module,"),
        (["plugins=[broken.py]", "experiment=demo"], "cannot import 'broken.py': should be a modu"),
        (["plugins=[./broken]", "experiment=demo"], "cannot import './broken': should be a module"),
        (["--config-dir", "nowhere", "experiment=demo"], "--config-dir nowhere: there is no such"),
        (["plugins=[my_worlds]", "experiment=counting"], "no such experiment"),
    ],
)
def test_mistakes_are_one_clear_line(folder, forgotten, arguments, message):
    (folder / "broken.py").write_text("1 / 0")
    refused = call(*arguments, folder=folder)
    assert refused.returncode == 2, refused.stdout
    assert message in refused.stderr
    assert "Traceback" not in refused.stderr


def test_worlds_that_no_plugin_has_registered_are_told_how_to(folder):
    refused = run("--config-dir", "my_configs", "experiment=counting", folder=folder)
    assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
    assert "plugins=[<module>]" in refused.stderr


@pytest.mark.parametrize(
    ("row", "message"), [("Mine", "row=Mine: should be a m"), ("{line: dotted}", "row.line=dotted")]
)
def test_mistakes_in_a_users_row_are_one_clear_line(row, message, tmp_path, monkeypatch):
    monkeypatch.setattr(config_files, "_user_folder", None)
    (tmp_path / "condition.yaml").write_text(f"mine: {{row: {row}}}\n")
    config_files.use_folder(tmp_path)
    with pytest.raises(UserError, match=message) as error:
        loading.load(["experiment=demo", "condition=mine"])
    assert len(str(error.value).splitlines()) == 1


def test_a_condition_needs_no_title(tmp_path, monkeypatch):
    monkeypatch.setattr(config_files, "_user_folder", None)
    (tmp_path / "condition.yaml").write_text("mine: {row: {order: 1}}\n")
    config_files.use_folder(tmp_path)
    assert loading.load(["experiment=demo", "condition=mine"]).row.title == "mine"
    assert catalogue.conditions()["mine"].order == 1


@pytest.mark.parametrize("name", ["it's conf", "a\\b, c]", "ends in \\", "both\\'"])
def test_a_folder_of_any_name_has_configurations(name, tmp_path, monkeypatch):
    monkeypatch.setattr(config_files, "_user_folder", None)
    (tmp_path / name).mkdir()
    (tmp_path / name / "condition.yaml").write_text(textwrap.dedent(CONDITION))
    config_files.use_folder(tmp_path / name)
    config = loading.load(["experiment=demo", "condition=eager"])
    assert config.agent.discount == 0.5
