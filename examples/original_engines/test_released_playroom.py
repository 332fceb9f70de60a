"""The released Playroom over dm_env_rpc, with a real server that has its names and no room."""

import os
import pickle
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import fake_playroom_server
import numpy as np
import playroom_rpc as rpc
import pytest
from released_playroom import COMMANDS, DockerVectorEnv, encode

from zipf import envs
from zipf.envs import EngineError, Split, make, make_vec
from zipf.envs.gymnasium import replayed
from zipf.envs.playroom.actions import ACTIONS
from zipf.envs.playroom.levels import VOCABULARY
from zipf.envs.testing import check_vector_env
from zipf.evaluate import score

LIFT = "released_playroom/lift/lift_shape_uniform"
SMALL: dict[str, Any] = {"image_size": (3, 4), "max_steps": 8}
FORWARD, GRAB = ACTIONS.index("MOVE_FORWARD_FULL"), ACTIONS.index("GRAB")


@pytest.fixture(autouse=True)
def served(monkeypatch: pytest.MonkeyPatch) -> Iterator[fake_playroom_server.Service]:
    with fake_playroom_server.serving() as (service, address):
        monkeypatch.setenv(rpc.ADDRESS, address)
        yield service
    replayed._NOT_DETERMINISTIC.clear()


def test_it_keeps_the_contract() -> None:
    short = {**SMALL, "max_steps": 3}
    check_vector_env(
        partial(make_vec, LIFT, **short), partial(make, LIFT, **short), num_envs=2, steps=8
    )


def test_every_level_begins(served: fake_playroom_server.Service) -> None:
    for level in envs.families()["released_playroom"].levels:
        env = make_vec(f"released_playroom/{level}", 1, **SMALL)
        assert env.reset(seed=0)[0]["image"].shape == (1, 3, 4, 3)
        env.close()
    assert served.envs == set()


def test_actions_are_held_for_four_frames(served: fake_playroom_server.Service) -> None:
    env = make_vec(LIFT, 1, **SMALL)
    env.reset(seed=0)
    for name in ("GRAB_AND_LOOK_UP_MID", "PULL_CLOSER_MID", "NOOP"):
        env.step(np.array([ACTIONS.index(name)]))
    nothing = dict.fromkeys(fake_playroom_server.CONTROLS, 0.0)
    frames = [
        {**nothing, "HAND_GRIP": 1.0, "LOOK_DOWN_UP": -0.03},
        {**nothing, "HAND_PUSH_PULL": 0.5},
        nothing,
    ]
    assert served.controls == [one for one in frames for _ in range(4)]


def test_the_signs_of_the_released_keys() -> None:
    def command(name: str) -> dict[str, float]:
        return {key: value for key, value in COMMANDS[ACTIONS.index(name)].items() if value}

    assert command("MOVE_FORWARD_FULL") == {"MOVE_BACK_FORWARD": 1}
    assert command("MOVE_LEFT_FULL") == {"STRAFE_LEFT_RIGHT": -1}
    assert command("LOOK_UP_FULL") == {"LOOK_DOWN_UP": -1}
    assert command("LOOK_LEFT_FULL") == {"LOOK_LEFT_RIGHT": -1}
    assert command("GRAB") == {"HAND_GRIP": 1}
    assert all(set(one) == set(fake_playroom_server.CONTROLS) for one in COMMANDS)


def test_ends_and_successes() -> None:
    def last(action: int, **options: Any) -> dict[str, Any]:
        env = make_vec(LIFT, 1, **{**SMALL, **options}, autoreset_mode="Disabled")
        env.reset(seed=0)
        for _ in range(options.get("max_steps", 8)):
            _, _, terminated, truncated, info = env.step(np.array([action]))
            if terminated[0] or truncated[0]:
                break
        env.close()
        ended = {"terminated": bool(terminated[0]), "truncated": bool(truncated[0])}
        return ended | {key: info[key][0].item() for key in ("success", "return", "length")}

    done = last(FORWARD, max_steps=20)
    assert (done["terminated"], done["success"], done["return"]) == (True, True, 1.0)
    failed = last(GRAB)
    assert failed == {
        **{"terminated": True, "truncated": False, "success": False},
        **{"return": 0.0, "length": 3},
    }
    late = last(0)
    assert (late["truncated"], late["success"], late["length"]) == (True, False, 8)


def test_instructions() -> None:
    env = make_vec(LIFT, 12, **SMALL)
    observation, info = env.reset(seed=0)
    assert set(info["instruction"]) == set(fake_playroom_server.TEXTS)
    np.testing.assert_array_equal(
        observation["instruction"], [encode(text) for text in info["instruction"].tolist()]
    )
    codes = encode("Lift a rubber duck").tolist()
    ours = VOCABULARY.encode("lift a duck").tolist()
    assert codes[:2] + codes[3:4] == ours[:3]
    assert codes[2] >= VOCABULARY.size
    with pytest.raises(ValueError, match="17 words: at most 16"):
        encode("a " * 17)


def test_pickled_batches_go_on() -> None:
    env = make_vec(LIFT, 2, **SMALL)
    env.reset(seed=0)
    env.step(np.array([FORWARD, 0]))
    other = pickle.loads(pickle.dumps(env))
    for _ in range(3):
        actions = np.array([0, FORWARD])
        one, two = env.step(actions)[0], other.step(actions)[0]
        np.testing.assert_array_equal(one["image"], two["image"])
    env.close()
    other.close()


def test_an_engine_that_is_not_deterministic(served: fake_playroom_server.Service) -> None:
    served.sound = False
    env = make_vec(LIFT, 4, **SMALL)
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="the released Playroom's lift/.* is not deterministic"):
        assert env.set_state(env.get_state()).all()
    env.close()


def test_policies_are_scored_in_shared_worlds(served: fake_playroom_server.Service) -> None:
    names = [
        "released_playroom/put/lift_shape_zipf2",
        "released_playroom/put/put_on_bed_tray_frequent",
    ]
    scores = score(
        lambda observation: np.full(len(observation["image"]), FORWARD),
        Split("put", names, names[0], names[1]),
        episodes=4,
        num_envs=2,
        **{**SMALL, "max_steps": 20},
    )
    assert scores == {"train": 1.0, "uniform": 1.0, "rare": 1.0}
    assert served.envs == set()


def test_containers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A container for each env, stopped when the batch is closed."""
    address = os.environ[rpc.ADDRESS]
    log = tmp_path / "log"
    script = tmp_path / "docker"
    script.write_text(
        f'#!/bin/sh\necho "$@" >> {log}\n'
        f"case $1 in run) echo c$(grep -c ^run {log});; port) echo {address};; esac\n"
    )
    script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.delenv(rpc.ADDRESS)
    env = make_vec(LIFT, 2, **SMALL)
    assert not log.exists()
    env.reset(seed=0)
    env.close()
    run = f"run --detach --rm --publish 127.0.0.1::10000 {rpc.IMAGE}"
    one, other = ([run, f"port c{i} 10000"] for i in (1, 2))
    assert log.read_text().splitlines() == [*one, *other, "kill c1", "kill c2"]

    script.write_text("#!/bin/sh\necho no such image >&2\nexit 125\n")
    env = make_vec(LIFT, 1, **SMALL)
    with pytest.raises(EngineError, match=r"cannot begin .* Docker image .* no such image"):
        env.reset(seed=0)


def test_servers_that_do_not_answer_or_are_others(
    served: fake_playroom_server.Service, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rpc, "_ATTEMPTS", 2)
    monkeypatch.setattr(rpc, "_PATIENCE", 0.01)
    env = DockerVectorEnv(1, address="localhost:9")
    with pytest.raises(EngineError, match="no dm_env_rpc server answers at localhost:9"):
        env.reset(seed=0)
    monkeypatch.undo()
    served.channels = 4
    with pytest.raises(ValueError, match="ZIPF_PLAYROOM_ADDRESS must be host:port, got 'here'"):
        DockerVectorEnv(1, address="here")


def test_images_of_another_shape(served: fake_playroom_server.Service) -> None:
    served.channels = 4
    env = make_vec(LIFT, 1, **SMALL)
    with pytest.raises(EngineError, match=r"shows uint8 \(3, 4, 4\), not uint8 \(3, 4, 3\)"):
        env.reset(seed=0)


def test_what_is_missing_is_said_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ValueError, match="unknown released_playroom option 'reach'"):
        make_vec(LIFT, 1, **SMALL, reach=3.0)
    with pytest.raises(ValueError, match=r"image_size must be at most 4096, got \(5000, 4\)"):
        make_vec(LIFT, 1, **{**SMALL, "image_size": (5000, 4)})
    with pytest.raises(ValueError, match="max_steps must be at most 1000000, got 1000000001"):
        make_vec(LIFT, 1, **{**SMALL, "max_steps": 10**9 + 1})
    monkeypatch.delenv(rpc.ADDRESS)
    monkeypatch.setenv("PATH", "")
    with pytest.raises(ValueError, match=r"needs the command docker.*ZIPF_PLAYROOM_ADDRESS=host"):
        make_vec(LIFT, 1, **SMALL)
    monkeypatch.setitem(sys.modules, "dm_env_rpc.v1.dm_env_adaptor", None)
    with pytest.raises(ValueError, match="pip install dm-env-rpc, or use the family playroom"):
        make_vec(LIFT, 1, **SMALL)


def test_there_are_no_references_experts_or_questions() -> None:
    for one in envs.BASELINES:
        assert envs.baseline(one.name, LIFT) is None
    for name in envs.SCRIPTED:
        assert envs.scripted(name, LIFT, make_vec(LIFT, 1, **SMALL)) is None
    with pytest.raises(
        ValueError, match="no questions about the first frames of released_playroom"
    ):
        envs.questions(envs.split("released_playroom_find"))
