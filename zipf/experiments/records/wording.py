"""Numbers and names as tables, captions and plots show them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal, get_args

PROTOCOL_SEEDS = 3  # the paper trains three replicas of each condition

KIND_NAMES: Mapping[str, str] = {
    "train": "Train (Zipfian)",
    "uniform": "Uniform",
    "rare": "Rare",
    "validation": "Validation",
    "fresh": "Fresh",
}
PlotFormat = Literal["png", "pdf", "svg"]
PLOT_FORMATS: tuple[PlotFormat, ...] = get_args(PlotFormat)
VideoFormat = Literal["gif", "mp4"]
VIDEO_FORMATS: tuple[VideoFormat, ...] = get_args(VideoFormat)
EXTERNAL_MARK = "†"
NONE = "–"


def score_text(value: float, error: float = math.nan) -> str:
    """`0.69 ± 0.05`, without the second part where there is none; a dash for no score.
    Two decimals, as the paper prints: 1000 episodes do not carry a third."""
    if math.isnan(value):
        return NONE
    text = f"{value:z.2f}"
    return text if math.isnan(error) else f"{text} ± {error:.2f}"


def seeds_text(count: int) -> str:
    """`2/3` below the protocol's number of seeds, the plain count from there."""
    return f"{count}/{PROTOCOL_SEEDS}" if count < PROTOCOL_SEEDS else str(count)


def count_text(count: int) -> str:
    """12,345,678 as it is below ten million, then 12.3 million or 12.3 billion."""
    for size, word in ((10**9, "billion"), (10**6, "million")):
        if count >= max(size, 10**7):
            number = count / size  # in exponents from 1,000 on, where it is rounded up to that, too
            return f"{number:.3g} {word}" if number < 999.5 else f"{number:,.0f} {word}"
    return f"{count:,}"


def range_text(counts: Sequence[int]) -> str:
    """`7 to 1,000`, or the one count where all are alike."""
    low, high = count_text(min(counts)), count_text(max(counts))
    return low if low == high else f"{low} to {high}"


def updates_text(start: int, end: int) -> str:
    """`150 to 1,000`, and both numbers also where they are the same."""
    return f"{count_text(start)} to {count_text(end)}"


def duration_text(seconds: float) -> str:
    """`45 s`, `12 min`, `3 h 05 min`."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def short_name(level: str) -> str:
    """A level's name without the names before its last: `put_on_bed_tray_all`."""
    return level.rpartition("/")[2]


def seeds_list(seeds: Sequence[int]) -> str:
    """`seed 0` or `seeds 0, 1, 2`."""
    return f"seed{'s' if len(seeds) > 1 else ''} {', '.join(map(str, seeds))}"


def spoken(name: str) -> str:
    """A rank's name as figures show it."""
    return name.replace("_", " ").capitalize()
