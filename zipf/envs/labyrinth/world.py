"""The world of one env, as the rules of a level see it."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zipf.envs.labyrinth import materials
from zipf.envs.labyrinth.grids import Cell
from zipf.envs.labyrinth.mover import BELOW, WIDE
from zipf.envs.labyrinth.patterns import SOLID
from zipf.envs.labyrinth.scenery import DOORS, METRES, SIDES, Scenery, atlas, faces
from zipf.envs.labyrinth.screen import Screen
from zipf.envs.labyrinth.state import (
    CELL,
    FRAMES_PER_SECOND,
    GRID,
    ITEMS,
    PITCH,
    QUADS,
    VX,
    VY,
    VZ,
    YAW,
    Envs,
    X,
    Y,
    Z,
    clear,
)
from zipf.envs.labyrinth.terrain import Terrain
from zipf.envs.labyrinth.words import VOCABULARY
from zipf.envs.render3d import (
    EAST,
    FACES_DOWN,
    GROUNDED,
    NORTH,
    SCREEN,
    SEE_THROUGH,
    SOUTH,
    TILE_SIDES,
    TWO_SIDED,
    WEST,
)
from zipf.envs.render3d.shadows import cast

Point = tuple[float, float, float]

END_DELAY = 12  # frames from the event that closes an episode to its end (0.2 s)
PUSH, PUSHED_FRAMES = 400.0, 10  # speed after a teleport, and frames without friction
DEEP = 40.0  # height of a platform's sides, units
DOOR, LIP = 2.0, 8.0  # thickness of a door, and what is seen of an open one, units

BARS = "bars"  # the texture of doors that are seen through


class Door(NamedTuple):
    """A door: the number of its wall, its middle, half of its width as a vector, its cell, and
    whether it hides what is behind it."""

    wall: int
    at: NDArray[np.float64]
    half: NDArray[np.float64]
    cell: Cell
    hides: bool


class World:
    """The three-dimensional world of one env, whose arrays are written: what a level builds in it,
    and what its rules do. `rewards`, float64 [N], are those of the running step."""

    def __init__(
        self, envs: Envs, scenery: Scenery, number: int, rewards: NDArray[np.float64]
    ) -> None:
        self._envs = envs
        self._scenery = scenery
        self._number = number
        self._rewards = rewards
        self._items = self._zones = 0
        self._doors: dict[int, Door] = {}
        self.instruction = ""

    # Building.

    def clear(self) -> None:
        """Removes all that was built, for a map of another layout. The clock runs on."""
        i, envs = self._number, self._envs
        clock, limit = envs.clock[i], envs.limit[i]
        clear(envs, i)
        envs.clock[i], envs.limit[i] = clock, limit
        self._scenery.clear(i)
        self._items = self._zones = 0
        self._doors = {}
        self.instruction = ""

    def add_text_map(
        self,
        solid: NDArray[np.bool_],
        floors: NDArray[np.int64] | str,
        walls: NDArray[np.int64] | None,
    ) -> None:
        """Builds walls and floors of a text map, roofless, bool [rows, columns] with rows to the
        north and a solid border.

        `floors` and `walls`, int64 [rows, columns], are the textures of a cell's floor and of the
        walls around it, where it is not solid. A name is the floor of all cells, and without
        textures walls are invisible.
        """
        i, envs, scenery = self._number, self._envs, self._scenery
        rows, columns = solid.shape
        envs.cells[i] = rows, columns
        envs.solid[i] = True
        envs.solid[i, :rows, :columns] = solid
        scenes = scenery.scenes
        if walls is not None:
            envs.opaque[i, :rows, :columns] = solid
            ends, cells, numbers = faces(solid)
            textures = walls[cells[:, 0], cells[:, 1]]
            # Numbers of faces count the columns of the scene's grid.
            cell, side = np.divmod(numbers, 4)
            numbers = (cell // columns * GRID + cell % columns) * 4 + side
            scenery.add_walls(i, ends, (0.0, CELL), textures, faces=numbers, flags=GROUNDED)
            scenes.solid[i] = envs.solid[i]
            scenes.grid[i] = 0, 0, CELL * METRES
        if isinstance(floors, str):
            floors = np.full(solid.shape, materials.index(floors))
        if walls is not None:
            for (up, right, _), flag in zip(SIDES, (EAST, NORTH, WEST, SOUTH), strict=True):
                floors = floors + (flag << TILE_SIDES) * np.roll(solid, (-up, -right), (0, 1))
        rectangle = (0, 0, columns * CELL * METRES, rows * CELL * METRES)
        scenes.add_flat(i, rectangle, 0, 0, tiles=np.where(solid, -1, floors))

    def add_platforms(
        self,
        heights: NDArray[np.floating],
        there: NDArray[np.bool_],
        textures: dict[int, int],
        unit: float,
    ) -> None:
        """Builds platforms of one cell each in the sky; between them are invisible walls.

        `there` bool [rows, columns] says where, `heights` of that shape how high their tops are, in
        units, and `textures` how these look at each multiple of `unit`.
        """
        i, envs, scenery = self._number, self._envs, self._scenery
        rows, columns = there.shape
        envs.cells[i] = rows, columns
        envs.solid[i, :rows, :columns] = ~there
        envs.floor[i, :rows, :columns] = heights
        for row, column in np.argwhere(there).tolist():
            height = float(heights[row, column])
            x, y = column * CELL, row * CELL
            square = np.array([x, y, x + CELL, y + CELL]) * METRES
            scenery.scenes.add_flat(
                i, square, height * METRES, textures[round(height / unit)], flags=TWO_SIDED
            )
            sides = []
            for up, right, (x0, y0, x1, y1) in SIDES:
                beside = row + up, column + right
                if not there[beside] or heights[beside] < height:
                    sides.append((x + x0 * CELL, y + y0 * CELL, x + x1 * CELL, y + y1 * CELL))
            if sides:
                riser = materials.index("riser")
                scenery.add_walls(i, sides, (height - DEEP, height), riser)

    def add_block(
        self,
        low: Point,
        high: Point,
        texture: str | None,
        *,
        tint: materials.Colour = materials.WHITE,
        repeat: float = CELL,
    ) -> int:
        """Adds an upright solid block between two corners and returns its number as a box.
        Without a texture it is invisible; `repeat` is the units per repeat of the texture."""
        i = self._number
        box = int(self._envs.box_count[i])
        self._envs.box_count[i] += 1
        self._envs.boxes[i, box] = *low, *high
        self._envs.see_through[i, box] = texture is None
        if texture is not None:
            x, y = (low[0], high[0]), (low[1], high[1])
            ends = [(x[x0], y[y0], x[x1], y[y1]) for _, _, (x0, y0, x1, y1) in SIDES]
            self._scenery.add_walls(
                i, ends, (low[2], high[2]), materials.index(texture),
                flags=GROUNDED if low[2] == 0.0 else 0, repeat=repeat, tint=tint,
            )  # fmt: skip
        return box

    def add_room(
        self,
        low: tuple[float, float],
        high: tuple[float, float],
        height: float,
        texture: str,
        *,
        tint: materials.Colour = materials.WHITE,
        open_sides: str = "",
    ) -> None:
        """Adds the walls of a rectangular room between two corners, but for its open sides, of
        "east", "north", "west" and "south"."""
        (x0, y0), (x1, y1) = low, high
        thick = 40.0
        for side, ends in (
            ("east", ((x1, y0 - thick), (x1 + thick, y1 + thick))),
            ("north", ((x0 - thick, y1), (x1 + thick, y1 + thick))),
            ("west", ((x0 - thick, y0 - thick), (x0, y1 + thick))),
            ("south", ((x0 - thick, y0 - thick), (x1 + thick, y0))),
        ):
            if side not in open_sides:
                start, stop = ends
                self.add_block((*start, 0.0), (*stop, height), texture, tint=tint)

    def add_ring(
        self, apothem: float, sides: int, height: float, texture: str, *, tint: materials.Colour
    ) -> None:
        """Adds the walls of a regular room around the origin, the first of which is in the east;
        their middles are `apothem` from the origin."""
        i = self._number
        angles = 2 * math.pi * np.arange(sides) / sides
        self._envs.plane_count[i] = sides
        self._envs.planes[i, :sides] = np.stack(
            [np.cos(angles), np.sin(angles), np.full(sides, apothem)], 1
        )
        corners = angles - math.pi / sides
        far = apothem / math.cos(math.pi / sides)
        points = np.stack([far * np.cos(corners), far * np.sin(corners)], 1)
        ends = np.concatenate([points, np.roll(points, -1, 0)], 1)
        self._scenery.add_walls(
            i, ends, (0.0, height), materials.index(texture),
            flags=GROUNDED, repeat=CELL, tint=tint,
        )  # fmt: skip

    def add_picture(
        self, distance: float, angle: float, height: float, size: float, texture: int
    ) -> None:
        """Hangs a square picture that faces the origin; its middle is at this distance, angle
        (radians) and height above the floor."""
        middle = distance * np.array([math.cos(angle), math.sin(angle)])
        along = size / 2 * np.array([-math.sin(angle), math.cos(angle)])
        ends = (*(middle - along), *(middle + along))
        heights = (height - size / 2, height + size / 2)
        self._scenery.add_walls(self._number, ends, heights, texture, flags=TWO_SIDED)

    def add_screen(self, distance: float, height: float, side: float) -> Screen:
        """Adds a white square screen that faces the origin from the north."""
        self._envs.screen[self._number] = 0.0, distance, height, side
        self.add_picture(distance, math.pi / 2, height, side, SCREEN)
        return Screen(self._envs, self._scenery, self._number)

    def add_floor(
        self,
        low: tuple[float, float],
        high: tuple[float, float],
        texture: str,
        *,
        height: float = 0.0,
        tint: materials.Colour = materials.WHITE,
        repeat: float = CELL,
        ceiling: bool = False,
    ) -> int:
        """Adds a visible floor, or ceiling, and returns its number."""
        rectangle = np.array([*low, *high]) * METRES
        return self._scenery.scenes.add_flat(
            self._number, rectangle, height * METRES, materials.index(texture),
            flags=FACES_DOWN if ceiling else 0, repeat=repeat * METRES, tint=tint,
        )  # fmt: skip

    def add_terrain(
        self,
        terrain: Terrain,
        texture: str,
        *,
        tint: materials.Colour,
        sky: tuple[materials.Colour, materials.Colour],
    ) -> None:
        """Builds a terrain, with invisible walls at its edges; the sky has colours at the horizon
        and overhead."""
        i, envs, scenes = self._number, self._envs, self._scenery.scenes
        envs.quad[i] = terrain.size
        envs.heights[i] = terrain.heights
        side = terrain.size * QUADS
        envs.plane_count[i] = 4
        envs.planes[i, :4] = (1, 0, side), (0, 1, side), (-1, 0, 0), (0, -1, 0)
        scenes.set_terrain(
            i, (0.0, 0.0), terrain.size * METRES, terrain.heights * METRES,
            materials.index(texture), repeat=2.0, tint=tint,
        )  # fmt: skip
        scenes.sky[i] = sky

    def add_pillar(self, x: float, y: float, radius: float) -> None:
        """Adds a solid upright pillar of a terrain, which is not drawn."""
        i = self._number
        self._envs.pillars[i, self._envs.pillar_count[i]] = x, y, radius
        self._envs.pillar_count[i] += 1

    def add_zone(self, low: Point, high: Point) -> int:
        """Adds a box that tells when the player enters, and returns its number."""
        i = self._number
        zone = self._zones
        self._zones += 1
        self._envs.zones[i, zone] = *low, *high
        return zone

    def add_cell_zone(self, cell: Cell) -> int:
        """Adds a zone that tells when the player's point enters a cell, and returns its number."""
        x, y = middle(cell)
        half = CELL / 2 - WIDE
        return self.add_zone((x - half, y - half, 0.0), (x + half, y + half, CELL))

    def add_pictures(self, solid: NDArray[np.bool_], rng: np.random.Generator) -> None:
        """Hangs pictures on some of a text map's walls: on every tenth, each another picture."""
        ends, _, numbers = faces(solid)
        count = math.floor(min(0.5 + 0.1 * len(ends), materials.PICTURES))
        chosen = rng.permutation(len(ends))[:count]
        pictures = rng.permutation(materials.PICTURES)[:count] + materials.index("picture_0")
        ends, (cell, side) = ends[chosen], np.divmod(numbers[chosen], 4)
        columns = solid.shape[1]
        # In the middle of the wall, three quarters as wide, a little in front of it.
        along = ends[:, 2:] - ends[:, :2]
        outward = np.stack([-along[:, 1], along[:, 0]], 1) / CELL
        starts = ends[:, :2] + along * 0.125 + 2 * outward
        stops = ends[:, :2] + along * 0.875 + 2 * outward
        numbers = (cell // columns * GRID + cell % columns) * 4 + side
        self._scenery.add_walls(
            self._number, np.concatenate([starts, stops], 1), (12.5, 87.5), pictures,
            faces=numbers,
        )  # fmt: skip

    def add_item(
        self,
        mesh: str,
        *,
        colours: tuple[materials.Colour, materials.Colour],
        scale: float = 1.0,
        spins: bool = True,
        seen_only: bool = False,
        pattern: str = SOLID,
    ) -> int:
        """Adds an item that is nowhere yet, and returns its number.

        Args:
            colours: main and accent colour.
            spins: whether it bobs and turns.
            seen_only: whether nothing happens when it is touched.
            pattern: one of `patterns.PATTERNS`, which mixes the two colours; solid: the mesh has
                parts of each.
        """
        item = self._items
        if item >= ITEMS:
            raise ValueError(f"a world has room for {ITEMS} items")
        self._items += 1
        i, scenery = self._number, self._scenery
        scenery.shape[i, item] = atlas().index(mesh)
        scenery.spins[i, item] = spins
        self._envs.touchable[i, item] = not seen_only
        scenery.scenes.rotation[i, item] = np.eye(3)
        scenery.scenes.scale[i, item] = scale
        scenery.scenes.colours[i, item] = colours
        scenery.scenes.pattern[i, item] = (
            -1 if pattern == SOLID else materials.index(f"pattern_{pattern}")
        )
        return item

    def add_door(
        self,
        cell: Cell,
        *,
        eastwards: bool,
        texture: str = "panel",
        tint: materials.Colour = materials.WHITE,
    ) -> int:
        """Adds an open door in the middle of a cell, and returns its number. It is walked through
        to the east or west if `eastwards`, else to the north or south."""
        i, scenery = self._number, self._scenery
        door = int(self._envs.box_count[i])
        self._envs.box_count[i] += 1
        self._envs.see_through[i, door] = True
        x, y = middle(cell)
        half = np.array([0.0, CELL / 2]) if eastwards else np.array([CELL / 2, 0.0])
        wall = scenery.add_walls(
            i, (*((x, y) - half), *((x, y) + half)), (0.0, CELL), materials.index(texture),
            flags=TWO_SIDED | SEE_THROUGH, tint=tint,
        )  # fmt: skip
        self._doors[door] = Door(wall, np.array([x, y]), half, cell, texture != BARS)
        self.set_door(door, is_open=True)
        return door

    # What rules do.

    def set_door(self, door: int, *, is_open: bool) -> None:
        """Opens or closes a door. An open one has slid into the wall but for a lip."""
        i = self._number
        wall, at, half, cell, hides = self._doors[door]
        self._envs.opaque[i, cell[0], cell[1]] = hides and not is_open
        first = at + half * (1 - 2 * LIP / CELL) if is_open else at - half
        first, last = first * METRES, (at + half) * METRES
        self._scenery.scenes.walls[i, wall, :4] = *first, *last
        angle = math.atan2(last[1] - first[1], last[0] - first[0])
        cast(
            self._scenery.scenes.shadows[i, DOORS + door], *((first + last) / 2), 0.0, angle,
            math.dist(first, last) / 2, DOOR / 2 * METRES, 0.0,
        )  # fmt: skip
        box = self._envs.boxes[i, door]
        thick = np.array([DOOR / 2, DOOR / 2])
        if is_open:
            box[:] = 0.0
        else:
            box[:3] = *(at - half - thick), 0.0
            box[3:] = *(at + half + thick), CELL

    def put(self, item: int, x: float, y: float, floor: float = 0.0, yaw: float = 0.0) -> None:
        """Places an item on a floor of this height, turned by `yaw`."""
        self._envs.places[self._number, item] = x, y, floor + BELOW
        if yaw:
            cos, sin = math.cos(yaw), math.sin(yaw)
            self._scenery.scenes.rotation[self._number, item, :2, :2] = (cos, -sin), (sin, cos)
        self._envs.present[self._number, item] = True

    def put_in_cell(self, item: int, cell: Cell) -> None:
        """Places an item at the middle of a cell of the text map."""
        x, y = middle(cell)
        self.put(item, x, y, float(self._envs.floor[self._number, cell[0], cell[1]]))

    def let_return(self, item: int, seconds: float) -> None:
        """Lets an item that was taken be there again after some seconds."""
        frames = round(seconds * FRAMES_PER_SECOND)
        self._envs.returning[self._number, item] = self._envs.clock[self._number] + frames

    def take(self, item: int) -> None:
        """Removes an item."""
        self._envs.present[self._number, item] = False

    def is_there(self, item: int) -> bool:
        """Whether an item is there to be touched."""
        return bool(self._envs.present[self._number, item])

    def place_player(self, x: float, y: float, yaw: float, floor: float = 0.0) -> None:
        """Puts the player at rest on a floor of this height, looking straight ahead."""
        body = self._envs.bodies[self._number]
        body[:] = 0.0
        self._envs.held[self._number] = False
        body[X], body[Y], body[Z], body[YAW] = x, y, floor + BELOW, yaw % (2 * math.pi)

    def place_player_in_cell(self, cell: Cell, yaw: float) -> None:
        """Puts the player at rest in the middle of a cell of the text map."""
        floor = float(self._envs.floor[self._number, cell[0], cell[1]])
        self.place_player(*middle(cell), yaw, floor)

    def teleport(self, x: float, y: float, yaw: float) -> None:
        """Moves the player, who leaves with a push along the new heading."""
        self.place_player(x, y, yaw)
        body = self._envs.bodies[self._number]
        body[VX], body[VY] = PUSH * math.cos(yaw), PUSH * math.sin(yaw)
        self._envs.pushed[self._number] = PUSHED_FRAMES

    def hold_player(self, x: float, y: float, height: float) -> None:
        """Holds the player at a place, on a platform that rises to a height."""
        self._envs.held[self._number] = True
        self._envs.hold[self._number] = x, y, height

    def set_timer(self, seconds: float) -> None:
        """Lets the timer go off after some seconds of the episode's clock."""
        frames = round(seconds * FRAMES_PER_SECOND)
        self._envs.timer[self._number] = self._envs.clock[self._number] + frames

    def tint_floor(self, floor: int, tint: materials.Colour) -> None:
        """Changes the colour of a floor."""
        self._scenery.scenes.flat_tint[self._number, floor] = tint

    def set_colours(self, item: int, colours: tuple[materials.Colour, materials.Colour]) -> None:
        """Changes the colours of an item."""
        self._scenery.scenes.colours[self._number, item] = colours

    def show_square(
        self, place: tuple[float, float, float, float], colour: materials.Colour | None
    ) -> None:
        """Draws a rectangle over the view, or removes it. Its place is left, top, right and bottom,
        as shares of the image's width and height."""
        i, scenes = self._number, self._scenery.scenes
        scenes.overlay_count[i] = colour is not None
        scenes.overlays[i, 0] = place
        if colour is not None:
            scenes.overlay_colours[i, 0] = *colour, 255

    def set_mesh(self, item: int, mesh: str) -> None:
        """Changes the shape of an item."""
        self._scenery.shape[self._number, item] = atlas().index(mesh)

    def reward(self, amount: float) -> None:
        """Adds to the reward of this step."""
        self._rewards[self._number] += amount

    def say(self, text: str) -> None:
        """Gives an instruction, in words of `words.VOCABULARY`, in the place of the last one."""
        self._envs.instruction[self._number] = VOCABULARY.encode(text)
        self.instruction = text

    def finish_map(self) -> None:
        """Lets the next frame begin with a new map."""
        self._envs.finishing[self._number] = True

    def end_episode(self) -> None:
        """Ends the episode 0.2 s from now."""
        if self._envs.ending[self._number] < 0:
            self._envs.ending[self._number] = END_DELAY + 1  # this frame is counted, too

    # What oracles read.

    @property
    def player(self) -> tuple[float, float, float, float]:
        """x, y, yaw and pitch of the player."""
        body = self._envs.bodies[self._number]
        return float(body[X]), float(body[Y]), float(body[YAW]), float(body[PITCH])

    @property
    def cell(self) -> Cell:
        """The cell of the text map that the player's point is in."""
        x, y, *_ = self.player
        return int(y // CELL), int(x // CELL)

    @property
    def velocity(self) -> tuple[float, float, float]:
        """Of the player forwards, to the left and upwards, units per second."""
        body = self._envs.bodies[self._number]
        cos, sin = math.cos(body[YAW]), math.sin(body[YAW])
        forward = body[VX] * cos + body[VY] * sin
        return float(forward), float(body[VY] * cos - body[VX] * sin), float(body[VZ])

    @property
    def frames_left(self) -> int:
        """Frames until the time limit."""
        return int(self._envs.limit[self._number] - self._envs.clock[self._number])


def middle(cell: Cell) -> tuple[float, float]:
    """x and y of the middle of a cell of a text map, units."""
    return CELL * (cell[1] + 0.5), CELL * (cell[0] + 0.5)
