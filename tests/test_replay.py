"""Replay: draws and their frequencies, and that it resumes from its state in RAM and on disk."""

import errno
import os
import shutil
from copy import deepcopy
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from fake_cuda import DEVICE, fake_cuda, on_device
from scipy.stats import chisquare
from tensordict import NonTensorData, TensorDict
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from zipf.agents import free_space, replay
from zipf.agents.priorities import SMALLEST_PRIORITY, PrioritySampler
from zipf.agents.replay import Replay
from zipf.experiments.building import checkpoint

ITEM = TensorDict(
    {
        "steps": TensorDict({"image": torch.zeros(3, 2, 2, dtype=torch.uint8)}, [3]),
        "memory": TensorDict({"above.hidden": torch.zeros(4)}),
    }
)


def items(first, count):
    """Items whose contents are their numbers."""
    numbers = torch.arange(first, first + count)
    return TensorDict(
        {
            "steps": TensorDict(
                {"image": (numbers % 256).to(torch.uint8)[:, None, None, None].expand(-1, 3, 2, 2)},
                [count, 3],
            ),
            "memory": TensorDict({"above.hidden": numbers.float()[:, None] + torch.arange(4)}),
        },
        [count],
    )


def build(folder=None, capacity=10, spare=6, item=ITEM, **changes):
    options = {"priority_exponent": 0.9, "importance_exponent": 0.6, "seed": 0} | changes
    return Replay(item, capacity=capacity, folder=folder, spare=spare, **options)


@pytest.mark.parametrize("size", [1, 2, 3, 7, 8, 100])
def test_draws_are_those_of_a_list_with_sums(size, monkeypatch):
    """Each is the first item up to which the sum is more than a mass; also before all are there."""
    rng, plain = np.random.default_rng(size), np.zeros(size)
    sampler = PrioritySampler(
        size, size, priority_exponent=1.0, importance_exponent=0.6, seed=0, device="cpu"
    )
    for inserted in (range(size // 2 + 1), range(size // 2 + 1, size)):
        plain[inserted] = plain.max(initial=1)
        sampler.extend(torch.tensor(inserted, dtype=torch.int64))
        for _ in range(50):
            index = rng.integers(inserted.stop, size=rng.integers(1, 6))
            index = np.unique(index)
            value = rng.random(len(index)) * (rng.random(len(index)) < 0.7)
            sampler.update_priority(torch.from_numpy(index), torch.from_numpy(value))
            plain[index] = value.clip(SMALLEST_PRIORITY)
            offsets = rng.random(20)
            monkeypatch.setattr(sampler, "_offsets", lambda _, given=offsets: torch.tensor(given))
            found = sampler.sample(None, 20)[0].numpy()
            mass, until = (np.arange(20) + offsets) * (plain.sum() / 20), plain.cumsum()
            assert (plain[found] > 0).all()
            assert (until[found] - plain[found] <= mass + 1e-9).all()
            assert (mass <= until[found] + 1e-9).all()


def follows(counts, probabilities):
    """Whether counts fit probabilities no worse than one time in a million."""
    return chisquare(counts, counts.sum() * probabilities).pvalue > 1e-6


def sampler_with(priorities, exponent, beta=0.6):
    size = len(priorities)
    sampler = PrioritySampler(
        size, size, priority_exponent=exponent, importance_exponent=beta, seed=1
    )
    sampler.extend(torch.arange(size))
    sampler.update_priority(torch.arange(size), torch.tensor(priorities))
    return sampler


@pytest.mark.parametrize("exponent", [0.0, 0.5, 0.9, 1.5])
def test_draws_follow_priorities(exponent):
    priorities = np.random.default_rng(0).gamma(1.0, size=100) + 0.05
    sampler = sampler_with(priorities, exponent)
    probabilities = priorities**exponent / (priorities**exponent).sum()
    counts = np.zeros(100)
    for _ in range(2000):
        counts += np.bincount(sampler.sample(None, 32)[0].numpy(), minlength=100)
    choices = np.random.default_rng(1).choice(100, size=64_000, p=probabilities)
    assert follows(np.bincount(choices, minlength=100), probabilities)
    assert follows(counts, probabilities)
    wrong = priorities ** (exponent + 0.1) / (priorities ** (exponent + 0.1)).sum()
    assert not follows(counts, wrong)


def test_frequencies_do_not_depend_on_the_size_of_batches():
    """One draw at a time gives the same frequencies as strata of 32."""
    priorities = np.arange(1.0, 11.0)
    sampler = sampler_with(priorities, 1.0)
    counts = np.bincount([int(sampler.sample(None, 1)[0]) for _ in range(20_000)], minlength=10)
    assert follows(counts, priorities / priorities.sum())


@pytest.mark.parametrize("beta", [0.0, 0.6, 1.0])
def test_importance_weights(beta):
    priorities = np.random.default_rng(0).gamma(1.0, size=50)
    sampler = sampler_with(priorities, 0.9, beta)
    index, info = sampler.sample(None, 16)
    scaled = [p**0.9 for p in priorities]
    weights = [(50 * scaled[i] / sum(scaled)) ** -beta for i in index]
    expected = [w / max(weights) for w in weights]
    np.testing.assert_allclose(info["weight"], expected, rtol=1e-6)
    if beta == 1.0:  # then weighted draws are unbiased: p w is the same for all
        products = np.array([scaled[i] for i in index]) * info["weight"].numpy()
        np.testing.assert_allclose(products, products[0], rtol=1e-5)


def test_items_without_error_can_still_be_drawn():
    sampler = sampler_with(np.zeros(4), 1.0)
    drawn = torch.cat([sampler.sample(None, 4)[0] for _ in range(10)])
    assert set(drawn.tolist()) == {0, 1, 2, 3}


@pytest.mark.parametrize("exponent", [1.0, 0.5])
def test_new_items_have_the_largest_priority_so_far(exponent):
    sampler = sampler_with([3.0, 0.5, 0.5], exponent)
    sampler.update_priority(torch.tensor([0, 1]), torch.tensor([0.25, 0.75]))
    sampler.extend(torch.tensor([0]))  # the ring begins again
    np.testing.assert_allclose(sampler.leaves, np.array([3.0, 0.75, 0.5]) ** exponent)


def test_draws_do_not_depend_on_the_size_of_the_ring():
    """It has room for what is inserted between two checkpoints, which changes nothing else."""
    drawn = {}
    for slots in (10, 13, 40):
        sampler = PrioritySampler(slots, 10, priority_exponent=0.9, importance_exponent=0.6, seed=0)
        numbers = []
        for first in range(0, 90, 3):
            inserted = np.arange(first, first + 3)
            sampler.extend(torch.from_numpy(inserted % slots))
            index, info = sampler.sample(None, 4)
            latest = {number % slots: number for number in range(max(0, first - 7), first + 3)}
            numbers.append([latest[slot] for slot in index.tolist()])
            priority = torch.tensor([(number * 7919) % 11 + 0.5 for number in numbers[-1]])
            sampler.update_priority(index, priority)
            numbers.append(info["weight"].tolist())
        drawn[slots] = numbers
    assert drawn[10] == drawn[13] == drawn[40]


class OneDevice(TorchDispatchMode):
    """No tensor is copied from the host to the device or back."""

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        result = function(*args, **(kwargs or {}))
        tensors = [one for one in tree_leaves((args, kwargs, result)) if torch.is_tensor(one)]
        assert len({one.device for one in tensors}) == 1, function
        return result


def test_the_host_never_waits_for_a_replay_on_a_device(monkeypatch):
    """Where there is no device, reading a number of its tensors is an error, too."""
    monkeypatch.setattr(replay, "free_on", lambda device: 10**9)
    with fake_cuda():
        offsets = torch.zeros(16, dtype=torch.float64, device=DEVICE)
        monkeypatch.setattr(PrioritySampler, "_offsets", lambda sampler, count: offsets)
        item = on_device(ITEM)
        kept = build(None, item=item)
        kept.insert(item.expand(8).clone())  # makes it
        with OneDevice():
            kept.insert(item.expand(8).clone())
            sample, index, weights = kept.sample(16)
            kept.update_priorities(index, torch.ones(16, device=DEVICE))
        assert {leaf.device for leaf in sample.values(True, True)} == {torch.device(DEVICE)}
        assert index.device == weights.device == torch.device(DEVICE)
        with pytest.raises(ValueError, match=r"take .* of cuda:0, and 1\.0 GB are free: .* in RAM"):
            build(None, item=item, capacity=10**8)


@pytest.mark.parametrize("storage", ["ram", "memmap"])
@pytest.mark.parametrize("batch", [1, 3, 4])
def test_the_latest_items_are_drawn_as_they_were_inserted(storage, batch, tmp_path):
    kept = build(tmp_path / "replay" if storage == "memmap" else None, priority_exponent=0.0)
    for first in range(0, 60, batch):
        kept.insert(items(first, batch))
        inserted = first + batch
        assert len(kept) == min(inserted, 10)
        sample, _, weights = kept.sample(60)
        numbers = sample["number"]
        everything = items(0, inserted)
        for name in (("steps", "image"), ("memory", "above.hidden")):
            assert torch.equal(sample[name], everything[name][numbers])
        assert (weights == 1).all()
        # Strata are narrower than an item, so that every item is drawn.
        assert set(numbers.tolist()) == set(range(max(0, inserted - 10), inserted))


def play(kept, first, times):
    """Inserts, draws and updates priorities; returns the draws."""
    drawn = []
    for i in range(times):
        kept.insert(items(first + 2 * i, 2))
        sample, index, weights = kept.sample(4)
        kept.update_priorities(index, (sample["number"] % 7).float() / 3)
        drawn.append((sample.clone(), weights))
    return drawn


@pytest.mark.parametrize("storage", ["ram", "memmap"])
@pytest.mark.parametrize("before", [2, 4, 9, 23])
@pytest.mark.parametrize("lost", [0, 1, 3])
def test_it_resumes_from_its_checkpoint(storage, before, lost, tmp_path):
    """Killed up to three inserts of two items after a checkpoint: as many as there is room for."""
    folder = tmp_path / "replay" if storage == "memmap" else None
    kept = build(folder)
    play(kept, 0, before)
    checkpoint.save(tmp_path / "checkpoint.pt", kept.state_dict())
    if storage == "ram":
        expected = play(kept, 2 * before, 6)
    else:
        other = build(tmp_path / "other")
        play(other, 0, before)
        expected = play(other, 2 * before, 6)
        play(kept, 2 * before, lost)
    again = build(folder, seed=5)
    again.load_state_dict(checkpoint.load(tmp_path / "checkpoint.pt"))
    for (sample, weights), (other_sample, other_weights) in zip(
        expected, play(again, 2 * before, 6), strict=True
    ):
        assert torch.equal(weights, other_weights)
        for name in sample.keys(True, True):
            assert torch.equal(sample[name], other_sample[name]), name


def test_as_many_items_as_an_item_has_rows_are_loaded():
    """The two axes are then of one length, and broadcasting could confuse them."""
    kept, again = build(), build()
    kept.insert(items(0, 3))
    again.load_state_dict(kept.state_dict())
    assert torch.equal(kept.sample(4)[0]["steps", "image"], again.sample(4)[0]["steps", "image"])


def test_an_empty_replay_resumes_as_an_empty_one(tmp_path):
    for folder in (None, tmp_path / "replay"):
        kept = build(folder)
        state = kept.state_dict()
        play(kept, 0, 3)
        kept.load_state_dict(state)
        assert len(kept) == 0
        play(kept, 0, 3)
        assert len(kept) == 6


def test_a_state_holds_only_items_that_can_be_drawn():
    kept = build(capacity=1000)
    play(kept, 0, 2)
    state = kept.state_dict()
    for leaf in state["items"].values():
        assert len(leaf) == 4
        assert leaf.untyped_storage().nbytes() == leaf.nbytes


def test_files_of_another_replay_are_refused(tmp_path):
    folder = tmp_path / "replay"
    kept = build(folder)
    play(kept, 0, 6)
    state = deepcopy(kept.state_dict())
    play(kept, 12, 20)  # far more than there is room for
    with pytest.raises(OSError, match="another replay than the checkpoint's"):
        build(folder).load_state_dict(state)
    with pytest.raises(OSError, match="missing"):
        build(tmp_path / "gone").load_state_dict(state)
    with pytest.raises(OSError, match="room for 6 items between two checkpoints, and 7 are needed"):
        build(folder, spare=7).load_state_dict(state)
    wider = ITEM.clone()
    wider["memory", "above.hidden"] = torch.zeros(5)
    other = Replay(
        wider,
        capacity=10,
        priority_exponent=0.9,
        importance_exponent=0.6,
        folder=folder,
        spare=6,
        seed=0,
    )
    with pytest.raises(OSError, match="has 256 bytes, and the checkpoint's replay 320"):
        other.load_state_dict(state)


def damages(folder):
    """Ways in which a file of the replay may be damaged."""
    image, number = folder / "steps" / "image.memmap", folder / "number.memmap"

    def flip(path):
        content = bytearray(path.read_bytes())
        content[len(content) // 3] ^= 1
        path.write_bytes(content)

    return {
        "flipped": lambda: flip(image),
        "flipped number": lambda: flip(number),
        "emptied": lambda: image.write_bytes(b""),
        "cut": lambda: image.write_bytes(image.read_bytes()[:-1]),
        "overwritten": lambda: image.write_bytes(bytes(image.stat().st_size)),
        "longer": lambda: image.write_bytes(image.read_bytes() * 2),
        "deleted": image.unlink,
        "a folder": lambda: (image.unlink(), image.mkdir()),
        "a link": lambda: image.rename(folder / "x") and image.symlink_to(folder / "x"),
    }


@pytest.mark.parametrize("damage", list(damages(Path())))
def test_damaged_files_are_refused(damage, tmp_path):
    kept = build(tmp_path / "replay")
    play(kept, 0, 12)
    state = deepcopy(kept.state_dict())
    build(tmp_path / "replay").load_state_dict(state)
    damages(tmp_path / "replay")[damage]()
    with pytest.raises(OSError, match=str(tmp_path / "replay")):
        build(tmp_path / "replay").load_state_dict(state)


class Malice:
    def __reduce__(self):
        return print, ("run",)


def test_what_a_stranger_puts_beside_the_files_is_not_loaded(tmp_path, capsys):
    """TensorDict's own loader unpickles whatever `meta.json` names."""
    folder = tmp_path / "replay"
    kept = build(folder)
    play(kept, 0, 6)
    state = deepcopy(kept.state_dict())
    planted = TensorDict({"evil": NonTensorData(Malice(), batch_size=[16])}, [16])
    planted.memmap(folder)
    TensorDict.load_memmap(folder, allow_pickle=True)
    assert "run" in capsys.readouterr().out, "the attack itself works"
    again = build(folder)
    again.load_state_dict(state)
    assert torch.equal(again.sample(4)[0]["steps", "image"], kept.sample(4)[0]["steps", "image"])
    assert capsys.readouterr().out == ""


def test_a_replay_that_does_not_fit_is_refused_before_it_is_allocated(tmp_path, monkeypatch):
    each = 3 * 2 * 2 + 4 * 4 + 2 * 8
    assert build().item_bytes == each
    monkeypatch.setattr(replay, "free_ram", lambda: 2 * 10 * each)
    monkeypatch.setattr(replay, "free_disk", lambda folder: 16 * each)
    build()
    build(tmp_path / "replay")
    with pytest.raises(ValueError, match=r"484 bytes of RAM.*replay_capacity=10 fits.*memmap"):
        build(capacity=11)
    with pytest.raises(ValueError, match=r"room for 6 between checkpoints.*replay_capacity=10 "):
        build(tmp_path / "replay", capacity=11)
    assert not (tmp_path / "replay").exists()
    monkeypatch.setattr(replay, "free_ram", lambda: each)
    monkeypatch.setattr(replay, "free_disk", lambda folder: each)
    for folder in (None, tmp_path / "replay"):
        with pytest.raises(ValueError, match="are free: a") as told:
            build(folder)
        assert "replay_capacity" not in str(told.value)


def test_disk_space_is_allocated_at_once(tmp_path, monkeypatch):
    kept = build(tmp_path / "replay", capacity=50_000)
    kept.insert(items(0, 2))
    taken = sum(p.stat().st_blocks * 512 for p in (tmp_path / "replay").rglob("*.memmap"))
    assert taken >= kept.bytes

    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.posix_fallocate", full)
    with pytest.raises(OSError, match="other: cannot be written: No space left on device"):
        build(tmp_path / "other").insert(items(0, 2))
    assert not (tmp_path / "other").exists()


def machine(monkeypatch, files):
    """A machine of which these files are read, and no others; numbers are in the kernel's units."""

    def read_text(path, *_, **__):
        if str(path) not in files:
            raise FileNotFoundError(path)
        return files[str(path)]

    monkeypatch.setattr(Path, "read_text", read_text)


MEMINFO = (
    "MemTotal: 8000000 kB\nMemFree: 1000000 kB\nMemAvailable: 5000000 kB\nHugePages_Total: 0\n"
)
CACHE = "anon 9\ninactive_file 300\nactive_file 40\n"
V2, V1 = "/sys/fs/cgroup", "/sys/fs/cgroup/memory"


def group(folder, limit, used, version=2):
    names = ("memory.max", "memory.current")
    if version == 1:
        names = ("memory.limit_in_bytes", "memory.usage_in_bytes")
    contents = (f"{limit}\n", f"{used}\n", CACHE)
    return {f"{folder}/{n}": c for n, c in zip((*names, "memory.stat"), contents, strict=True)}


@pytest.mark.parametrize(
    ("groups", "files", "free"),
    [
        ("0::/job\n", {}, 5_000_000 * 1024),  # a group without limits
        ("0::/job\n", group(f"{V2}/job", "max", 7), 5_000_000 * 1024),
        # A limit, less what is used, and the cache of files is given back.
        ("0::/job\n", group(f"{V2}/job", 9000, 7000), 2000 + 340),
        ("0::/job\n", group(f"{V2}/job", 9000, 9900), 0),
        # The tightest of all groups above counts.
        (
            "0::/all/job\n",
            group(f"{V2}/all/job", 9000, 7000) | group(f"{V2}/all", 9900, 9500),
            400 + 340,
        ),
        ("5:cpu:/x\n4:memory:/job\n", group(f"{V1}/job", 9000, 7000, version=1), 2340),
        ("4:memory:/job\n", group(f"{V1}/job", 2**62, 7000, version=1), 5_000_000 * 1024),
    ],
)
def test_free_ram_is_the_least_of_what_machine_and_groups_leave(groups, files, free, monkeypatch):
    known = {"/proc/meminfo": MEMINFO, "/proc/self/cgroup": groups}
    machine(monkeypatch, known | files)
    assert free_space.free_ram() == free


def test_without_the_files_of_linux_it_is_all_of_the_ram(monkeypatch):
    machine(monkeypatch, {})
    monkeypatch.setattr(os, "sysconf", {"SC_PHYS_PAGES": 1000, "SC_PAGE_SIZE": 4096}.__getitem__)
    assert free_space.free_ram() == 4_096_000


def test_free_disk_counts_what_the_folder_has_already(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=1000))
    assert free_space.free_disk(tmp_path / "not" / "there" / "yet") == 1000
    (tmp_path / "file").write_bytes(bytes(64 * 1024))
    own = (tmp_path / "file").stat().st_blocks * 512
    assert own > 0
    assert free_space.free_disk(tmp_path) == 1000 + own


@pytest.mark.parametrize(
    ("size", "words"),
    [
        (0, "0 bytes"),
        (999, "999 bytes"),
        (1500, "1.5 kB"),
        (1.57e11, "157.0 GB"),
        (4e16, "40000.0 TB"),
    ],
)
def test_sizes_as_text(size, words):
    assert free_space.in_words(size) == words
