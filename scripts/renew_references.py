"""Writes what is known of references now into the runs of `results/`.

    python scripts/renew_references.py
    make results

`run.json` has the scores of players that do not learn as they were known when a run began. They
belong to the levels and not to the run: after a change of `references.json` this renews them. A
kind of levels that a run was not scored on is not added.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import yaml

from zipf import envs
from zipf.experiments.building.run_folder import describe_levels

RESULTS = Path(__file__).parent.parent / "results"


def renewed(description: dict[str, Any], *, questions: bool) -> dict[str, Any]:
    """A run's description with the references that are known now.

    Args:
        questions: whether the agent answers questions about first frames and does not act.
    """
    split = envs.split(description["split"])
    known = describe_levels(
        envs.questions(split) if questions else split, description["environment"]
    )
    references = {(one["level_kind"], one["level"]): one["references"] for one in known}
    levels = []
    for one in description["levels"]:
        new = references.get((one["level_kind"], one["level"]), one["references"])
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
    for path in sorted(RESULTS.rglob("run.json")):
        folder = path.parent
        description = json.loads(path.read_text("utf-8"))
        config = folder / "config.yaml"
        agent = yaml.safe_load(config.read_text("utf-8"))["agent"] if config.exists() else {}
        new = renewed(description, questions=agent.get("name") == "supervised")
        if new != description:
            path.write_text(json.dumps(new, indent=2) + "\n", "utf-8")
            print(f"written: {path.relative_to(RESULTS)}")


if __name__ == "__main__":
    main()
