"""`run.json`: what a run is, and which levels it is scored on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from zipf.errors import UserError
from zipf.experiments.records.csv_files import plain, read_bytes
from zipf.experiments.records.wording import EXTERNAL_MARK
from zipf.options import Positive
from zipf.protocol import BASELINE_NAMES, KINDS

LINE_PATTERN = r"^[^\r\n]*$"
COLOUR_PATTERN = r"^#[0-9a-fA-F]{6}$"
Line = Annotated[str, Field(min_length=1, pattern=LINE_PATTERN)]
Colour = Annotated[str, Field(pattern=COLOUR_PATTERN)]
Whole = Annotated[int, Field(gt=-(2**63), lt=2**63)]
Count = Annotated[int, Field(ge=0, lt=10**15)]
Finite = Annotated[float, Field(allow_inf_nan=False)]


class _Described(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, strict=True)


class RowDescription(_Described):
    """How a condition appears in tables and plots.

    Rows are in ascending `order`; those without one follow, by name. A `colour` that is not given
    is assigned.
    """

    title: Line
    order: Finite | None
    colour: Colour | None
    line: Literal["solid", "dashed"]


class BaselineDescription(_Described):
    """The score of a policy that does not learn on a level.

    `episodes` is over how many it was measured, None where it is exact. `by_rank` is the same at
    each value of a rank of the situation, for those ranks for which it is known. `policy` is the
    text of the policy of a blind one that was searched for, see `zipf.envs.floors`.
    """

    score: Finite
    episodes: Count | None
    by_rank: Mapping[str, tuple[Finite, ...]]
    policy: str | None = None


class LevelDescription(_Described):
    """A level of a run.

    `weight` is its share in the score of its kind, relative to those of the kind's other levels.
    `normalised` says whether its score is a fraction of a human's above random actions.
    `baselines` (`references` in the file) are those of `zipf.protocol.BASELINES` that are known, by
    name.
    """

    level_kind: Literal[KINDS]  # type: ignore[valid-type]
    level: Line
    weight: Positive
    normalised: bool
    baselines: Mapping[
        Literal[BASELINE_NAMES],  # type: ignore[valid-type]
        BaselineDescription,
    ] = Field(alias="references")


class ExternalDescription(_Described):
    """An agent of another program, recorded by `zipf.evaluate.record`."""

    name: Line


class PretrainedDescription(_Described):
    """The run whose weights a run began with.

    `parts` are those of the network that it took, `frames` those that the other run had learned
    from by then, and before it the run that it began with itself.
    """

    experiment: Line
    condition: Line
    seed: Whole
    update: Count
    frames: Count
    parts: tuple[Line, ...]


class RunDescription(_Described):
    """`run.json`: what a run is.

    `window` is in updates, both ends included. `spread` is what the ± of the table is: the spread
    across seeds or across the levels (tasks) of a kind. `situation` has the number of ranks of each
    of the situation's columns. What describes the training (`window` to `precision`) may be missing
    in the description of an external agent.
    """

    experiment: Line
    condition: Line
    row: RowDescription
    seed: Whole
    split: Line
    spread: Literal["seeds", "tasks"]
    environment: dict[str, Any]
    levels: tuple[LevelDescription, ...]
    situation: dict[str, Annotated[int, Field(gt=0, lt=10**9)]]
    version: str
    external: ExternalDescription | None
    paper: str | None = None
    window: tuple[Count, Count] | None = None
    command: str | None = None
    commit: str | None = None
    torch: str | None = None
    device: str | None = None
    precision: str | None = None
    images: Count | None = None
    pretrained: PretrainedDescription | None = None
    resumed: tuple[dict[str, Any], ...] = ()

    @model_validator(mode="after")
    def _is_consistent(self) -> RunDescription:
        if self.window is None and self.external is None:
            raise ValueError("window: missing")
        if self.window is not None and self.window[0] > self.window[1]:
            raise ValueError(f"window {list(self.window)} ends before it starts")
        for level_kind in KINDS:
            names = [one.level for one in self.levels if one.level_kind == level_kind]
            if not names and level_kind == "train":
                raise ValueError("levels: there is no train level")
            if len(set(names)) < len(names):
                raise ValueError(f"levels: two {level_kind} levels have the same name")
        return self

    @property
    def last_command(self) -> str | None:
        """The command that finished the run: it has the number of updates and the window that
        count, which may change when a run is resumed."""
        commands = [self.command, *(again.get("command") for again in self.resumed)]
        return next((one for one in reversed(commands) if isinstance(one, str)), None)

    @property
    def devices(self) -> tuple[str, ...]:
        """What it was trained on, at its start and each time that it was resumed."""
        named = [self.device, *(again.get("device") for again in self.resumed)]
        return tuple(one for one in named if isinstance(one, str))

    @property
    def row_key(self) -> str:
        """The row of a table that the run belongs to: its condition, marked if it is external."""
        return self.condition + (f" {EXTERNAL_MARK}" if self.external else "")

    @property
    def row_order(self) -> tuple[Any, ...]:
        """The sort key of rows."""
        return (self.row.order is None, self.row.order or 0, self.condition, bool(self.external))

    def levels_of(self, level_kind: str) -> LevelGroup:
        """All levels of a kind."""
        chosen = [one for one in self.levels if one.level_kind == level_kind]
        return LevelGroup(level_kind, "", {one.level: one.weight for one in chosen})


@dataclass(frozen=True)
class LevelGroup:
    """Levels of a kind that are scored together."""

    level_kind: str  # of `zipf.envs.KINDS`
    name: str  # of the group; empty for all levels of the kind
    weights: Mapping[str, float]  # of each level by its name

    @property
    def column(self) -> str:
        """Unique among the groups of a table."""
        return f"{self.level_kind}: {self.name}" if self.name else self.level_kind

    @property
    def is_weighted(self) -> bool:
        """Whether the weighted and the plain mean may differ."""
        return len(set(self.weights.values())) > 1


def read_description(path: Path) -> RunDescription:
    """The description in a `run.json`. Raises UserError: it cannot be read, or is none."""
    try:
        return RunDescription.model_validate_json(plain(path, read_bytes(path)))
    except ValidationError as error:
        problem = first_problem(error)
        raise UserError(f"{path.as_posix()}: not a run's description: {problem}") from error


def first_problem(error: ValidationError) -> str:
    """Where the first mistake is, and what."""
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    return f"{where}: {first['msg']}" if where else first["msg"]
