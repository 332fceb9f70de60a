"""Checkpoints survive what happens to files."""

import pickle
import resource
import subprocess
import sys

import numpy as np
import pytest
import torch

from zipf.errors import UserError
from zipf.experiments.building import checkpoint

STATE = {
    "update": 3,
    "options": {"agent.discount": 0.99, "sizes": [1, 2], "name": "x", "none": None},
    "weights": torch.arange(6.0),
    "environment": {
        "words": np.array([2**63 + 5, 1], np.uint64),
        "ended": np.array([True, False]),
        "small": np.arange(3, dtype=np.uint8),
    },
}


def test_what_is_saved_is_loaded(tmp_path):
    path = tmp_path / "checkpoint.pt"
    checkpoint.save(path, STATE)
    loaded = checkpoint.load(path)
    assert loaded["update"] == 3
    assert loaded["options"] == STATE["options"]
    assert torch.equal(loaded["weights"], STATE["weights"])
    for name, array in checkpoint.arrays(loaded["environment"]).items():
        assert array.dtype == STATE["environment"][name].dtype
        np.testing.assert_array_equal(array, STATE["environment"][name])
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]


def test_every_flipped_byte_is_noticed(tmp_path):
    path = tmp_path / "checkpoint.pt"
    checkpoint.save(path, {"update": 3})
    content = path.read_bytes()
    for position in range(len(content)):
        damaged = bytearray(content)
        damaged[position] ^= 0x10
        path.write_bytes(damaged)
        with pytest.raises(UserError, match=r"checkpoint\.pt"):
            checkpoint.load(path)


@pytest.mark.parametrize("keep", [0, 10, 100, -1])
def test_a_cut_file_is_noticed(tmp_path, keep):
    path = tmp_path / "checkpoint.pt"
    checkpoint.save(path, STATE)
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(UserError, match=r"checkpoint\.pt"):
        checkpoint.load(path)


class Malice:
    def __reduce__(self):
        return (print, ("run",))


def test_a_strangers_checkpoint_runs_no_code(tmp_path, capsys):
    path = tmp_path / "checkpoint.pt"
    checkpoint.save(path, {"update": Malice()})
    with pytest.raises(UserError, match="more than data"):
        checkpoint.load(path)
    assert capsys.readouterr().out == ""
    assert pickle.loads(pickle.dumps(Malice())) is None  # the attack itself works
    assert capsys.readouterr().out == "run\n"


PEAKS = """
import resource, sys
import torch
from pathlib import Path
from zipf.experiments.building import checkpoint

path = Path(sys.argv[1])
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
checkpoint.save(path, {"replay": torch.zeros(1)})
checkpoint.load(path)
state = {"replay": torch.ones(200 * 2**20, dtype=torch.uint8)}
peaks = [peak()]
checkpoint.save(path, state)
peaks.append(peak())
state.clear()
checkpoint.load(path)
print(*peaks, peak())
"""


def test_no_copy_is_made_of_what_is_saved_or_loaded(tmp_path):
    command = [sys.executable, "-c", PEAKS, str(tmp_path / "checkpoint.pt")]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    before, saved, loaded = (int(peak) / 1024 for peak in output.split())  # MiB
    assert saved - before < 50
    assert loaded - saved < 50


FULL_DISK = """
import resource, sys
from pathlib import Path
from zipf.experiments.building import checkpoint
from zipf.errors import UserError

path = Path(sys.argv[1])
checkpoint.save(path, {"update": 1})
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
import torch
try:
    checkpoint.save(path, {"update": 2, "weights": torch.zeros(10_000)})
except UserError as error:
    print(error)
"""


def test_a_second_signal_leaves_no_half_of_a_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "checkpoint.pt"
    checkpoint.save(path, {"update": 1})

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(torch, "save", interrupted)
    with pytest.raises(KeyboardInterrupt):
        checkpoint.save(path, {"update": 2})
    assert checkpoint.load(path) == {"update": 1}
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]


@pytest.mark.skipif(not hasattr(resource, "RLIMIT_FSIZE"), reason="no limits on file sizes here")
def test_a_disk_that_fills_up_leaves_the_old_checkpoint(tmp_path):
    path = tmp_path / "checkpoint.pt"
    command = [sys.executable, "-c", FULL_DISK, str(path)]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert "cannot be written" in output
    assert "the checkpoint before it is kept" in output
    assert checkpoint.load(path) == {"update": 1}
    assert [file.name for file in tmp_path.iterdir()] == ["checkpoint.pt"]
