"""Runs the frames of a step in all envs, compiled, and stops where a level's rules are needed.

A frame is: turn and move (in combat: fight), touch items, enter zones, the timer, the gaze, the
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
LOOKED, LOOKED_AWAY = 6, 7  # events of a screen: the gaze has entered a widget, or has left it

_MOVING, _TOUCHING = 0, 1


@compiled(error_model="numpy")
def run(mask, commands, left, part, envs, over, timed_out, event, index):
    """Runs the envs of `mask` until their frames are used up or something happens.

    Args:
        mask: bool [N].
        commands: float64 [N, 5], see `actions.commands`.
        left: int64 [N], frames of the step that are left; written.
        part: int64 [N], the part of a frame at which an env stopped; written.
        envs: `Envs`, written.
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
                if envs.finishing[i]:
                    envs.finishing[i] = False
                    event[i] = MAP
                    break
                left[i] -= 1
                envs.clock[i] += 1
                turn, rise, strafe, forward, fire = commands[i]
                if envs.combat.fighters[i] > 0:
                    fight(envs, i, turn, rise, strafe, forward, fire > 0.0)
                else:
                    move(envs, i, turn, rise, strafe, forward)
                part[i] = _TOUCHING
            if envs.combat.fighters[i] > 0:
                index[i] = next_point(envs.combat, i)
                if index[i] != 0:
                    event[i] = POINT
                    break
            index[i] = _touched(envs, i)
            if index[i] >= 0:
                envs.present[i, index[i]] = False
                event[i] = ITEM
                break
            index[i] = _entered(envs, i)
            if index[i] >= 0:
                event[i] = ZONE
                break
            if 0 <= envs.timer[i] <= envs.clock[i]:
                envs.timer[i] = -1
                event[i] = TIMER
                break
            if envs.screen[i, 3] > 0.0:
                event[i], index[i] = _looked(envs, i)
                if event[i] != NOTHING:
                    break
            part[i] = _MOVING
            if envs.ending[i] > 0:
                envs.ending[i] -= 1
                over[i] = envs.ending[i] == 0
            timed_out[i] = not over[i] and envs.clock[i] >= envs.limit[i]
        happened |= event[i] != NOTHING
    return happened


@compiled(error_model="numpy")
def _touched(envs, i):
    """The first item that the player touches, or -1. Items whose time has come return first."""
    body = envs.bodies[i]
    for k in range(envs.present.shape[1]):
        if envs.returning[i, k] >= 0 and envs.clock[i] >= envs.returning[i, k]:
            envs.returning[i, k] = -1
            envs.present[i, k] = True
        if envs.present[i, k] and envs.touchable[i, k]:
            place = envs.places[i, k]
            if (
                abs(body[X] - place[0]) <= TOUCH_X
                and abs(body[Y] - place[1]) <= TOUCH_Y
                and abs(body[Z] - place[2]) <= TOUCH_Z
            ):
                return k
    return -1


@compiled(error_model="numpy")
def _entered(envs, i):
    """The first zone that the player has entered since the last call, or -1."""
    body = envs.bodies[i]
    for k in range(envs.zones.shape[1]):
        zone = envs.zones[i, k]
        inside = (
            zone[0] - WIDE <= body[X] <= zone[3] + WIDE
            and zone[1] - WIDE <= body[Y] <= zone[4] + WIDE
            and zone[2] - ABOVE <= body[Z] <= zone[5] + BELOW
            and zone[0] < zone[3]
        )
        before = envs.inside[i, k]
        envs.inside[i, k] = inside
        if inside and not before:
            return k
    return -1


@compiled(error_model="numpy")
def _looked(envs, i):
    """What the gaze has done since the last call, and to which widget: it leaves one first."""
    x, y = gaze(envs, i)
    now, before = widget_at(envs, i, x, y), envs.watched[i]
    if now == before:
        return NOTHING, -1
    if before >= 0:
        envs.watched[i] = -1
        return LOOKED_AWAY, before
    envs.watched[i] = now
    return LOOKED, now
