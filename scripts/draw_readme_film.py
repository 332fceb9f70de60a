"""Draws docs/agents.gif, the moving picture of the README: two trained agents in rare situations.

    python scripts/draw_readme_film.py

The agents are those in results/, whose weights come with the repository, and their scores those of
the record. Both play each rare situation once, the rarest first; the film shows the first six,
chosen by nothing else. Long episodes are shown faster towards their end.
"""

import argparse
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from zipf import envs
from zipf.envs import distributions
from zipf.experiments.evaluation.agent_policy import AgentPolicy
from zipf.experiments.evaluation.trained import load_agent
from zipf.experiments.playing.captions import BACKGROUND, BAD, BRIGHT, DIM, FONT, GOOD
from zipf.experiments.playing.recording import Recording

ROOT = Path(__file__).parent.parent
OUTPUT = ROOT / "docs" / "agents.gif"
RUNS = ROOT / "results" / "gridworld_conditions"
AGENTS = {
    "impala_mlp/seed1": "IMPALA",
    "imitation_comparing_augmented/seed1": "Imitation, compares view and cue",
}
LEVEL, TRAINED_ON = "gridworld/rare", "zipf_2"
SHOWN = 6  # situations
FPS = 12.5
SLOW, FAST = 20, 6  # steps that are all shown; then every so many-th is
PAUSE, END = 10, 30  # frames on the end of a situation, and of the film

LEGEND = "white: the agent and its view     amber: the cue and the object to find"
SIDE, GAP, TOP, HEAD, FOOT, LAST = 382, 12, 40, 56, 44, 28
WIDTH, HEIGHT = 2 * SIDE + 3 * GAP, TOP + HEAD + SIDE + FOOT + LAST


@dataclass(frozen=True)
class Episode:
    """The pictures of an episode, one more than its steps, and how it ended."""

    pictures: list[Image.Image]
    success: bool
    outcome: str

    def at(self, step: int) -> Image.Image:
        return self.pictures[min(step, self.steps)]

    @property
    def steps(self) -> int:
        return len(self.pictures) - 1


@cache  # of every frame
def situations() -> list[tuple[dict[str, int], float]]:
    """The rare situations and how often they are drawn in training, the rarest first."""
    rare, trained_on = (distributions.by_name(name) for name in ("rare", TRAINED_ON))
    sizes = envs.make_vec(LEVEL, 1).situation
    found = []
    for m in np.flatnonzero(rare(sizes["map"])).tolist():
        for t in np.flatnonzero(rare(sizes["target"])).tolist():
            often = float(trained_on(sizes["map"])[m] * trained_on(sizes["target"])[t])
            found.append(({"map": m, "target": t}, often))
    return sorted(found, key=lambda one: one[1])


def play(run: str) -> list[Episode]:
    """An episode of an agent in each rare situation."""
    trained = load_agent(RUNS / run, "cpu")
    policy = AgentPolicy(trained.agent, seed=0)
    env = envs.make_vec(LEVEL, 1, autoreset_mode="Disabled", render_mode="rgb_array")
    episodes = []
    for ranks, _ in situations():
        policy.start(1)
        observation, _ = env.reset(seed=0, options=ranks)
        reward, is_first, pictures = np.zeros(1, np.float32), np.ones(1, np.bool_), [picture(env)]
        while True:
            observation, rewards, over, late, info = env.step(policy(observation, reward, is_first))
            reward, is_first = rewards.astype(np.float32), np.zeros(1, np.bool_)
            pictures.append(picture(env))
            if over[0] or late[0]:
                break
        success = bool(info["success"][0])
        ending = "found it" if success else "out of time" if late[0] else "took another object"
        episodes.append(Episode(pictures, success, f"{ending}, step {len(pictures) - 1}"))
    return episodes


def picture(env: envs.ZipfVectorEnv) -> Image.Image:
    (drawn,) = env.pictures(2 * SIDE + 1, 2 * SIDE + 1)
    return Image.fromarray(drawn).resize((SIDE, SIDE), Image.Resampling.BOX)


@cache
def score(run: str, kind: str) -> float:
    """A score of the record."""
    table = pd.read_csv(ROOT / "results" / "scores.csv").set_index(["run", "level_kind"])
    return float(table.score[f"{RUNS.name}/{run}", kind])


def text(
    pen: ImageDraw.ImageDraw, x: float, y: float, words: str, size: int, colour: object
) -> None:
    pen.text((x, y), words, colour, ImageFont.truetype(FONT, size), anchor="lm")


def frame(episodes: dict[str, list[Episode]], number: int, step: int) -> NDArray[np.uint8]:
    """The film at a step of the episodes of a situation."""
    page = Image.new("RGB", (WIDTH, HEIGHT), BACKGROUND)
    pen = ImageDraw.Draw(page)
    one_in = 1 / situations()[number][1]
    words = f"Rare situation {number + 1}: in training 1 episode of {one_in:,.0f} is about it"
    text(pen, GAP, TOP / 2 + 4, words, 18, BRIGHT)
    for k, (run, played) in enumerate(episodes.items()):
        x, episode = GAP + k * (SIDE + GAP), played[number]
        ended = step >= episode.steps
        rare, train = (score(run, kind) for kind in ("rare", "train"))
        scores = f"finds {rare:.0%} of rare objects, {train:.0%} in training"
        text(pen, x, TOP + 16, AGENTS[run], 18, BRIGHT)
        text(pen, x, TOP + 40, scores, 15, DIM)
        page.paste(episode.at(step), (x, TOP + HEAD))
        y = TOP + HEAD + SIDE + FOOT / 2
        for i, other in enumerate(played[: number + ended]):
            colour = GOOD if other.success else BAD
            pen.ellipse((x + 18 * i, y - 6, x + 18 * i + 12, y + 6), colour)
        colour = DIM if not ended else GOOD if episode.success else BAD
        words = episode.outcome if ended else f"step {step}"
        text(pen, x + 18 * SHOWN + 12, y, words, 16, colour)
    text(pen, GAP, HEIGHT - LAST / 2 - 4, LEGEND, 15, DIM)
    return np.asarray(page)


def main() -> None:
    """Writes the film."""
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    episodes = {run: play(run) for run in AGENTS}
    with Recording(OUTPUT, FPS) as film:
        for number in range(SHOWN):
            longest = max(played[number].steps for played in episodes.values())
            fast = range(SLOW + FAST, longest, FAST)
            for step in [*range(min(SLOW, longest)), *fast, longest]:
                film.add(frame(episodes, number, step))
            film.hold(PAUSE / FPS if number < SHOWN - 1 else END / FPS)
    for run, played in episodes.items():
        found = [sum(one.success for one in some) for some in (played[:SHOWN], played)]
        print(f"{AGENTS[run]}: {found[0]} of {SHOWN} shown, {found[1]} of {len(played)} rare")
    print(f"wrote {OUTPUT.name}: {film.frames / FPS:.0f} s, {OUTPUT.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
