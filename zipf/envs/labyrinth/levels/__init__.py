"""The levels of the labyrinth, one file for each kind."""

from zipf.envs.labyrinth.levels.explore_goals import GoalLocationsLarge, GoalLocationsSmall
from zipf.envs.labyrinth.world import Episode

LEVELS: dict[str, type[Episode]] = {
    "explore_goal_locations_small": GoalLocationsSmall,
    "explore_goal_locations_large": GoalLocationsLarge,
}
"""By name."""
