"""The paper's claims: each outcome of each form, on the paper's own numbers, and in the report."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pandas as pd
import pytest
from run_folders import constant, write_run

from zipf import envs
from zipf.experiments.options import command_line
from zipf.experiments.records import paper, results
from zipf.experiments.reporting import markdown, tables
from zipf.experiments.reporting.claim_checks import (
    EVERY,
    CurvesCheck,
    EffortCheck,
    Expression,
    Measured,
    Results,
    WindowCheck,
    change,
    published_results,
    results_of,
    share,
    together,
)
from zipf.experiments.reporting.claim_checks import SCORES as t
from zipf.experiments.reporting.claims import CLAIM_COLUMNS, CLAIMS, check_claims, csv_claims

# By hand from the paper's tables; "" where they have too few numbers.
ON_THE_PAPERS_NUMBERS = {
    ("rare_lower", "gridworld"): "holds",
    ("rare_lower", "playroom_lifting"): "fails",
    ("rare_lower", "playroom_putting"): "fails",
    ("rare_lower", "playroom_finding"): "holds",
    ("rare_lower", "labyrinth_forward"): "fails",
    ("rare_lower", "labyrinth_reversed"): "fails",
    ("lab_train_higher", "labyrinth_reversed"): "fails",
    ("playroom_train_range", "playroom_putting"): "fails",
    ("per_exponent", "playroom_lifting"): "",
    ("per_exponent", "playroom_putting"): "",
    ("ssl_lab", "labyrinth_reversed"): "fails",
    ("rl_curve_match", "playroom_finding"): "",
}


def scores(seeds: int = 3, **of_conditions: dict[str, float]) -> Results:
    found = {
        (condition, column): Measured(value, seeds, 1000)
        for condition, columns in of_conditions.items()
        for column, value in columns.items()
    }
    return Results(found, every=list(of_conditions))


def test_claims_about_the_papers_own_numbers() -> None:
    for claim in CLAIMS:
        for experiment, checks in claim.checks.items():
            verdicts = [one.judge(published_results(experiment)) for one in checks]
            expected = ON_THE_PAPERS_NUMBERS.get((claim.id, experiment), "holds")
            if claim.id in ("windows", "eval_episodes"):  # which the paper's tables do not say
                expected = ""
            outcome = together([verdict.outcome for verdict in verdicts])
            assert outcome == (expected or "not enough data"), (claim.id, experiment)


def test_claims_name_what_there_is() -> None:
    conditions = set(command_line.choices("condition"))
    experiments = {split.paper for split in envs.all_splits().values() if split.paper}
    ids = [claim.id for claim in CLAIMS]
    assert len(ids) == len(set(ids)) == 24
    for claim in CLAIMS:
        assert claim.checks or claim.note
        for experiment, checks in claim.checks.items():
            assert experiment in experiments
            table = paper.paper_table(experiment)
            for one in checks:
                if isinstance(one, CurvesCheck):
                    assert {*one.conditions} <= conditions
                if isinstance(one, Expression):
                    assert {*one.but} <= set(table.rows)
                    for condition, column in one.places:
                        assert condition == EVERY or re.split(r"[,[]", condition)[0] in conditions
                        assert column in envs.PAPER_KINDS or column in table.train_groups


VALUE = t["b", "rare"]
DIFFERENCE = t["b", "rare"] - t["a", "rare"]
CHANGE = change(t["b", "rare"], t["a", "rare"])
SHARE = share(t["b", "rare"], t["c", "rare"], t["a", "rare"])


@pytest.mark.parametrize(
    ("one", "outcome", "number"),
    [
        (VALUE.between(0.6, 0.7), "holds", "b rare 0.60"),
        (VALUE.between(0.61, 0.7), "fails", "b rare 0.60"),
        (DIFFERENCE.between(0.1, 1), "holds", "b rare 0.60, a rare 0.50: +0.10"),
        (DIFFERENCE.between(-1, 0.05), "fails", "b rare 0.60, a rare 0.50: +0.10"),
        (CHANGE.between(0.2, 0.2), "holds", "b rare 0.60, a rare 0.50: +20 %"),
        (CHANGE.between(0.3, 1), "fails", "b rare 0.60, a rare 0.50: +20 %"),
        (SHARE.between(0.2, 0.4), "holds", "b rare 0.60, c rare 0.80, a rare 0.50: 33 %"),
        (SHARE.between(0.7, 1), "fails", "b rare 0.60, c rare 0.80, a rare 0.50: 33 %"),
        (VALUE >= 0.6, "holds", "b rare 0.60"),
        (VALUE >= 0.61, "fails", "b rare 0.60"),
        (DIFFERENCE <= 0.1, "holds", "b rare 0.60, a rare 0.50: +0.10"),
        (DIFFERENCE <= 0.09, "fails", "b rare 0.60, a rare 0.50: +0.10"),
    ],
)
def test_scores_between_bounds(one: Expression, outcome: str, number: str) -> None:
    known = {"a": {"rare": 0.5}, "b": {"rare": 0.6}, "c": {"rare": 0.8}}
    verdict = one.judge(scores(**known))
    assert (verdict.outcome, verdict.numbers) == (outcome, (number,))
    few = one.judge(scores(seeds=2, **known))
    assert few.outcome == "not enough data"
    assert "(2/3 seeds)" in few.numbers[0]
    missing = one.judge(scores(c={"uniform": 0.8}))
    assert (missing.outcome, missing.at_hand) == ("not enough data", False)


@pytest.mark.parametrize(
    ("one", "text"),
    [
        (VALUE >= 0.965, "at least 0.965"),
        (DIFFERENCE <= -0.005, "difference at most -0.005"),
        (CHANGE.between(-0.06, 0.04), "relative change -6 % to +4 %"),
        (SHARE.between(0.25, 0.75), "share of the improvement 25 % to 75 %"),
    ],
)
def test_bounds_in_words(one: Expression, text: str) -> None:
    assert one.bounds == text


@pytest.mark.parametrize("of_a", [0.0, -0.2])
@pytest.mark.parametrize(
    "one", [CHANGE <= 9, share(t["b", "rare"], t["a", "rare"], t["c", "rare"]) <= 9]
)
def test_a_fraction_of_nothing_or_of_less_is_not_enough(one: Expression, of_a: float) -> None:
    verdict = one.judge(scores(a={"rare": of_a}, b={"rare": 0.6}, c={"rare": 0.0}))
    assert (verdict.outcome, verdict.at_hand) == ("not enough data", True)


def test_a_pattern_stands_for_every_condition_that_it_fits() -> None:
    one = t["a,*exponent=*", "rare"] <= 0.5
    known = {"a": {"rare": 0.9}, "a,x.exponent=1": {"rare": 0.4}, "a,exponent=2": {"rare": 0.6}}
    assert one.judge(scores(**known)).outcome == "fails"
    del known["a,exponent=2"]
    assert one.judge(scores(**known)).numbers == ("a,x.exponent=1 rare 0.40",)
    assert one.judge(scores(a={"rare": 0.1})).outcome == "not enough data"


def test_every_row_has_to_hold() -> None:
    one = (t[EVERY, "rare"] - t[EVERY, "uniform"] <= -0.005).without("c")
    known = {
        "a": {"rare": 0.1, "uniform": 0.2},
        "b": {"rare": 0.3, "uniform": 0.4},
        "c": {"rare": 0.9, "uniform": 0.1},
    }
    assert one.judge(scores(**known)).numbers == ("2 of 2 rows hold",)
    known["b"]["rare"] = 0.4
    verdict = one.judge(scores(**known))
    assert verdict.outcome == "fails"
    assert verdict.numbers == ("1 of 2 rows hold", "not b rare 0.40, b uniform 0.40: +0.00")
    del known["b"]["uniform"]
    assert one.judge(scores(**known)).outcome == "not enough data"
    assert one.judge(scores(seeds=1, **known)).outcome == "not enough data"


@pytest.mark.parametrize(
    ("one", "of_a", "of_b", "floor", "decided"),
    [
        (DIFFERENCE, 0.1, 0.14, 0.1, False),
        (DIFFERENCE, 0.1, 0.15, 0.1, True),
        (DIFFERENCE, 0.15, 0.1, 0.1, True),
        (CHANGE, 0.1, 0.14, 0.1, False),
        (DIFFERENCE, 0.1, 0.14, math.nan, True),  # the floor is not known
        (VALUE, 0.1, 0.14, 0.1, True),  # nothing is compared
    ],
)
def test_scores_at_the_floor_are_not_compared(
    one: Expression, of_a: float, of_b: float, floor: float, decided: bool
) -> None:
    known = {
        (condition, "rare"): Measured(value, 3, 1000, floor)
        for condition, value in (("a", of_a), ("b", of_b))
    }
    verdict = (one <= 9).judge(Results(known, every=["a", "b"]))
    assert verdict.outcome == ("holds" if decided else "not enough data")
    assert ("none is 0.05 above the floor" in verdict.numbers[0]) != decided


def test_what_is_compared_is_also_shown_by_seed() -> None:
    """Of two conditions any two seeds are compared, of one its own scores of one seed."""
    known = {
        ("a", "rare"): Measured(0.2, 3, 1000, by_seed={0: 0.1, 1: 0.2, 2: 0.3}),
        ("a", "uniform"): Measured(0.5, 3, 1000, by_seed={0: 0.4, 1: 0.5, 2: 0.6}),
        ("b", "rare"): Measured(0.7, 3, 1000, by_seed={3: 0.6, 4: 0.7, 5: 0.9}),
    }
    found = Results(known, every=["a", "b"])
    both = t["b", "rare"] - t["a", "rare"] >= 0
    assert both.judge(found).numbers == (
        "b rare 0.70, a rare 0.20: +0.50 (by seed +0.30 to +0.80)",
    )
    one = t["a", "rare"] - t["a", "uniform"] <= 0
    assert one.judge(found).numbers == (
        "a rare 0.20, a uniform 0.50: -0.30 (by seed -0.30 to -0.30)",
    )


def test_curves_windows_and_effort() -> None:
    curves = CurvesCheck(("a", "b"), "rare", at_most=0.1)
    a, b = pd.Series({0: 0.9, 10: 0.2, 20: 0.3}), pd.Series({0: 0.0, 10: 0.3, 30: 0.9})
    found = Results({}, [], curves={("a", "rare"): (a, 3), ("b", "rare"): (b, 3)})
    verdict = curves.judge(found)  # update 10 alone: 0.1 apart
    assert (verdict.outcome, verdict.numbers) == (
        "holds",
        ("a and b, rare: 0.10 over 1 evaluations",),
    )
    far = Results({}, [], curves={("a", "rare"): (a + 0.5, 3), ("b", "rare"): (b, 3)})
    assert curves.judge(far).outcome == "fails"
    crossing = {("a", "rare"): (pd.Series({10: 0.1, 20: 0.7}), 3)}
    crossing["b", "rare"] = pd.Series({10: 0.5, 20: 0.3}), 3  # above, then below
    assert curves.judge(Results({}, [], curves=crossing)).outcome == "fails"
    scores = {(one, "rare"): Measured(0.5, 3, 1000, floor=0.48) for one in "ab"}
    unlearned = curves.judge(Results(scores, [], curves=found.curves))
    assert unlearned.outcome == "not enough data"
    assert unlearned.numbers[0].endswith("none is 0.05 above the floor")
    few = Results({}, [], curves={("a", "rare"): (a, 2), ("b", "rare"): (b, 3)})
    assert curves.judge(few).outcome == "not enough data"
    assert curves.judge(Results({}, [])).at_hand is False

    window = WindowCheck((100, 300))
    known = {("a", "rare"): Measured(0.5, 3, 1000)}
    assert window.judge(Results(known, [], window=(100, 300))).outcome == "holds"
    assert window.judge(Results(known, [], window=(100, 200))).outcome == "fails"
    assert window.judge(Results(known, [])).outcome == "fails"
    assert window.judge(Results({}, [], window=(100, 300))).outcome == "not enough data"

    effort = EffortCheck(seeds=3, episodes=1000)
    assert effort.judge(Results(known, [])).outcome == "holds"
    known[("b", "rare")] = Measured(0.5, 3, 999)
    assert effort.judge(Results(known, [])).outcome == "fails"
    assert effort.judge(Results({}, [])).outcome == "not enough data"


def test_a_curve_has_as_many_seeds_at_every_update(tmp_path: Path) -> None:
    """Seeds that were just begun do not make the others' curves those of three."""
    for condition in ("impala", "supervised"):
        for seed in range(3):
            scores = {0: (0.1,) * 3} if seed else {0: (0.1,) * 3, **constant(0.5)}
            worlds = {"paper": "playroom_finding", "experiment": "playroom_find"}
            write_run(tmp_path, scores, condition=condition, seed=seed, **worlds)
    lines = check_claims(tables.score_tables(results.load_runs([tmp_path])))
    (line,) = (line for line in lines if line.claim.id == "rl_curve_match")
    assert line.outcome == "not enough data"
    for condition in ("impala", "supervised"):
        for seed in range(3):
            worlds = {"paper": "playroom_finding", "experiment": "playroom_find"}
            write_run(tmp_path / "all", constant(0.5), condition=condition, seed=seed, **worlds)
    lines = check_claims(tables.score_tables(results.load_runs([tmp_path / "all"])))
    (line,) = (line for line in lines if line.claim.id == "rl_curve_match")
    assert line.outcome == "holds"


def test_a_window_is_kept_by_runs_that_have_come_to_its_end(tmp_path: Path) -> None:
    for seed in range(3):
        scores = {update: (0.5,) * 3 for update in ((100, 200) if seed else (100, 200, 300))}
        write_run(tmp_path, scores, seed=seed)
    (table,) = tables.score_tables(results.load_runs([tmp_path]))
    assert results_of(table).window == (100, 200)


def test_claims_in_the_report(tmp_path: Path) -> None:
    """Visual reconstruction gains more than half of 20 % on the rare level, and BYOL helps, which
    is claimed not to."""
    for seed in range(3):
        write_run(tmp_path, constant(0.2), seed=seed)
        write_run(tmp_path, constant(0.23), condition="impala_vision", seed=seed)
        write_run(tmp_path, constant(0.5), condition="impala_byol", seed=seed)
    write_run(tmp_path, constant(0.4), condition="impala_transformer")
    found = tables.score_tables(results.load_runs([tmp_path]))
    lines = check_claims(found)
    outcomes = {line.claim.id: line.outcome for line in lines if line.table == "gridworld"}
    assert outcomes["ssl_grid_rare"] == "holds"
    assert outcomes["byol_failed"] == "fails"
    assert outcomes["transformer_no_gain"] == "not enough data"
    assert outcomes["rare_lower"] == "fails"
    text = markdown.markdown_report(found, {}, lines)
    assert (
        "| Visual reconstruction improves the rarest maps and objects of the gridworld by 20 %. "
        "| gridworld | relative change at least +10 % | IMPALA + vis recon rare 0.23, "
        "IMPALA rare 0.20: +15 % (by seed +15 % to +15 %) | holds | holds |"
    ) in text
    assert "IMPALA + transformer rare 0.40 (1/3 seeds), IMPALA rare 0.20: +0.20" in text
    written = csv_claims(lines)
    assert written.startswith(",".join(CLAIM_COLUMNS))
    assert {line.claim.id for line in lines} == {claim.id for claim in CLAIMS}


def test_runs_of_no_published_experiment_have_no_claims(tmp_path: Path) -> None:
    write_run(tmp_path, constant(0.2), paper=None)
    found = tables.score_tables(results.load_runs([tmp_path]))
    assert "Claims" not in markdown.markdown_report(found, {}, check_claims(found))
