"""Writes what is known of baselines now into the record of runs in `results/`.

    python scripts/renew_baselines.py
    make results

A run's description has the scores of policies that do not learn as they were known when it began.
They belong to the levels and not to the run: after a change of `baselines.json` this renews them.
A kind of levels that a run was not scored on is not added.
"""

import argparse
import json
from pathlib import Path
from typing import Any

from zipf import envs
from zipf.experiments.building.run_folder import describe_levels
from zipf.experiments.records import record

RESULTS = Path(__file__).parent.parent / "results"


def renewed(description: dict[str, Any], *, questions: bool) -> dict[str, Any]:
    """A run's description with the baselines that are known now.

    Args:
        questions: whether the agent answers questions about first frames and does not act.
    """
    split = envs.split(description["split"])
    known = describe_levels(
        envs.questions(split) if questions else split, description["environment"]
    )
    baselines = {(one["level_kind"], one["level"]): one["references"] for one in known}
    levels = []
    for one in description["levels"]:
        new = baselines.get((one["level_kind"], one["level"]), one["references"])
        same = _rounded(new) == _rounded(one["references"])
        levels.append(one if same else {**one, "references": new})
    return {**description, "levels": levels}


def _rounded(value: Any) -> Any:
    """Without the last digits, which differ from one processor to another."""
    if isinstance(value, float):
        return round(value, 9)
    if isinstance(value, dict):
        return {name: _rounded(item) for name, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list | tuple) else value


def main() -> None:
    argparse.ArgumentParser(description=__doc__.partition("\n")[0]).parse_args()
    kept = record.read(RESULTS)
    before = dict(kept.runs)
    for name, description in before.items():
        questions = kept.options.get(name, {}).get("agent", {}).get("name") == "supervised"
        kept.runs[name] = renewed(description, questions=questions)
        path = RESULTS / name / "run.json"  # of an agent whose weights are kept
        if path.exists() and kept.runs[name] != description:
            path.write_text(json.dumps(kept.runs[name], indent=2) + "\n", "utf-8")
    changed = [name for name in before if kept.runs[name] != before[name]]
    if changed:
        record.write(RESULTS, kept)
    for name in changed:
        print(f"written: {name}")


if __name__ == "__main__":
    main()
