"""Parts of agents from outside the package, one file each: `examples/parts/`."""

from pathlib import Path

import pytest
from conftest import TINY, assert_equal, learned

from zipf.errors import UserError
from zipf.experiments.building import loading
from zipf.experiments.options import composing
from zipf.experiments.training import runner
from zipf.registry import registries

PARTS = {
    "exploration": "episode_count",
    "critic": "huber",
    "memory": "running_mean",
    "network": "linear",
}


@pytest.fixture
def options(own_registries, monkeypatch):
    """The options that choose them."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent / "examples" / "parts"))
    chosen = [f"{group}={name}" for group, name in PARTS.items()]
    return [*TINY, f"plugins=[{','.join(PARTS.values())}]", "name=own_parts", *chosen]


def test_they_are_trained_and_resumed_bit_for_bit(options, tmp_path):
    def train(folder, updates):
        more = [f"run_root={tmp_path / folder}", f"updates={updates}", "schedule.window=[0,4]"]
        config = loading.load([*options, *more])
        assert runner.train(config) == 0
        return config

    for updates in (2, 4):
        cut = train("cut", updates)
    whole = train("whole", 4)
    assert_equal(learned(cut.folder), learned(whole.folder))
    for group, name in PARTS.items():
        assert getattr(cut, group) == registries()[group].options[name](
            name=name, **getattr(cut, group).model_dump(exclude={"name"})
        )
        assert name in composing.choices(group)
    with pytest.raises(UserError, match=r"memory\.decay"):
        loading.load([*options, "memory.decay=slow"])
