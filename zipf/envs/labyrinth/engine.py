"""Runs the frames of a step in all envs, compiled, and stops where a level's rules are needed.

A frame is: turn and move (in combat: fight), touch items, enter zones, timers, the gaze, the
clock. Whatever happens is told to the episode of that env, in Python; then its frames go on where
they stopped. Envs do not wait for each other: most steps have no event at all.
"""

from zipf.compiled import compiled
from zipf.envs.labyrinth.gaze import gaze, widget_at
from zipf.envs.labyrinth.lasertag.fight import fight, next_point
from zipf.envs.labyrinth.mover import ABOVE, BELOW, WIDE, move
from zipf.envs.labyrinth.state import TOUCH_X, TOUCH_Y, TOUCH_Z, X, Y, Z

NOTHING, MAP, ITEM, ZONE, TIMER, POINT = range(6)
"""Kinds of events: a new map begins, an item was touched, a zone entered, a timer went off, the
player has won or lost a point in combat."""
LOOKED, LOOKED_AWAY = 6, 7
"""Events of a screen: the gaze has entered a widget, or has left it."""

_MOVING, _TOUCHING = 0, 1


@compiled(error_model="numpy")
def run(mask, commands, left, part, worlds, over, timed_out, event, index):
    """Runs the envs of `mask` until their frames are used up or something happens.

    Args:
        mask: bool [N].
        commands: float64 [N, 5], see `actions.commands`.
        left: int64 [N], frames of the step that are left; written.
        part: int64 [N], the part of a frame at which an env stopped; written.
        envs: `Worlds`, written.
        over, timed_out: bool [N], set where the level or the clock ends the episode.
        event, index: int64 [N], what happened and to which item, zone, timer or widget, or how many
            points were won; written.

    Returns whether anything happened.
    """
    happened = False
    for i in range(mask.size):
        event[i] = NOTHING
        if not mask[i]:
            continue
        while not over[i] and not timed_out[i]:
            if part[i] == _MOVING:
                if left[i] == 0:
                    break
                if worlds.finishing[i]:
                    worlds.finishing[i] = False
                    event[i] = MAP
                    break
                left[i] -= 1
                worlds.clock[i] += 1
                turn, rise, strafe, forward, fire = commands[i]
                if worlds.combat.fighters[i] > 0:
                    fight(worlds, i, turn, rise, strafe, forward, fire > 0.0)
                else:
                    move(worlds, i, turn, rise, strafe, forward)
                part[i] = _TOUCHING
            if worlds.combat.fighters[i] > 0:
                index[i] = next_point(worlds.combat, i)
                if index[i] != 0:
                    event[i] = POINT
                    break
            index[i] = _touched(worlds, i)
            if index[i] >= 0:
                worlds.present[i, index[i]] = False
                event[i] = ITEM
                break
            index[i] = _entered(worlds, i)
            if index[i] >= 0:
                event[i] = ZONE
                break
            index[i] = _expired(worlds, i)
            if index[i] >= 0:
                worlds.timers[i, index[i]] = -1
                event[i] = TIMER
                break
            if worlds.screen[i, 3] > 0.0:
                event[i], index[i] = _looked(worlds, i)
                if event[i] != NOTHING:
                    break
            part[i] = _MOVING
            if worlds.ending[i] > 0:
                worlds.ending[i] -= 1
                over[i] = worlds.ending[i] == 0
            timed_out[i] = not over[i] and worlds.clock[i] >= worlds.limit[i]
        happened |= event[i] != NOTHING
    return happened


@compiled(error_model="numpy")
def _touched(worlds, i):
    """The first item that the player touches, or -1. Items whose time has come return first."""
    body = worlds.bodies[i]
    for k in range(worlds.present.shape[1]):
        if worlds.returning[i, k] >= 0 and worlds.clock[i] >= worlds.returning[i, k]:
            worlds.returning[i, k] = -1
            worlds.present[i, k] = True
        if worlds.present[i, k] and worlds.touchable[i, k]:
            place = worlds.places[i, k]
            if (
                abs(body[X] - place[0]) <= TOUCH_X
                and abs(body[Y] - place[1]) <= TOUCH_Y
                and abs(body[Z] - place[2]) <= TOUCH_Z
            ):
                return k
    return -1


@compiled(error_model="numpy")
def _entered(worlds, i):
    """The first zone that the player has entered since the last call, or -1."""
    body = worlds.bodies[i]
    for k in range(worlds.zones.shape[1]):
        zone = worlds.zones[i, k]
        inside = (
            zone[0] - WIDE <= body[X] <= zone[3] + WIDE
            and zone[1] - WIDE <= body[Y] <= zone[4] + WIDE
            and zone[2] - ABOVE <= body[Z] <= zone[5] + BELOW
            and zone[0] < zone[3]
        )
        before = worlds.inside[i, k]
        worlds.inside[i, k] = inside
        if inside and not before:
            return k
    return -1


@compiled(error_model="numpy")
def _expired(worlds, i):
    """The first timer that has gone off, or -1."""
    for k in range(worlds.timers.shape[1]):
        if worlds.timers[i, k] >= 0 and worlds.clock[i] >= worlds.timers[i, k]:
            return k
    return -1


@compiled(error_model="numpy")
def _looked(worlds, i):
    """What the gaze has done since the last call, and to which widget: it leaves one first."""
    x, y = gaze(worlds, i)
    now, before = widget_at(worlds, i, x, y), worlds.watched[i]
    if now == before:
        return NOTHING, -1
    if before >= 0:
        worlds.watched[i] = -1
        return LOOKED_AWAY, before
    worlds.watched[i] = now
    return LOOKED, now
