"""Videos for the report: which episodes are recorded, and what is refused before any is played."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image, ImageSequence
from run_folders import constant, refusal, write_external, write_run

from zipf import envs, report
from zipf.experiments.building import loading
from zipf.experiments.evaluation.trained import load_agent
from zipf.experiments.playing import videos as recorder
from zipf.experiments.records import video_files
from zipf.experiments.training import runner


@pytest.fixture(scope="module")
def trained_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of no updates: its agent acts almost at random."""
    root = tmp_path_factory.mktemp("runs")
    config = loading.load(
        [
            *("experiment=demo", "device=cpu", "updates=1", f"run_root={root}"),
            *("collector.num_envs=4", "collector.unroll_length=5", "evaluation.episodes=5"),
            *("network.size=16", "memory.size=16", "memory=lstm", "environment.max_steps=30"),
            "schedule.window=[0,1]",
        ]
    )
    assert runner.train(config) == 0
    return config.folder


@pytest.fixture
def run(trained_run: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(trained_run, tmp_path / "runs/seed0"))


def test_a_success_and_a_failure_of_both_situations(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert report.main([str(run), "videos=gif"]) == 0
    assert f"Wrote {(run / 'videos').as_posix()} (successes: " in capsys.readouterr().out
    described = video_files.read(run)
    assert described is not None
    assert described.update == 1
    often, rare = described.situations
    assert (often.ranks, rare.ranks) == ({"map": 0, "target": 0}, {"map": 19, "target": 4})
    files = {path.name for path in (run / "videos").iterdir()} - {"videos.json"}
    assert files == {video.file for one in described.situations for video in one.videos}
    for situation in described.situations:
        assert situation.level == "gridworld/uniform"
        for video in situation.videos:
            assert (video.outcome == "success") == (video.episode_return == 1.0)
            assert pictures(run / "videos" / video.file) == video.length + 1
    page = (run / "report/report.html").read_text()
    assert page.count("data:image/gif;base64,") == len(files)

    again = (run / "videos/videos.json").read_bytes()
    for name in ("failure.gif", "rarest_success.mp4"):
        (run / "videos" / name).touch()
    recorder.record_run(run, load_agent(run, "cpu"), "gif")
    assert (run / "videos/videos.json").read_bytes() == again
    there = {path.name for path in (run / "videos").iterdir()}
    assert there == {*files, "videos.json", "failure.gif"}  # the last is a logger's


def test_an_episode_is_played_again_as_it_was(run: Path) -> None:
    """Of the agent's own actions, in an env that starts where the recorded one did."""
    trained = load_agent(run, "cpu")
    situation = recorder.find_situation(trained, lambda ranks: int(ranks.max()))
    episodes, tried, successes = recorder.play(trained, situation, "rarest")
    assert 0 <= successes <= tried <= recorder.EPISODES
    for episode in episodes:
        env = envs.make_vec("gridworld/uniform", 1, **trained.config.level_options)
        _, info = env.reset(seed=episode.seed, options=situation.ranks)
        assert {name: info[name][0] for name in situation.ranks} == situation.ranks
        for action in episode.actions:
            *_, info = env.step(np.array([action]))
        outcome = info["final_info"]
        assert outcome["length"][0] == len(episode.actions)
        assert outcome["return"][0] == episode.episode_return
        assert outcome["success"][0] == episode.success


def test_an_outcome_that_does_not_come_is_said(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    played = recorder._batch

    def failing(*args, **kwargs):
        return (episode for episode in played(*args, **kwargs) if not episode.success)

    monkeypatch.setattr(recorder, "_batch", failing)
    monkeypatch.setattr(recorder, "EPISODES", 60)  # played by 50 at a time
    assert report.main([str(run), "videos=gif"]) == 0
    page = (run / "report/report.html").read_text()
    assert page.count("No success in 100 episodes.") == 2
    assert page.count("0 of 100 episodes succeeded") == 2


def test_long_episodes_show_some_of_their_frames(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recorder, "MOST_FRAMES", 10)
    made = recorder.record_run(run, load_agent(run, "cpu"), "gif")
    recorded = [video for one in made.situations for video in one.videos]
    assert max(video.every for video in recorded) == 4  # of 31 pictures
    for video in recorded:
        shown = 1 + -(-video.length // video.every)
        assert pictures(run / "videos" / video.file) == shown


def pictures(path: Path) -> int:
    """How many pictures a GIF shows before the second on its last one, by its time: of pictures
    that are alike it holds one."""
    with Image.open(path) as gif:
        seconds = sum(frame.info["duration"] for frame in ImageSequence.Iterator(gif)) / 1000
    return round((seconds - recorder.PAUSE) * 8)


# Mistakes.


def test_a_run_without_a_checkpoint(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("checkpoint.pt", "weights.pt"):
        (run / name).unlink()
    told = refusal(capsys, str(run), "videos=gif")
    assert f"videos: {run.as_posix()}: has no agent" in told
    assert not (run / "videos").exists()


def test_an_external_agent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_run(tmp_path, constant(0.5))
    write_external(tmp_path, constant(0.5))
    assert "has no agent" in refusal(capsys, str(tmp_path), "videos=gif")


def test_videos_are_of_the_conditions_that_are_shown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    ours = write_run(tmp_path, constant(0.5))
    write_external(tmp_path, constant(0.5), name="theirs")
    asked = []
    monkeypatch.setattr(recorder, "record_videos", lambda folders, *_: asked.append(folders))
    assert report.main([str(tmp_path), "videos=gif", "conditions=impala"]) == 0
    assert asked == [[ours]]
    told = refusal(capsys, str(tmp_path), "videos=gif", "highlight=other")
    assert "other: no such condition" in told
    assert len(asked) == 1


@pytest.mark.parametrize(
    ("attribute", "value", "message"),
    [("reports_success", False, "report no success"), ("situation", {}, "report no situation")],
)
def test_worlds_without_success_or_situation(
    run: Path,
    attribute: str,
    value: object,
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    made = recorder._envs

    def without(*args, **kwargs):
        env = made(*args, **kwargs)
        setattr(env, attribute, value)
        return env

    monkeypatch.setattr(recorder, "_envs", without)
    told = refusal(capsys, str(run), "videos=gif")
    assert f"the envs of {run.as_posix()} {message}" in told
    assert not (run / "videos").exists()


def test_plugins_without_videos(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told = refusal(capsys, str(run), "plugins=corridor")
    assert "plugins=corridor: goes with videos= only" in told


def test_a_damaged_checkpoint_is_not_loaded(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with (run / "checkpoint.pt").open("ab") as file:
        file.write(b"more")
    assert "checkpoint.pt: is damaged" in refusal(capsys, str(run), "videos=gif")


def test_objects_drawn_without_replacement_are_not_forced_to_be_the_same() -> None:
    config = loading.load(["experiment=playroom_lift"])
    trained = SimpleNamespace(config=config)
    often = recorder.find_situation(trained, lambda ranks: int(ranks.min()))
    rarest = recorder.find_situation(trained, lambda ranks: int(ranks.max()))
    assert often.ranks == {"target": 0, "other_1": 1, "other_2": 2}
    assert rarest.ranks == {"target": 49, "other_1": 48, "other_2": 47}
