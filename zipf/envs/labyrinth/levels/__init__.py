"""The levels of the labyrinth: one file for each kind, and here what is said of all of them."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

from zipf.envs.arguments import unknown
from zipf.envs.labyrinth.state import FRAMES_PER_SECOND

if TYPE_CHECKING:
    from zipf.envs.labyrinth.episode import Episode


@dataclass(frozen=True)
class Level:
    """A level: its rules, its length and the published scores."""

    name: str  # in DeepMind Lab
    rules: str  # "module:class", an `Episode`
    seconds: int  # of an episode
    # random, human: mean returns of random actions and of people in the original engine, as three
    # public code bases have them (scalable_agent, seed_rl, sample-factory). Those of levels that
    # end in `_train` were taken on their `_test` variants.
    random: float
    human: float

    @property
    def frames(self) -> int:
        """Frames of an episode."""
        return self.seconds * FRAMES_PER_SECOND

    def load(self) -> type[Episode]:
        """The class of the rules."""
        module, name = self.rules.split(":")
        loaded: type[Episode] = getattr(importlib.import_module(f"{__name__}.{module}"), name)
        return loaded


_TABLE = """
name                                  rules                                           s random human
rooms_collect_good_objects_train      rooms_collect:CollectGoodObjects               60  0.073 10
rooms_exploit_deferred_effects_train  rooms_exploit:ExploitDeferredEffects           60  8.501 85.65
rooms_select_nonmatching_object       rooms_select:SelectNonmatchingObject           12  0.312 65.9
rooms_watermaze                       rooms_watermaze:Watermaze                     120  4.065 54
rooms_keys_doors_puzzle               rooms_keys_doors:KeysDoorsPuzzle               60  4.135 53.8
language_select_described_object      language_select:SelectDescribedObject          60  -0.07 389.5
language_select_located_object        language_select:SelectLocatedObject           120  1.929 280.7
language_execute_random_task          language_execute:ExecuteRandomTask           120 -5.913 254.05
language_answer_quantitative_question language_answer:AnswerQuantitativeQuestion     60  -0.33 184.5
lasertag_one_opponent_small           lasertag:OneOpponentSmall                     240 -0.224 12.65
lasertag_three_opponents_small        lasertag:ThreeOpponentsSmall                  240 -0.214 18.55
lasertag_one_opponent_large           lasertag:OneOpponentLarge                     240 -0.083 18.6
lasertag_three_opponents_large        lasertag:ThreeOpponentsLarge                  240 -0.102 31.5
natlab_fixed_large_map                natlab:FixedLargeMap                          120  2.173 36.9
natlab_varying_map_regrowth           natlab:VaryingMapRegrowth                     120  2.989 24.45
natlab_varying_map_randomized         natlab:VaryingMapRandomized                   120  7.346 42.35
skymaze_irreversible_path_hard        skymaze:IrreversiblePathHard                   60    0.1 100
skymaze_irreversible_path_varied      skymaze:IrreversiblePathVaried                 60   14.4 100
psychlab_arbitrary_visuomotor_mapping psychlab_memory:ArbitraryVisuomotorMapping    300  0.163 58.75
psychlab_continuous_recognition       psychlab_memory:ContinuousRecognition         300  0.224 58.3
psychlab_sequential_comparison        psychlab_comparison:SequentialComparison      300  0.129 39.5
psychlab_visual_search                psychlab_search:VisualSearch                  150  0.085 78.5
explore_object_locations_small        explore:ObjectLocationsSmall                   90  3.575 74.45
explore_object_locations_large        explore:ObjectLocationsLarge                  120  4.673 65.65
explore_obstructed_goals_small        explore:ObstructedGoalsSmall                   90   6.76 206
explore_obstructed_goals_large        explore:ObstructedGoalsLarge                  120   2.61 119.5
explore_goal_locations_small          explore:GoalLocationsSmall                     90   7.66 267.5
explore_goal_locations_large          explore:GoalLocationsLarge                    120   3.14 194.5
explore_object_rewards_few            explore:ObjectRewardsFew                       90  2.073 77.7
explore_object_rewards_many           explore:ObjectRewardsMany                     120  2.438 106.7
"""

LEVELS: dict[str, Level] = {
    name: Level(name, rules, int(seconds), float(random), float(human))
    for name, rules, seconds, random, human in map(str.split, _TABLE.splitlines()[2:])
}
"""All levels by name, in the order of the paper: the most frequent first."""

_LONGER = "_v2"  # what the paper adds to the names of the skymazes


def by_name(name: str) -> Level:
    """The level of this name, with or without `labyrinth/` before it.
    Raises ValueError: there is no such level."""
    if not isinstance(name, str):
        raise ValueError(f"level must be a name, got {name!r}: expected one of {', '.join(LEVELS)}")
    plain = name.removeprefix("labyrinth/")
    if plain.startswith("skymaze_"):
        plain = plain.removesuffix(_LONGER)
    if plain not in LEVELS:
        raise unknown("level", plain, LEVELS)
    return LEVELS[plain]
