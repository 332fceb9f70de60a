"""The paper's claims about the experiments at hand, and about the paper's own numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pandas as pd

from zipf.experiments.records.paper import paper_table
from zipf.experiments.records.wording import PROTOCOL_SEEDS
from zipf.experiments.reporting.claims import (
    Check,
    Claim,
    Measured,
    Outcome,
    Results,
    ScoreCheck,
    Verdict,
    claims,
    judge,
    together,
)
from zipf.experiments.reporting.rows import Row
from zipf.experiments.reporting.scores import seed_means
from zipf.experiments.reporting.tables import ScoreTable
from zipf.experiments.reporting.windows import UpdateWindow

CLAIM_COLUMNS = ("claim", "statement", "table", "bounds", "outcome", "numbers", "paper", "note")


@dataclass(frozen=True)
class ClaimLine:
    """A claim about one table.

    Attributes:
        claim: what is claimed.
        table: the title of the table; empty where no run of the claim's experiments is there.
        outcome: of all checks of this experiment together.
        verdicts: of each.
        paper: the outcome with the paper's own numbers; None where it prints too few of them.
    """

    claim: Claim
    table: str
    outcome: Outcome
    verdicts: tuple[Verdict, ...]
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
    by_experiment: dict[str, list[ScoreTable]] = {}
    for table in tables:
        if table.description.paper is not None:
            by_experiment.setdefault(table.description.paper, []).append(table)
    of_table = {table.name: results_of(table) for table in tables}
    lines = []
    for claim in claims():
        checks: dict[str, list[Check]] = {}
        for check in claim.checks:
            checks.setdefault(check.experiment, []).append(check)
        for experiment, of_experiment in checks.items():
            paper = together(
                [
                    judge(check, published_results(experiment)).outcome
                    if isinstance(check, ScoreCheck)
                    else "not enough data"
                    for check in of_experiment
                ]
            )
            for table in by_experiment.get(experiment, []):
                verdicts = tuple(judge(check, of_table[table.name]) for check in of_experiment)
                outcome = together([verdict.outcome for verdict in verdicts])
                on_paper = None if paper == "not enough data" else paper
                lines.append(ClaimLine(claim, table.title, outcome, verdicts, on_paper))
        if not any(line.claim is claim for line in lines):
            lines.append(ClaimLine(claim, "", "not enough data", (), None))
    return lines


def results_of(table: ScoreTable) -> Results:
    """What a table knows, without agents from outside the package."""
    rows = [row for row in table.rows if not row.external]
    scores = pd.concat([table.scores, table.group_scores])
    scores = scores[~scores["external"].astype(bool)]
    curves, by_seed = {}, {}
    for row in rows:
        for levels in table.kinds:
            means = [run.mean_scores(levels) for run in row.runs]
            curves[row.condition, levels.level_kind] = _curve(means)
        for levels in (*table.kinds, *table.groups):
            column = levels.name or levels.level_kind
            by_seed[row.condition, column] = seed_means(row, levels, table.window)
    measured = {}
    for line in scores.to_dict("records"):
        place = line["condition"], line["level"] or line["level_kind"]
        measured[place] = Measured(
            float(line["score"]),
            int(line["seeds"]),
            int(line["episodes"]),
            float(line["chance"]),
            by_seed[place],
        )
    experiment = table.description.paper
    return Results(
        scores=measured,
        every=list(paper_table(experiment).rows) if experiment else [],
        titles={row.condition: row.title for row in rows},
        window=_window(table, rows),
        curves=curves,
    )


def _window(table: ScoreTable, rows: Sequence[Row]) -> tuple[int, int] | None:
    """The updates that scores were taken from, as far as all runs have come; None for another kind
    of window."""
    if not isinstance(table.window, UpdateWindow):
        return None
    reached = [run.updates for row in rows for run in row.runs]
    scored = [updates for updates in reached if updates >= table.window.start]
    return table.window.start, min([table.window.end, *scored])


def _curve(seeds: Sequence[pd.DataFrame]) -> tuple[pd.Series, int]:
    """The median over seeds by update, of the updates with as many seeds as any has, or as the
    protocol asks for; and how many seeds that are."""
    by_update = pd.concat(seeds).groupby("update")["score"]
    counts = by_update.count()
    most = int(counts.max()) if len(counts) else 0
    most = min(most, PROTOCOL_SEEDS)
    return by_update.median()[counts >= most], most


def published_results(experiment: str) -> Results:
    """What the paper prints of one of its experiments."""
    rows = paper_table(experiment).rows
    scores = {
        (condition, column): Measured(score.value, PROTOCOL_SEEDS, 0)
        for condition, row in rows.items()
        for column, score in row.items()
    }
    return Results(scores, every=[*rows])


def csv_claims(lines: Sequence[ClaimLine]) -> str:
    """`claims.csv`: every line, whether there are scores for it or not."""
    cells = [
        (
            line.claim.id,
            line.claim.statement,
            line.table,
            line.bounds,
            line.outcome,
            line.numbers,
            line.paper or "",
            line.claim.unchecked or line.claim.note or "",
        )
        for line in lines
    ]
    return pd.DataFrame(cells, columns=list(CLAIM_COLUMNS)).to_csv(index=False, lineterminator="\n")
