"""How much RAM, space on a device and disk space is free, and sizes as text."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import torch


def free_ram() -> int:
    """Bytes of RAM that this process can still get, from the machine and its control groups."""
    try:
        lines = Path("/proc/meminfo").read_text().splitlines()
        groups = Path("/proc/self/cgroup").read_text().splitlines()
    except FileNotFoundError:  # not Linux
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    sizes = {name: int(rest.split()[0]) for name, rest in (line.split(":") for line in lines)}
    free = sizes["MemAvailable"] * 1024
    for line in groups:
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            root, names = Path("/sys/fs/cgroup"), ("memory.max", "memory.current")
        elif controllers == "memory":
            root = Path("/sys/fs/cgroup/memory")
            names = "memory.limit_in_bytes", "memory.usage_in_bytes"
        else:
            continue
        leaf = root / path.strip("/")
        for group in (leaf, *leaf.parents):
            try:
                limit, used = ((group / name).read_text().strip() for name in names)
                statistics = dict(
                    line.split() for line in (group / "memory.stat").read_text().splitlines()
                )
            except FileNotFoundError:
                continue
            if limit != "max":  # the kernel would free its cache of files
                files = int(statistics["inactive_file"]) + int(statistics["active_file"])
                free = min(free, max(int(limit) - int(used) + files, 0))
    return free


def free_on(device: torch.device) -> int:
    """Bytes of a CUDA device that PyTorch can still get, and those that it holds and does not
    use."""
    unused = torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)
    return torch.cuda.mem_get_info(device)[0] + unused


def free_disk(folder: Path) -> int:
    """Bytes that files in `folder`, which need not exist, can take: those that its files take now,
    as they will be used again or replaced, and those that are free."""
    own = sum(p.stat().st_blocks * 512 for p in folder.rglob("*") if p.is_file())
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    return own + shutil.disk_usage(there).free


def in_words(size: float) -> str:
    """12_300_000 -> "12.3 MB"."""
    units = ("bytes", "kB", "MB", "GB", "TB")
    power = min(max(len(str(int(size))) - 1, 0) // 3, len(units) - 1)
    return f"{size / 1000**power:.{0 if power == 0 else 1}f} {units[power]}"
