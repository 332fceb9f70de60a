"""Videos of a run for its report: a success and a failure in the most frequent situation and in the
rarest.

Episodes are played in a batch of envs, without drawing them. Those that are wanted are played
again, action by action, in a single env with the same seed, which equals its env of the batch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from zipf import envs
from zipf.envs.pictures import enlarge
from zipf.envs.vector import ZipfVectorEnv
from zipf.errors import UserError, writing
from zipf.experiments.building.run_folder import agent_file
from zipf.experiments.building.seeds import derive_seed
from zipf.experiments.evaluation.agent_policy import AgentPolicy
from zipf.experiments.evaluation.trained import TrainedAgent, load_agent
from zipf.experiments.playing.recording import Recording
from zipf.experiments.records import video_files
from zipf.experiments.records.replacing import replace_text
from zipf.experiments.records.video_files import OUTCOMES, Video, VideosOfSituation
from zipf.experiments.records.wording import VIDEO_FORMATS, VideoFormat

EPISODES = 200  # tried in a situation
AT_A_TIME = 50  # envs that play them; as many draws find every value of a rank, ten times over
MOST_FRAMES = 150  # in a file; of longer episodes every so many-th frame is shown
HEIGHT = 192  # pixels; pictures of a smaller height are enlarged
MOST_FPS = 50  # browsers show a GIF's frames of less than 1/50 s five times slower than meant
PAUSE = 1.0  # seconds on the last frame

Extreme = Callable[[NDArray[np.int64]], int]
SITUATIONS: tuple[tuple[str, str, Extreme], ...] = (
    ("most_frequent", "most frequent situation", lambda ranks: int(ranks.min())),
    ("rarest", "rarest situation", lambda ranks: int(ranks.max())),
)


@dataclass(frozen=True)
class Situation:
    """A situation to play: a level and its ranks there."""

    level: envs.SplitLevel
    ranks: dict[str, int]


@dataclass(frozen=True)
class Episode:
    """An episode that was played; `actions` is int64 [length]."""

    seed: int
    success: bool
    episode_return: float
    actions: NDArray[np.int64]

    @property
    def outcome(self) -> video_files.Outcome:
        return "success" if self.success else "failure"


def record_videos(
    folders: Sequence[Path],
    format: VideoFormat,
    plugins: Sequence[str],
    say: Callable[[str], None],
) -> None:
    """Records videos of the runs in these folders, each into a folder `videos` in the run's; `say`
    prints a line about each.

    Raises UserError: before anything is recorded, a run has no checkpoint that can be loaded, an
    agent that does not act, or envs that report no success.
    """
    for folder in folders:
        try:
            agent_file(folder)
        except UserError as error:
            raise UserError(
                f"videos: {error}; give folders of runs with one (most kept results have none)"
            ) from None
    for folder in folders:
        _playable(folder, load_agent(folder, "cpu", plugins))
    for folder in folders:
        made = record_run(folder, load_agent(folder, "cpu", plugins), format)
        counts = ", ".join(
            f"{one.title} {one.successes} of {one.episodes} episodes" for one in made.situations
        )
        say(f"Wrote {(folder / video_files.FOLDER).as_posix()} (successes: {counts})")


def film(folder: Path, plugins: Sequence[str]) -> Path | None:
    """Records a failure of a run's agent in the rarest situation to `failure.gif` in its folder
    `videos`; returns None where the agent has not failed in `EPISODES` episodes.
    Raises UserError: as `record_videos`."""
    trained = load_agent(folder, "cpu", plugins)
    _playable(folder, trained)
    name, _, extreme = SITUATIONS[1]
    situation = find_situation(trained, extreme)
    failures = [one for one in play(trained, situation, name)[0] if not one.success]
    path = folder / video_files.FOLDER / "failure.gif"
    with writing(path):
        path.parent.mkdir(exist_ok=True)
        for failure in failures:
            _record(trained, situation, failure, path)
    return path if failures else None


def record_run(folder: Path, trained: TrainedAgent, format: VideoFormat) -> video_files.Videos:
    """Records the videos of a run in the place of those that it may have.
    Raises UserError: the envs do not play the same actions alike, or a file cannot be written."""
    target = folder / video_files.FOLDER
    with writing(target):
        target.mkdir(exist_ok=True)
        (target / video_files.NAME).unlink(missing_ok=True)
        for name, *_ in SITUATIONS:
            for outcome in OUTCOMES:
                for ending in VIDEO_FORMATS:
                    (target / f"{name}_{outcome}.{ending}").unlink(missing_ok=True)
        parts = []
        for name, title, extreme in SITUATIONS:
            situation = find_situation(trained, extreme)
            episodes, tried, successes = play(trained, situation, name)
            recorded = [
                _record(trained, situation, one, target / f"{name}_{one.outcome}.{format}")
                for one in episodes
            ]
            parts.append(
                VideosOfSituation(
                    title=title,
                    level=situation.level.name,
                    ranks=situation.ranks,
                    episodes=tried,
                    successes=successes,
                    videos=tuple(recorded),
                )
            )
        made = video_files.Videos(update=trained.update, situations=tuple(parts))
        replace_text(target / video_files.NAME, made.model_dump_json(indent=2) + "\n")
    return made


def find_situation(trained: TrainedAgent, extreme: Extreme) -> Situation:
    """The most frequent situation of the uniform levels, or the rarest; of the train levels where
    there are no uniform ones.

    The first rank takes its extreme value, then the next rank its own among situations with that
    one, and so on: where objects are drawn without replacement the second is not that of the first.
    """
    found = []
    split = trained.config.split
    for level in split.uniform or split.train:
        with closing(_envs(trained, level, AT_A_TIME)) as env:
            ranks: dict[str, int] = {}
            for name in env.situation:
                drawn = [
                    env.reset(seed=seed, options=ranks)[1][name]
                    for seed in range(0, 10 * AT_A_TIME, AT_A_TIME)
                ]
                ranks[name] = extreme(np.concatenate(drawn))
            found.append(Situation(level, ranks))
    best = extreme(np.array([next(iter(one.ranks.values())) for one in found]))
    return next(one for one in found if next(iter(one.ranks.values())) == best)


def play(trained: TrainedAgent, situation: Situation, name: str) -> tuple[list[Episode], int, int]:
    """Plays a situation until it has had both outcomes, `EPISODES` at most; the agent's draws are
    seeded from `name`.

    Returns the first success and the first failure, without an outcome that there was not; how many
    episodes were played, and how many of them succeeded.
    """
    first: dict[video_files.Outcome, Episode] = {}
    tried = successes = 0
    policy = AgentPolicy(trained.agent, seed=derive_seed(0, "videos", name))
    with closing(_envs(trained, situation.level, AT_A_TIME)) as env:
        while tried < EPISODES and len(first) < len(OUTCOMES):
            for episode in _batch(env, policy, situation, seed=tried):
                first.setdefault(episode.outcome, episode)
                successes += episode.success
            tried += env.num_envs
    return [first[outcome] for outcome in OUTCOMES if outcome in first], tried, successes


def _batch(
    env: ZipfVectorEnv, policy: AgentPolicy, situation: Situation, seed: int
) -> Iterator[Episode]:
    """One episode in every env, in the order of envs."""
    policy.start(env.num_envs)
    observation, _ = env.reset(seed=seed, options=situation.ranks)
    reward = np.zeros(env.num_envs, np.float32)
    is_first = np.ones(env.num_envs, np.bool_)
    taken: list[NDArray[np.int64]] = []
    ended: dict[int, Episode] = {}
    while len(ended) < env.num_envs:
        actions = policy(observation, reward, is_first)
        taken.append(np.asarray(actions, np.int64))
        observation, rewards, terminated, truncated, info = env.step(actions)
        reward, is_first = rewards.astype(np.float32), terminated | truncated
        env.check_lengths()
        for i in np.flatnonzero(is_first).tolist():
            if i not in ended:
                outcome = info["final_info"]
                ended[i] = Episode(
                    seed=seed + i,
                    success=bool(outcome["success"][i]),
                    episode_return=float(outcome["return"][i]),
                    actions=np.array([each[i] for each in taken]),
                )
    yield from (ended[i] for i in range(env.num_envs))


def _record(trained: TrainedAgent, situation: Situation, episode: Episode, path: Path) -> Video:
    length = len(episode.actions)
    every = ceil((length + 1) / MOST_FRAMES)
    drawn = {"autoreset_mode": AutoresetMode.DISABLED, "render_mode": "rgb_array"}
    with closing(_envs(trained, situation.level, 1, **drawn)) as env:
        env.reset(seed=episode.seed, options=situation.ranks)
        info: dict[str, Any] = {}
        with Recording(path, min(env.metadata["render_fps"], MOST_FPS)) as recording:
            recording.add(_picture(env))
            for step, action in enumerate(episode.actions, 1):
                _, _, terminated, truncated, info = env.step(np.array([action]))
                if step % every == 0 or step == length:
                    recording.add(_picture(env))
                if (terminated | truncated).any() != (step == length):
                    raise _not_alike(situation)
            recording.hold(PAUSE)
    if bool(info["success"][0]) != episode.success:
        raise _not_alike(situation)
    return Video(
        file=path.name,
        outcome=episode.outcome,
        seed=episode.seed,
        episode_return=episode.episode_return,
        length=length,
        every=every,
    )


def _picture(env: ZipfVectorEnv) -> NDArray[np.uint8]:
    frames = env.render()
    assert frames is not None
    picture = np.asarray(frames[0], np.uint8)
    return enlarge(picture, ceil(HEIGHT / len(picture)))


def _playable(folder: Path, trained: TrainedAgent) -> None:
    if trained.agent.answers_questions:
        raise UserError(
            f"videos: {folder.as_posix()} is of a classifier, which answers questions and does "
            "not act"
        )
    with closing(_envs(trained, trained.config.split.train[0], 1)) as env:
        for has, lacks in (
            (env.reports_success, "report no success"),
            (env.metadata.get("render_modes"), "draw no pictures"),
            (env.situation, "report no situation"),
        ):
            if not has:
                raise UserError(
                    f"videos: the envs of {folder.as_posix()} {lacks}; give runs of envs that do"
                )


def _envs(
    trained: TrainedAgent, level: envs.SplitLevel, count: int, **kwargs: Any
) -> ZipfVectorEnv:
    options = {**trained.config.level_options, **kwargs}
    return envs.make_scored(trained.config.split, level, count, **options)


def _not_alike(situation: Situation) -> UserError:
    return UserError(
        f"videos: level {situation.level.name} does not play the same actions alike twice, and "
        "so an episode cannot be recorded after it was played"
    )
