"""What the paper claims, and whether scores bear it out.

Every claim with the checks that it comes down to, by experiment. The bounds are ours, as the paper
(Chan, Lampinen, Richemond and Hill 2022) states effects and no bounds; the note of a claim says how
they were chosen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from zipf.experiments.reporting.claim_checks import (
    EVERY,
    SCORES,
    UNDECIDED,
    Check,
    CurvesCheck,
    EffortCheck,
    Outcome,
    Verdict,
    WindowCheck,
    change,
    published_results,
    results_of,
    share,
    together,
)
from zipf.experiments.reporting.tables import ScoreTable

CLAIM_COLUMNS = ("claim", "statement", "table", "bounds", "outcome", "numbers", "paper", "note")


@dataclass(frozen=True)
class Claim:
    """What the paper claims."""

    id: str
    statement: str
    source: str  # where the paper does
    checks: Mapping[str, Sequence[Check]]  # by experiment; all of an experiment have to hold
    note: str = ""  # how the bounds were chosen, or why there are no checks


def on(experiments: str, *checks: Check) -> dict[str, Sequence[Check]]:
    """The same checks of several experiments."""
    return dict.fromkeys(experiments.split(), checks)


PUBLISHED_WINDOWS: Mapping[str, tuple[int, int]] = {
    "gridworld": (2_000_000, 3_000_000),
    "playroom_lifting": (300_000, 400_000),
    "playroom_putting": (300_000, 400_000),
    "playroom_finding": (2_000_000, 3_000_000),
    "labyrinth_forward": (200_000, 380_000),
    "labyrinth_reversed": (200_000, 380_000),
}
"""The window, in updates, from which the paper takes the scores of each of its experiments."""

LIFTING, PUTTING, FINDING = "playroom_lifting", "playroom_putting", "playroom_finding"
LABYRINTH = "labyrinth_forward labyrinth_reversed"
NOT_FINDING = f"gridworld {LIFTING} {PUTTING} {LABYRINTH}"
FREQUENT = "Putting (frequent only)"
VISION, BOTH = "impala_vision", "impala_vision_language"
SELF_SUPERVISED = "Results, on self-supervised learning"
REPLAY = "Results, on prioritised replay"
HALF = "Half of the published effect is enough."
t = SCORES

CLAIMS = (
    Claim(
        "rare_lower",
        "Scores on rare situations are lower than on all situations alike, for every agent.",
        "Results, first paragraph",
        on(" ".join(PUBLISHED_WINDOWS), t[EVERY, "rare"] - t[EVERY, "uniform"] <= -0.005),
        "Lower by more than tables round away.",
    ),
    Claim(
        "fig_misleading",
        "IMPALA looks almost perfect on the training distribution, and acts correctly in less than "
        "60 % of episodes on the rarest objects.",
        'Figure "misleading"',
        on(LIFTING, t["impala", "train"] >= 0.95, t["impala", "rare"] <= 0.6),
    ),
    Claim(
        "lab_train_higher",
        "In the labyrinth, training scores are higher than uniform and rare ones, for every agent.",
        "Table tab:labyrinth_results, caption",
        on(
            LABYRINTH,
            t[EVERY, "train"] - t[EVERY, "uniform"] >= 0.005,
            t[EVERY, "train"] - t[EVERY, "rare"] >= 0.005,
        ),
        "Higher by more than tables round away.",
    ),
    Claim(
        "playroom_train_range",
        "Training scores are 0.97 to 1.00 for lifting and 0.97 to 0.99 for putting, except for "
        "V-MPO and the MLP.",
        "Table tab:playroom_results, caption",
        {
            LIFTING: [(t[EVERY, "train"] >= 0.965).without("vmpo", "impala_mlp")],
            PUTTING: [
                (t[EVERY, FREQUENT] >= 0.965).without("vmpo", "impala_mlp", "r2d2_uniform_replay")
            ],
        },
        "A score that rounds to 0.97 counts.",
    ),
    Claim(
        "grid_train",
        "In the gridworld, training scores are 0.85 for IMPALA and 0.99 with visual "
        "reconstruction.",
        "Table tab:gridworld_results, caption",
        on("gridworld", t["impala", "train"].between(0.8, 0.9), t[VISION, "train"] >= 0.94),
        "Within 0.05 of the published score.",
    ),
    Claim(
        "vmpo_put",
        "V-MPO does not learn putting, even in training.",
        "Results",
        on(PUTTING, t["vmpo", FREQUENT] <= 0.5),
        "At most half of the episodes.",
    ),
    Claim(
        "per_putting",
        "R2D2 without prioritised replay scores 17 % less on putting.",
        REPLAY,
        on(
            PUTTING,
            change(t["r2d2_uniform_replay", "uniform"], t["r2d2", "uniform"]) <= -0.08,
            change(t["r2d2_uniform_replay", "rare"], t["r2d2", "rare"]) <= -0.09,
        ),
        HALF,
    ),
    Claim(
        "per_exponent",
        "A larger exponent of the priorities makes little difference.",
        REPLAY,
        on(
            f"{LIFTING} {PUTTING}",
            change(t["r2d2[,-]*priority_exponent[=_][1-9]*", "rare"], t["r2d2", "rare"]).between(
                -0.1, 0.1
            ),
        ),
        "Within 10 %, of exponents from 1 on; the paper prints no number.",
    ),
    Claim(
        "ssl_lift_rare",
        "Reconstructing vision and language improves rare lifting by 12 %.",
        SELF_SUPERVISED,
        on(LIFTING, change(t[BOTH, "rare"], t["impala", "rare"]) >= 0.06),
        HALF,
    ),
    Claim(
        "ssl_put_rare",
        "Reconstructing vision and language improves rare putting by 18 %.",
        SELF_SUPERVISED,
        on(PUTTING, change(t[BOTH, "rare"], t["impala", "rare"]) >= 0.09),
        HALF,
    ),
    Claim(
        "ssl_lift_all",
        "Reconstructing vision and language changes uniform lifting by -1 %.",
        SELF_SUPERVISED,
        on(LIFTING, change(t[BOTH, "uniform"], t["impala", "uniform"]).between(-0.06, 0.04)),
        "Within 5 % of the published change.",
    ),
    Claim(
        "ssl_put_all",
        "Reconstructing vision and language improves uniform putting by 10 %.",
        SELF_SUPERVISED,
        on(PUTTING, change(t[BOTH, "uniform"], t["impala", "uniform"]) >= 0.05),
        HALF,
    ),
    Claim(
        "ssl_equal_parts",
        "Vision and language contribute about equally to the improvement on rare objects.",
        SELF_SUPERVISED,
        on(
            f"{LIFTING} {PUTTING}",
            share(t[VISION, "rare"], t[BOTH, "rare"], t["impala", "rare"]).between(0.25, 0.75),
        ),
        "Vision alone makes a quarter to three quarters of the improvement; the paper has no "
        "condition with language alone.",
    ),
    Claim(
        "ssl_grid_rare",
        "Visual reconstruction improves the rarest maps and objects of the gridworld by 20 %.",
        SELF_SUPERVISED,
        on("gridworld", change(t[VISION, "rare"], t["impala", "rare"]) >= 0.1),
        HALF,
    ),
    Claim(
        "ssl_grid_all",
        "Visual reconstruction improves the uniform score in the gridworld by 16 %.",
        SELF_SUPERVISED,
        on("gridworld", change(t[VISION, "uniform"], t["impala", "uniform"]) >= 0.08),
        HALF,
    ),
    Claim(
        "ssl_lab",
        "In the labyrinth, self-supervised learning brings less: 3 to 6 %.",
        SELF_SUPERVISED,
        on(
            LABYRINTH,
            (t[VISION, "uniform"] - t["impala", "uniform"]).between(0.015, 0.12),
            (t[BOTH, "uniform"] - t["impala", "uniform"]).between(0.015, 0.12),
        ),
        "Read as points of the uniform score, which is what the paper's table has; half to twice "
        "the published effect.",
    ),
    Claim(
        "byol_failed",
        "BYOL, as implemented there, does not help.",
        SELF_SUPERVISED,
        on(NOT_FINDING, t["impala_byol", "rare"] - t["impala", "rare"] <= 0.05),
        "No gain of more than 0.05.",
    ),
    Claim(
        "transformer_no_gain",
        "A transformer in the place of the LSTM is no better on rare situations.",
        "Results, on memory",
        on(NOT_FINDING, t["impala_transformer", "rare"] - t["impala", "rare"] <= 0.05),
        "No gain of more than 0.05.",
    ),
    Claim(
        "supervised_equal",
        "On finding, the agent and a supervised classifier score almost the same.",
        "Table tab:playroom_results:supervised",
        on(
            FINDING,
            (t["impala", "uniform"] - t["supervised", "uniform"]).between(-0.05, 0.05),
            (t["impala", "rare"] - t["supervised", "rare"]).between(-0.05, 0.05),
        ),
        "Within 0.05.",
    ),
    Claim(
        "rl_curve_match",
        "On finding, the learning curves of the agent and the classifier are very similar.",
        "Results, on supervised learners",
        on(
            FINDING,
            CurvesCheck(("impala", "supervised"), "uniform", at_most=0.05),
            CurvesCheck(("impala", "supervised"), "rare", at_most=0.05),
        ),
        "The median curves differ by at most 0.05 on average; the paper shows no such figure.",
    ),
    Claim(
        "below_uniform_training",
        "The best agents on rare situations stay well below an agent trained on uniform "
        "experience.",
        "Abstract",
        {},
        "needs an agent trained on the uniform levels, which is in none of the paper's tables",
    ),
    Claim(
        "windows",
        "Scores are taken from updates 300k to 400k (playroom), 200k to 380k (labyrinth) and 2M to "
        "3M (gridworld, finding).",
        "Training and evaluation",
        {one: [WindowCheck(window)] for one, window in PUBLISHED_WINDOWS.items()},
    ),
    Claim(
        "eval_episodes",
        "Three seeds of a condition, and at least 1000 episodes of a level in each evaluation.",
        "Appendix, using the benchmarks",
        on(" ".join(PUBLISHED_WINDOWS), EffortCheck(seeds=3, episodes=1000)),
    ),
    Claim(
        "fps",
        "Envs run at about 900 (playroom), 700 to 1000 (labyrinth) and 4,700 (gridworld) frames "
        "per second.",
        "Appendix, environment details",
        {},
        "result files have the speed of training; the scripts that benchmark envs measure theirs",
    ),
)


@dataclass(frozen=True)
class ClaimLine:
    """A claim about one table."""

    claim: Claim
    table: str  # the title of the table; empty where no run of the claim's experiments is there
    outcome: Outcome  # of all checks of this experiment together
    verdicts: tuple[Verdict, ...]  # of each
    # the outcome with the paper's own numbers; None where it prints too few of them
    paper: Outcome | None

    @property
    def at_hand(self) -> bool:
        """Whether any score that it needs is known."""
        return any(verdict.at_hand for verdict in self.verdicts)

    @property
    def numbers(self) -> str:
        """What the outcome rests on."""
        return "; ".join(text for verdict in self.verdicts for text in verdict.numbers)

    @property
    def bounds(self) -> str:
        """When it would hold."""
        return "; ".join(dict.fromkeys(verdict.bounds for verdict in self.verdicts))


def check_claims(tables: Sequence[ScoreTable]) -> list[ClaimLine]:
    """Every claim of the paper, a line for each table of an experiment that it is about; one line
    where there is none."""
    reached = [table for table in tables if table.unreached is None]
    known = [(table, results_of(table)) for table in reached]
    lines = []
    for claim in CLAIMS:
        found = []
        for experiment, checks in claim.checks.items():
            printed = published_results(experiment)
            paper = together([check.judge(printed).outcome for check in checks])
            for table, results in known:
                if table.description.paper == experiment:
                    verdicts = tuple(check.judge(results) for check in checks)
                    outcome = together([verdict.outcome for verdict in verdicts])
                    on_paper = None if paper == UNDECIDED else paper
                    found.append(ClaimLine(claim, table.title, outcome, verdicts, on_paper))
        lines += found or [ClaimLine(claim, "", UNDECIDED, (), None)]
    return lines


def csv_claims(lines: Sequence[ClaimLine]) -> str:
    """`claims.csv`: every line, whether there are scores for it or not."""
    cells = []
    for line in lines:
        judged = line.bounds, line.outcome, line.numbers, line.paper or ""
        cells.append((line.claim.id, line.claim.statement, line.table, *judged, line.claim.note))
    return pd.DataFrame(cells, columns=list(CLAIM_COLUMNS)).to_csv(index=False, lineterminator="\n")
