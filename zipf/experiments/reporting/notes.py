"""What is missing or doubtful in a table, one sentence each."""

from __future__ import annotations

import math
from collections.abc import Sequence

from zipf.experiments.records.results import Run, devices_of
from zipf.experiments.records.wording import count_text, seeds_list
from zipf.experiments.reporting.windows import (
    LastEvaluations,
    ScaledWindow,
    UpdateWindow,
    Window,
    evaluations_inside,
    window_of,
    window_text,
)
from zipf.protocol import PAPER_KINDS, REFERENCE_NAMES, says_little


def notes(runs: Sequence[Run], window: Window) -> tuple[str, ...]:
    """The notes of a table of these runs."""
    found: list[str] = []
    for run in runs:
        found += run.notes
        found += _window_notes(run, window_of(run, window))
    devices = devices_of(runs)
    if len(devices) > 1:
        found.append(
            f"Runs were on {'; '.join(devices)}: their times are not compared, so that there is no "
            "figure of scores against time."
        )
    found += [note for name in REFERENCE_NAMES for note in _reference_notes(runs, name)]
    found += _floor_notes(runs)
    for key in dict.fromkeys(run.description.row_key for run in runs):
        of_row = [run for run in runs if run.description.row_key == key]
        found += _seeds_notes(of_row) + _pretrained_notes(of_row)
    return tuple(found)


def _window_notes(run: Run, window: Window) -> list[str]:
    if not len(run.evaluations):
        return [f"{run.label}: no evaluation yet; not counted."]
    inside = evaluations_inside(run, window)
    if isinstance(window, UpdateWindow) and not len(inside):
        last = count_text(int(run.evaluations["update"].max()))
        assert run.description.window is not None  # external agents have no window of updates
        scaled = ScaledWindow(*run.description.window).select(run.evaluations["update"])
        others = "--window scaled or --window last shows" if scaled.any() else "--window last shows"
        return [
            f"{run.label}: no evaluation at {window_text(window)} (the last is at update {last}); "
            f"not counted. {others} it."
        ]
    found = []
    number = inside["update"].nunique()
    if isinstance(window, LastEvaluations) and number < window.count:
        beside = " beside that at update 0" if len(inside) < len(run.evaluations) else ""
        found.append(
            f"{run.label}: has {number} evaluation{'s' if number > 1 else ''}{beside}, not "
            f"{window.count}: scored over what there is."
        )
    missing = set(PAPER_KINDS) - set(inside["level_kind"])
    if missing:
        found.append(
            f"{run.label}: no evaluation of {', '.join(sorted(missing))}; not counted there."
        )
    if isinstance(window, ScaledWindow) and inside["update"].max() < window.end:
        start, end = window.inside(int(inside["update"].max()))
        found.append(
            f"{run.label}: ends at update {count_text(end)}, before update "
            f"{count_text(window.end)}: scored over updates {count_text(math.ceil(start))} to "
            f"{count_text(end)}, a scaled window."
        )
    if isinstance(window, UpdateWindow) and run.updates < window.end:
        found.append(
            f"{run.label}: at update {count_text(run.updates)}, before the window's end: scored "
            f"over the {number} evaluations so far."
        )
    return found


def _reference_notes(runs: Sequence[Run], name: str) -> list[str]:
    first: dict[tuple[str, str], tuple[float, Run]] = {}
    for run in runs:
        for level in run.description.levels:
            if name not in level.references:
                continue
            score = level.references[name].score
            known, other = first.setdefault((level.level_kind, level.level), (score, run))
            if not math.isclose(known, score, rel_tol=1e-9, abs_tol=1e-12):  # of other machines
                return [
                    f"{other.label} and {run.label} disagree about {name} "
                    f"({known:.2f} and {score:.2f} on {level.level}): the first is shown."
                ]
    return []


def _floor_notes(runs: Sequence[Run]) -> list[str]:
    """Levels on which a policy that neither reads nor looks does well."""
    names: list[str] = []
    for run in runs:
        for level in run.description.levels:
            blind, expert = (level.references.get(name) for name in ("blind", "expert"))
            scores = [one.score if one else None for one in (blind, expert)]
            if says_little(*scores) and level.level not in names:
                names.append(level.level)
    if not names:
        return []
    shown = ", ".join(names[:5]) + (f" and {len(names) - 5} more" if len(names) > 5 else "")
    return [
        f"Says little about reading: {shown}. A policy that neither reads nor looks has more than "
        "half of the expert's score there."
    ]


def _seeds_notes(runs: Sequence[Run]) -> list[str]:
    """Seeds of a condition should differ in nothing else."""
    titles = list(dict.fromkeys(run.description.row.title for run in runs))
    found = []
    if len(titles) > 1:
        found.append(
            f"The seeds of {runs[0].description.condition} have different titles "
            f"({', '.join(titles)}): the first is shown."
        )
    names = sorted({name for run in runs for name in run.settings})
    differing = [name for name in names if len({repr(run.settings.get(name)) for run in runs}) > 1]
    if differing:
        shown = ", ".join(differing[:5]) + (" and more" if len(differing) > 5 else "")
        found.append(
            f"The seeds of {titles[0]} were not trained with the same settings: {shown} differ."
        )
    return found


def _pretrained_notes(runs: Sequence[Run]) -> list[str]:
    """Which other runs the seeds of a condition began with."""
    alike: dict[tuple[str, str, str], list[int]] = {}
    for run in runs:
        seed, there = run.description.seed, run.description.pretrained
        if there is not None:
            other = "the same seed" if there.seed == seed else f"seed {there.seed}"
            frames = count_text(there.frames)
            where = f"{', '.join(there.parts)} of {there.experiment} {there.condition}"
            alike.setdefault((where, other, frames), []).append(seed)
    return [
        f"{seeds_list(seeds).capitalize()} of {runs[0].description.row.title} began with the "
        f"{where}, {other}, trained on {frames} frames, which are not counted here."
        for (where, other, frames), seeds in alike.items()
    ]
