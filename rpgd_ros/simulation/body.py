# SPDX-License-Identifier: Apache-2.0
"""An articulated human body: a chain of rigid segments, moved by joint angles.

World and body frames have z up; a body's own frame has x forward and y left (REP 103).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.core.geometry import Array
from rpgd_ros.simulation import gait
from rpgd_ros.simulation.gait import rot_x, rot_y, rot_z
from rpgd_ros.simulation.motion import Course, Instants, MotionName, plan_course
from rpgd_ros.simulation.signals import Wobble, smooth_step

Offset = tuple[float, float, float]
SIDES = MappingProxyType({'left': 1.0, 'right': -1.0})
SIZES = (0.92, 1.08)  # against 1.75 m: from 1.61 to 1.89 m, nine adults of ten
CROUCH_M = 0.38  # the pelvis at the lowest crouch: knees at about 110 deg


def _segments() -> dict[str, tuple[str, Offset]]:
    """Segment: (parent, where it is hinged in the parent's frame, metres)."""
    tree: dict[str, tuple[str, Offset]] = {
        'lumbar': ('pelvis', (-0.01, 0.0, 0.10)),
        'thorax': ('lumbar', (0.0, 0.0, 0.16)),
        'neck': ('thorax', (0.01, 0.0, 0.22)),
        'head': ('neck', (0.02, 0.0, 0.09)),
    }
    for side, y in SIDES.items():
        tree[f'{side}_clavicle'] = ('thorax', (0.02, y * 0.02, 0.19))
        tree[f'{side}_upper_arm'] = (f'{side}_clavicle', (-0.02, y * 0.155, 0.0))
        tree[f'{side}_forearm'] = (f'{side}_upper_arm', (0.0, 0.0, -0.29))
        tree[f'{side}_hand'] = (f'{side}_forearm', (0.0, 0.0, -0.255))
        tree[f'{side}_thigh'] = ('pelvis', (0.0, y * gait.HIP_HALF_WIDTH, 0.0))
        tree[f'{side}_shank'] = (f'{side}_thigh', (0.0, 0.0, -gait.THIGH))
        tree[f'{side}_foot'] = (f'{side}_shank', (0.0, 0.0, -gait.SHANK))
        tree[f'{side}_toes'] = (f'{side}_foot', gait.BALL)
    return tree


def _landmarks() -> dict[str, tuple[str, Offset]]:
    """Landmark: (segment, place in its frame, metres)."""
    marks: dict[str, tuple[str, Offset]] = {
        'pelvis': ('pelvis', (0.0, 0.0, 0.0)),
        'spine_lower': ('lumbar', (0.0, 0.0, 0.0)),
        'spine_middle': ('lumbar', (0.0, 0.0, 0.09)),
        'spine_upper': ('thorax', (0.0, 0.0, 0.0)),
        'chest': ('thorax', (0.02, 0.0, 0.10)),
        'thorax': ('thorax', (0.02, 0.0, 0.18)),
        'neck': ('neck', (0.0, 0.0, 0.0)),
        'head': ('head', (0.0, 0.0, 0.0)),
        'head_centre': ('head', (0.02, 0.0, 0.09)),
        'head_top': ('head', (0.01, 0.0, 0.21)),
        'nose': ('head', (0.12, 0.0, 0.06)),
        'jaw': ('head', (0.08, 0.0, -0.01)),
    }
    for side, y in SIDES.items():
        here: dict[str, tuple[str, Offset]] = {
            'eye': ('head', (0.09, y * 0.032, 0.095)),
            'eye_inner': ('head', (0.095, y * 0.017, 0.095)),
            'eye_outer': ('head', (0.08, y * 0.047, 0.095)),
            'ear': ('head', (0.01, y * 0.075, 0.07)),
            'mouth': ('head', (0.10, y * 0.025, 0.015)),
            'clavicle': (f'{side}_clavicle', (0.0, 0.0, 0.0)),
            'shoulder': (f'{side}_upper_arm', (0.0, 0.0, 0.0)),
            'elbow': (f'{side}_forearm', (0.0, 0.0, 0.0)),
            'wrist': (f'{side}_hand', (0.0, 0.0, 0.0)),
            'hand': (f'{side}_hand', (0.01, 0.0, -0.085)),
            'hand_tip': (f'{side}_hand', (0.02, 0.0, -0.18)),
            'thumb_base': (f'{side}_hand', (0.03, 0.0, -0.03)),
            'thumb': (f'{side}_hand', (0.05, 0.0, -0.06)),
            'thumb_tip': (f'{side}_hand', (0.065, 0.0, -0.10)),
            'index': (f'{side}_hand', (0.03, 0.0, -0.095)),
            'pinky': (f'{side}_hand', (-0.035, 0.0, -0.08)),
            'hip': (f'{side}_thigh', (0.0, 0.0, 0.0)),
            'knee': (f'{side}_shank', (0.0, 0.0, 0.0)),
            'ankle': (f'{side}_foot', (0.0, 0.0, 0.0)),
            'heel': (f'{side}_foot', (-0.05, 0.0, -0.065)),
            'foot': (f'{side}_foot', (0.10, 0.0, -0.05)),
            'toe_base': (f'{side}_toes', (0.0, 0.0, 0.01)),
            'toe_tip': (f'{side}_toes', (0.06, 0.0, 0.005)),
            'big_toe': (f'{side}_toes', (0.06, y * -0.03, 0.005)),
            'small_toe': (f'{side}_toes', (0.02, y * 0.045, 0.005)),
        }
        marks |= {f'{side}_{name}': place for name, place in here.items()}
    return marks


SEGMENTS: Mapping[str, tuple[str, Offset]] = MappingProxyType(_segments())
LANDMARKS: Mapping[str, tuple[str, Offset]] = MappingProxyType(_landmarks())


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """A body at some instants.

    Attributes:
        hinge: Segment -> (T, 3) where it is hinged, metres, world frame.
        rotation: Segment -> (T, 3, 3) its frame in the world.
        heading: (T,) direction of the body's forward axis, radians from x towards y.
        scale: Size against 1.75 m.

    """

    hinge: Mapping[str, Array]
    rotation: Mapping[str, Array]
    heading: Array
    scale: float

    def place(self, names: Sequence[str]) -> Array:
        """Return the landmarks (T, J, 3), metres, world frame.

        Raises:
            InputError: Unknown landmark.

        """
        unknown = [name for name in names if name not in LANDMARKS]
        if unknown:
            msg = f'the body has no landmark {unknown[0]!r}; known: {", ".join(LANDMARKS)}'
            raise InputError(Reason.BAD_INPUT, msg)
        x = np.empty((len(self.heading), len(names), 3))
        for j, name in enumerate(names):
            segment, offset = LANDMARKS[name]
            arm = self.scale * np.array(offset)
            x[:, j] = self.hinge[segment] + self.rotation[segment] @ arm
        return x

    def segment_frames(self, names: Sequence[str]) -> Array:
        """Return the frames (T, J, 3, 3) of the segments that carry the landmarks."""
        return np.stack([self.rotation[LANDMARKS[name][0]] for name in names], 1)


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A person on a course, as a function of continuous time.

    Attributes:
        course: Where it goes.
        scale: Size against 1.75 m.
        habits: Slow random signals by name: lean, bend, twist, nod, look, crouch, and per side
            reach, spread, elbow.

    """

    course: Course
    scale: float
    habits: Mapping[str, Wobble]

    @classmethod
    def draw(
        cls,
        rng: np.random.Generator,
        motion: MotionName = 'walk',
        *,
        seconds: float,
        area_m: float = 4.0,
        centre: tuple[float, float] = (0.0, 0.0),
    ) -> Body:
        """Draw a person; arguments as those of `plan_course`."""
        course = plan_course(rng, motion, seconds=seconds, area_m=area_m, centre=centre)
        habits = {
            'lean': Wobble.draw(rng, 0.05, 0.1, 0.6),
            'bend': Wobble.draw(rng, 0.05, 0.1, 0.6),
            'twist': Wobble.draw(rng, 0.15, 0.05, 0.4),
            'nod': Wobble.draw(rng, 0.15, 0.05, 0.5),
            'look': Wobble.draw(rng, 0.30, 0.05, 0.5),
            'crouch': Wobble.draw(rng, 1.0, 0.03, 0.12),
        }
        for side in SIDES:
            habits[f'{side}_reach'] = Wobble.draw(rng, 1.0, 0.04, 0.25)
            habits[f'{side}_spread'] = Wobble.draw(rng, 1.0, 0.04, 0.25)
            habits[f'{side}_elbow'] = Wobble.draw(rng, 0.6, 0.05, 0.5)
        return cls(course, float(rng.uniform(*SIZES)), MappingProxyType(habits))

    def at(self, t: Array) -> Pose:
        """Return the body at the times (T,), seconds."""
        now = self.course.at(t)
        habit = {name: wobble(now.activity) for name, wobble in self.habits.items()}
        # A crouch now and then, not all the time: only the upper part of the signal counts.
        crouch = smooth_step((habit['crouch'] - 0.45) / 0.9)
        heading = rot_z(now.heading)
        rotation = {'pelvis': _pelvis(now, habit, crouch)}
        _bend_trunk(rotation, now, habit, crouch)
        for side, y in SIDES.items():
            _swing_arm(rotation, now, habit, side, y)
        height = self._put_on_feet(rotation, now, crouch)
        forward = {name: heading @ r for name, r in rotation.items()}
        sway = np.column_stack([now.sway, height])
        root = np.column_stack([now.position, np.zeros_like(t)]) + np.einsum(
            'tij,tj->ti', heading, sway
        )
        hinge = {'pelvis': root}
        for name, (parent, offset) in SEGMENTS.items():
            hinge[name] = hinge[parent] + forward[parent] @ (self.scale * np.array(offset))
        return Pose(hinge, forward, now.heading, self.scale)

    def _put_on_feet(self, rotation: dict[str, Array], now: Instants, crouch: Array) -> Array:
        """Add the rotations of the legs; return the pelvis' height (T,) above the floor."""
        hips, ankles = [], []
        for side, y in SIDES.items():
            cycle = now.phase + (0.0 if y > 0.0 else 0.5)
            feet = gait.foot_targets(cycle, now.speed, now.vigour, y, self.scale)
            feet.ball[:, :2] -= now.sway
            feet.ball[:, 0] += 0.10 * self.scale * crouch  # who crouches sits back
            rotation[f'{side}_foot'] = gait.foot_rotation(feet.pitch, y)
            rotation[f'{side}_toes'] = gait.foot_rotation(feet.toes_pitch, y)
            ankles.append(gait.ankle_of(feet, y, self.scale))
            hip = np.array([0.0, y * gait.HIP_HALF_WIDTH, 0.0]) * self.scale
            hips.append(rotation['pelvis'] @ hip)
        height = gait.pelvis_height((ankles[0], ankles[1]), (hips[0], hips[1]), self.scale)
        height = height - CROUCH_M * self.scale * crouch
        for side, hip, ankle in zip(SIDES, hips, ankles, strict=True):
            pelvis = np.column_stack([np.zeros((len(height), 2)), height])
            leg = gait.bend_leg(ankle - hip - pelvis, self.scale)
            rotation[f'{side}_thigh'], rotation[f'{side}_shank'] = leg.thigh, leg.shank
        return height


def _pelvis(now: Instants, habit: Mapping[str, Array], crouch: Array) -> Array:
    """The pelvis turns with the leading leg, drops on the swinging side, and tips in a crouch."""
    stride = np.cos(2.0 * np.pi * now.phase)
    yaw = -0.09 * now.vigour * stride
    drop = -0.06 * now.vigour * np.sin(2.0 * np.pi * now.phase)
    return rot_z(yaw) @ rot_y(0.35 * crouch + 0.5 * habit['lean']) @ rot_x(drop)


def _bend_trunk(
    rotation: dict[str, Array], now: Instants, habit: Mapping[str, Array], crouch: Array
) -> None:
    """Add lumbar, thorax, neck and head: the chest turns against the pelvis, the head looks."""
    stride = np.cos(2.0 * np.pi * now.phase)
    list_back = 0.05 * now.vigour * np.sin(2.0 * np.pi * now.phase)
    pitch = 0.25 * crouch + 0.03 * now.vigour + 0.5 * habit['lean']
    yaw = 0.09 * now.vigour * stride + 0.5 * habit['twist']
    half = rot_z(yaw) @ rot_y(pitch) @ rot_x(list_back + 0.5 * habit['bend'])
    rotation['lumbar'] = rotation['pelvis'] @ half
    rotation['thorax'] = rotation['lumbar'] @ half
    upright = 0.06 - 0.35 * crouch
    rotation['neck'] = rotation['thorax'] @ rot_z(0.4 * habit['look']) @ rot_y(upright + 0.12)
    rotation['head'] = (
        rotation['neck'] @ rot_z(0.6 * habit['look']) @ rot_y(habit['nod'] + upright - 0.2)
    )


def _swing_arm(
    rotation: dict[str, Array], now: Instants, habit: Mapping[str, Array], side: str, y: float
) -> None:
    """Add one arm: it swings against the leg of its side, and reaches out now and then."""
    cycle = now.phase + (0.0 if y > 0.0 else 0.5)
    swing = -np.cos(2.0 * np.pi * cycle) * now.vigour
    reach = smooth_step((habit[f'{side}_reach'] - 0.2) / 1.1)
    spread = smooth_step((habit[f'{side}_spread'] - 0.3) / 1.1)
    calm = 1.0 - 0.8 * np.maximum(reach, spread)
    rotation[f'{side}_clavicle'] = rotation['thorax'] @ rot_x(y * 0.12 * (reach + spread))
    flexion = 0.05 + 0.45 * swing * calm + 2.2 * reach
    away = 0.14 + 1.3 * spread
    rotation[f'{side}_upper_arm'] = (
        rotation[f'{side}_clavicle'] @ rot_x(y * away) @ rot_y(-flexion)
    )
    bent = np.logaddexp(0.0, 6.0 * habit[f'{side}_elbow']) / 6.0  # never bends backwards
    elbow = 0.30 + 0.22 * (1.0 + swing) * calm + bent
    rotation[f'{side}_forearm'] = (
        rotation[f'{side}_upper_arm'] @ rot_z(-y * 0.3 * np.ones_like(elbow)) @ rot_y(-elbow)
    )
    # Palms face the thighs: thumbs forwards.
    rotation[f'{side}_hand'] = rotation[f'{side}_forearm'] @ rot_y(
        -0.15 + 0.25 * habit[f'{side}_elbow']
    )
