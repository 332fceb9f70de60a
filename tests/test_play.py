"""Playing, watching and recording: keys, experts, files, screens, and what is said of mistakes."""

import codecs
import fcntl
import math
import os
import pty
import re
import signal
import subprocess
import sys
import termios
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import zipf.play
from zipf import envs
from zipf.envs.gridworld import sprites
from zipf.envs.gridworld.maps import MOVES
from zipf.envs.gridworld.vector import GridworldVectorEnv
from zipf.envs.keyboard import LEAVE, NEXT, Binding, Keys, Toggle
from zipf.envs.labyrinth import words
from zipf.envs.pictures import fit
from zipf.errors import UserError
from zipf.experiments.options import command_line
from zipf.experiments.playing import playing, screens, sessions
from zipf.experiments.playing.captions import BACKGROUND, captioned
from zipf.experiments.playing.playing import PlayOptions
from zipf.experiments.playing.recording import Recording

PATIENCE = 120.0  # seconds, on a machine busy with other things
FAMILIES = {
    name: family.splits[0].rare[0].name if family.splits else f"{name}/{family.levels[0]}"
    for name, family in envs.families().items()
}
NAMED = {"up", "down", "left", "right", "home", "end", "pageup", "pagedown"} | {
    *("space", "tab", "backspace")
}


def play(*arguments: str) -> list[str]:
    """Plays, and returns the lines that were said."""
    said: list[str] = []
    playing.play(command_line.read_options(PlayOptions, list(arguments)), said.append)
    return said


# Keys.


@pytest.mark.parametrize("level", FAMILIES.values(), ids=FAMILIES)
def test_the_keys_of_a_family_reach_every_action(level):
    keys, env = envs.keys(level), envs.make_vec(level, 1)
    assert keys is not None
    pressed = {
        keys.press(key, toggled)[0]
        for binding in keys.bindings
        for key in binding.keys
        for toggled in range(2 ** len(keys.toggles))
    }
    assert pressed == set(range(env.single_action_space.n))
    for part in (*keys.bindings, *keys.toggles):
        assert len(part.actions) in (0, 1, 2 ** len(keys.toggles))
    names = [key for binding in keys.bindings for key in binding.keys]
    assert all(len(name) == 1 or name in NAMED for name in names)


def test_toggles_change_what_keys_do_until_pressed_again():
    keys = Keys(
        (Binding(("a", "b"), "go", (1, 2, 3, 4)), Binding(("c",), "sit", (5,))),
        (Toggle("x", "fast"), Toggle("y", "hold", (0, 0, 9, 9))),
    )
    assert keys.press("a") == keys.press("b") == (1, 0)
    assert keys.press("x", 0) == (None, 1)
    assert keys.press("a", 1) == (2, 1)
    assert keys.press("y", 1) == (9, 3)
    assert keys.press("a", 3) == (4, 3)
    assert keys.press("c", 3) == (5, 3)
    assert keys.press("x", 3) == (None, 2)
    assert keys.press("y", 2) == (0, 0)
    assert keys.press("?", 2) == (None, 2)


@pytest.mark.parametrize("key", ["a", "x", LEAVE, NEXT])
def test_a_key_means_one_thing(key):
    with pytest.raises(ValueError, match="more than one meaning"):
        Keys((Binding(("a",), "", (0,)), Binding((key,), "", (1,))), (Toggle("x", ""),))


def test_actions_are_one_or_one_for_each_combination_of_toggles():
    toggle = Toggle("x", "fast")
    for bindings, toggles in (
        ((Binding(("a",), "go", (1, 2)),), ()),
        ((Binding(("a",), "go", ()),), ()),
        ((Binding(("a",), "go", (1, 2, 3)),), (toggle, Toggle("y", "hold"))),
        ((), (toggle, Toggle("y", "go", (1, 2)))),
    ):
        with pytest.raises(ValueError, match=r"'go' has \d actions: must be 1 or \d"):
            Keys(bindings, toggles)


def test_what_a_terminal_sends_is_read_as_keys():
    sent = (
        "aQ \t\r\x7f\x1b[A\x1bOB\x1b[1;2C\x1b[D\x1b[5~\x1b[6;5~\x1b[H\x1b[4~\x1bOw\x1b[99~\x1b\x01é"
    )
    assert list(screens.key_names(sent)) == [
        *("a", "q", "space", "tab", "enter", "backspace", "up", "down", "right", "left"),
        *("pageup", "pagedown", "home", "end", "7", "é"),
    ]


# Experts.


def shortest(board: np.ndarray, start: tuple[int, int], goal: tuple[int, int]) -> int:
    """By breadth-first search, from the rules."""
    steps, edge = {start: 0}, deque([start])
    while edge:
        row, column = edge.popleft()
        if (row, column) == goal:
            return steps[goal]
        if board[row, column] >= sprites.FIRST_LOOK:
            continue
        for down, right in MOVES:
            to = row + down, column + right
            between = board[row + down, column], board[row, column + right]
            squeezed = down and right and between == (sprites.WALL, sprites.WALL)
            if to not in steps and board[to] != sprites.WALL and not squeezed:
                steps[to] = steps[row, column] + 1
                edge.append(to)
    raise AssertionError("there is no way")


def test_the_gridworld_expert_always_succeeds_by_the_shortest_way():
    env = envs.make_vec("gridworld/uniform", 400)
    expert = envs.expert("gridworld/uniform", env)
    assert expert is not None
    maps, targets = np.divmod(np.arange(400), 20)
    env.reset(seed=0, options={"map": maps, "target": targets})
    lengths = np.zeros(400, np.int64)
    while not lengths.all():
        *_, info = env.step(expert())
        if "final_info" in info:
            first = info["_final_info"] & (lengths == 0)
            lengths[first] = info["final_info"]["length"][first]
            assert info["final_info"]["success"][first].all()
    made = env.level.maps
    for i, (map, target) in enumerate(zip(maps, targets, strict=True)):
        start, goal = (tuple(made.cells[map, j].tolist()) for j in (-1, target))
        assert lengths[i] == shortest(made.boards[map], start, goal)


# Recordings.


def moving(frames: int, height: int = 31, width: int = 45) -> list[np.ndarray]:
    """Frames with a square that moves."""
    made = []
    for i in range(frames):
        frame = np.full((height, width, 3), (20, 60, 140), np.uint8)
        frame[5:15, 2 * i : 2 * i + 10] = (250, 200, 10)
        made.append(frame)
    return made


def read_gif(path: Path) -> tuple[list[np.ndarray], list[int]]:
    """Frames, and milliseconds of each."""
    frames, lasts = [], []
    with Image.open(path) as image:
        for i in range(image.n_frames):
            image.seek(i)
            frames.append(np.array(image.convert("RGB")))
            lasts.append(image.info["duration"])
    return frames, lasts


def read_mp4(path: Path) -> tuple[list[np.ndarray], float]:
    """Frames, and how many a second."""
    import av

    with av.open(str(path)) as file:
        frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
        return frames, float(file.streams.video[0].average_rate)


def test_a_gif_holds_the_frames_and_their_time(tmp_path):
    frames = moving(8)
    with Recording(tmp_path / "out.gif", 8) as recording:
        for frame in frames:
            recording.add(frame)
        recording.hold(2.0)
    assert (recording.written, recording.frames, recording.size) == (True, 8 + 16, (45, 31))
    read, lasts = read_gif(tmp_path / "out.gif")
    np.testing.assert_array_equal(read, frames)
    assert set(lasts[:-1]) == {120, 130}  # 125 is no whole number of hundredths of a second
    assert sum(lasts) == 3000
    assert [path.name for path in tmp_path.iterdir()] == ["out.gif"]


def test_an_mp4_holds_the_frames_of_odd_sizes_too(tmp_path):
    frames = moving(9)
    with Recording(tmp_path / "out.mp4", 12) as recording:
        for frame in frames:
            recording.add(frame)
        recording.hold(0.5)
    read, rate = read_mp4(tmp_path / "out.mp4")
    assert rate == 12
    assert len(read) == 9 + 6
    assert read[0].shape == (32, 46, 3)
    for frame, found in zip(frames, read, strict=False):
        assert abs(found[:31, :45].astype(int) - frame).mean() < 8


@pytest.mark.parametrize("ending", ["gif", "mp4"])
def test_a_recording_that_is_cut_short_is_kept(ending, tmp_path):
    path = tmp_path / f"out.{ending}"

    def interrupted():
        with Recording(path, 5) as recording:
            for frame in moving(3):
                recording.add(frame)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert len((read_gif if ending == "gif" else read_mp4)(path)[0]) == 3


def test_no_frames_replace_no_file(tmp_path):
    path = tmp_path / "out.gif"
    path.write_text("before")
    with pytest.raises(ZeroDivisionError), Recording(path, 5):
        raise ZeroDivisionError
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]


def test_an_mp4_takes_its_library(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(UserError, match=r"\.\[video\]"):
        Recording(tmp_path / "out.mp4", 5)
    with Recording(tmp_path / "out.gif", 5) as recording:
        recording.add(moving(1)[0])
    assert not (tmp_path / "out.mp4").exists()


@pytest.mark.parametrize(
    ("level", "policy"),
    [
        pytest.param(level, policy, marks=[pytest.mark.slow] if name == "labyrinth" else [])
        for name, level in FAMILIES.items()
        for policy in envs.SCRIPTED
        if getattr(envs.find_family(name), policy) is not None
    ],
)
def test_every_family_can_be_recorded(level, policy, tmp_path):
    path = tmp_path / "out.gif"
    said = play(f"level={level}", f"policy={policy}", "seed=1", f"record={path}", "view=agent")
    assert said[0] == f"{level}, seed 1"
    assert said[-2].startswith("episode 1: ")
    steps = int(re.search(r"(\d+) steps?$", said[-2])[1])
    env = envs.make_vec(level, 1)
    fps = env.metadata["render_fps"]
    height, width, _ = env.single_observation_space["image"].shape
    scale = 480 // height
    frames = 1 + steps + math.ceil(fps)
    read, lasts = read_gif(path)
    high, wide, _ = read[0].shape
    assert said[-1].startswith(f"written: {path} ({frames} frames, {wide} x {high}, ")
    # Where nothing changes a GIF shows a frame for longer, and of fast families each second one.
    assert sum(lasts) == pytest.approx(1000 * frames / fps, abs=10)
    assert min(lasts) >= 100
    assert wide == width * scale
    assert height * scale < high < 1.25 * height * scale  # with the strip of text


def test_a_recording_shows_the_worlds_frames(tmp_path):
    path = tmp_path / "out.gif"
    said = play(
        *("level=gridworld/rare", "policy=expert", "seed=3", "episodes=2", "fps=10"),
        *(f"record={path}", "size=459x459"),
    )
    env = envs.make_vec("gridworld/rare", 1, autoreset_mode="Disabled", render_mode="rgb_array")
    expert = envs.expert("gridworld/rare", env)
    frames, lasts = [], []
    for seed in (3, None):
        env.reset(seed=seed)
        ended = False
        frames.append(env.render()[0])
        lasts.append(100)
        while not ended:
            _, _, terminated, truncated, _ = env.step(expert())
            ended = terminated[0] or truncated[0]
            frames.append(env.render()[0])
            lasts.append(100)
        lasts[-1] += 1000
    read, read_lasts = read_gif(path)
    np.testing.assert_array_equal([frame[:459] for frame in read], frames)
    assert read_lasts == lasts
    assert [line.split(":")[0] for line in said] == [
        *("gridworld/rare, seed 3", "episode 1", "episode 2", "written"),
    ]
    assert all("success, return 1" in line for line in said[1:3])


def test_a_fast_gif_shows_each_so_many_th_frame_at_its_time(tmp_path):
    path = tmp_path / "out.gif"
    said = play(*["level=gridworld/rare", "policy=expert", "seed=3", "fps=30"], f"record={path}")
    steps = int(re.search(r"(\d+) steps?$", said[1])[1])
    read, lasts = read_gif(path)
    assert len(read) == 1 + -(-steps // 3)  # the last one in any case
    assert sum(lasts) == pytest.approx(1000 * (1 + steps + 30) / 30, abs=10)


@pytest.mark.parametrize("view", ["world", "agent"])
def test_a_still_is_the_first_frame_at_the_size_asked_for(view, tmp_path):
    path = tmp_path / "out.png"
    level = "playroom/lift/lift_shape_uniform"
    said = play(f"level={level}", "seed=2", f"record={path}", "size=400x300", f"view={view}")
    drawn = np.asarray(Image.open(path))
    assert said[1].startswith(f"written: {path} (1 frame, {drawn.shape[1]} x {drawn.shape[0]}, ")
    if view == "agent":
        env = envs.make_vec(level, 1)
        picture = env.reset(seed=2)[0]["image"][0].repeat(4, axis=0).repeat(4, axis=1)
    else:
        env = envs.make_vec(level, 1, image_size=[300, 400])
        picture = env.reset(seed=2)[0]["image"][0]
        picture[143:158, 193:208] = drawn[143:158, 193:208]  # the cross
    height, width, _ = picture.shape
    np.testing.assert_array_equal(drawn[:height], picture)
    assert drawn.shape[0] > height
    assert drawn.shape[1] == width


def test_the_text_below_pictures_fits(tmp_path):
    picture = np.zeros((60, 200, 3), np.uint8)
    short, long = (captioned(picture, ("Title", words), True) for words in ("done", "word " * 12))
    assert short.shape == long.shape
    for drawn in (short, long):
        strip = drawn[60:]
        assert (strip[:, -3:] == BACKGROUND).all()
        assert len(np.unique(strip.reshape(-1, 3), axis=0)) <= 17
    assert (captioned(picture, ("", "done"), True) != captioned(picture, ("", "done"), False)).any()


def test_the_same_seed_plays_the_same(tmp_path):
    def once(seed: int) -> tuple[list[str], bytes]:
        path = tmp_path / "out.gif"
        said = play("level=gridworld/uniform", "policy=random", f"seed={seed}", f"record={path}")
        return said, path.read_bytes()

    assert once(1) == once(1) != once(2)
    # Without one it is drawn, and told.
    said = play("level=gridworld/uniform", "policy=random", f"record={tmp_path}/out.gif")
    assert re.fullmatch(r"gridworld/uniform, seed \d+", said[0])


@pytest.fixture(scope="module")
def run(trained_once) -> Path:
    """A run of two updates."""
    (folder,) = trained_once.glob("*/*/seed0")
    return folder


@pytest.mark.parametrize(
    ("level", "played"),
    [
        ([], "gridworld/zipf_2"),
        (["level=rare"], "gridworld/rare"),
        (["level=uniform"], "gridworld/uniform"),
        (["level=gridworld/zipf_1"], "gridworld/zipf_1"),
    ],
)
def test_a_run_plays_its_levels(run, level, played, tmp_path):
    said = play(f"run={run}", *level, "episodes=2", "seed=0", f"record={tmp_path}/out.gif")
    assert said[0] == f"{played}, seed 0"
    assert len(said) == 4
    # Of the run's 20 maps and 5 targets the rarest fifths are the last four and the last one.
    if played == "gridworld/rare":
        assert all(re.search("map 1[6-9], target 4", line) for line in said[1:3])
    assert all(int(line.split()[-2]) <= 9 for line in said[1:3])


def test_the_agent_acts_as_when_it_is_scored(run, tmp_path):
    from zipf.experiments.building.seeds import derive_seed
    from zipf.experiments.evaluation.agent_policy import AgentPolicy
    from zipf.experiments.evaluation.evaluator import play as score
    from zipf.experiments.evaluation.trained import load_agent

    said = play(f"run={run}", "episodes=1", "seed=7", f"record={tmp_path}/out.gif")
    trained = load_agent(run, "cpu")
    env = envs.make_vec("gridworld/zipf_2", 1, **trained.config.level_options)
    policy = AgentPolicy(trained.agent, seed=derive_seed(7, "actions"))
    episode = score(policy, env, episodes=1, seed=7).iloc[0]
    assert f"map {episode['map']}, target {episode['target']}:" in said[1]
    assert said[1].split()[-2] == str(episode["length"])


# Mistakes.


def test_a_folder_is_no_recording(tmp_path):
    (tmp_path / "x.gif").mkdir()
    with pytest.raises(UserError, match=r"x\.gif: is a folder"):
        play("level=gridworld/rare", "policy=random", f"record={tmp_path}/x.gif")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("level=gridwrld/rare", r"unknown level 'gridwrld/rare' \(did you mean 'gridworld/rare'"),
        ("level=gridworld/zipf2", r"unknown level 'zipf2' \(did you mean 'zipf_2'"),
        ("level=gridworld/rare policy=robot", "policy=robot: should be 'keyboard', 'random'"),
        ("level=gridworld/rare policy=agent", "policy=agent: needs the agent of a run"),
        ("level=rare", "level=rare: names a run's level"),
        ("policy=random", "level is not set"),
        ("levl=gridworld/rare", "levl: no such option; did you mean level?"),
        ("level=gridworld/rare record=x.gif", "policy is not set"),
        ("level=gridworld/rare policy=random record=x.avi", "should end in .gif, .mp4 or .png"),
        ("level=labyrinth/uniform policy=random record=x.avi", "should end in .gif, .mp4 or .png"),
        ("level=gridworld/rare policy=random record=no/x.gif", "there is no folder no"),
        ("level=gridworld/rare policy=random record=x.png", "policy=random: does not go with rec"),
        ("run=nowhere record=x.png episodes=2", "episodes=2: does not go with record=x.png"),
        ("level=gridworld/rare size=1280", "size=1280: should be <width>x<height> such as 1280x96"),
        ("level=gridworld/rare size=1280x9", "each 64 to 4096 pixels"),
        ("level=gridworld/rare policy=random record=x.gif episodes=0", "greater than or equal"),
        ("run=nowhere", "nowhere: is no run's folder \\(there is no such folder"),
        ("level=gridworld/rare", "no screen: .*record=FILE.gif"),
        ("level=gridworld/rare screen=terminal", "are not a terminal"),
        ("level=gridworld/rare screen=window", "needs a display.*use screen=terminal"),
    ],
)
def test_mistakes_are_told_in_a_line(arguments, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(UserError, match=message):
        play(*arguments.split())
    assert not list(tmp_path.iterdir())


def test_what_is_no_run_says_what_it_is(tmp_path):
    (tmp_path / "runs" / "seed0").mkdir(parents=True)
    (tmp_path / "runs" / "seed0" / "run.json").touch()
    (tmp_path / "empty").mkdir()
    for name, why in (
        ("empty", r"it has no run.json\)"),
        ("runs", r"it has no run.json; did you mean .*seed0\?\)"),
        ("runs/seed0/run.json", r"it is a file; its folder: .*seed0\)"),
    ):
        with pytest.raises(UserError, match=rf"{name}: is no run's folder \({why}"):
            play(f"run={tmp_path / name}")


def test_a_missing_screen_is_said_before_envs_are_made(monkeypatch):
    monkeypatch.setattr(envs, "make_vec", lambda *_, **__: pytest.fail("made"))
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(UserError, match="no screen"):
        play("level=gridworld/rare")


def test_a_run_without_a_checkpoint(run, tmp_path):
    for name in ("config.yaml", "run.json"):
        (tmp_path / name).write_text((run / name).read_text())
    with pytest.raises(UserError, match="has no agent"):
        play(f"run={tmp_path}", f"record={tmp_path}/x.gif")


def test_a_run_without_levels_of_a_kind(run, tmp_path, monkeypatch):
    trained = playing._load(str(run), [])
    monkeypatch.setattr(envs, "split", lambda name: envs.Split(name, "gridworld/zipf_2"))
    monkeypatch.setattr(playing, "_load", lambda *_: trained)
    with pytest.raises(UserError, match="level=rare: the run has no such level; expected train"):
        play(f"run={run}", "level=rare", f"record={tmp_path}/x.gif")


def test_a_level_that_the_agent_cannot_play(run, tmp_path):
    others = [level for family, level in FAMILIES.items() if family != "gridworld"]
    for level in others:
        with pytest.raises(UserError, match=f"level={level}: belongs to another family than"):
            play(f"run={run}", f"level={level}", f"record={tmp_path}/x.gif")


def test_faults_of_worlds_are_not_taken_for_the_users(run, monkeypatch, tmp_path):
    def broken(*_, **__):
        raise TypeError("a fault")

    monkeypatch.setattr(envs, "make_vec", broken)
    with pytest.raises(TypeError, match="a fault"):
        play(f"run={run}", f"record={tmp_path}/x.gif")


def test_a_family_may_have_neither_keys_nor_scripts(monkeypatch, tmp_path):
    for name in ("keys", "scripted"):
        monkeypatch.setattr(envs, name, lambda *_: None)
    for name in envs.SCRIPTED:
        with pytest.raises(UserError, match=f"policy={name}: gridworld/rare has none; policy=ran"):
            play("level=gridworld/rare", f"policy={name}", f"record={tmp_path}/x.gif")
    with pytest.raises(UserError, match="no keys for gridworld/rare"):
        play("level=gridworld/rare")


def test_a_family_may_draw_no_pictures(monkeypatch, tmp_path):
    monkeypatch.delitem(GridworldVectorEnv.metadata, "render_modes")
    with pytest.raises(UserError, match="render_mode must be None: these envs draw no pictures"):
        play("level=gridworld/rare", "policy=random", f"record={tmp_path}/x.gif")


def test_the_agents_view_takes_an_image(monkeypatch, tmp_path):
    make = envs.make_vec
    monkeypatch.setattr(envs, "make_vec", lambda *a, **k: make(*a, observation="tiles", **k))
    with pytest.raises(UserError, match="view=agent"):
        play("level=gridworld/rare", "policy=random", "view=agent", f"record={tmp_path}/x.gif")


# Screens.


def test_a_picture_in_half_blocks():
    picture = np.zeros((3, 2, 3), np.uint8)
    picture[0] = (255, 0, 0)
    picture[1, 1] = (0, 0, 255)
    assert screens.half_blocks(picture) == [
        "\x1b[38;2;255;0;0m\x1b[48;2;0;0;0m▀\x1b[48;2;0;0;255m▀\x1b[0m",
        "\x1b[38;2;0;0;0m\x1b[48;2;0;0;0m▀▀\x1b[0m",
    ]


def test_pictures_fit_in_proportion():
    picture = np.arange(10 * 20 * 3, dtype=np.uint8).reshape(10, 20, 3)
    assert fit(picture, 70, 100).shape == (30, 60, 3)
    np.testing.assert_array_equal(fit(picture, 70, 100)[::3, ::3], picture)
    assert fit(picture, 10, 100).shape == (5, 10, 3)
    assert fit(picture, 100, 1).shape == (1, 2, 3)


class Person:
    """Somebody at a terminal, 90 x 30, who does what `script` says while something runs in it."""

    def __init__(self) -> None:
        self.master, self.slave = pty.openpty()
        termios.tcsetwinsize(self.slave, (30, 90))
        self.before = termios.tcgetattr(self.slave)
        self.output = ""
        self.new = threading.Condition()
        threading.Thread(target=self._watch, args=[os.dup(self.master)], daemon=True).start()

    def type(self, keys: str) -> None:
        os.write(self.master, keys.encode())

    def _watch(self, terminal: int) -> None:
        """Reads all the time, as terminals do: a program blocks when nobody does."""
        decoder = codecs.getincrementaldecoder("utf-8")()
        while True:
            try:
                some = os.read(terminal, 65536)
            except OSError:  # everybody has left
                os.close(terminal)
                return
            with self.new:
                self.output += decoder.decode(some)
                self.new.notify_all()

    def sees(self, text: str) -> str:
        """Waits until it is shown, after what was waited for before; returns what is between."""
        with self.new:
            if not self.new.wait_for(lambda: text in self.output, PATIENCE):
                raise AssertionError(f"no {text!r} in {self.output[-2000:]!r}")
            before, _, self.output = self.output.partition(text)
            return before

    @contextmanager
    def doing(self, script: Callable[[], None]) -> Iterator[None]:
        """Runs the script beside what is within, which it has to bring to an end."""
        failures: list[BaseException] = []

        def run() -> None:
            try:
                script()
            except BaseException as failure:
                failures.append(failure)
                self.type("q")

        thread = threading.Thread(target=run)
        thread.start()
        try:
            with (
                os.fdopen(os.dup(self.slave)) as stdin,
                os.fdopen(os.dup(self.slave), "w") as stdout,
                pytest.MonkeyPatch.context() as patch,
            ):
                patch.setattr(sys, "stdin", stdin)
                patch.setattr(sys, "stdout", stdout)
                yield
        finally:
            thread.join()
            assert not failures, failures
            self.sees("\x1b[?25h\x1b[?1049l")
            assert termios.tcgetattr(self.slave) == self.before


@pytest.fixture
def person(monkeypatch):
    """Somebody at the terminal of this process."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    one = Person()
    yield one
    os.close(one.master)
    os.close(one.slave)


def test_a_person_plays_in_a_terminal(person, tmp_path):
    env = envs.make_vec("gridworld/zipf_2", 1, autoreset_mode="Disabled")
    expert = envs.expert("gridworld/zipf_2", env)
    keys = envs.keys("gridworld/zipf_2")
    _, info = env.reset(seed=5)
    typed = []
    ended = False
    while not ended:
        action = int(expert()[0])
        typed.append(keys.bindings[action].keys[1])
        _, _, terminated, _, _ = env.step(np.array([action]))
        ended = terminated[0]

    def script():
        person.sees("\x1b[?1049h\x1b[?25l")
        person.sees("▀")
        person.sees("gridworld/zipf_2   policy keyboard")
        person.sees(f"ranks: map {info['map'][0]}, target {info['target'][0]}")
        person.sees("step 0")
        person.sees("↑/k/8: north")
        person.sees("q: leave")
        person.type("x\x1a?")  # none of this means anything
        person.type("".join(typed))
        person.sees(f"success, return 1, {len(typed)} steps")
        person.type("\x1b[A\r")
        person.sees("episode 2   step 0")
        person.type("\x1b[A\x1bOA")
        person.sees("episode 2   step 2")
        person.type("\n")
        person.sees("episode 3   step 0")
        person.type("q")

    path = tmp_path / "mine.gif"
    with person.doing(script):
        said = play(
            *("level=gridworld/zipf_2", "policy=keyboard", "seed=5", "fps=10", f"record={path}")
        )
    assert said[0] == "gridworld/zipf_2, seed 5"
    assert said[1].endswith(f": success, return 1, {len(typed)} steps")
    assert said[2].endswith(": left after 2 steps")
    assert said[3].endswith(": left after 0 steps")
    # The second on the last frame of the first episode; then three frames and one.
    frames, lasts = read_gif(path)
    assert sum(lasts) == 100 * (len(typed) + 1 + 10 + 3 + 1)
    assert frames[0].shape[:2] > (459, 459)


def test_toggles_are_shown(person, monkeypatch):
    keys = Keys((Binding(("a",), "go", (0, 4)),), (Toggle("space", "boots"),))
    monkeypatch.setattr(envs, "keys", lambda level: keys)

    def script():
        person.sees("boots off")
        person.sees("space: boots")
        person.type(" ")
        person.sees("step 0   return 0   boots on")
        person.type("a")
        person.sees("step 1   return 0   boots on")
        person.type("q")

    with person.doing(script):
        play("level=gridworld/zipf_2", "seed=3")  # where the first step ends nothing


def test_a_terminal_may_change_its_size(person):
    def script():
        person.sees("step 1")
        for shown, rows, columns in (((5, 20), 5, 20), ((0, 0), 24, 80)):
            termios.tcsetwinsize(person.slave, shown)  # some say 0 where they do not know
            person.sees("\x1b[H")
            person.sees("\x1b[H")
            lines = re.sub(r"\x1b\[[0-9;]*[mK]", "", person.sees("\x1b[J")).split("\n")
            assert len(lines) == rows
            assert max(len(line.strip("\r")) for line in lines) <= columns
        person.type("\r")
        person.sees("episode 2")
        person.type("q")

    with person.doing(script):
        play("level=gridworld/zipf_2", "policy=random", "seed=3")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_leaves_the_terminal_as_it_was(person, monkeypatch, number):
    def script():
        person.sees("step 2")
        os.kill(os.getpid(), number)

    monkeypatch.setattr(sys, "argv", ["play", "level=gridworld/zipf_2", "policy=random", "seed=3"])
    before = {n: signal.getsignal(n) for n in (signal.SIGTERM, signal.SIGHUP)}
    try:
        with pytest.raises(SystemExit) as left, person.doing(script):
            zipf.play.main()
        assert left.value.code == 128 + number
    finally:
        for n, handler in before.items():
            signal.signal(n, handler)


def at_a_terminal() -> None:
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # which background jobs of a shell ignore


def test_ctrl_c_leaves_the_terminal_and_keeps_the_recording(tmp_path):
    person = Person()
    process = subprocess.Popen(
        [
            *(sys.executable, "-m", "zipf.play", "level=gridworld/zipf_2"),
            *("policy=keyboard", "record=out.mp4", "screen=terminal"),
        ],
        **dict.fromkeys(("stdin", "stdout", "stderr"), person.slave),
        cwd=tmp_path,
        start_new_session=True,
        preexec_fn=at_a_terminal,
    )

    def script():
        person.sees("step 0")
        person.type("\x1b[A")
        person.sees("step 1")
        person.type("\x03")

    with person.doing(script):
        assert process.wait(2 * PATIENCE) == 130
    person.sees("left after 1 step")
    person.sees("written: out.mp4 (2 frames, 459 x ")
    assert len(read_mp4(tmp_path / "out.mp4")[0]) == 2
    os.close(person.master)
    os.close(person.slave)


def test_a_person_plays_in_a_window(monkeypatch):
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    shown: list[tuple[np.ndarray, tuple[str, ...]]] = []

    def press(key: int, text: str = "") -> None:
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key, unicode=text))

    typed = iter([(pygame.K_RIGHT, ""), (pygame.K_k, "K"), (pygame.K_KP4, "4"), (0, "")])

    class Watched(screens.Window):
        def show(self, picture, text):
            super().show(picture, text)
            drawn = pygame.surfarray.array3d(pygame.display.get_surface()).swapaxes(0, 1)
            shown.append((drawn, text.lines))
            key, letter = next(typed)
            if key:
                press(key, letter)
            else:
                pygame.event.post(pygame.event.Event(pygame.QUIT))

    monkeypatch.setattr(screens, "Window", Watched)
    said = play("level=gridworld/zipf_2", "seed=6", "screen=window")
    assert said[-1].endswith("left after 3 steps")
    assert not pygame.display.get_init()

    env = envs.make_vec("gridworld/zipf_2", 1, autoreset_mode="Disabled", render_mode="rgb_array")
    env.reset(seed=6)
    for i, action in enumerate([2, 0, 6, None]):
        drawn, lines = shown[i]
        frame = env.render()[0]
        left = (drawn.shape[1] - frame.shape[1]) // 2
        np.testing.assert_array_equal(drawn[: len(frame), left : left + frame.shape[1]], frame)
        assert len(np.unique(drawn[len(frame) :].reshape(-1, 3), axis=0)) > 2  # there is text
        assert lines[0].startswith("Walk to the object that the top left corner shows.")
        assert lines[1] == "gridworld/zipf_2   policy keyboard"
        assert f"step {i}   return 0" in lines[3]
        if action is not None:
            env.step(np.array([action]))


def test_a_window_reads_keys_also_where_there_is_no_time_to_wait(monkeypatch):
    """As while a slow policy is watched."""
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    with screens.Window() as window:
        window.show(np.zeros((8, 8, 3), np.uint8), screens.Text(("",), ()))
        assert window.key(0.0) is None
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_q, unicode="q"))
        pygame.event.post(pygame.event.Event(pygame.QUIT))
        assert [window.key(0.0) for _ in range(3)] == ["q", LEAVE, None]


@pytest.mark.parametrize(
    ("level", "ending"),
    [
        ("labyrinth/language_select_described_object", r"(cake|car|cassette|hat|tv): out of time"),
        ("labyrinth/rooms_select_nonmatching_object", "out of time"),
    ],
)
def test_a_level_shows_its_instruction_if_it_has_one(level, ending, monkeypatch, tmp_path):
    """The one at the moment: a level may give several in an episode."""
    shown: list[tuple[str, tuple[str, ...]]] = []
    step = sessions.Shows.step

    def watched(self, env, observation, text, **kwargs):
        shown.append((env.envs.instruction[0].copy(), text.lines))
        step(self, env, observation, text, **kwargs)

    monkeypatch.setattr(sessions.Shows, "step", watched)
    made = envs.make_vec
    monkeypatch.setattr(envs, "make_vec", lambda *a, **k: made(*a, action_repeat=60, **k))
    said = play(f"level={level}", "policy=random", "seed=0", f"record={tmp_path}/x.gif")
    assert re.match(rf"episode 1: {ending}", said[1])
    for codes, lines in shown:
        text = words.VOCABULARY.decode(codes)
        assert lines[:2] == (f"{level}   policy random", text)
    assert len(shown) > 10


@pytest.mark.parametrize("arguments", [[], ["--help"]])
def test_the_command_says_what_there_is(arguments, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["play", *arguments])
    with pytest.raises(SystemExit) as left:
        zipf.play.main()
    assert left.value.code == (0 if arguments else 2)
    told = capsys.readouterr().out
    for option in PlayOptions.model_fields:
        assert re.search(rf"^ +{option}=", told, re.MULTILINE), option


def test_the_command_ends_with_2_after_a_mistake(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["play", "policy=x", "fps=y"])
    with pytest.raises(SystemExit) as left:
        zipf.play.main()
    assert left.value.code == 2
    assert [line.split("=")[0] for line in capsys.readouterr().err.splitlines()] == [
        *("error: policy", "error: fps"),
    ]
