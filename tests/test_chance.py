"""Chance that was measured holds for what it was measured on, and nothing else."""

import json
import sys
from pathlib import Path

import pytest

from zipf.envs.random_play import Chance, measured


def test_what_was_measured_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    package = tmp_path / "family_of_this_test"
    package.mkdir()
    (package / "__init__.py").write_text("")
    figures = [
        {"score": 0.25, "episodes": 400, "options": {"max_steps": 900, "order": "usual"}},
        {"score": 0.1, "episodes": 300, "options": {"max_steps": 90, "order": "usual"}},
    ]
    (package / "chance.json").write_text(json.dumps({"lift/easy": figures}))
    monkeypatch.syspath_prepend(tmp_path)
    chance = measured(package.name)
    assert chance("lift/easy") == Chance(0.25, 400)
    assert chance("lift/easy", max_steps=900, order="usual") == Chance(0.25, 400)
    assert chance("lift/easy", max_steps=90) == Chance(0.1, 300)
    assert chance("lift/easy", max_steps=10) is None
    assert chance("lift/easy", gravity=0) is None
    assert chance("lift/hard") is None
    sys.modules.pop(package.name)
