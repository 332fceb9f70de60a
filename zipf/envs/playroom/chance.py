"""Chance on the playroom's levels, as `scripts/measure_chance.py` measured it."""

from zipf.envs.random_play import measured

chance = measured("zipf.envs.playroom")
