import hashlib
import json
import string
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zipf.envs.gridworld import sprites
from zipf.envs.gridworld.chance import destinations
from zipf.envs.gridworld.maps import Maps, build_maps
from zipf.envs.gridworld.vector import GridworldVectorEnv

FACTS = json.loads((Path(__file__).parent / "data" / "gridworld_facts.json").read_text())
LETTERS = string.ascii_uppercase[1:]
LOOKS = [(colour, shape) for colour in sprites.COLOURS for shape in sprites.SHAPES]


def sha256(data: str | bytes) -> str:
    return hashlib.sha256(data.encode() if isinstance(data, str) else data).hexdigest()


def rows_of(maps: Maps, i: int) -> list[str]:
    """A map as the release draws it."""
    rows = [["#" if cell == sprites.WALL else " " for cell in row] for row in maps.boards[i]]
    for letter, (row, column) in zip(LETTERS[: maps.num_objects] + "A", maps.cells[i], strict=True):
        rows[row][column] = letter
    return ["".join(row) for row in rows]


def look(code: int) -> tuple[str, str]:
    """The colour and shape of an object's cell code."""
    return LOOKS[code - sprites.FIRST_LOOK]


def codes_of(maps: Maps, i: int) -> list[int]:
    """The cell codes of a map's objects by rank."""
    return [int(maps.boards[i, row, column]) for row, column in maps.cells[i, :-1]]


def objects_of(maps: Maps, i: int) -> list[list[str]]:
    return [[letter, *look(code)] for letter, code in zip(LETTERS, codes_of(maps, i), strict=False)]


def test_colours_and_shapes() -> None:
    assert {name: list(rgb) for name, rgb in sprites.COLOURS.items()} == FACTS["colours"]
    drawn = {
        name: ["".join("#" if on else "." for on in row) for row in mask]
        for name, mask in sprites.SHAPES.items()
    }
    assert drawn == FACTS["shape_masks"]


def test_codes_and_looks_are_one_to_one() -> None:
    codes = [sprites.code(*pair) for pair in LOOKS]
    assert codes == list(range(sprites.FIRST_LOOK, sprites.NUM_CODES))


@pytest.mark.parametrize("i", range(20))
def test_released_map(i: int) -> None:
    facts, maps = FACTS["maps"][i], build_maps()
    rows, objects = rows_of(maps, i), objects_of(maps, i)
    assert rows == facts["rows"]
    assert sha256("\n".join(rows)) == facts["layout_sha256"]
    assert objects == [entry[:3] for entry in facts["objects"]]
    assert sha256(json.dumps(objects)) == facts["objects_sha256"]


def test_first_image_of_every_map_and_target() -> None:
    map, target = np.divmod(np.arange(400), 20)
    env = GridworldVectorEnv(400, level="uniform")
    observation, _ = env.reset(options={"map": map, "target": target})
    hashes = [sha256(image.tobytes()) for image in observation["image"]]
    assert hashes == [one for facts in FACTS["maps"] for one in facts["first_images_sha256"]]


@pytest.mark.parametrize(
    "facts", FACTS["other_sizes"], ids=lambda f: f"{f['num_rooms']}-{f['room_size']}"
)
def test_maps_of_other_sizes_are_those_of_the_release(facts: dict[str, Any]) -> None:
    maps = build_maps(
        facts["num_maps"],
        tuple(facts["num_rooms"]),
        tuple(facts["room_size"]),
        facts["num_objects"],
    )
    hashes = [
        sha256("\n".join(rows_of(maps, i)) + json.dumps(objects_of(maps, i)))
        for i in range(maps.num_maps)
    ]
    assert hashes == facts["maps_sha256"]


@pytest.mark.parametrize("i", range(20))
def test_shortest_ways_past_other_objects(i: int) -> None:
    maps = build_maps()
    width = maps.boards.shape[2]
    leads_to = destinations(maps)[i]
    objects = {int(row * width + column): k for k, (row, column) in enumerate(maps.cells[i, :-1])}
    start = int(maps.cells[i, -1] @ [width, 1])
    steps, queue = {start: 0}, deque([start])
    while queue:
        cell = queue.popleft()
        if cell in objects:
            continue
        for following in leads_to[cell].tolist():
            if following not in steps:
                steps[following] = steps[cell] + 1
                queue.append(following)
    lengths = {rank: steps[cell] for cell, rank in objects.items()}
    assert [lengths[k] for k in range(20)] == [entry[3] for entry in FACTS["maps"][i]["objects"]]


@settings(max_examples=60, deadline=None)
@given(
    num_rooms=st.tuples(st.integers(1, 5), st.integers(1, 5)),
    room_size=st.tuples(st.integers(3, 6), st.integers(3, 6)),
    num_objects=st.integers(1, 60),
    num_maps=st.integers(1, 3),
)
def test_maps_of_any_size_can_be_walked(
    num_rooms: tuple[int, int], room_size: tuple[int, int], num_objects: int, num_maps: int
) -> None:
    try:
        maps = build_maps(num_maps, num_rooms, room_size, num_objects)
    except ValueError as error:
        # Doors leave a room of 3 x 3 at least 8 - 4 places, one of them for the agent.
        assert "places" in str(error)  # noqa: PT017
        assert num_objects >= 4 * num_rooms[0] * num_rooms[1]
        return
    height = num_rooms[0] * (room_size[0] + 1) + 1
    width = num_rooms[1] * (room_size[1] + 1) + 1
    assert maps.boards.shape == (num_maps, height, width)
    for i, board in enumerate(maps.boards):
        rim = np.concatenate([board[0], board[-1], board[:, 0], board[:, -1]])
        assert (rim == sprites.WALL).all()
        assert len(set(codes_of(maps, i))) == num_objects
        assert (board >= sprites.FIRST_LOOK).sum() == num_objects
        assert board[tuple(maps.cells[i, -1])] == sprites.FLOOR
        reached = np.zeros(board.size, dtype=np.bool_)
        queue = deque([int(maps.cells[i, -1] @ [width, 1])])
        leads_to = destinations(maps)[i]
        while queue:
            cell = queue.popleft()
            if not reached[cell]:
                reached[cell] = True
                queue.extend(leads_to[cell].tolist())
        assert (reached == (board.ravel() != sprites.WALL)).all()


def test_maps_are_shared_and_cannot_be_changed() -> None:
    maps = build_maps()
    assert build_maps() is maps
    with pytest.raises(ValueError, match="read-only"):
        maps.codes[0, 0, 0] = 1
