"""Packs a folder of runs into files of bounded size, and unpacks them elsewhere.

    python scripts/pack_runs.py pack runs/ packed/ --part 16MiB
    python scripts/pack_runs.py unpack packed/ runs/

The files are pieces of one tar archive, `part-00000` and so on, with an `index.json` that has their
sizes and hashes; `cat packed/part-* | tar t` lists what is in them. All parts are checked before
anything is unpacked. A run that is there already is left as it is if it has the same files, and an
error otherwise; a run that is being trained is not packed, and neither is what belongs to no run,
such as a report. Only the standard library is needed, but for `--without-replay`: that leaves the
replay of R2D2 behind, most of what such a run takes. The run then fills a new one before it learns
on, which is not bit for bit what it would have learned.
"""

from __future__ import annotations

import argparse
import fcntl
import filecmp
import hashlib
import json
import os
import re
import signal
import sys
import tarfile
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

FORMAT = "zipf runs 1"
INDEX = "index.json"
UNITS = {"": 1, "kB": 10**3, "MB": 10**6, "GB": 10**9, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30}
SMALLEST = 1024  # bytes of a part; ours: their list stays much smaller than they are
UNPACKING = ".unpacking-"
BLOCK = 2**20  # bytes that are copied at a time


class PackingError(Exception):
    """What is wrong, in a line."""


class Parts:
    """A file to write to, in pieces of at most `size` bytes. `written` is what the index says of
    each: {"bytes": int, "sha256": str}."""

    def __init__(self, folder: Path, size: int):
        self.folder = folder
        self.size = size
        self.written: list[dict[str, Any]] = []
        self._left = 0
        self._file: Any = None

    def write(self, content: bytes) -> int:
        rest = memoryview(content)
        while len(rest):
            if not self._left:
                self.close()
                self._file = open(part(self.folder, len(self.written)), "xb")  # noqa: SIM115
                self._hash, self._left = hashlib.sha256(), self.size
            now, rest = rest[: self._left], rest[self._left :]
            self._file.write(now)
            self._hash.update(now)
            self._left -= len(now)
        return len(content)

    def close(self) -> None:
        """Completes the last piece."""
        if self._file is not None:
            self._file.close()
            done = {"bytes": self.size - self._left, "sha256": self._hash.hexdigest()}
            self.written.append(done)
            self._file = None


class Joined:
    """The pieces as one file to read from."""

    def __init__(self, paths: list[Path]):
        self._blocks = self._read(paths)
        self._rest = b""

    def read(self, size: int) -> bytes:
        while len(self._rest) < size and (block := next(self._blocks, b"")):
            self._rest += block
        content, self._rest = self._rest[:size], self._rest[size:]
        return content

    @staticmethod
    def _read(paths: list[Path]) -> Iterator[bytes]:
        for path in paths:
            with open(path, "rb") as file:
                while block := file.read(BLOCK):
                    yield block


def part(folder: Path, number: int) -> Path:
    return folder / f"part-{number:05d}"


def pack(runs: Path, packed: Path, size: int, *, without_replay: bool = False) -> str:
    """Packs all runs below a folder; returns what was done in a line.

    Raises:
        PackingError: there are none, one is being trained, the target is not empty, or a file is
            a link.
        OSError: a file cannot be read or written.
    """
    if packed.exists() and any(packed.iterdir()):
        raise PackingError(f"{packed}: is not empty; choose another folder")
    folders = run_folders(runs)
    with ExitStack() as stack:
        for folder in folders:
            hold(folder / "lock", stack)
        packed.mkdir(parents=True, exist_ok=True)
        temporary = Path(stack.enter_context(tempfile.TemporaryDirectory(dir=packed)))
        parts = Parts(packed, size)
        try:
            with tarfile.open(fileobj=parts, mode="w|", bufsize=BLOCK) as archive:
                for folder in folders:
                    for path in files_of(folder):
                        name, inside = path.relative_to(runs), path.relative_to(folder)
                        if without_replay and inside.parts[0] == "replay":
                            continue
                        if without_replay and inside == Path("checkpoint.pt"):
                            path = stripped(path, temporary / "checkpoint.pt")
                        archive.add(path, name.as_posix(), recursive=False)
            parts.close()
            index = {
                "format": FORMAT,
                "runs": [folder.relative_to(runs).as_posix() for folder in folders],
                "parts": parts.written,
            }
            (packed / INDEX).write_text(json.dumps(index, indent=2) + "\n", "utf-8")
        except BaseException:
            for path in (*packed.glob("part-*"), packed / INDEX):
                path.unlink(missing_ok=True)
            raise
    total = sum(one["bytes"] for one in parts.written)
    return f"{len(folders)} runs, {total:,} bytes in {len(parts.written)} parts, in {packed}"


def run_folders(runs: Path) -> list[Path]:
    """The folders of runs below a folder, sorted."""
    if not runs.is_dir():
        raise PackingError(f"{runs}: is no folder")
    for path in runs.rglob("*"):
        if path.is_symlink() and path.is_dir() and not is_of_wandb(path, runs):
            raise PackingError(f"{path}: is a link; put the folder itself there")
    found = {
        path.parent
        for name in ("run.json", "checkpoint.pt")
        for path in runs.rglob(name)
        if not path.relative_to(runs).parts[0].startswith(UNPACKING)  # left by one that was killed
    }
    if runs in found:
        raise PackingError(f"{runs}: is itself a run; give the folder of runs that it is in")
    if not found:
        raise PackingError(f"{runs}: holds no runs")
    return sorted(found)


def is_of_wandb(path: Path, folder: Path) -> bool:
    """Whether Weights & Biases has written it, with links to its latest run and to its cache."""
    return "wandb" in path.relative_to(folder).parts


def hold(path: Path, stack: ExitStack) -> None:
    """Keeps others from training in the folder of this lock until the stack ends."""
    file = stack.enter_context(path.open("a"))
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise PackingError(f"{path.parent}: is being trained; stop it first") from None


def files_of(folder: Path) -> Iterator[Path]:
    """All files of a run but its lock and what was not written to its end, sorted."""
    for path in sorted(folder.rglob("*")):
        if path.is_symlink():
            if is_of_wandb(path, folder):
                continue
            raise PackingError(f"{path}: is a link; put the file itself there")
        if path.is_file() and path != folder / "lock" and path.suffix != ".new":
            yield path


def stripped(path: Path, target: Path) -> Path:
    """A checkpoint without the replay of its agent: itself, or a copy at `target`."""
    from zipf.errors import UserError
    from zipf.experiments.building import checkpoint

    try:
        saved = checkpoint.load(path)
        if not saved["agent"].get("replay"):
            return path
        saved["agent"]["replay"] = {}
        checkpoint.save(target, {**saved, "without_replay": True})
    except UserError as error:
        raise PackingError(str(error)) from None
    return target


def unpack(packed: Path, runs: Path) -> str:
    """Unpacks all runs into a folder; returns what was done in a line.

    Raises:
        PackingError: a part is missing or damaged, or a run is there with other files. Nothing was
            written.
        OSError: a file cannot be read or written.
    """
    index = read_index(packed)
    parts = [part(packed, number) for number in range(len(index["parts"]))]
    for path, known in zip(parts, index["parts"], strict=True):
        check(path, known)
    runs.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=UNPACKING, dir=runs) as temporary:
        root = Path(temporary)
        try:
            with tarfile.open(fileobj=Joined(parts), mode="r|", bufsize=BLOCK) as archive:
                archive.extractall(root, filter="data")
        except tarfile.TarError as error:
            raise PackingError(f"{packed}: is no archive of runs ({error})") from None
        folders = run_folders(root)
        if [folder.relative_to(root).as_posix() for folder in folders] != index["runs"]:
            raise PackingError(f"{packed / INDEX}: names other runs than there are in the parts")
        there = [runs / folder.relative_to(root) for folder in folders]
        for folder, target in zip(folders, there, strict=True):
            if target.exists() and not same(folder, target):
                raise PackingError(
                    f"{target}: holds other files than the packed run; remove it, or unpack into "
                    "another folder"
                )
        new = 0
        for folder, target in zip(folders, there, strict=True):
            if not target.exists():
                target.parent.mkdir(parents=True, exist_ok=True)
                os.rename(folder, target)
                new += 1
    return f"{new} runs unpacked, {len(folders) - new} were there, in {runs}"


def read_index(packed: Path) -> dict[str, Any]:
    path = packed / INDEX
    try:
        index: dict[str, Any] = json.loads(path.read_text("utf-8"))
        runs, parts = index["runs"], index["parts"]
        if index["format"] != FORMAT or not all(isinstance(run, str) for run in runs):
            raise ValueError
        for one in parts:
            int(one["bytes"]), str(one["sha256"])
    except FileNotFoundError:
        raise PackingError(f"{packed}: holds no packed runs (it has no {INDEX})") from None
    except (ValueError, LookupError, TypeError):
        raise PackingError(f"{path}: is damaged, or of another version") from None
    return index


def check(path: Path, known: dict[str, Any]) -> None:
    """Raises PackingError where a part is not what the index says."""
    try:
        with open(path, "rb") as file:
            found = {
                "bytes": os.fstat(file.fileno()).st_size,
                "sha256": hashlib.file_digest(file, "sha256").hexdigest(),
            }
    except FileNotFoundError:
        raise PackingError(f"{path}: this part is missing") from None
    if found["bytes"] != known["bytes"]:
        raise PackingError(
            f"{path}: this part has {found['bytes']:,} bytes and should have {known['bytes']:,}"
        )
    if found["sha256"] != known["sha256"]:
        raise PackingError(f"{path}: this part is damaged (its checksum does not match)")


def same(one: Path, other: Path) -> bool:
    """Whether two runs have the same files."""
    names = [sorted(path.relative_to(run) for path in files_of(run)) for run in (one, other)]
    return names[0] == names[1] and all(
        filecmp.cmp(one / name, other / name, shallow=False) for name in names[0]
    )


def size(text: str) -> int:
    """Bytes, from a number with or without a unit."""
    match = re.fullmatch(r"(\d{1,15}) ?(\w*)", text)
    if match is None or match[2] not in UNITS:
        raise PackingError(f"--part {text}: should be a number of bytes, or as in 500kB or 16MiB")
    if (found := int(match[1]) * UNITS[match[2]]) < SMALLEST:
        raise PackingError(f"--part {text}: should be at least {SMALLEST} bytes")
    return found


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    commands = parser.add_subparsers(dest="command", required=True)
    packing = commands.add_parser("pack", help="runs into parts")
    packing.add_argument("runs", type=Path, help="folder of runs")
    packing.add_argument("packed", type=Path, help="folder for the parts, new or empty")
    packing.add_argument("--part", default="16MiB", help="the most that a file may have")
    packing.add_argument("--without-replay", action="store_true", help="leave R2D2's replay behind")
    unpacking = commands.add_parser("unpack", help="parts into runs")
    unpacking.add_argument("packed", type=Path, help="folder of the parts")
    unpacking.add_argument("runs", type=Path, help="folder for the runs")
    given = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # and clean up
    try:
        if given.command == "pack":
            bound, left_out = size(given.part), given.without_replay
            print(pack(given.runs, given.packed, bound, without_replay=left_out))
        else:
            print(unpack(given.packed, given.runs))
    except PackingError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except OSError as error:
        where = error.filename or given.packed
        print(f"error: {where}: {error.strerror or error}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
