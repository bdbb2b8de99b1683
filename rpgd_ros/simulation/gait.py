# SPDX-License-Identifier: Apache-2.0
"""The legs: feet that stand still on the floor, and the joint angles that put them there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rpgd_ros.core.geometry import Array
from rpgd_ros.simulation.motion import STANCE, stride_length

# Metres, of a body 1.75 m tall (Drillis and Contini's proportions, rounded).
THIGH = 0.43
SHANK = 0.42
HIP_HALF_WIDTH = 0.09
BALL = (0.13, 0.0, -0.07)  # of the foot, seen from the ankle; the sole is 7 cm below it
HEEL_TO_BALL = 0.18

STRAIGHT = 0.995 * (THIGH + SHANK)  # a standing knee is never quite straight: 11 deg here
TRACK_HALF_WIDTH = 0.075  # people walk on a narrower track than their hips
BALL_FORWARD = 0.09  # of the hip, when standing
PELVIS_BLEND_M = 0.02  # over which the pelvis passes from one carrying leg to the other
TOE_OUT = np.radians(6.0)


class Feet(NamedTuple):
    """Targets of one foot against the pelvis, in the body's heading frame (x forward, z up).

    Attributes:
        ball: (T, 3) ball of the foot; x and y from below the pelvis, z from the floor, metres.
        pitch: (T,) of the sole, positive with the heel raised, radians.
        toes_pitch: (T,) of the toes, which stay on the floor when the heel leaves it, radians.

    """

    ball: Array
    pitch: Array
    toes_pitch: Array


class Leg(NamedTuple):
    """Rotations of one leg's segments into the heading frame, each (T, 3, 3)."""

    thigh: Array
    shank: Array


def rot_x(angle: Array) -> Array:
    """Return rotations (T, 3, 3) about x by (T,) radians."""
    c, s = np.cos(angle), np.sin(angle)
    r = np.zeros((*angle.shape, 3, 3))
    r[..., 0, 0] = 1.0
    r[..., 1, 1] = r[..., 2, 2] = c
    r[..., 1, 2], r[..., 2, 1] = -s, s
    return r


def rot_y(angle: Array) -> Array:
    """Return rotations (T, 3, 3) about y by (T,) radians."""
    c, s = np.cos(angle), np.sin(angle)
    r = np.zeros((*angle.shape, 3, 3))
    r[..., 1, 1] = 1.0
    r[..., 0, 0] = r[..., 2, 2] = c
    r[..., 0, 2], r[..., 2, 0] = s, -s
    return r


def rot_z(angle: Array) -> Array:
    """Return rotations (T, 3, 3) about z by (T,) radians."""
    c, s = np.cos(angle), np.sin(angle)
    r = np.zeros((*angle.shape, 3, 3))
    r[..., 2, 2] = 1.0
    r[..., 0, 0] = r[..., 1, 1] = c
    r[..., 0, 1], r[..., 1, 0] = -s, s
    return r


def _bump(cycle: Array, centre: float, sharpness: float) -> Array:
    """A periodic bell of height 1 (the von Mises shape)."""
    bell: Array = np.exp(sharpness * (np.cos(2.0 * np.pi * (cycle - centre)) - 1.0))
    return bell


def foot_targets(cycle: Array, speed: Array, vigour: Array, side: float, scale: float) -> Feet:
    """Place a foot through its stride.

    In stance the ball of the foot moves backwards under the body exactly as fast as the body
    moves forwards, so it stands still on the floor; the swing returns it on a cubic that meets
    both ends with that speed.

    Args:
        cycle: (T,) phase of this foot; its heel strikes at whole numbers.
        speed: (T,) of the body, m/s.
        vigour: (T,) 0 to 1, scales the lift.
        side: +1 left, -1 right.
        scale: Size of the body against 1.75 m.

    """
    u = cycle - np.floor(cycle)
    stride = stride_length(speed)
    range_m = STANCE * stride
    front, back = 0.48 * range_m, -0.52 * range_m
    w = np.clip((u - STANCE) / (1.0 - STANCE), 0.0, 1.0)
    slope = -stride * (1.0 - STANCE)
    swing = (
        (2 * w**3 - 3 * w**2 + 1) * back
        + (3 * w**2 - 2 * w**3) * front
        + (2 * w**3 - 3 * w**2 + w) * slope
    )
    heel_rise = 0.95 * vigour**2 * _bump(u, 0.63, 10.0)
    toe_rise = 0.33 * vigour**2 * _bump(u, 0.97, 14.0)
    ball = np.empty((*u.shape, 3))
    ball[:, 0] = BALL_FORWARD * scale + np.where(u < STANCE, front - stride * u, swing)
    ball[:, 1] = side * TRACK_HALF_WIDTH * scale
    ball[:, 2] = scale * (0.05 * vigour * np.sin(np.pi * w) ** 2 + HEEL_TO_BALL * np.sin(toe_rise))
    return Feet(ball, heel_rise - toe_rise, -toe_rise)


def foot_rotation(pitch: Array, side: float) -> Array:
    """Return the foot's rotation (T, 3, 3) into the heading frame."""
    return rot_z(np.full_like(pitch, side * TOE_OUT)) @ rot_y(pitch)


def ankle_of(feet: Feet, side: float, scale: float) -> Array:
    """Return the ankles (T, 3) that go with the targets of a foot."""
    ankle: Array = feet.ball - scale * (foot_rotation(feet.pitch, side) @ np.array(BALL))
    return ankle


def pelvis_height(ankles: tuple[Array, Array], hips: tuple[Array, Array], scale: float) -> Array:
    """Return the largest height (T,) of the pelvis at which both legs reach their ankles.

    Args:
        ankles: (T, 3) left and right; z from the floor.
        hips: (T, 3) left and right, against the pelvis.
        scale: Size of the body against 1.75 m.

    """
    limits = []
    for ankle, hip in zip(ankles, hips, strict=True):
        across2 = ((ankle[:, :2] - hip[:, :2]) ** 2).sum(-1)
        rise = np.sqrt(np.maximum((STRAIGHT * scale) ** 2 - across2, (0.3 * scale) ** 2))
        limits.append(ankle[:, 2] + rise - hip[:, 2])
    blend = PELVIS_BLEND_M
    lowest: Array = -blend * np.logaddexp(-limits[0] / blend, -limits[1] / blend)
    return lowest


def bend_leg(hip_to_ankle: Array, scale: float) -> Leg:
    """Solve a leg of two bones: the knee points forwards.

    Args:
        hip_to_ankle: (T, 3) in the heading frame, metres, no longer than the leg.
        scale: Size of the body against 1.75 m.

    """
    x, y, z = np.moveaxis(hip_to_ankle, -1, 0)
    a, b = THIGH * scale, SHANK * scale
    r = np.clip(np.sqrt(x * x + y * y + z * z), abs(a - b) + 1e-3, 0.9999 * (a + b))
    knee = np.pi - np.arccos((a * a + b * b - r * r) / (2.0 * a * b))
    thigh = np.arctan2(x, np.hypot(y, z)) + np.arccos((a * a + r * r - b * b) / (2.0 * a * r))
    lean = rot_x(np.arctan2(y, -z))
    return Leg(lean @ rot_y(-thigh), lean @ rot_y(knee - thigh))
