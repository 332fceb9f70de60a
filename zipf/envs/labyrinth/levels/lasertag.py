"""The laser tag levels: find and tag opponents in an unknown maze."""

from __future__ import annotations

import math
from typing import ClassVar

import numpy as np

from zipf.envs.labyrinth import themes
from zipf.envs.labyrinth.episode import Episode
from zipf.envs.labyrinth.knowledge import EVERYTHING, Knowledge
from zipf.envs.labyrinth.lasertag.arena import (
    AMMUNITION,
    ARMOUR_PACK,
    BEAM,
    DISC,
    HEALTH_PACK,
    IMPULSE,
    ORB,
    RAPID,
    REACH,
)
from zipf.envs.labyrinth.lasertag.match import Match
from zipf.envs.labyrinth.lasertag.shooting import BLAST_RADIUS, ORB_SPEED
from zipf.envs.labyrinth.mazes import MazeOptions, random_maze
from zipf.envs.labyrinth.mover import WIDE
from zipf.envs.labyrinth.state import CELL
from zipf.envs.labyrinth.steering import LARGE, NAMES, SMALL, Point, Ways, bearing, walk_to
from zipf.envs.labyrinth.world import World

_FIRE = NAMES["fire"]
_STEP = 4 / 60
_STOP = 0.1  # seconds after which a fighter that does not run stands still


class Lasertag(Episode):
    """Goal: tag opponents, who tag each other and the player.

    Layout: a maze of rooms and corridors, open to the sky; every room has a floor and walls of its
    own. Opponents are robots in three colours, drawn for the episode. There are gadgets (green: the
    orb launcher, blue: the beam, magenta: the disc) and supplies (a box with a red cross: health;
    a blue vest: armour) in random cells.
    Rules: firing uses the gadget in hand. Everybody begins with Impulse (50 points of damage every
    0.4 s at arm's length) and with Rapid and 100 shots (7 every 0.1 s). An orb flies and does 100
    where it hits, less around (10 orbs, one in 0.8 s); the beam does 8 every 0.05 s as far as 768
    units (100); a disc does 100 to all in its way (10, one in 1.5 s). A gadget that is picked up is
    taken in hand at once; without ammunition, the best that has some. Damage costs health, of which
    there are 125, soon 100, and pushes. Armour takes two thirds of it. A health pack gives 50 up to
    100 and is back after 35 s, armour 50 up to 200 (25 s), a gadget is back after 5 s. Without
    health a fighter is tagged: the player sees the place from the ground until it fires, from 1.7 s
    on, or until 21.7 s are over. It then begins again in a random spawn cell that is free, looking
    anywhere. A tagged fighter drops the gadget in hand for 30 s. Bars show health (left) and
    ammunition (right).
    Rewards: +1 for tagging an opponent, -1 for tagging oneself with an orb.
    Length: 240 s.
    Approximated: the original's opponents are programs of tens of thousands of lines. These have
    the parameters of the same three at skill 4 (accuracy, reaction, turning, bursts), but decide by
    a state machine of ours, see `lasertag.opponents`. A burst hurts fighters with no wall between
    their middle and it. One may fire again at once after respawning. The dead view is from 8 units
    above the ground. No clock and no numbers are shown; armour has no bar.
    """

    opponents: ClassVar[int]
    options: ClassVar[MazeOptions]
    gadgets: ClassVar[int]
    supplies: ClassVar[int]

    def __init__(self, world: World, rng: np.random.Generator) -> None:
        super().__init__(world, rng)
        self.maze = random_maze(rng, self.options)
        themes.build_maze(world, self.maze, rng, alike=False)
        spawns = [cell for room in self.maze.spawns for cell in room]
        empty = [(int(r), int(c)) for r, c in np.argwhere(~self.maze.solid)]
        empty = [cell for cell in empty if cell not in spawns]
        count = self.gadgets + self.supplies
        cells = [empty[k] for k in rng.permutation(len(empty))[:count].tolist()]
        kinds = [(ORB, BEAM, DISC)[k] for k in rng.integers(3, size=self.gadgets).tolist()]
        kinds += [(HEALTH_PACK, ARMOUR_PACK)[k] for k in rng.integers(2, size=self.supplies)]
        self.match = Match(
            world, self.opponents, spawns, list(zip(kinds, cells, strict=True)),
            hue=int(rng.integers(360)), seed=int(rng.integers(2**63)),
        )  # fmt: skip
        self.ways = Ways(self.maze.solid, [])

    def begin_map(self, rng: np.random.Generator) -> None:
        self.match.begin()

    def scored(self, points: int) -> None:
        self.world.reward(points)

    def act(self, known: Knowledge) -> int:
        """Fights an opponent in view, a near and weak one first; else fetches what it needs, or
        chases the nearest. A player that does not know where anybody is explores."""
        match = self.match
        if not match.is_up(0):
            return _FIRE
        x, y, *_ = self.world.player
        enemies = match.enemies
        seen = [f for f in enemies if match.in_view(f) and known.faces(*match.place(f))]
        if seen:
            action = self._fight(
                min(seen, key=lambda f: math.dist(match.place(f), (x, y)) * (50 + match.health(f))),
                known,
            )
            if action is not None:
                return action
        wanted = self._wanted(known)
        if wanted is not None:
            return self._go_to(wanted, known)
        if known is not EVERYTHING:
            return known.explore(self.maze.solid, size=CELL)
        if not enemies:
            return self._go_to(self._spawn(), known)
        places = {self.ways.cell_of(*match.place(f)): match.place(f) for f in enemies}
        self.ways.distances = {}
        for cell in places:
            self.ways.add(cell)
        return self._go_to(places[self.ways.nearest(self.world, list(places))], known)

    def _spawn(self) -> Point:
        """Where an opponent may appear next."""
        row, column = self.maze.spawns[self.world.frames_left // 600 % len(self.maze.spawns)][0]
        return CELL * (column + 0.5), CELL * (row + 0.5)

    def _wanted(self, known: Knowledge) -> Point | None:
        """Where the nearest supply lies that is worth fetching."""
        match = self.match
        x, y, *_ = self.world.player
        strong = sum(match.loaded(gadget) > 2 for gadget in (ORB, BEAM, DISC))
        armed = strong > 0 or match.loaded(RAPID) > 30
        best, least = None, math.inf
        for supply in match.supplies:
            if not known.knows(supply.item):
                continue
            if supply.kind == HEALTH_PACK:
                far = 500.0 if match.health(0) < 60 else 0.0
            elif supply.kind == ARMOUR_PACK:
                far = 200.0
            elif not armed:
                far = math.inf
            else:
                short = match.loaded(supply.kind) <= AMMUNITION[supply.kind] // 2
                far = 1000.0 if strong == 0 else 400.0 if short else 100.0
            away = math.dist((x, y), (supply.x, supply.y))
            if away < min(far, least):
                best, least = (supply.x, supply.y), away
        return best

    def _go_to(self, point: Point, known: Knowledge) -> int:
        ways = Ways(self.maze.solid & known.seen(*self.maze.solid.shape), [])
        cell = ways.cell_of(*point)
        x, y, *_ = self.world.player
        if ways.cell_of(x, y) == cell:
            return walk_to(self.world, *point)
        ways.add(cell)
        return ways.walk_to(self.world, cell)

    def _fight(self, enemy: int, known: Knowledge) -> int | None:
        """Aims and fires at an opponent in view; None: it is out of reach."""
        match, gadget = self.match, self.match.gadget
        x, y, yaw, _ = self.world.player
        to_x, to_y = match.place(enemy)
        away = math.dist((x, y), (to_x, to_y))
        if gadget == IMPULSE and self._wanted(known) is not None and away > 150:
            return None
        speed_x, speed_y = match.velocity(enemy)
        own_x, own_y = match.velocity(0)

        def off_after(seconds: float) -> float:
            """By how many degrees it will be to the left of the view."""
            flight = seconds + (away / ORB_SPEED if gadget == ORB else 0.0)
            ahead_x = to_x + speed_x * flight - x - own_x * min(seconds, _STOP)
            ahead_y = to_y + speed_y * flight - y - own_y * min(seconds, _STOP)
            return bearing(yaw, math.atan2(ahead_y, ahead_x))

        reach = 60.0 if gadget == IMPULSE else float(REACH[gadget]) - 20.0
        if away > reach:
            return walk_to(self.world, to_x, to_y)
        off = off_after(0.5 * _STEP)
        if gadget == ORB and away < BLAST_RADIUS + 2 * WIDE and abs(off) < 60:
            return NAMES["backward"]
        if abs(off) <= math.degrees(math.atan(0.8 * WIDE / away)):
            return _FIRE
        off = off_after(1.5 * _STEP)  # after a turn, when it is fired at
        side = "left" if off > 0 else "right"
        if abs(off) > (SMALL + LARGE) / 2:
            return NAMES[f"look {side}"]
        if abs(off) > SMALL / 2:
            return NAMES[f"look slightly {side}"]
        # A small turn would miss on the other side.
        return NAMES[f"strafe {side}"]


_SMALL = MazeOptions(11, 11, rooms=3, smallest=3, largest=5, spawns=3, objects=0, extra=0.05)
_LARGE = MazeOptions(21, 21, rooms=4, smallest=5, largest=7, spawns=3, objects=0, extra=0.05)


class OneOpponentSmall(Lasertag):
    opponents, options, gadgets, supplies = 1, _SMALL, 1, 2


class ThreeOpponentsSmall(Lasertag):
    opponents, options, gadgets, supplies = 3, _SMALL, 1, 2


class OneOpponentLarge(Lasertag):
    opponents, options, gadgets, supplies = 1, _LARGE, 2, 4


class ThreeOpponentsLarge(Lasertag):
    opponents, options, gadgets, supplies = 3, _LARGE, 2, 4
