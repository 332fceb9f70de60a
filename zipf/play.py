"""`python -m zipf.play level=<level>`: play a level, or watch and record episodes."""

from __future__ import annotations

import signal
import sys

from zipf.experiments.command_line import read_options
from zipf.experiments.errors import UserError
from zipf.experiments.output import keep_going
from zipf.experiments.playing.playing import PlayOptions, play

__all__ = ["main"]

USAGE = """Plays a level by hand, or shows or records episodes of a script or an agent.

    python -m zipf.play level=gridworld/zipf_2
    python -m zipf.play level=gridworld/rare policy=expert record=expert.mp4 episodes=3
    python -m zipf.play run=runs/demo/impala_mlp/seed0 level=rare record=agent.gif

level=NAME        a level; with run=, also train, uniform or rare: the run's levels of that kind
run=FOLDER        a run's folder with a checkpoint: its agent plays, in the worlds of the run
policy=NAME       keyboard, random, agent (of the run), or a script: expert, which reads the state
                  of the world, or generalist, which knows what has been in view
record=FILE       a .gif, for short recordings, or an .mp4; opens no screen unless you play
episodes=N        default: 1 without a screen, otherwise until you leave
plugins=NAMES     modules to import, for worlds and agents from outside the package
seed=N            of the worlds and the actions; default: a new one each time, which is printed
fps=N             frames per second; default: those of the family
scale=N           side of a pixel in windows and recordings, in pixels of the screen
view=NAME         world (drawn for people) or agent (its image); default: agent in a terminal
screen=auto       window, terminal, or auto: a window if possible

The screen lists the keys; q leaves."""


def main() -> None:
    """The command."""
    keep_going()
    arguments = sys.argv[1:]
    if not arguments or {"-h", "--help"} & set(arguments):
        print(USAGE)
        sys.exit(0 if arguments else 2)
    for number in (signal.SIGTERM, signal.SIGHUP):  # leave a terminal and a recording in order
        signal.signal(number, _exit)
    try:
        play(read_options(PlayOptions, arguments), lambda line: print(line, flush=True))
    except KeyboardInterrupt:
        sys.exit(130)
    except UserError as error:
        for line in str(error).splitlines():
            print(f"error: {line}", file=sys.stderr)
        sys.exit(2)


def _exit(number: int, frame: object) -> None:
    sys.exit(128 + number)


if __name__ == "__main__":
    main()
