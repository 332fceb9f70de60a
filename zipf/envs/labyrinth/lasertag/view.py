"""What is seen of laser tag: opponents, shots, flashes, and bars of health and ammunition."""

from __future__ import annotations

import colorsys
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from zipf.compiled import compiled
from zipf.envs.labyrinth.lasertag.arena import (
    AMMUNITION,
    BLAST,
    DISC,
    FIGHTERS,
    FIRST_HEALTH,
    FLASH_FRAME,
    FLASH_KIND,
    FLASHES,
    GADGET,
    HEALTH,
    IMPULSE,
    LOADED,
    NOTHING,
    ORB,
    PUFF,
    RAPID,
    SHOOTER,
    SHOTS,
    SUPPLIES,
    TAGGED_AT,
    TRACE_FRAME,
    TRACE_GADGET,
    TRACES,
)
from zipf.envs.labyrinth.materials import Colour
from zipf.envs.labyrinth.mover import BELOW
from zipf.envs.labyrinth.state import YAW, X, Y, Z
from zipf.envs.render3d.shadows import cast

SEGMENTS, DASHES, DASH = 36, 12, 50.0
"""Segments of which shots are drawn: how many, at most for one shot, their least distance."""
ACTORS = 2 * (FIGHTERS - 1) + SHOTS + FLASHES + SEGMENTS
"""Instances of meshes that an env needs beside its items."""
BARS = 6  # overlays: two bars with their grounds, and a cross in the middle of the view
SUPPLY_MESHES = ("", "", "orb_gadget", "beam_gadget", "disc_gadget", "health_pack", "armour_pack")
"""The mesh of each kind of supply."""
ACTOR_MESHES = ("robot", "robot_head", "orb", "puff", "bolt")
_ROBOT, _HEAD, _ORB, _PUFF, _BOLT = range(5)
COLOURS: tuple[tuple[Colour, Colour], ...] = (
    ((190, 190, 200), (120, 120, 130)),
    ((255, 226, 60), (255, 130, 30)),
    ((70, 215, 90), (235, 245, 120)),
    ((70, 200, 255), (245, 250, 255)),
    ((225, 80, 235), (255, 190, 60)),
    ((250, 250, 250), (225, 40, 40)),
    ((60, 90, 220), (255, 205, 60)),
)
"""Main and accent colour of gadgets, of their shots and of supplies, by kind."""
_PAINT = np.array(COLOURS, np.uint8)
_VISOR = (245, 248, 255)
_HEALTHY, _HURT, _GROUND, _CROSS = (70, 225, 90), (240, 60, 50), (20, 22, 28), (255, 255, 255)
_HURT_BELOW = 40
_HEAD_AT = 36.0  # above the soles
_DEAD_EYE = 8.0  # above the ground
_SPEED = 180.0  # of a bolt of Rapid, units per frame
_METRES = 0.01
_WIDE = 0.2  # half width of an opponent's shadow, metres


class Pictures(NamedTuple):
    """The arrays of `Scenes` that are written."""

    camera: NDArray[np.float32]
    mesh: NDArray[np.int32]
    position: NDArray[np.float32]
    rotation: NDArray[np.float32]
    scale: NDArray[np.float32]
    colours: NDArray[np.uint8]
    overlays: NDArray[np.float32]
    overlay_colours: NDArray[np.uint8]
    overlay_count: NDArray[np.int32]
    shadows: NDArray[np.float32]


def opponents_colours(hue: int) -> list[tuple[Colour, Colour]]:
    """Main and accent colour of an opponent's body and of its head, from a hue in degrees."""
    pure = []
    for turn in range(3):
        red, green, blue = colorsys.hsv_to_rgb((hue / 360 + turn / 3) % 1.0, 1.0, 1.0)
        pure.append((round(255 * red), round(255 * green), round(255 * blue)))
    return [(pure[0], pure[1]), (pure[2], _VISOR)]


@compiled(error_model="numpy")
def show_supplies(mask, combat, meshes, shape, colours):
    """Gives the supplies of the envs of `mask` their looks, also those that were dropped.

    Args:
        meshes: int32, numbers of SUPPLY_MESHES.
        shape, colours: of `Scenery` and `Scenes`, written.
    """
    for i in range(mask.size):
        if mask[i] and combat.fighters[i] > 0:
            for k in range(SUPPLIES):
                kind = combat.kinds[i, k]
                if kind != NOTHING:
                    shape[i, k] = meshes[kind]
                    _paint(colours[i, k], kind)


@compiled(error_model="numpy")
def pose(mask, items, clock, combat, meshes, pictures):
    """Copies what happens in the combats of the envs of `mask` to their scenes.

    Args:
        items: how many instances come before those of the actors.
        meshes: int32, numbers of ACTOR_MESHES.
        pictures: `Pictures`, written.
    """
    for i in range(mask.size):
        if not mask[i] or combat.fighters[i] == 0:
            continue
        pictures.mesh[i, items:] = -1
        at = items
        for f in range(1, combat.fighters[i]):
            shadow = pictures.shadows[i, items + f - 1]
            shadow[7] = 0.0
            if combat.status[i, f, TAGGED_AT] < 0:
                body = combat.bodies[i, f]
                soles = body[Z] - BELOW
                x, y = body[X] * _METRES, body[Y] * _METRES
                cast(shadow, x, y, 0.0, 0.0, _WIDE, _WIDE, max(soles, 0.0) * _METRES)
                for part in range(2):
                    k = at + 2 * (f - 1) + part
                    lift = _HEAD_AT if part else 0.0
                    _place(pictures, i, k, meshes[part], body[X], body[Y], soles + lift, 1.0)
                    _turn(pictures.rotation[i, k], math.cos(body[YAW]), math.sin(body[YAW]), 0.0)
        at += 2 * (FIGHTERS - 1)
        now = clock[i]
        for n in range(SHOTS):
            shot = combat.shots[i, n]
            if shot[SHOOTER] >= 0:
                _place(pictures, i, at + n, meshes[_ORB], shot[0], shot[1], shot[2] - 10.0, 1.0)
                _turn(pictures.rotation[i, at + n], math.cos(0.2 * now), math.sin(0.2 * now), 0.0)
                _paint(pictures.colours[i, at + n], ORB)
        at += SHOTS
        for n in range(FLASHES):
            _draw_flash(pictures, i, at + n, meshes[_PUFF], combat.flashes[i, n], now)
        _draw_traces(pictures, i, at + FLASHES, meshes[_BOLT], combat, now)
        _draw_bars(pictures, i, combat.status[i, 0])
        if combat.status[i, 0, TAGGED_AT] >= 0:
            pictures.camera[i, 2] = _DEAD_EYE * _METRES


@compiled(error_model="numpy")
def _place(pictures, i, k, mesh, x, y, z, scale):
    pictures.mesh[i, k] = mesh
    position = pictures.position[i, k]
    position[0], position[1], position[2] = x * _METRES, y * _METRES, z * _METRES
    pictures.scale[i, k] = scale


@compiled(error_model="numpy")
def _turn(rotation, dx, dy, dz):
    """Turns an instance so that its x axis lies along a direction of length 1, not upright."""
    flat = math.hypot(dx, dy) + 1e-9
    left_x, left_y = -dy / flat, dx / flat
    rotation[0, 0], rotation[1, 0], rotation[2, 0] = dx, dy, dz
    rotation[0, 1], rotation[1, 1], rotation[2, 1] = left_x, left_y, 0.0
    rotation[0, 2], rotation[1, 2] = -dz * left_y, dz * left_x
    rotation[2, 2] = dx * left_y - dy * left_x


@compiled(error_model="numpy")
def _paint(colours, kind):
    """Writes the colours of a gadget or supply, uint8 [2, 3]."""
    for part in range(2):
        for c in range(3):
            colours[part, c] = _PAINT[kind, part, c]


@compiled(error_model="numpy")
def _draw_flash(pictures, i, k, mesh, flash, now):
    """Draws a flash, while it lasts: it grows."""
    age, kind = now - flash[FLASH_FRAME], flash[FLASH_KIND]
    life, first, last = 6.0, 0.3, 0.5
    main, accent = (255, 250, 190), (255, 190, 60)
    if kind == BLAST:
        life, first, last = 14.0, 1.2, 3.2
        main, accent = (255, 150, 40), (255, 235, 120)
    elif kind == PUFF:
        life, first, last = 24.0, 1.2, 2.4
        main, accent = (235, 235, 240), (180, 190, 205)
    if age > life:
        return
    scale = first + (last - first) * age / life
    _place(pictures, i, k, mesh, flash[0], flash[1], flash[2] - 20.0 * scale, scale)
    _turn(pictures.rotation[i, k], math.cos(0.3 * age), math.sin(0.3 * age), 0.0)
    for c in range(3):
        pictures.colours[i, k, 0, c], pictures.colours[i, k, 1, c] = main[c], accent[c]


@compiled(error_model="numpy")
def _draw_traces(pictures, i, first, mesh, combat, now):
    """Draws the last shots, the newest first: bolts of Rapid that fly, dashed lines of others."""
    used = 0
    for n in range(TRACES):
        trace = combat.traces[i, (combat.written[i, 0] - 1 - n) % TRACES]
        age, gadget = now - trace[TRACE_FRAME], int(trace[TRACE_GADGET])
        if age > (16.0 if gadget == DISC else 4.0):
            continue
        dx, dy, dz = trace[3] - trace[0], trace[4] - trace[1], trace[5] - trace[2]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        if length < DASH:
            continue
        dx, dy, dz = dx / length, dy / length, dz / length
        count, step, scale = 1, length, 0.7
        start = min(DASH + _SPEED * age, length - DASH / 2)
        if gadget != RAPID:
            count = min(int(length / DASH), DASHES)
            step, start = length / count, length / count / 2
            scale = 0.8 if gadget == DISC else 0.5
        for m in range(count):
            if used == SEGMENTS:
                return
            k, along = first + used, start + m * step
            used += 1
            x, y, z = trace[0] + along * dx, trace[1] + along * dy, trace[2] + along * dz
            _place(pictures, i, k, mesh, x, y, z - 3.0 * scale, scale)
            _turn(pictures.rotation[i, k], dx, dy, dz)
            _paint(pictures.colours[i, k], gadget)


@compiled(error_model="numpy")
def _draw_bars(pictures, i, status):
    """Draws bars of health and of ammunition, and a cross in the middle of the view."""
    overlays, paint = pictures.overlays[i], pictures.overlay_colours[i]
    gadget = status[GADGET]
    health = min(max(status[HEALTH] / FIRST_HEALTH, 0.0), 1.0)
    loaded = 1.0
    if gadget != IMPULSE:
        loaded = min(status[LOADED + gadget] / AMMUNITION[gadget], 1.0)
    up = status[TAGGED_AT] < 0
    for k in range(2):
        left, share = (0.03, health) if k == 0 else (0.53, loaded if up else 0.0)
        for n in range(2):
            overlay = overlays[2 * k + n]
            overlay[0], overlay[1], overlay[3] = left, 0.93, 0.98
            overlay[2] = left + 0.44 * (share if n else 1.0)
            for c in range(3):
                paint[2 * k + n, c] = _GROUND[c]
            paint[2 * k + n, 3] = 255 if n else 150
    for c in range(3):
        paint[1, c] = (_HURT if status[HEALTH] < _HURT_BELOW else _HEALTHY)[c]
        paint[3, c] = _PAINT[gadget, 0, c]
    for k in range(4, 6):
        wide, high = (1.5 / 96, 0.5 / 72) if k == 4 else (0.5 / 96, 1.5 / 72)
        overlay = overlays[k]
        overlay[0], overlay[2] = 0.501 - wide, 0.501 + wide  # away from the edges of pixels
        overlay[1], overlay[3] = 0.501 - high, 0.501 + high
        for c in range(3):
            paint[k, c] = _CROSS[c]
        paint[k, 3] = 200 if up else 0
    pictures.overlay_count[i] = BARS
