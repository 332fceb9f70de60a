"""The videos of a run: the files in its `videos` folder, and what `videos.json` there says of them.

`zipf.experiments.playing.videos` makes them, from a checkpoint; reports show those that are there.
"""

from __future__ import annotations

import base64
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from zipf.errors import UserError
from zipf.experiments.records.csv_files import plain, read_bytes
from zipf.experiments.records.descriptions import Count, first_problem

FOLDER = "videos"
NAME = "videos.json"
Outcome = Literal["success", "failure"]
OUTCOMES: tuple[Outcome, ...] = ("success", "failure")

_MEDIA: Mapping[str, str] = {".gif": "image/gif", ".mp4": "video/mp4"}


class _Described(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Video(_Described):
    """An episode in a file."""

    # its name, in the folder of `videos.json`
    file: Annotated[str, Field(pattern=r"^[a-z_]+\.(gif|mp4)$")]
    outcome: Outcome  # "success" or "failure"
    seed: Count  # of the env
    episode_return: Annotated[float, Field(allow_inf_nan=False)]  # undiscounted, in units of reward
    length: Count  # in frames
    every: Annotated[int, Field(ge=1)]  # the file shows every so many-th frame


class VideosOfSituation(_Described):
    """The videos of one situation: the first success and the first failure of those tried."""

    title: Annotated[str, Field(min_length=1)]  # "most frequent situation" or "rarest situation"
    level: str  # the level's name
    ranks: Mapping[str, Count]  # of the situation
    episodes: Count  # how many were tried
    successes: Count  # how many of them succeeded
    videos: tuple[Video, ...]  # at most one of each outcome

    def of(self, outcome: Outcome) -> Video | None:
        """The video of this outcome; None where no episode had it."""
        return next((one for one in self.videos if one.outcome == outcome), None)


class Videos(_Described):
    """The contents of `videos.json`."""

    update: Count  # of the checkpoint whose agent plays
    situations: tuple[VideosOfSituation, ...]  # the most frequent one and the rarest


def read(folder: Path) -> Videos | None:
    """The videos of a run; None where it has none. Raises UserError: `videos.json` is damaged."""
    path = folder / FOLDER / NAME
    if not path.exists():
        return None
    try:
        return Videos.model_validate_json(plain(path, read_bytes(path)))
    except ValidationError as error:
        raise UserError(
            f"{path.as_posix()}: is damaged ({first_problem(error)}); videos= records them again"
        ) from None


def data_address(folder: Path, video: Video) -> str:
    """A run's video as a `data:` address, which holds the file itself. Raises UserError: the file
    is gone, or is not of the format that its name says."""
    path = folder / FOLDER / video.file
    content = read_bytes(path)
    good = content[:4] == b"GIF8" if path.suffix == ".gif" else content[4:8] == b"ftyp"
    if not good:
        raise UserError(f"{path.as_posix()}: is no {path.suffix[1:].upper()} file")
    return f"data:{_MEDIA[path.suffix]};base64,{base64.b64encode(content).decode('ascii')}"
