"""What the envs of an experiment have, and which choices they lack something for."""

from functools import cache

from zipf import envs
from zipf.agents import agents
from zipf.experiments.options import composing, config_files


@cache
def world_of(experiment):
    """One env of an experiment, closed."""
    worlds = composing.composed(f"experiment={experiment}").values["environment"]
    options = {name: value for name, value in worlds.items() if name != "split"}
    env = envs.make_vec(envs.split(worlds["split"]).train[0], 1, **options)
    env.close()
    return env


def speaks(experiment):
    """Whether the envs of an experiment have an instruction."""
    return "instruction" in world_of(experiment).single_observation_space.spaces


@cache
def asks(split):
    """Whether there are questions about the first frames of a split."""
    try:
        envs.questions(envs.split(split))
    except ValueError:
        return False
    return True


def achieves(experiment):
    """Whether the envs of an experiment tell what an episode has achieved."""
    return world_of(experiment).achieves


def kind_of_worlds(experiment):
    """What choices depend on: experiments of which this is the same need the same for them."""
    split = composing.composed(f"experiment={experiment}").values["environment"]["split"]
    family = envs.family_of_split(split)
    return family.name, asks(split), speaks(experiment), achieves(experiment)


def needs(
    experiment,
    agent="impala",
    auxiliary="none",
    network="compact",
    augmentation="none",
    hindsight="none",
    **_,
):
    """What envs of this experiment lack for it, in the words of the message; None for nothing."""
    split = composing.composed(f"experiment={experiment}").values["environment"]["split"]
    if agents()[agent].answers_questions and not asks(split):
        return f"splits with such questions: {', '.join(filter(asks, envs.all_splits()))}"
    if auxiliary in ("language", "vision_language") and not speaks(experiment):
        return "needs an instruction"
    if network in ("film", "attention", "matching") and not speaks(experiment):
        return "reads images by an instruction"
    if augmentation != "none" and envs.family_of_split(split).symmetries is None:
        return "declare no symmetries"
    if hindsight != "none" and not achieves(experiment):
        return "do not tell what an episode has achieved"
    return None


def chosen(experiment, condition):
    """What a condition's file chooses for these envs, by group."""
    file = config_files.find("condition", condition).values
    parts = dict(file["choose"])
    if not speaks(experiment):
        parts |= file.get("without_instruction", {})
    return parts


def possible(experiment, condition):
    return needs(experiment, **chosen(experiment, condition)) is None


@cache
def cheapest_pairs():
    """Pairs of experiment and condition: every condition with the cheapest experiment that it is
    possible with, of those with and of those without instructions, and every experiment with at
    least one condition.
    """
    cheapest = {}
    experiments = sorted(composing.choices("experiment"), key=cost)
    conditions = composing.choices("condition")
    for experiment in experiments:
        instructed = speaks(experiment)
        for condition in conditions:
            if (instructed, condition) not in cheapest and possible(experiment, condition):
                cheapest[instructed, condition] = experiment
    pairs = [(experiment, condition) for (_, condition), experiment in cheapest.items()]
    left = [experiment for experiment in experiments if experiment not in dict(pairs)]
    return pairs + [(experiment, "impala") for experiment in left]


def pairs_once():
    """Of these as few as have every experiment, and every condition with all that it chooses."""
    pairs = cheapest_pairs()
    for pair in cheapest_pairs():
        experiment, condition = pair
        rest = [one for one in pairs if one != pair]
        again = [one for one, other in rest if other == condition]
        parts = chosen(experiment, condition)
        if experiment in dict(rest) and any(
            speaks(one) or chosen(one, condition) == parts for one in again
        ):
            pairs = rest
    return pairs


def cost(experiment):
    """The levels that an evaluation scores, and the updates: few of both are for small machines."""
    values = composing.composed(f"experiment={experiment}").values
    split = envs.split(values["environment"]["split"])
    return sum(len(split.levels(kind)) for kind in envs.KINDS), values["updates"]
