"""The keys and doors puzzle: which key to take, and which door to spend it on."""

from __future__ import annotations

import numpy as np

from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.grids import Cell
from zipf.envs.labyrinth.knowledge import Knowledge
from zipf.envs.labyrinth.levels.keys_doors import COLOURS, GOAL_REWARD, random_plan, solve
from zipf.envs.labyrinth.steering import WAIT, Ways, walk_to
from zipf.envs.labyrinth.world import BARS, World, middle

_HUD = (12 / 640, 12 / 480, 60 / 640, 60 / 480)


class KeysDoorsPuzzle(Episode):
    """Goal: reach the ice lolly; doors need keys, and a key opens one door.

    Layout: up to nine small rooms on orange tiles under the sky, new in every episode. Walls are
    invisible; doors are fences in their colour.
    Rules: a key that is taken takes the place of the one carried before, which is lost. Entering
    the cell of a door with a key of its colour opens the door for good and uses the key up. Some
    doors and keys lead nowhere. The ice lolly ends the episode. A square at the top left shows the
    key that is carried.
    Rewards: +1 for a key, +1 for a door that is opened, +50 for the ice lolly.
    Approximated: see `keys_doors`.
    """

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.plan = plan = random_plan(rng)
        rows = np.array([row for row, _ in plan.rooms])
        columns = np.array([column for _, column in plan.rooms])
        # Corner of each room, in cells of the text map; rows grow to the north here.
        high = 3 * (int(rows.max() - rows.min()) + 1) + 3
        wide = 4 * (int(columns.max() - columns.min()) + 1) + 3
        upper = high - 3 - 3 * (rows - rows.min())  # the row of a room's upper cells
        left = 4 * (columns - columns.min()) + 2
        self.corners = list(zip(upper.tolist(), left.tolist(), strict=True))
        solid = np.ones((high, wide), np.bool_)
        for row, column in self.corners:
            solid[row - 1 : row + 1, column : column + 3] = False
        self.links = list(plan.links.items())
        self.link_cells: list[Cell] = []
        for (a, b), _ in self.links:
            (row, column), (other_row, other_column) = self.corners[a], self.corners[b]
            if row == other_row:
                cell = row, max(column, other_column) - 1
            else:
                cell = min(row, other_row) + 1, column + 1
            self.link_cells.append(cell)
            solid[cell] = False
        self.solid = solid
        world.add_text_map(solid, "floor_0", None)
        self.doors: dict[int, int] = {}  # by link
        self.zones: dict[int, int] = {}  # link by zone
        for k, ((a, b), colour) in enumerate(self.links):
            if colour is None:
                continue
            row, column = self.link_cells[k]
            beside = self.corners[a][0] == self.corners[b][0]
            self.doors[k] = world.add_door(
                (row, column), eastwards=beside, texture=BARS, tint=COLOURS[colour]
            )
            zone = world.add_cell_zone((row, column))
            self.zones[zone] = k
        self.keys = [
            world.add_item("key_large", colours=(COLOURS[colour], COLOURS[colour]))
            for _, colour in plan.keys
        ]
        self.lolly = world.add_item("ice_lolly_large", colours=((255, 140, 0), (240, 200, 120)))
        solved = solve(plan)
        assert solved is not None
        self.best, self.steps = solved
        self.opened: set[int] = set()
        self.carried = ""

    def begin_map(self, rng: np.random.Generator) -> None:
        slots = {
            room: [(row - 1, column + 2 * k) for k in rng.permutation(2).tolist()]
            for room, (row, column) in enumerate(self.corners)
        }
        self.places = {key: slots[room].pop() for key, (room, _) in
                       zip(self.keys, self.plan.keys, strict=True)}  # fmt: skip
        self.places[self.lolly] = slots[self.plan.goal].pop()
        for item, cell in self.places.items():
            self.world.put_in_cell(item, cell)
        for door in self.doors.values():
            self.world.set_door(door, is_open=False)
        row, column = self.corners[0]
        starts = (row, column), (row, column + 1), (row, column + 2), (row - 1, column + 1)
        start = starts[int(rng.integers(4))]
        self.world.place_player_in_cell(start, float(rng.uniform(0, 2 * np.pi)))

    def picked_up(self, item: int) -> None:
        if item == self.lolly:
            self.world.reward(GOAL_REWARD)
            self.world.end_episode()
            return
        self.world.reward(1)
        self._carry(self.plan.keys[self.keys.index(item)][1])

    def entered(self, zone: int) -> None:
        link = self.zones[zone]
        if link not in self.opened and self.carried == self.links[link][1]:
            self.opened.add(link)
            self.world.reward(1)
            self.world.set_door(self.doors[link], is_open=True)
            self._carry("")

    def _carry(self, colour: str) -> None:
        self.carried = colour
        self.world.show_square(_HUD, COLOURS[colour] if colour else None)

    def act(self, known: Knowledge) -> int:
        """Follows the plan with the highest return, once all rooms, doors and things are seen;
        nothing in this level hides what is behind it."""
        there = [item for item in self.places if self.world.is_there(item)]
        seen = known.seen(*self.solid.shape)
        if not seen[~self.solid].all() or not all(map(known.knows, there)):
            return known.search()
        while self.steps and self._is_done(*self.steps[0]):
            self.steps.pop(0)
        if not self.steps:
            return WAIT
        kind, number = self.steps[0]
        blocked = self.solid.copy()
        for k in self.doors:
            blocked[self.link_cells[k]] = k not in self.opened
        for item in there:
            blocked[self.places[item]] = True
        if kind == "door":
            goal = self.link_cells[number]
        else:
            goal = self.places[self.keys[number] if kind == "key" else self.lolly]
        if self.world.cell == goal:
            return walk_to(self.world, *middle(goal), slowly=True)
        blocked[goal] = False
        return Ways(blocked, [goal]).walk_to(self.world, goal, slowly=True)

    def _is_done(self, kind: str, number: int) -> bool:
        if kind == "key":
            return not self.world.is_there(self.keys[number])
        if kind == "door":
            return number in self.opened or self.links[number][1] is None
        return False
