"""The levels of the labyrinth, one file for each kind."""

from zipf.envs.labyrinth.levels import (
    explore_goals,
    explore_object_locations,
    explore_object_rewards,
    natlab,
    rooms_collect,
    rooms_exploit,
    rooms_keys_doors,
    rooms_select,
    rooms_watermaze,
    skymaze,
)
from zipf.envs.labyrinth.world import Episode

LEVELS: dict[str, type[Episode]] = {
    "rooms_collect_good_objects_train": rooms_collect.CollectGoodObjects,
    "rooms_exploit_deferred_effects_train": rooms_exploit.ExploitDeferredEffects,
    "rooms_select_nonmatching_object": rooms_select.SelectNonmatchingObject,
    "rooms_keys_doors_puzzle": rooms_keys_doors.KeysDoorsPuzzle,
    "rooms_watermaze": rooms_watermaze.Watermaze,
    "natlab_fixed_large_map": natlab.FixedLargeMap,
    "natlab_varying_map_regrowth": natlab.VaryingMapRegrowth,
    "natlab_varying_map_randomized": natlab.VaryingMapRandomized,
    "skymaze_irreversible_path_hard": skymaze.IrreversiblePathHard,
    "skymaze_irreversible_path_varied": skymaze.IrreversiblePathVaried,
    "explore_object_locations_small": explore_object_locations.ObjectLocationsSmall,
    "explore_object_locations_large": explore_object_locations.ObjectLocationsLarge,
    "explore_obstructed_goals_small": explore_goals.ObstructedGoalsSmall,
    "explore_obstructed_goals_large": explore_goals.ObstructedGoalsLarge,
    "explore_goal_locations_small": explore_goals.GoalLocationsSmall,
    "explore_goal_locations_large": explore_goals.GoalLocationsLarge,
    "explore_object_rewards_few": explore_object_rewards.ObjectRewardsFew,
    "explore_object_rewards_many": explore_object_rewards.ObjectRewardsMany,
}
"""By name."""
