"""`scripts/pack_runs.py`: runs packed into parts, and unpacked elsewhere."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pack_runs
import pytest
from conftest import TINY, assert_equal, contents, learned

from zipf.errors import UserError
from zipf.experiments.building import checkpoint, loading, run_folder
from zipf.experiments.options.schema import Config
from zipf.experiments.training import runner


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """A folder of two runs, as far as packing knows."""
    for seed in (0, 1):
        folder = tmp_path / "runs" / "demo" / "impala" / f"seed{seed}"
        (folder / "tensorboard").mkdir(parents=True)
        (folder / "run.json").write_text(json.dumps({"seed": seed}))
        (folder / "checkpoint.pt").write_bytes(os.urandom(5000))
        (folder / "tensorboard" / "events").write_bytes(b"")
        (folder / "lock").touch()
    (tmp_path / "runs" / "report").mkdir()
    (tmp_path / "runs" / "report" / "index.html").touch()
    return tmp_path / "runs"


def files(runs: Path) -> dict[str, bytes]:
    """What is in all files but locks."""
    found = {path.relative_to(runs).as_posix(): held for path, (held, _) in contents(runs).items()}
    return {path: held for path, held in found.items() if not path.endswith("lock")}


def command(*arguments: object) -> tuple[int, str, str]:
    ended = subprocess.run(
        [sys.executable, pack_runs.__file__, *map(str, arguments)], capture_output=True, text=True
    )
    return ended.returncode, ended.stdout, ended.stderr


@pytest.mark.parametrize("size", [1024, 10240, 2**20])
def test_what_is_unpacked_is_what_was_packed(size: int, runs: Path, tmp_path: Path) -> None:
    packed = tmp_path / "packed"
    assert pack_runs.pack(runs, packed, size).startswith("2 runs, 30,720 bytes in ")
    sizes = [path.stat().st_size for path in sorted(packed.glob("part-*"))]
    assert all(one == size for one in sizes[:-1])
    assert sizes[-1] <= size
    assert sum(sizes) == 30720
    pack_runs.unpack(packed, tmp_path / "other")
    expected = files(runs)
    del expected["report/index.html"]
    assert files(tmp_path / "other") == expected
    assert pack_runs.unpack(packed, runs).startswith("0 runs unpacked, 2 were there")


def test_the_commands(runs: Path, tmp_path: Path) -> None:
    packed, other = tmp_path / "packed", tmp_path / "other"
    done = (0, f"2 runs, 30,720 bytes in 4 parts, in {packed}\n", "")
    assert command("pack", runs, packed, "--part", "8KiB") == done
    (packed / "part-00001").unlink()
    missing = f"error: {packed / 'part-00001'}: this part is missing\n"
    assert command("unpack", packed, other) == (2, "", missing)
    again = f"error: {packed}: is not empty; choose another folder\n"
    assert command("pack", runs, packed) == (2, "", again)


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda packed: flip(packed / "part-00002"), "part-00002: this part is damaged"),
        (
            lambda packed: os.truncate(packed / "part-00000", 100),
            "part-00000: this part has 100 bytes and should have 8,192",
        ),
        (lambda packed: (packed / "index.json").unlink(), "packed: holds no packed runs"),
        (lambda packed: os.truncate(packed / "index.json", 99), "index.json: is damaged"),
    ],
)
def test_damage_is_named_and_nothing_is_unpacked(damage, told, runs, tmp_path):
    packed = tmp_path / "packed"
    pack_runs.pack(runs, packed, 8192)
    damage(packed)
    with pytest.raises(pack_runs.PackingError, match=told):
        pack_runs.unpack(packed, tmp_path / "other")
    assert not (tmp_path / "other").exists()


def flip(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[17] ^= 1
    path.write_bytes(content)


@pytest.mark.parametrize("change", ["other", "more", "less"])
def test_a_run_that_is_there_is_not_written_over(change, runs, tmp_path):
    packed = tmp_path / "packed"
    pack_runs.pack(runs, packed, 8192)
    shutil.rmtree(runs / "demo" / "impala" / "seed0")
    there = runs / "demo" / "impala" / "seed1"
    if change == "other":
        flip(there / "checkpoint.pt")
    elif change == "more":
        (there / "weights.pt").touch()
    else:
        (there / "checkpoint.pt").unlink()
    before = contents(runs)
    with pytest.raises(pack_runs.PackingError, match="seed1: holds other files than the packed"):
        pack_runs.unpack(packed, runs)
    assert contents(runs) == before


def test_a_run_that_is_being_trained_is_not_packed(runs, tmp_path):
    with run_folder.lock(runs / "demo" / "impala" / "seed1"):
        assert command("pack", runs, tmp_path / "packed") == (
            2,
            "",
            f"error: {runs / 'demo' / 'impala' / 'seed1'}: is being trained; stop it first\n",
        )
    assert not (tmp_path / "packed").exists()


def test_a_failure_leaves_no_parts(runs, tmp_path):
    (runs / "demo" / "impala" / "seed1" / "zlink").symlink_to(runs / "report" / "index.html")
    with pytest.raises(pack_runs.PackingError, match="zlink: is a link"):
        pack_runs.pack(runs, tmp_path / "packed", 8192)
    assert list((tmp_path / "packed").iterdir()) == []


def test_a_link_to_runs_is_refused(runs, tmp_path):
    (runs / "demo" / "elsewhere").symlink_to(runs / "demo" / "impala")
    with pytest.raises(pack_runs.PackingError, match="elsewhere: is a link; put the folder itself"):
        pack_runs.pack(runs, tmp_path / "packed", 8192)


def test_the_links_of_weights_and_biases_are_left_behind(runs, tmp_path):
    folder = runs / "demo" / "impala" / "seed1" / "wandb"
    (folder / "run-1" / "logs").mkdir(parents=True)
    (folder / "run-1" / "run.wandb").write_bytes(b"log")
    (folder / "latest-run").symlink_to("run-1")
    (folder / "run-1" / "logs" / "debug-core.log").symlink_to(tmp_path / "gone")
    pack_runs.pack(runs, tmp_path / "packed", 2**20)
    pack_runs.unpack(tmp_path / "packed", tmp_path / "there")
    kept = [name for name in files(tmp_path / "there") if "wandb" in name]
    assert kept == ["demo/impala/seed1/wandb/run-1/run.wandb"]
    assert pack_runs.unpack(tmp_path / "packed", runs).startswith("0 runs unpacked, 2 were there")


def test_what_a_killed_unpacking_left_is_no_run(runs, tmp_path):
    shutil.copytree(runs / "demo", runs / ".unpacking-abc" / "demo")
    assert pack_runs.pack(runs, tmp_path / "packed", 2**20).startswith("2 runs, ")


def test_no_run_can_be_trained_while_it_is_packed(runs, tmp_path, monkeypatch):
    """Neither one that was unpacked, which has no lock yet."""
    folder = runs / "demo" / "impala" / "seed1"
    (folder / "lock").unlink()

    def files_of(folder, before=pack_runs.files_of):
        with pytest.raises(UserError, match="another process"), run_folder.lock(folder):
            pass
        return before(folder)

    monkeypatch.setattr(pack_runs, "files_of", files_of)
    pack_runs.pack(runs, tmp_path / "packed", 2**20)


def test_what_was_not_written_to_its_end_is_left_out(runs, tmp_path):
    (runs / "demo" / "impala" / "seed1" / "checkpoint.pt.new").write_bytes(b"half")
    pack_runs.pack(runs, tmp_path / "packed", 2**20)
    pack_runs.unpack(tmp_path / "packed", tmp_path / "there")
    assert not any(name.endswith(".new") for name in files(tmp_path / "there"))


@pytest.mark.parametrize(
    ("text", "told"),
    [("16 MB", 16_000_000), ("2048", 2048), ("16mb", "should be a number of"), ("9", "at least")],
)
def test_sizes_of_parts(text, told):
    if isinstance(told, int):
        assert pack_runs.size(text) == told
    else:
        with pytest.raises(pack_runs.PackingError, match=told):
            pack_runs.size(text)


@pytest.mark.parametrize("named", ["", "demo/impala/seed0", "nothing"])
def test_what_is_no_folder_of_runs_is_refused(named, runs, tmp_path):
    source = runs / named if named else tmp_path / "report"
    (tmp_path / "report").mkdir()
    told = {"": "holds no runs", "nothing": "is no folder"}.get(named, "is itself a run")
    with pytest.raises(pack_runs.PackingError, match=told):
        pack_runs.pack(source, tmp_path / "packed", 8192)


# Trainings in pieces


def of_r2d2(root: Path, storage: str, updates: int) -> Config:
    return loading.load(
        [
            *TINY,
            "agent=r2d2",
            f"agent.storage={storage}",
            "agent.replay_capacity=24",
            "agent.replay_min=12",
            f"updates={updates}",
            f"run_root={root}",
        ]
    )


@pytest.mark.parametrize("storage", ["ram", "memmap"])
def test_a_training_in_pieces_equals_one_in_whole(storage, tmp_path):
    whole = of_r2d2(tmp_path / "whole", storage, 8)
    assert runner.train(whole) == 0
    cut, moved = (of_r2d2(tmp_path / name, storage, 8) for name in ("cut", "moved"))
    runner.train(cut.model_copy(update={"updates": 5}))
    pack_runs.pack(tmp_path / "cut", tmp_path / "packed", 8192)
    pack_runs.unpack(tmp_path / "packed", tmp_path / "moved")
    assert runner.train(moved.model_copy(update={"resume": "must"})) == 0
    assert_equal(learned(whole.folder), learned(moved.folder))


@pytest.mark.parametrize("storage", ["ram", "memmap"])
def test_a_run_without_its_replay_fills_a_new_one(storage, tmp_path, capsys):
    run = of_r2d2(tmp_path / "runs", storage, 5)
    assert runner.train(run) == 0
    pack_runs.pack(tmp_path / "runs", tmp_path / "packed", 2**20, without_replay=True)
    pack_runs.unpack(tmp_path / "packed", tmp_path / "moved")
    moved = of_r2d2(tmp_path / "moved", storage, 6)
    assert not (moved.folder / "replay").exists()
    whole, rest = (learned(one.folder) for one in (run, moved))
    assert rest.pop("without_replay")
    assert whole["agent"].pop("replay")
    assert rest["agent"].pop("replay") == {}
    assert_equal(whole, rest)

    assert run_folder.find_checkpoint(moved)["update"] == 5
    capsys.readouterr()
    assert runner.train(moved) == 0
    assert "the replay was left behind: " in capsys.readouterr().out
    saved = checkpoint.load(moved.folder / "checkpoint.pt")
    assert "without_replay" not in saved
    assert saved["agent"]["steps"] == whole["agent"]["steps"]  # 6 sequences are not yet 12
    further = of_r2d2(tmp_path / "moved", storage, 8)
    assert runner.train(further) == 0
    assert "the replay was left behind: " not in capsys.readouterr().out
    assert learned(moved.folder)["agent"]["steps"] == whole["agent"]["steps"] + 2
