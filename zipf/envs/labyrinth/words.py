"""The closed vocabulary of the instructions of all levels."""

from zipf.envs.language import Vocabulary

_SHAPES = (
    "apple2 ball balloon banana bottle cake can car cassette chair cherries cow flower fork fridge "
    "guitar hair_brush hammer hat ice_lolly jug key knife ladder mug pencil pig pincer plant "
    "saxophone shoe spoon suitcase tennis_racket tomato toothbrush tree tv wine_glass zebra"
)
_COMMON = "Pick the object in room Every near Are all objects Is any anything most"
SHAPES = tuple(_SHAPES.split())
COLOURS = ("red", "green", "blue", "cyan", "magenta", "yellow")

VOCABULARY = Vocabulary(
    (*SHAPES, *COLOURS, *_COMMON.split(), *(f"{colour}?" for colour in COLOURS)), length=16
)
"""Sixteen words at most, as the published agents read."""
