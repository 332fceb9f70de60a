"""The words of reports and of the code, one meaning each; `docs/glossary.md` shows them."""

GLOSSARY = (
    ("environment (env)", "what an agent acts in; environments are stepped in batches"),
    (
        "family",
        "levels that share an engine, observations and actions, and differ in task and "
        "distribution: gridworld, playroom, labyrinth",
    ),
    ("level", "a named environment with a fixed distribution of situations"),
    (
        "level kind",
        "what a level is for: train (Zipfian), uniform, rare (the rarest fifth), validation "
        "(the middle fifth), fresh (maps that nobody trains on)",
    ),
    ("split", "the levels of each kind, to train on and to be scored on"),
    (
        "situation",
        "what was drawn for an episode, such as its map and its target, as frequency ranks",
    ),
    ("rank", "place in the order of frequency, 0 = most frequent"),
    (
        "exponent",
        "the alpha of Zipf's law: the situation of rank k is drawn in proportion to 1 / (k + "
        "1)^alpha",
    ),
    ("policy", "what chooses actions: an agent, a script, any function of observations"),
    ("baseline", "what a policy that does not learn scores: chance, blind, generalist, expert"),
    (
        "floor, blind",
        "the best known score of a policy that is not told what an episode asks for",
    ),
    ("frame", "one step of an environment as the agent sees it, after action repeat"),
    ("unroll", "T steps of B environments that an update learns from"),
    ("update", "one step of the optimiser; with PPO several, on one unroll"),
    ("behaviour policy, target policy", "the weights that acted, and those that learn from it"),
    ("lag", "how many unrolls collection runs ahead of learning"),
    ("memory", "what an agent carries from frame to frame; that of the machine is RAM"),
    ("burn-in", "rows before a sequence that bring its memory up to date and are not learned from"),
    (
        "priority",
        "what a sequence's probability of being replayed grows with: its temporal-difference error",
    ),
    ("encoder, head", "the parts of a network before and after the memory"),
    ("auxiliary loss", "what the memory's output has to predict in addition to policy and value"),
    ("hindsight", "learning from episodes as if they had asked for what they achieved"),
    ("memory of goals", "kept episodes of each goal, from which hindsight learns about all alike"),
    ("matcher", "the part of a network that tells where an image shows what an instruction names"),
    ("teacher", "a scripted policy whose actions an agent imitates"),
    ("stage", "one of several trainings of which each begins with the weights of an earlier one"),
    ("condition", "a row of a table: agent, memory, auxiliary loss and other parts"),
    ("experiment", "environments, schedule and values of options: a file of configs/experiments/"),
    (
        "seed",
        "of all random draws of a run; a table's number is the median over the seeds of a "
        "condition",
    ),
    ("window", "the interval of updates that a run's number is taken from"),
)
"""Words and their meanings."""
