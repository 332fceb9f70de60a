"""How episodes are drawn: objects, targets, tasks, instructions, colours and poses."""

import itertools
from typing import Any

import numpy as np
import pytest
from conftest import slow_but
from numpy.typing import NDArray
from playroom_envs import KINDS
from scipy.stats import chisquare

from zipf.envs import make_vec, split
from zipf.envs.playroom.constants import AGENT_RADIUS, FURNITURE_SIZE, NEAR_DISTANCE, ROOM
from zipf.envs.playroom.geometry import footprint, rectangle_gap
from zipf.envs.playroom.judgement import APPROACH_DISTANCE
from zipf.envs.playroom.layout import FIRST_PITCH
from zipf.envs.playroom.levels import ALTERNATE, LEVELS, OBJECTS, TASKS, VOCABULARY
from zipf.envs.playroom.state import ANGLE, PITCH, YAW, Z
from zipf.envs.playroom.vector import PlayroomVectorEnv

N = 500


@pytest.fixture(autouse=True)
def _no_physics(monkeypatch: pytest.MonkeyPatch) -> None:
    """No episode is stepped here, and building the physics of thousands of rooms takes long."""
    monkeypatch.setattr(PlayroomVectorEnv, "_furnish", lambda *args: None)


def drawn(level: str, episodes: int, **options: Any) -> dict[str, NDArray[Any]]:
    """The situations of many episodes."""
    env = PlayroomVectorEnv(N, level, image_size=(1, 1), max_steps=1, **options)
    infos = [env.reset(seed=7)[1]]
    while len(infos) * N < episodes:
        infos.append(env.reset()[1])
    return {key: np.concatenate([info[key] for info in infos]) for key in infos[0]}


def law(level: str) -> NDArray[np.float64]:
    """A level's distribution over ranks, by its name."""
    name = level.rsplit("_", 1)[1]
    if name.startswith("zipf"):
        weights = 1 / np.arange(1, 51) ** float(name[4:])
    else:
        weights = np.zeros(50)
        kept = {
            "uniform": range(50),
            "all": range(50),
            "rare": range(40, 50),
            "validation": range(20, 30),
            "frequent": range(10),
        }
        weights[kept[name]] = 1
    return weights / weights.sum()


def first_and_target(p: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """The law of a target that is chosen uniformly among `count` draws without replacement.

    By enumeration of the first draws: exact, for up to three.
    """
    chance = p.copy()
    if count >= 2:
        second = np.zeros_like(p)
        for a in np.flatnonzero(p):
            left = np.where(np.arange(p.size) == a, 0, p) / (1 - p[a])
            second += p[a] * left
        chance += second
    if count >= 3:
        third = np.zeros_like(p)
        for a, b in itertools.permutations(np.flatnonzero(p), 2):
            taken = np.isin(np.arange(p.size), (a, b))
            left = np.where(taken, 0, p) / (1 - p[a] - p[b])
            third += p[a] * p[b] / (1 - p[a]) * left
        chance += third
    return chance / count


def fits(counts: NDArray[np.int64], p: NDArray[np.float64]) -> bool:
    """Whether counts fit probabilities no worse than once in a million; rare ones are joined."""
    assert counts[p == 0].sum() == 0
    order = np.argsort(-p)
    expected, counts = p[order] * counts.sum(), counts[order]
    kept = max(int((expected >= 8).sum()), 1)
    tail = expected[kept:].sum()
    expected = np.append(expected[:kept], [tail] if tail > 0 else [])
    counts = np.append(counts[:kept], [counts[kept:].sum()] if tail > 0 else [])
    return bool(len(counts) == 1 or chisquare(counts, expected).pvalue > 1e-6)


@pytest.mark.parametrize("level", [level for level in LEVELS if "find" not in level])
def test_objects_are_drawn_without_replacement(level: str) -> None:
    p = law(level)
    np.testing.assert_allclose(LEVELS[level].probabilities, p)
    given = drawn(level, 4000)
    names = [name for name in given if name == "target" or name.startswith("other")]
    assert len(names) == (6 if "many" in level else 3)
    ranks = np.sort(np.stack([given[name] for name in names]), axis=0)
    assert (np.diff(ranks, axis=0) > 0).all()
    if len(names) == 3:
        expected = first_and_target(p, 3)
    else:
        # Clocks that ring at rates p ring in the order of draws without replacement.
        rng = np.random.default_rng(0)
        clocks = rng.exponential(size=(100_000, 50)) / p
        first = np.argpartition(clocks, 6, axis=1)[:, :6]
        expected = np.bincount(first.ravel(), minlength=50) / first.size
    # The target is as likely to be any of those drawn.
    assert fits(np.bincount(given["target"], minlength=50), expected)
    assert fits(np.bincount(ranks.ravel(), minlength=50), expected)


@pytest.mark.parametrize("level", [level for level in LEVELS if "find" in level])
def test_the_two_to_find_are_drawn_with_replacement(level: str) -> None:
    p = law(level)
    given = drawn(level, 4000)
    for name in ("target", "other"):
        assert fits(np.bincount(given[name], minlength=50), p)
    joint = np.bincount(given["target"] * 50 + given["other"], minlength=2500)
    assert fits(joint, np.outer(p, p).ravel())
    assert (given["target"] == given["other"]).any()
    assert fits(np.bincount(given["side"], minlength=2), np.array([0.5, 0.5]))


def test_the_test_of_laws_can_fail() -> None:
    rng = np.random.default_rng(0)
    p, other = law("zipf_zipf2"), np.arange(1, 51) ** -1.8
    assert fits(rng.multinomial(6000, p), p)
    assert not fits(rng.multinomial(6000, other / other.sum()), p)
    assert not fits(
        rng.multinomial(6000, first_and_target(law("zipf_zipf3"), 3)), law("zipf_zipf3")
    )


@pytest.mark.parametrize("level", [level for level in LEVELS if level.startswith("put")])
def test_tasks_are_those_of_the_level(level: str) -> None:
    given = drawn(level, 1500)["task"]
    expected = np.zeros(5)
    relation = level.split("/")[1].split("_")[1]
    of = {"shape": ["lift"], "near": ["near bed", "near tray"], "on": ["on bed", "on tray"]}
    for task in of[relation]:
        expected[TASKS.index(task)] = 1 / len(of[relation])
    assert fits(np.bincount(given, minlength=5), expected)


@pytest.mark.parametrize("level", slow_but(LEVELS, *KINDS))
def test_instructions_name_the_task_and_the_target(level: str) -> None:
    env = PlayroomVectorEnv(200, level, image_size=(1, 1))
    observation, info = env.reset(seed=3)
    for i in range(200):
        target = OBJECTS[info["target"][i]]
        text = str(info["instruction"][i])
        if "find" in level:
            assert text == f"find a {target}"
        elif TASKS[info["task"][i] if "task" in info else 0] == "lift":
            assert text == f"lift a {target}"
        else:
            relation, support = TASKS[info["task"][i]].split()
            assert text == f"put a {target} {relation} a {support}"
        assert VOCABULARY.decode(observation["instruction"][i]) == text
        np.testing.assert_array_equal(VOCABULARY.encode(text), observation["instruction"][i])


def test_the_alternate_order_is_an_unrelated_permutation() -> None:
    assert sorted(ALTERNATE) == sorted(OBJECTS)
    assert len(set(OBJECTS)) == 50
    assert sum(a == b for a, b in zip(OBJECTS, ALTERNATE, strict=True)) <= 3
    frequent, rare = set(OBJECTS[:10]), set(OBJECTS[-10:])
    assert len(frequent & set(ALTERNATE[:10])) <= 4
    assert len(rare & set(ALTERNATE[-10:])) <= 4
    env = PlayroomVectorEnv(
        50, "lift/lift_shape_uniform", image_size=(1, 1), object_order="alternate"
    )
    info = env.reset(seed=0)[1]
    expected = [f"lift a {ALTERNATE[rank]}" for rank in info["target"]]
    assert info["instruction"].tolist() == expected
    # The order changes names and meshes, but not the ranks.
    other = PlayroomVectorEnv(50, "lift/lift_shape_uniform", image_size=(1, 1)).reset(seed=0)[1]
    np.testing.assert_array_equal(info["target"], other["target"])


# Forcing.


@pytest.mark.parametrize("level", ["lift/lift_shape_zipf4", "put/put_on_bed_tray_frequent"])
def test_ranks_are_forced_in_any_combination(level: str) -> None:
    env = PlayroomVectorEnv(40, level, image_size=(1, 1))
    names = [name for name in env.situation if name != "task"]
    values = {"target": 3, "other_1": 0, "other_2": 1}
    for count in range(4):
        for forced in itertools.combinations(names, count):
            options: dict[str, Any] = {name: values[name] for name in forced}
            info = env.reset(seed=5, options=options)[1]
            for name in forced:
                assert (info[name] == values[name]).all()
            ranks = np.sort(np.stack([info[name] for name in names]), axis=0)
            assert (np.diff(ranks, axis=0) > 0).all()  # drawn ranks differ from forced ones


def test_equal_ranks_may_be_forced() -> None:
    env = PlayroomVectorEnv(30, "lift/lift_shape_zipf4", image_size=(1, 1))
    for equal in (["target", "other_1"], ["other_1", "other_2"], ["target", "other_1", "other_2"]):
        info = env.reset(seed=1, options=dict.fromkeys(equal, 2))[1]
        assert all((info[name] == 2).all() for name in equal)
        for name in set(env.situation) - set(equal):
            assert (info[name] != 2).all()


def test_any_task_may_be_forced() -> None:
    env = PlayroomVectorEnv(5, "put/lift_shape_uniform", image_size=(1, 1))
    info = env.reset(seed=0, options={"task": np.arange(5)})[1]
    relations = [str(text).split(" ", 3)[3:] for text in info["instruction"]]
    assert relations == [[], ["near a bed"], ["near a tray"], ["on a bed"], ["on a tray"]]


# Scenery.


def begun(level: str, num_envs: int, **forced: int) -> PlayroomVectorEnv:
    """Many envs at the beginning of an episode."""
    env = PlayroomVectorEnv(num_envs, level, image_size=(1, 1))
    env.reset(seed=0, options=forced)
    return env


@pytest.mark.parametrize(
    "level",
    [
        "lift/lift_shape_uniform",
        "put/put_on_bed_tray_all",
        "put/lift_shape_many_zipf1",
        "supervised/find_shape_uniform",
    ],
)
def test_nothing_overlaps_at_the_start(level: str) -> None:
    env = begun(level, 800)
    radius = np.array([footprint(extent) for extent in env.envs.extents])[env.envs.ranks]
    places, agents = env.envs.objects[:, :, :2], env.envs.agents[:, :2]
    half = ROOM / 2
    assert (np.abs(places).max(-1) + radius < half).all()
    assert (np.abs(agents) + AGENT_RADIUS < half).all()
    assert (env.envs.objects[:, :, Z] == 0).all()
    gaps = np.linalg.norm(places - agents[:, None], axis=-1) - radius - AGENT_RADIUS
    assert gaps.min() > 0.05
    for j, k in itertools.combinations(range(places.shape[1]), 2):
        gap = np.linalg.norm(places[:, j] - places[:, k], axis=-1) - radius[:, j] - radius[:, k]
        assert gap.min() > 0.05
    if not env.level.furnished:
        return
    for i in range(800):
        pieces = list(zip(env.envs.furniture[i], FURNITURE_SIZE, strict=True))
        for pose, size in pieces:
            assert rectangle_gap(pose, size, *agents[i]) > AGENT_RADIUS
            for place, r in zip(places[i], radius[i], strict=True):
                assert rectangle_gap(pose, size, *place) > r
            cos, sin = np.abs(np.cos(pose[2])), np.abs(np.sin(pose[2]))
            assert np.abs(pose[0]) + cos * size[0] + sin * size[1] < half
            assert np.abs(pose[1]) + sin * size[0] + cos * size[1] < half


def test_poses_and_colours_cover_their_ranges() -> None:
    env = begun("put/put_on_bed_tray_all", 1500)
    eight = np.full(8, 1 / 8)

    def octants(angles: NDArray[np.float64]) -> NDArray[np.int64]:
        return np.bincount(((angles + np.pi) / (2 * np.pi) * 8).astype(int) % 8, minlength=8)

    assert fits(octants(env.envs.agents[:, YAW]), eight)
    assert fits(octants(env.envs.furniture[:, 1, 2]), eight)
    for j in range(3):
        assert fits(octants(env.envs.objects[:, j, ANGLE]), eight)
        # All corners of the room are equally likely.
        x, y = env.envs.objects[:, j, :2].T
        assert fits(np.bincount(2 * (x > 0) + (y > 0), minlength=4), np.full(4, 0.25))
    quarter = np.bincount((np.round(env.envs.furniture[:, 0, 2] / (np.pi / 2)) % 4).astype(int))
    assert fits(quarter, np.full(4, 0.25))
    assert len(np.unique(env.envs.colours.reshape(1500, -1), axis=0)) == 1500
    assert (env.envs.colours[:, :, 0] != env.envs.colours[:, :, 1]).any(-1).all()
    assert (env.envs.agents[:, PITCH] == FIRST_PITCH).all()


def test_the_place_does_not_tell_the_target() -> None:
    """Nor does how central it is in the room or in the view, or how near.

    Where the target is placed first, it is the most central of six in 17.3 % of episodes.
    """
    env = PlayroomVectorEnv(10_000, "put/lift_shape_many_zipf1", image_size=(1, 1), max_steps=1)
    first: dict[str, list[NDArray[np.int64]]] = {"central": [], "aside": [], "near": []}
    for seed in range(0, 50_000, 10_000):
        env.reset(seed=seed)
        places, agents = env.envs.objects[:, :, :2], env.envs.agents[:, None]
        x, y = (places - agents[..., :2]).transpose(2, 0, 1)
        aside = np.angle(np.exp(1j * (np.arctan2(y, x) - agents[..., YAW])))
        first["central"].append(np.linalg.norm(places, axis=-1).argmin(1))
        first["aside"].append(np.abs(aside).argmin(1))
        first["near"].append(np.hypot(x, y).argmin(1))
    for numbers in first.values():
        counts = np.bincount(np.concatenate(numbers), minlength=6)
        assert fits(counts, np.full(6, 1 / 6))


def test_the_first_frame_shows_an_object() -> None:
    for level in ("lift/lift_shape_uniform", "put/put_on_bed_tray_all"):
        env = PlayroomVectorEnv(300, level, image_size=(24, 32))
        first = env.reset(seed=0)[0]["image"].copy()
        count = env.envs.ranks.shape[1]
        env._view.scenes.mesh[:, :count] = -1
        shown = (first != env.observations()["image"]).any((1, 2, 3))
        assert shown.mean() > 0.97


def test_no_place_is_near_both_supports() -> None:
    env = begun("put/put_near_bed_tray_frequent", 300)
    grid = np.stack(np.meshgrid(*[np.linspace(-ROOM / 2, ROOM / 2, 30)] * 2), -1).reshape(-1, 2)
    for furniture in env.envs.furniture:
        gaps = [
            [rectangle_gap(pose, size, *place) for place in grid]
            for pose, size in zip(furniture, FURNITURE_SIZE, strict=True)
        ]
        assert (np.max(gaps, axis=0) > NEAR_DISTANCE).all()


@pytest.mark.parametrize("exponent", [0.0, 2.0])
def test_frequent_objects_are_drawn_by_an_exponent(exponent: float) -> None:
    p = np.append(1 / np.arange(1, 11) ** exponent, np.zeros(40))
    given = drawn("put/put_on_bed_tray_frequent", 4000, frequent_exponent=exponent)
    assert fits(np.bincount(given["target"], minlength=50), first_and_target(p / p.sum(), 3))
    # Other levels do not use it.
    rare = drawn("put/put_on_bed_tray_rare", 500, frequent_exponent=exponent)["target"]
    np.testing.assert_array_equal(rare, drawn("put/put_on_bed_tray_rare", 500)["target"])


def test_colours_do_not_depend_on_the_object() -> None:
    """The colours of the target are the same for every rank."""
    means = []
    for rank in (0, 25, 49):
        env = begun("lift/lift_shape_uniform", 1500, target=rank)
        means.append(env.envs.colours[:, 0].mean(0))
    assert np.ptp(means, axis=0).max() == 0


def test_the_side_is_where_the_target_appears() -> None:
    env = PlayroomVectorEnv(200, "supervised/find_shape_uniform")
    image, info = env.reset(seed=0)
    scenes = env._view.scenes
    mesh = scenes.mesh[:, 0].copy()
    scenes.mesh[:, 0] = -1
    hidden = env.observations()["image"]
    scenes.mesh[:, 0] = mesh
    for i, seen in enumerate((image["image"] != hidden).any(-1)):
        column = np.flatnonzero(seen.any(0))
        assert len(column) >= 3
        assert (column.mean() > 47.5) == info["side"][i]
    # The agent is as often nearer to one object as to the other.
    gaps = np.linalg.norm(env.envs.objects[:, :, :2] - env.envs.agents[:, None, :2], axis=-1)
    assert (gaps > APPROACH_DISTANCE + 0.1).all()
    assert abs((gaps[:, 0] < gaps[:, 1]).mean() - 0.5) < 0.15


def test_the_split_of_putting_trains_on_three_levels() -> None:
    env = make_vec(split("playroom_put").train, 6, image_size=(1, 1))
    info = env.reset(seed=0)[1]
    assert [text.split()[0] for text in info["instruction"]] == ["lift"] * 2 + ["put"] * 4
    assert [" near " in text for text in info["instruction"]] == [False] * 2 + [True] * 2 + [
        False
    ] * 2
    assert (info["target"][2:] < 10).all()
