"""What private interfaces and emitted code buy, as ratios: the numbers of docs/underneath.md.

    python scripts/benchmark_underneath.py
    python scripts/benchmark_underneath.py --match chipmunk --rounds 3

Every row is measured as it is and without the interface, in turn, several times over; a ratio is
the median over rounds of without beside with. Where code has to be compiled otherwise, each side is
a process with a cache of its own, which takes a minute or two at first.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

LIFT = "playroom/lift/lift_shape_zipf3"
Timed = Callable[[], float]
"""Seconds of CPU time that something takes."""

STEPS = """
import statistics, sys, time
import numpy as np
{patch}
import zipf.envs
env = zipf.envs.make_vec({level!r}, 64)
out = env.allocate()
actions = np.random.default_rng(0).integers(int(env.single_action_space.n), size=(200, 64))
env.reset(seed=0, out=out)
env.step(actions[0], out=out)
print("ready", flush=True)
for line in sys.stdin:
    start = time.process_time()
    for these in actions:
        env.step(these, out=out)
    print(time.process_time() - start, flush=True)
"""

COUNTED = """
import zipf.compiled as module
_original = module.compiled
module.compiled = lambda *, references=True, **options: _original(**options)
"""


class Stepping:
    """A process that steps 64 environments of a level, with something changed before it begins."""

    def __init__(self, level: str, patch: str, cache: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", STEPS.format(patch=patch, level=level)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "NUMBA_CACHE_DIR": cache},
        )
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "ready\n"

    def __call__(self) -> float:
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        print(file=self.process.stdin, flush=True)
        return float(self.process.stdout.readline())


def stepping(level: str, patch: str) -> tuple[Timed, Timed]:
    folder = tempfile.mkdtemp()
    return Stepping(level, "", f"{folder}/with"), Stepping(level, patch, f"{folder}/without")


def timed(function: Callable[[], object]) -> Timed:
    def run() -> float:
        start = time.process_time()
        function()
        return time.process_time() - start

    run()
    return run


def baselines() -> tuple[Timed, Timed]:
    return stepping(LIFT, COUNTED)


def copier() -> tuple[Timed, Timed]:
    """The gridworld's images, by vectors of 32 bytes and byte by byte."""
    from zipf import envs
    from zipf.compiled import compiled
    from zipf.envs.gridworld import kernels
    from zipf.envs.gridworld.maps import PAD, VIEW
    from zipf.envs.gridworld.sprites import AGENT, CELL, FLOOR, NUM_CODES, SPRITES

    stripes = SPRITES.reshape(2, NUM_CODES, CELL, 3 * CELL)

    @compiled(references=False)
    def plain(mask, states, codes, cells, stripes, image):
        for i in range(len(states)):
            map, row, column = states[i, 0], states[i, 2], states[i, 3]
            goal = cells[map, states[i, 1]]
            for r in range(VIEW):
                for c in range(VIEW):
                    code = np.intp(codes[map, row + r, column + c])
                    if r == PAD and c == PAD and code == FLOOR:
                        code = AGENT
                    shown = 0
                    if r == 0 and c == 0:
                        shown, code = 1, np.intp(codes[map, goal[0] + PAD, goal[1] + PAD])
                    for stripe in range(CELL):
                        for k in range(3 * CELL):
                            byte = stripes[shown, code, stripe, k]
                            image[i, r * CELL + stripe, 3 * CELL * c + k] = byte

    env = envs.make_vec("gridworld/zipf_2", 256)
    env.reset(seed=0)
    maps, states = env.level.maps, env._envs  # type: ignore[attr-defined]
    one, other = (env.allocate()["image"] for _ in range(2))
    mask = np.ones(256, np.bool_)

    def vectors() -> None:
        for _ in range(100):
            kernels.draw_images(mask, states, maps.codes, maps.cells, kernels.STRIPES, one)

    def bytes_() -> None:
        lines = other.reshape(256, VIEW * CELL, 3 * VIEW * CELL)
        for _ in range(100):
            plain(mask, states, maps.codes, maps.cells, stripes, lines)

    both = timed(vectors), timed(bytes_)
    assert (one == other).all()
    return both


def chipmunk() -> tuple[Timed, Timed]:
    """The physics of 64 rooms, by address and by pymunk's methods."""
    from zipf import envs
    from zipf.envs.playroom import chipmunk as physics
    from zipf.envs.playroom.constants import FRAME, FRAMES

    env = envs.make_vec(LIFT, 64)
    env.reset(seed=0)
    env.step(np.zeros(64, np.int64))
    found = [env._room(i).addresses() for i in range(64)]  # type: ignore[attr-defined]
    spaces = np.array([space for space, _ in found])
    bodies = np.array([of_room for _, of_room in found])
    states = env.envs  # type: ignore[attr-defined]
    forces = np.random.default_rng(0).uniform(-100, 100, (64, 2))
    mask = np.ones(64, np.bool_)

    def compiled() -> None:
        for _ in range(50):
            physics.simulate(
                mask, physics.functions(), spaces, bodies, forces, states.agents, states.objects
            )

    def methods() -> None:
        for _ in range(50):
            for i in range(64):
                room = env._room(i)  # type: ignore[attr-defined]
                for _ in range(FRAMES):
                    room.agent.force = tuple(forces[i])
                    room.space.step(FRAME)
                states.agents[i, :2] = room.agent.position
                for j, body in enumerate(room.objects):
                    states.objects[i, j, :3] = (*body.position, body.angle)

    return timed(compiled), timed(methods)


def blocks() -> tuple[Timed, Timed]:
    """The pixels of a wall's rows, in blocks of sixteen and one by one."""
    from zipf.compiled import compiled
    from zipf.envs.render3d.blocks import address, wall_block
    from zipf.envs.render3d.lanes import LANES

    width, rows = 96, 72
    z, dz, u, du, v, dv = (np.float32(a) for a in (0.4, 0.001, 3.0, 0.2, 2.0, 0.1))
    area, fade, light = np.float32(2.0), np.float32(0.01), np.float32(0.7)
    texels = np.full(1 << 13, -0x7F7F80, np.int32)

    @compiled(references=False, error_model="numpy")
    def by_blocks(colour, depth, texels):
        for y in range(rows):
            for x in range(0, width, LANES):
                at = 4 * (y * colour.shape[1] + x)
                wall_block(
                    address(colour) + at, address(depth) + at, address(texels), x, width - 1, z, dz,
                    u, du, v, dv, area, fade, light, light, light, 0,
                )  # fmt: skip

    @compiled(references=False, error_model="numpy")
    def one_by_one(colour, depth, texels):
        for y in range(rows):
            for x in range(width):
                place = np.float32(x)
                inverse = z + dz * place
                if inverse <= depth[y, x]:
                    continue
                square = inverse * inverse
                lit = square + fade
                both = np.float32(1.0) / (inverse * lit)
                t, dim = lit * both, square * inverse * both
                each = min(max(area * t * t * t, np.float32(1.0)), np.float32(4096.0))
                level = np.int32(np.log2(each)) >> 1
                iu, iv = np.int32((u + du * place) * t) & 63, np.int32((v + dv * place) * t) & 63
                index = ((iv >> level) << 7) + (iu >> level) + 128 - (128 >> level)
                texel = texels[index]
                if texel >= 0:
                    continue
                paint = 0
                for channel in range(3):
                    part = np.float32((texel >> 8 * channel) & 255) * (dim * light)
                    paint |= np.int32(part) << 8 * channel
                depth[y, x] = inverse
                colour[y, x] = paint

    colour = np.zeros((rows, width + LANES), np.int32)
    depth = np.zeros((rows, width + LANES), np.float32)

    def run(draw: Callable[..., None]) -> Callable[[], None]:
        def several() -> None:
            for _ in range(200):
                depth[:] = 0
                draw(colour, depth, texels)

        return several

    return timed(run(by_blocks)), timed(run(one_by_one))


def cache() -> tuple[Timed, Timed]:
    """The first step of the gridworld in a new process, with saved code and without."""
    program = "from zipf import envs; e = envs.make_vec('gridworld/zipf_2', 2); e.reset(seed=0)"
    saved = tempfile.mkdtemp()

    def start(folder: Callable[[], str]) -> Timed:
        def run() -> float:
            begun = time.perf_counter()
            subprocess.run(
                [sys.executable, "-W", "ignore", "-c", program],
                check=True,
                env={**os.environ, "NUMBA_CACHE_DIR": folder()},
                stderr=subprocess.DEVNULL,
            )
            return time.perf_counter() - begun

        return run

    start(lambda: saved)()
    return start(lambda: saved), start(tempfile.mkdtemp)


ROWS: dict[str, Callable[[], tuple[Timed, Timed]]] = {
    "cache": cache,
    "references": baselines,
    "copier": copier,
    "chipmunk": chipmunk,
    "blocks": blocks,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--match", default="", help="rows whose names contain this")
    parser.add_argument("--rounds", type=int, default=7)
    arguments = parser.parse_args()
    os.environ["PYTHONPATH"] = str(Path(__file__).parent.parent)
    for name, make in ROWS.items():
        if arguments.match not in name:
            continue
        with_it, without = make()
        pairs = [(with_it(), without()) for _ in range(arguments.rounds)]
        ratios = sorted(slow / fast for fast, slow in pairs)
        print(
            f"{name:12} {statistics.median(ratios):6.2f} times as long without it "
            f"({ratios[0]:.2f} .. {ratios[-1]:.2f})",
            flush=True,
        )


if __name__ == "__main__":
    main()
