"""What the labyrinth's generators draw: mazes, plans of keys and doors, skymazes and deserts."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from zipf.envs.labyrinth.grids import STEPS, Cell, distances, random_path
from zipf.envs.labyrinth.levels import explore
from zipf.envs.labyrinth.levels.keys_doors import Plan, random_plan, solve
from zipf.envs.labyrinth.levels.skymaze import random_heights
from zipf.envs.labyrinth.mazes import Maze, MazeOptions, random_maze
from zipf.envs.labyrinth.state import ITEMS, PILLARS, QUADS, ZONES
from zipf.envs.labyrinth.terrain import BORDER, WALKABLE, Terrain, make_terrain

FEW = settings(max_examples=40, deadline=None)
SEEDS = st.integers(0, 2**32 - 1)


def beside(cell: Cell) -> Iterator[Cell]:
    return ((cell[0] + up, cell[1] + right) for up, right in STEPS)


# Mazes.


@st.composite
def maze_options(draw: st.DrawFn) -> MazeOptions:
    smallest = draw(st.sampled_from([3, 5]))
    largest = draw(st.sampled_from([smallest, smallest + 2]))
    side = st.integers((2 * largest + 1) // 2, 10).map(lambda half: 2 * half + 1)
    return MazeOptions(
        draw(side),
        draw(side),
        draw(st.integers(1, 9)),
        smallest,
        largest,
        spawns=draw(st.integers(1, 6)),
        objects=draw(st.integers(0, 6)),
        extra=draw(st.sampled_from([0.0, 0.05, 1.0])),
        doors=draw(st.booleans()),
    )


@FEW
@given(SEEDS, maze_options())
def test_a_maze_is_connected_and_has_what_it_should(seed: int, options: MazeOptions) -> None:
    maze = random_maze(np.random.default_rng(seed), options)
    solid = maze.solid
    assert solid.shape == (options.rows, options.columns)
    assert solid[[0, -1]].all()
    assert solid[:, [0, -1]].all()
    steps = distances(solid, *maze.spawns[0][0])
    assert ((steps >= 0) == ~solid).all()
    assert 1 <= len(maze.spawns) == len(maze.objects) <= options.rooms
    for number in range(len(maze.spawns)):
        cells = {(int(r), int(c)) for r, c in np.argwhere(maze.room == number)}
        rows, columns = (len({cell[axis] for cell in cells}) for axis in (0, 1))
        assert rows * columns == len(cells)
        for side in (rows, columns):
            assert side % 2 == 1
            assert options.smallest <= side <= options.largest
        assert not any(solid[cell] for cell in cells)
        # Between rooms there are walls.
        around = {cell for inner in cells for cell in beside(inner)} - cells
        assert all(maze.room[cell] < 0 for cell in around)
        spawns, objects = maze.spawns[number], maze.objects[number]
        assert len(spawns) == min(options.spawns, len(cells))
        assert len(objects) == min(options.objects, len(cells) - len(spawns))
        assert len({*spawns, *objects}) == len(spawns) + len(objects)
        assert {*spawns, *objects} <= cells


@FEW
@given(SEEDS, maze_options())
def test_corridors_lead_on_and_doors_stand_between_walls(seed: int, options: MazeOptions) -> None:
    maze = random_maze(np.random.default_rng(seed), options)
    for row, column in np.argwhere(~maze.solid & (maze.room < 0)).tolist():
        assert sum(not maze.solid[cell] for cell in beside((row, column))) >= 2
    assert options.doors or not maze.doors
    for cell in maze.doors:
        east, north, west, south = (bool(maze.solid[one]) for one in beside(cell))
        assert maze.room[cell] < 0
        assert (east and west) != (north and south)
    rooms_closed = maze.solid.copy()
    for cell in maze.doors:
        rooms_closed[cell] = True
    if maze.doors:  # every connection has a door
        reached = distances(rooms_closed, *maze.spawns[0][0]) >= 0
        assert set(maze.room[reached].tolist()) == {0}


@pytest.mark.parametrize(
    ("options", "rooms", "floor", "objects", "doors"),
    [
        (MazeOptions(11, 11, 4, 3, 5, doors=True), 3.71, 59, 14.9, 8.1),
        (MazeOptions(17, 17, 9, 3, 3, doors=True), 9, 147, 36, 23),
        (MazeOptions(11, 11, 3, 3, 5, extra=0.05), 2.98, 54, None, None),
        (MazeOptions(21, 21, 4, 5, 7, extra=0.05), 4, 191, None, None),
    ],
    ids=["explore small", "explore large", "lasertag small", "lasertag large"],
)
def test_mazes_have_the_statistics_of_the_originals(
    options: MazeOptions, rooms: float, floor: float, objects: float | None, doors: float | None
) -> None:
    """Those of 400 mazes of another implementation of the same description."""
    mazes = [random_maze(np.random.default_rng(seed), options) for seed in range(150)]
    assert np.mean([len(maze.spawns) for maze in mazes]) == pytest.approx(rooms, abs=0.15)
    assert np.mean([(~maze.solid).sum() for maze in mazes]) == pytest.approx(floor, rel=0.04)
    if objects is not None and doors is not None:
        placed = [sum(map(len, maze.objects)) for maze in mazes]
        assert np.mean(placed) == pytest.approx(objects, abs=0.5)
        assert np.mean([len(maze.doors) for maze in mazes]) == pytest.approx(doors, rel=0.08)


def test_sizes_of_rooms() -> None:
    sizes = []
    for seed in range(150):
        maze = random_maze(np.random.default_rng(seed), explore.SMALL)
        sizes += [_size(maze, number) for number in range(len(maze.spawns))]
    shares = {size: sizes.count(size) / len(sizes) for size in set(sizes)}
    assert set(shares) == {(3, 3), (3, 5), (5, 3)}
    # Larger ones are placed less often where there is little room.
    assert 0.45 < shares[3, 3] < 0.7
    assert shares[3, 5] == pytest.approx(shares[5, 3], abs=0.06)


def _size(maze: Maze, number: int) -> tuple[int, int]:
    rows, columns = np.nonzero(maze.room == number)
    return int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1


@FEW
@given(SEEDS)
def test_random_paths_are_simple_and_lead_there(seed: int) -> None:
    rng = np.random.default_rng(seed)
    maze = random_maze(rng, explore.SMALL)
    free = [(int(r), int(c)) for r, c in np.argwhere(~maze.solid)]
    start, goal = free[int(rng.integers(len(free)))], free[int(rng.integers(len(free)))]
    path = random_path(maze.solid, start, goal, rng)
    assert path[0] == start
    assert path[-1] == goal
    assert len(set(path)) == len(path)
    assert not any(maze.solid[cell] for cell in path)
    assert all(after in beside(cell) for cell, after in pairwise(path))


def test_there_may_be_no_path() -> None:
    solid = np.zeros((3, 3), np.bool_)
    solid[:, 1] = True
    with pytest.raises(ValueError, match=r"no path leads from \(0, 0\) to \(0, 2\)"):
        random_path(solid, (0, 0), (0, 2), np.random.default_rng(0))


# Plans of keys and doors.


def doors(plan: Plan) -> int:
    return sum(colour is not None for colour in plan.links.values())


@settings(max_examples=100, deadline=None)
@given(SEEDS)
def test_plans_can_be_solved(seed: int) -> None:
    plan = random_plan(np.random.default_rng(seed))
    assert len(set(plan.rooms)) == len(plan.rooms)
    assert all(0 <= row < 3 and 0 <= column < 3 for row, column in plan.rooms)
    for a, b in plan.links:
        assert sum(abs(x - y) for x, y in zip(plan.rooms[a], plan.rooms[b], strict=True)) == 1
        assert (b, a) not in plan.links
    held = [room for room, _ in plan.keys] + [plan.goal]
    assert max(held.count(room) for room in held) <= 2
    assert doors(plan) <= ZONES
    solved = solve(plan)
    assert solved is not None
    assert 52 <= solved[0] <= 58
    _carry_out(plan, *solved)


def test_a_useless_key_may_open_an_easy_room() -> None:
    """Both are worth a point then, so that the best return is up to 58 in some layouts."""
    plans = [random_plan(np.random.default_rng(seed)) for seed in range(400)]
    assert {solved[0] for plan in plans if (solved := solve(plan))} == set(range(52, 59))


def _carry_out(plan: Plan, value: int, steps: list[tuple[str, int]]) -> None:
    """Plays a solution by the rules of the level, written out again."""
    links = list(plan.links.items())
    room, carried, taken, opened, score = 0, None, set(), set(), 0
    for kind, number in steps:
        if kind == "key":
            where, colour = plan.keys[number]
            assert where == room
            assert number not in taken
            taken.add(number)
            carried, score = colour, score + 1
        elif kind == "door":
            pair, colour = links[number]
            assert room in pair
            if colour is not None and number not in opened:
                assert carried == colour
                opened.add(number)
                carried, score = None, score + 1
            room = sum(pair) - room
        else:
            assert room == plan.goal
            score += 50
    assert score == value


def test_plans_have_the_statistics_of_the_originals() -> None:
    """Those of 1500 plans of another implementation: rooms 3 .. 7, keys 1 .. 5, doors 2 .. 8."""
    plans = [random_plan(np.random.default_rng(seed)) for seed in range(300)]
    for counts, mean, least, most in (
        ([len(plan.rooms) for plan in plans], 5.6, 3, 8),
        ([len(plan.keys) for plan in plans], 3.0, 1, 5),
        ([doors(plan) for plan in plans], 5.4, 2, 9),
    ):
        assert np.mean(counts) == pytest.approx(mean, abs=0.35)
        assert least <= min(counts)
        assert max(counts) <= most
    best = [found[0] for plan in plans if (found := solve(plan))]
    assert np.mean(best) == pytest.approx(54.2, abs=0.3)


# Skymazes.


def climb(heights: NDArray[np.int64], start: Cell, up: bool) -> dict[Cell, int]:
    """The cells that can be reached without a step up (down, if `up`), and how many steps away."""
    found, queue = {start: 0}, [start]
    for cell in queue:
        for other in beside(cell):
            inside = all(0 <= other[k] < heights.shape[k] for k in range(2))
            if not inside or heights[other] < 0 or other in found:
                continue
            rise = int(heights[other] - heights[cell])
            if (rise >= 0) if up else (rise <= 0):
                found[other] = found[cell] + 1
                queue.append(other)
    return found


@FEW
@given(SEEDS, st.floats(0, 1, exclude_max=True))
def test_a_skymaze_leads_down_to_its_goal(seed: int, difficulty: float) -> None:
    heights, start, goal = random_heights(np.random.default_rng(seed), difficulty)
    assert heights.shape[0] == heights.shape[1]
    assert heights.shape[0] % 2 == 1
    assert (heights[[0, -1]] < 0).all()
    assert (heights[:, [0, -1]] < 0).all()
    assert goal in climb(heights, start, up=False)
    # The start is a tower: nothing else is nearly as high, and nobody comes back to it.
    others = heights.copy()
    others[start] = -1
    assert heights[start] - others.max() >= 5
    assert set(climb(heights, start, up=True)) == {start}
    assert heights[heights >= 0].min() > 0  # also the lowest detour is above the ground


@pytest.mark.parametrize(
    ("difficulty", "platforms", "moves", "dead"), [(0.9, 100, 25, 0.70), (None, None, None, 0.54)]
)
def test_skymazes_have_the_statistics_of_the_originals(
    difficulty: float | None, platforms: float | None, moves: float | None, dead: float
) -> None:
    """Platforms, moves of the shortest solution, and the share of reachable dead ends."""
    found = []
    for seed in range(120):
        rng = np.random.default_rng(seed)
        drawn = float(rng.random()) if difficulty is None else difficulty
        heights, start, goal = random_heights(rng, drawn)
        forward = climb(heights, start, up=False)
        to_goal = climb(heights, goal, up=True)
        lost = np.mean([cell not in to_goal for cell in forward])
        found.append(((heights >= 0).sum(), to_goal[start], lost))
    mean = np.mean(found, 0)
    if platforms is not None:
        assert mean[0] == pytest.approx(platforms, rel=0.05)
        assert mean[1] == pytest.approx(moves, abs=1.5)
    assert mean[2] == pytest.approx(dead, abs=0.04)


# Deserts.


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from([(2048.0, (5, 30)), (3600.0, (80, 80))]))
def test_in_a_desert_everything_can_be_reached(
    seed: int, kind: tuple[float, tuple[int, int]]
) -> None:
    side, (least, most) = kind
    terrain = make_terrain(seed, side, (least, most))
    assert terrain.heights.shape == (QUADS + 1, QUADS + 1)
    assert terrain.heights.min() == 0
    assert least <= len(terrain.mushrooms) <= most
    assert len(terrain.starts) == 10
    assert len(terrain.mushrooms) + len(terrain.props) <= ITEMS
    assert sum(prop.radius > 0 for prop in terrain.props) <= PILLARS
    places = np.array([*terrain.starts, *terrain.mushrooms])
    assert (places > BORDER - terrain.size).all()
    assert (places < side - BORDER + terrain.size).all()
    cells = (places[:, ::-1] // terrain.size).astype(int)
    reached = distances(~terrain.walkable, *cells[0])
    assert (reached[tuple(cells.T)] >= 0).all()
    apart = np.hypot(*(places[:, None] - places[None]).T)
    np.fill_diagonal(apart, np.inf)
    assert apart.min() > 32
    assert apart[:10].min() > 60  # who starts touches nothing
    for prop in terrain.props:
        assert np.hypot(*(places - (prop.x, prop.y)).T).min() > prop.radius


def test_deserts_are_drawn_once() -> None:
    first = make_terrain(3, 2048.0, (5, 30))
    make_terrain.cache_clear()
    again = make_terrain(3, 2048.0, (5, 30))
    assert again is not first
    assert (again.heights == first.heights).all()
    assert again.mushrooms == first.mushrooms


def test_the_height_of_a_desert_is_that_of_its_triangles() -> None:
    terrain = make_terrain(5, 2048.0, (5, 30))
    size, heights = terrain.size, terrain.heights
    rng = np.random.default_rng(0)
    for row, column in rng.integers(0, QUADS, (20, 2)).tolist():
        u, v = rng.random(2).tolist()
        corners = [(0, 0), (1, 1), (1, 0) if u >= v else (0, 1)]  # x, y
        system = np.array([[x, y, 1.0] for x, y in corners])
        values = [heights[row + y, column + x] for x, y in corners]
        plane = np.linalg.solve(system, values)
        height = terrain.height((column + u) * size, (row + v) * size)
        assert height == pytest.approx(plane @ [u, v, 1.0])


def test_deserts_have_the_statistics_of_the_originals() -> None:
    """Those of 37 of the 200 small maps: hills, slopes, plants and mushrooms."""
    for first, mushrooms, count, apart in ((1, (5, 30), 18, 300), (1001, (10, 75), 39, 196)):
        terrains = [make_terrain(first + k, 2048.0, mushrooms) for k in range(40)]
        assert np.mean([len(t.mushrooms) for t in terrains]) == pytest.approx(count, rel=0.2)
        assert np.mean([np.ptp(t.heights) for t in terrains]) == pytest.approx(392, rel=0.15)
        deviations = [t.heights.std() for t in terrains]
        assert np.mean(deviations) == pytest.approx(82, rel=0.15)
        assert min(deviations) > 30
        assert max(deviations) < 150
        slopes = [_normals(t) for t in terrains]
        assert np.mean(slopes) == pytest.approx(0.945, abs=0.02)
        assert np.mean([(s < WALKABLE).mean() for s in slopes]) < 0.04
        assert min((s >= WALKABLE).mean() for s in slopes) >= 0.8
        for kind, most in (("cactus", 38), ("rock", 37), ("bush", 18)):
            counts = [sum(prop.mesh.startswith(kind) for prop in t.props) for t in terrains]
            assert max(counts) <= most
        nearest = []
        for terrain in terrains:
            places = np.array(terrain.mushrooms)
            distance = np.hypot(*(places[:, None] - places[None]).T)
            np.fill_diagonal(distance, np.inf)
            nearest.append(distance.min(1).mean())
        assert np.mean(nearest) == pytest.approx(apart, rel=0.2)


def _normals(terrain: Terrain) -> NDArray[np.float64]:
    """How upright the middle of each quad stands."""
    h, size = terrain.heights, terrain.size
    east = (h[:-1, 1:] + h[1:, 1:] - h[:-1, :-1] - h[1:, :-1]) / 2 / size
    north = (h[1:, :-1] + h[1:, 1:] - h[:-1, :-1] - h[:-1, 1:]) / 2 / size
    normals: NDArray[np.float64] = 1 / np.sqrt(1 + east**2 + north**2)
    return normals
