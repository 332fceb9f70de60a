"""`python -m zipf.play level=<level>`: play a level, or watch and record episodes."""

from __future__ import annotations

import signal
import sys

from zipf.output import is_quiet, run_command

__all__ = ["main"]

USAGE = """usage: python -m zipf.play level=NAME [option=value ...]
       python -m zipf.play run=FOLDER [option=value ...]

Opens a window, or the terminal, in which you play a level by hand or watch a scripted policy or a
trained agent; or records episodes, or a picture, to a file. The screen lists the keys; q leaves.

Examples:

    python -m zipf.play level=gridworld/zipf_2
    python -m zipf.play level=gridworld/rare policy=expert record=expert.mp4 episodes=3
    python -m zipf.play run=runs/demo/impala_mlp/seed0 level=rare record=agent.gif
    python -m zipf.play level=playroom/lift/lift_shape_zipf3 record=room.png size=1600x1200

Options:

    level=NAME      a level; with run=: also train, uniform, rare, validation or fresh, the run's
                    levels of that kind; default with run=: train
    run=FOLDER      a run's folder with a checkpoint or, without one, weights: its agent plays, in
                    the envs of the run
    policy=NAME     keyboard, random, agent (of the run), or a script: expert, which reads the state
                    of the env, or generalist, which knows what has been in view;
                    default: agent with run=, otherwise keyboard
    record=FILE     a film: a .gif, for short ones, of at most 10 frames per second, or an .mp4 (pip
                    install ".[video]" in a clone of zipf); or a still, a .png of an episode's first
                    frame. A strip below the picture has title, situation and outcome. No screen
                    opens unless you play; default: nothing is recorded
    episodes=N      default: 1 without a screen, otherwise until you leave
    seed=N          of the envs and the actions; default: a new one each time, which is printed
    fps=N           steps per second, 1 to 120; default: those of the family
    size=WxH        pixels of the picture, without the text below: it is drawn as large as fits, in
                    its own proportions, in windows and recordings. Playroom and labyrinth are
                    rendered at that size, the gridworld and what an agent sees are enlarged by a
                    whole factor; default: 640x480
    view=NAME       world (drawn for people) or agent (its image); default: world, agent in a
                    terminal
    screen=NAME     window (pip install ".[human]" in a clone of zipf), terminal, or auto: a window
                    if possible; default: auto
    plugins=NAMES   modules to import, for envs and agents from outside the package; default: none
    --quiet, -q     print nothing but warnings and errors
"""


def main() -> None:
    """The command."""
    sys.exit(run_command(USAGE, _play))


def _play(arguments: list[str]) -> None:
    # Here, because help needs none of these.
    from zipf.experiments.options.command_line import read_options
    from zipf.experiments.playing.playing import PlayOptions, play

    for name in ("SIGTERM", "SIGHUP"):  # leave a terminal and a recording in order
        if hasattr(signal, name):  # Windows has no SIGHUP
            signal.signal(signal.Signals[name], _exit)
    options = read_options(PlayOptions, arguments)
    play(options, (lambda line: None) if is_quiet() else lambda line: print(line, flush=True))


def _exit(number: int, frame: object) -> None:
    sys.exit(128 + number)


if __name__ == "__main__":
    main()
