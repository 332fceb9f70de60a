"""What happens in an episode: moves, ends, rewards, images, and which episodes are drawn."""

import dataclasses
import hashlib
import json
from collections import deque
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import chisquare

from zipf.envs import baseline, distributions, make, make_vec
from zipf.envs.gridworld import expert, sprites
from zipf.envs.gridworld.chance import destinations, success_of_random_actions
from zipf.envs.gridworld.gridworld_env import GridworldEnv
from zipf.envs.gridworld.maps import MOVES, PAD, Maps, build_maps
from zipf.envs.gridworld.vector import GridworldVectorEnv

FACTS = json.loads((Path(__file__).parent / "data" / "gridworld_facts.json").read_text())
NORTH, EAST, SOUTH, WEST = 0, 2, 4, 6
ACTIONS = ("N", "NE", "E", "SE", "S", "SW", "W", "NW")


def wall_patterns() -> list[tuple[str, str, bool]]:
    table = FACTS["moves_when_these_cells_are_walls"]
    return [(name, walls, moves) for name in table for walls, moves in table[name].items()]


@pytest.mark.parametrize(("name", "walls", "moves"), wall_patterns())
def test_moves_by_wall_pattern(name: str, walls: str, moves: bool) -> None:
    """One step from the middle of a 5 x 5 board, with walls where the pattern says."""
    down, right = MOVES[ACTIONS.index(name)]
    cell_of = {"dest": (down, right), "vertical_neighbour": (down, 0)}
    cell_of["horizontal_neighbour"] = (0, right)
    codes = np.zeros((1, 5 + 2 * PAD, 5 + 2 * PAD), dtype=np.uint8)
    board = codes[0, PAD:-PAD, PAD:-PAD]
    board[0, 0] = sprites.code("red", "plus")
    for wall in walls.split("+"):
        if wall != "none":
            board[2 + cell_of[wall][0], 2 + cell_of[wall][1]] = sprites.WALL
    maps = Maps(1, (1, 1), (3, 3), 1, codes, np.array([[[0, 0], [2, 2]]]))
    expected = [2 + down, 2 + right] if moves else [2, 2]

    options = {"num_maps": 1, "num_objects": 1, "observation": "tiles"}
    batch, single = GridworldVectorEnv(2, "uniform", **options), GridworldEnv("uniform", **options)
    for env in (batch, single):
        env.level = dataclasses.replace(env.level, maps=maps)
        env.reset()
    tiles = single.step(ACTIONS.index(name))[0]["tiles"]
    both = batch.step(np.full(2, ACTIONS.index(name)))[0]["tiles"]
    padded = codes[0].copy()
    padded[expected[0] + PAD, expected[1] + PAD] = sprites.AGENT
    view = padded[expected[0] : expected[0] + 7, expected[1] : expected[1] + 7]
    view[0, 0] = sprites.FLOOR
    np.testing.assert_array_equal(tiles, view)
    np.testing.assert_array_equal(both, [view, view])


@pytest.mark.parametrize("facts", FACTS["trajectories"], ids=lambda f: f["level"])
def test_trajectories_are_those_of_the_release(facts: dict[str, Any]) -> None:
    """Every image, reward and end of the original engine under the same random actions."""
    env = make(f"gridworld/{facts['level']}", **facts["options"])
    rng = np.random.default_rng(facts["action_seed"])
    digest, ends, done = hashlib.sha256(), [], False
    digest.update(env.reset(seed=facts["seed"])[0]["image"])
    for t in range(facts["steps"]):
        if done:
            digest.update(env.reset()[0]["image"])
        observation, reward, terminated, truncated, _ = env.step(rng.integers(8))
        digest.update(observation["image"])
        done = terminated or truncated
        if done:
            ends.append([t + 1, reward, 0.0 if terminated else 1.0])
    assert ends == facts["ends"]
    assert digest.hexdigest() == facts["images_sha256"]


@pytest.mark.parametrize("facts", FACTS["episode_sequences"], ids=lambda f: f"seed{f['seed']}")
def test_episode_sequences(facts: dict[str, Any]) -> None:
    env = make_vec("gridworld/zipf_2", 1)
    _, info = env.reset(seed=facts["seed"])
    drawn = [[info["map"][0], info["target"][0]]]
    rng = np.random.default_rng(0)
    while len(drawn) < len(facts["map_target"]):
        *_, info = env.step(rng.integers(8, size=1))
        if "_final_info" in info:
            drawn.append([info["map"][0], info["target"][0]])
    assert drawn == facts["map_target"]


def way(maps: Maps, map: int, target: int) -> list[int]:
    """Actions from the start to an object that touch no other."""
    width = maps.boards.shape[2]
    leads_to = destinations(maps)[map]
    start, goal = maps.cells[map, -1] @ [width, 1], maps.cells[map, target] @ [width, 1]
    objects = set((maps.cells[map, :-1] @ [width, 1]).tolist())
    actions: dict[int, list[int]] = {int(start): []}
    queue = deque(actions)
    while queue:
        cell = queue.popleft()
        for action, following in enumerate(leads_to[cell].tolist()):
            if following not in actions and (following == goal or following not in objects):
                actions[following] = [*actions[cell], action]
                queue.append(following)
    return actions[int(goal)]


def act(
    env: GridworldVectorEnv, actions: list[int], target: int
) -> list[tuple[float, bool, bool, dict[str, Any]]]:
    """Rewards, ends and infos of both envs of `env` on map 0; the two must agree."""
    env.reset(seed=0, options={"map": 0, "target": target})
    results = []
    for action in actions:
        _, reward, terminated, truncated, info = env.step(np.full(2, action))
        assert reward[0] == reward[1]
        results.append((float(reward[0]), bool(terminated[0]), bool(truncated[0]), info))
    return results


@pytest.mark.parametrize("target", range(20))
def test_reaching_the_target_is_rewarded(target: int) -> None:
    env = make_vec("gridworld/uniform", 2)
    path = way(env.level.maps, 0, target)
    *before, last = act(env, path, target)
    assert all(step[:3] == (0.0, False, False) for step in before)
    assert last[:3] == (1.0, True, False)
    final = {key: value[0] for key, value in last[3]["final_info"].items()}
    expected = {"map": 0, "target": target, "success": True, "return": 1.0, "length": len(path)}
    assert final == expected


def test_touching_another_object_ends_the_episode_without_reward() -> None:
    env = make_vec("gridworld/uniform", 2)
    *_, last = act(env, way(env.level.maps, 0, target=3), target=4)
    assert last[:3] == (0.0, True, False)
    assert not last[3]["final_info"]["success"][0]


def test_a_touched_object_hides_the_agent() -> None:
    env = make_vec("gridworld/uniform", 2, observation="tiles")
    maps = env.level.maps
    assert env.reset(options={"map": 0, "target": 3})[0]["tiles"][0, 3, 3] == sprites.AGENT
    *_, last = act(env, way(maps, 0, target=3), target=3)
    code = maps.boards[0][tuple(maps.cells[0, 3])]
    assert last[3]["final_obs"]["tiles"][0, 3, 3] == last[3]["final_obs"]["cue"][0, 0] == code


def dawdle(length: int) -> list[int]:
    """Steps that touch nothing and end where they began, on map 0."""
    return ([EAST, WEST] * length)[:length]


def test_dawdling_comes_back() -> None:
    boards, cells = build_maps().boards, build_maps().cells
    row, column = cells[0, -1]
    assert boards[0, row, column + 1] == sprites.FLOOR


@pytest.mark.parametrize("max_steps", [100, 40])
def test_time_runs_out_on_the_last_step(max_steps: int) -> None:
    env = make_vec("gridworld/uniform", 2, max_steps=max_steps)
    *before, last = act(env, dawdle(max_steps), target=0)
    assert all(step[:3] == (0.0, False, False) for step in before)
    assert last[:3] == (0.0, False, True)
    assert last[3]["final_info"]["length"].tolist() == [max_steps, max_steps]


def test_the_target_on_the_last_step_counts() -> None:
    env = make_vec("gridworld/uniform", 2)
    path = way(env.level.maps, 0, target=0)
    assert len(path) % 2 == 1  # so that 100 - len is odd and the dawdling needs a blocked step
    row, column = env.level.maps.cells[0, -1]
    assert env.level.maps.boards[0, row, column - 1] == sprites.WALL
    in_time = [WEST, *dawdle(99 - len(path)), *path]
    assert len(in_time) == 100
    *before, last = act(env, in_time, target=0)
    assert all(step[:3] == (0.0, False, False) for step in before)
    assert last[:3] == (1.0, True, False)
    too_late = [WEST, WEST, *in_time[1:]]
    assert act(env, too_late[:100], target=0)[-1][:3] == (0.0, False, True)


def test_tiles_show_what_the_image_shows() -> None:
    options = {"num_envs": 32, "level": "uniform", "max_steps": 30}
    images = GridworldVectorEnv(**options, observation="image")
    tiles = GridworldVectorEnv(**options, observation="tiles")
    rng = np.random.default_rng(3)
    image, _ = images.reset(seed=1)
    symbols, _ = tiles.reset(seed=1)
    for _ in range(100):
        drawn = sprites.SPRITES[0][symbols["tiles"]]  # [N, 7, 7, 9, 9, 3]
        drawn[:, 0, 0] = sprites.SPRITES[1][symbols["cue"][:, 0]]
        drawn = drawn.swapaxes(2, 3).reshape(32, 63, 63, 3)
        np.testing.assert_array_equal(drawn, image["image"])
        actions = rng.integers(8, size=32)
        image, symbols = images.step(actions)[0], tiles.step(actions)[0]


def test_images_are_written_within_their_rows_of_memory() -> None:
    """The overlapping blocks that images are drawn with must not reach beyond them."""
    memory = np.full(3 * 63 * 63 * 3 + 128, 77, dtype=np.uint8)
    image = memory[64:-64].reshape(3, 63, 63, 3)
    env = make_vec("gridworld/uniform", 3)
    env.reset(seed=0, out={"image": image})
    assert (memory[:64] == 77).all()
    assert (memory[-64:] == 77).all()
    kept = image.copy()
    final = np.full_like(image, 77)
    rng = np.random.default_rng(0)
    for _ in range(200):
        *_, info = env.step(
            rng.integers(8, size=3), out={"image": image}, final_out={"image": final}
        )
        if "_final_obs" in info:
            assert (final[~info["_final_obs"]] == 77).all()
        final[:] = 77
    assert (kept != image).any()


# Which episodes are drawn.


def follows(counts: NDArray[np.int64], p: NDArray[np.float64]) -> bool:
    """Whether counts fit probabilities, neither worse nor better than one time in a million."""
    assert counts[p == 0].sum() == 0
    counts, expected = counts[p > 0], p[p > 0] * counts.sum()
    assert expected.min() >= 5
    return bool(1e-6 < chisquare(counts, expected).pvalue < 1 - 1e-6)


@pytest.mark.parametrize("level", ["zipf_2", "zipf_1", "uniform", "rare"])
def test_maps_and_targets_follow_the_law(level: str) -> None:
    num_envs, resets = 1000, 20
    env = make_vec(f"gridworld/{level}", num_envs, observation="tiles")
    info = env.reset(seed=11)[1]
    drawn = [np.stack([info["map"], info["target"]])]
    for _ in range(resets - 1):
        info = env.reset()[1]
        drawn.append(np.stack([info["map"], info["target"]]))
    map, target = np.concatenate(drawn, axis=1)
    p = distributions.by_name(level)(20)
    assert follows(np.bincount(map, minlength=20), p)
    assert follows(np.bincount(target, minlength=20), p)
    # The two are independent: their joint counts, the rarer ranks taken together, fit the product.
    first = int(np.argmax(p > 0))
    folded = np.array([*p[first : first + 3], p[first + 3 :].sum()])
    joint = np.minimum(map - first, 3) * 4 + np.minimum(target - first, 3)
    assert follows(np.bincount(joint, minlength=16), np.outer(folded, folded).ravel())


def test_the_law_test_can_fail() -> None:
    p = distributions.zipfian(20, 2)
    other = distributions.zipfian(20, 1.9)
    counts = np.random.default_rng(0).multinomial(20_000, other)
    assert not follows(counts, p)


# Uniformly random actions.


@pytest.mark.parametrize(
    ("level", "success"), [("zipf_2", 0.0324), ("uniform", 0.0477), ("rare", 0.0859)]
)
def test_chance_is_known(level: str, success: float) -> None:
    known = baseline("chance", f"gridworld/{level}")
    assert known is not None
    assert round(known.score, 4) == success
    assert known.episodes is None


@pytest.mark.parametrize("level", ["zipf_2", "uniform", "rare"])
def test_random_actions_do_as_computed(level: str) -> None:
    env = make_vec(f"gridworld/{level}", 500, observation="tiles", autoreset_mode="Disabled")
    rng = np.random.default_rng(5)
    outcomes = []
    # Envs wait for the last one, so that short episodes are not counted more often.
    for seed in range(0, 20_000, 500):
        env.reset(seed=seed)
        waiting = np.ones(500, dtype=np.bool_)
        success = np.zeros(500)
        while waiting.any():
            *_, info = env.step(rng.integers(8, size=500))
            if "_success" in info:
                ended = info["_success"]
                new = ended & waiting
                success[new] = info["success"][new]
                waiting &= ~ended
                env.reset(options={"reset_mask": ended})
        outcomes.append(success)
    sample = np.concatenate(outcomes)
    p = distributions.by_name(level)(20)
    expected = p @ success_of_random_actions(build_maps(), 100) @ p
    assert abs(sample.mean() - expected) < 4 * sample.std() / np.sqrt(len(sample))


def test_the_expert_scores_as_computed() -> None:
    """Every situation is played once: the expert's actions are not random."""
    for max_steps in (9, 100):
        exact = expert.reached(build_maps(), max_steps)
        env = make_vec("gridworld/uniform", 400, max_steps=max_steps, autoreset_mode="Disabled")
        maps, targets = np.divmod(np.arange(400), 20)
        env.reset(seed=0, options={"map": maps, "target": targets})
        player = expert.Expert(env)
        success = np.zeros(400, np.bool_)
        for _ in range(max_steps):
            *_, info = env.step(player())
            if "_success" in info:
                success[info["_success"]] = info["success"][info["_success"]]
                env.reset(options={"reset_mask": info["_success"], "map": maps, "target": targets})
        np.testing.assert_array_equal(success.reshape(20, 20), exact)
        known = baseline("expert", "gridworld/uniform", max_steps=max_steps)
        assert known is not None
        assert known.score == pytest.approx(exact.mean())
        assert exact.all() == (max_steps == 100)


def test_chance_of_other_sizes() -> None:
    options = {"num_maps": 5, "num_rooms": [2, 2], "num_objects": 5}
    expected = baseline("chance", "gridworld/uniform", **options)
    other_looks = {"observation": "tiles", "copy": False}
    assert expected == baseline("chance", "gridworld/uniform", **options, **other_looks)
    exact = success_of_random_actions(build_maps(5, (2, 2), (3, 3), 5), 100)
    assert expected is not None
    assert expected.score == pytest.approx(exact.mean())
    one_step = success_of_random_actions(build_maps(), 1)
    assert set((one_step * 8).ravel().tolist()) == {0.0, 1.0}
