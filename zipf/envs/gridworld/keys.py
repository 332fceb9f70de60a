"""The gridworld's keys: arrows, the letters of roguelike games, and the numeric pad."""

from zipf.envs.keyboard import Binding, Keys

KEYS = Keys(
    (
        Binding(("up", "k", "8"), "north", (0,)),
        Binding(("pageup", "u", "9"), "north-east", (1,)),
        Binding(("right", "l", "6"), "east", (2,)),
        Binding(("pagedown", "n", "3"), "south-east", (3,)),
        Binding(("down", "j", "2"), "south", (4,)),
        Binding(("end", "b", "1"), "south-west", (5,)),
        Binding(("left", "h", "4"), "west", (6,)),
        Binding(("home", "y", "7"), "north-west", (7,)),
    ),
    goal="Walk to the object that the top left corner shows. Touching another ends the episode.",
)
