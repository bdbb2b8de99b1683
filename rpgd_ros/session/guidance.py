# SPDX-License-Identifier: Apache-2.0
"""What the person in the room should do next, in words and numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

from rpgd_ros.core.config import AcceptConfig
from rpgd_ros.session.coverage import ImageCoverage, RoomCoverage
from rpgd_ros.session.expect import Expected

# Walks through a whole room of 4 x 4 m show a camera a quarter to half of its image in a minute,
# the rest is ceiling and walls: a camera that has seen this much needs no visit of its own.
GOAL_SHARE = 0.2
USUAL_S = 60.0  # asked for until it is known how fast the uncertainty falls
NOTHING = 0.005  # share of an image that is no more than a stray keypoint


@dataclass(frozen=True, slots=True)
class Guidance:
    """How far a recording is on its way to an accepted calibration.

    Attributes:
        seconds: That cameras and MoCap saw the person together.
        motion_m: How far the body has moved, metres.
        needed_motion_m: How far it must, metres.
        images: What each camera has seen, in the order of the rig.
        room: Where the person has been.
        expected: What the pose would be known to if the recording stopped now.
        gates: What it must be known to.

    """

    seconds: float
    motion_m: float
    needed_motion_m: float
    images: tuple[ImageCoverage, ...]
    room: RoomCoverage
    expected: Expected
    gates: AcceptConfig

    @property
    def coverage(self) -> float:
        """Mean share of the images that has been seen."""
        return sum(i.share for i in self.images) / max(len(self.images), 1)

    @property
    def excess(self) -> float:
        """Expected sigma over the largest accepted one, the worse of the two; NaN = not known."""
        if not self.expected.is_known:
            return math.nan
        turn = self.expected.sigma_deg / max(self.gates.max_sigma_deg, 1e-9)
        return max(turn, self.expected.sigma_m / max(self.gates.max_sigma_m, 1e-9))

    @property
    def wanted_s(self) -> float:
        """How long the recording should be, as far as can be told now, seconds.

        Independent errors fall with the root of the time. Errors that go with the body's attitude
        fall faster once it turns, and never where it stands: the advice matters more.
        """
        if math.isnan(self.excess):
            return USUAL_S
        return max(self.seconds, 1.0) * max(1.0, self.excess) ** 2

    @property
    def progress(self) -> float:
        """Progress to acceptance, 0 to 1: that of the gate that is farthest away."""
        n_pairs = sum(image.n_pairs for image in self.images)
        steps = [
            self.motion_m / self.needed_motion_m if self.needed_motion_m else 1.0,
            n_pairs / self.gates.min_pairs,
            self.seconds / self.wanted_s,
        ]
        return min(1.0, *steps)

    @property
    def advice(self) -> str:
        """What to do next; '' where nothing is missing."""
        if self.seconds and self.motion_m < self.needed_motion_m:
            return (
                f'walk through the room: moved {self.motion_m:.1f} of {self.needed_motion_m:.1f} m'
            )
        if not self.images or not self.seconds or self.excess <= 1.0:
            return ''
        poorest = min(self.images, key=lambda image: image.share)
        if poorest.share <= NOTHING:
            return f'{poorest.camera} has seen nobody yet: walk in front of it'
        if poorest.share < GOAL_SHARE:
            half = poorest.poorest_side
            where = f'walk to the {half} half of it' if half else 'walk nearer to it and across it'
            return f'{poorest.camera} has seen {poorest.share:.0%} of its image: {where}'
        length, width = self.room.extent_m
        return (
            f'turn around and cross the room, it was walked over {length:.1f} x {width:.1f} m so '
            'far'
        )

    @property
    def sentence(self) -> str:
        """Advice and figures for `~/status`."""
        parts = [self.advice, f'{self.seconds:.0f} of {self.wanted_s:.0f} s']
        if self.excess <= 1.0:
            parts[1] = f'{self.seconds:.0f} s are enough'
        if self.expected.is_known:
            parts.append(
                f'known to {self.expected.sigma_deg:.2f} deg (need '
                f'{self.gates.max_sigma_deg:.2f}) and {1e3 * self.expected.sigma_m:.0f} mm (need '
                f'{1e3 * self.gates.max_sigma_m:.0f}) if stopped now'
            )
        text = '; '.join(part for part in parts if part)
        return text[:1].upper() + text[1:] if not self._names_camera(text) else text

    def figures(self) -> dict[str, object]:
        """Return the figures by diagnostic key."""
        length, width = self.room.extent_m
        return {
            'progress': self.progress,
            'recorded_s': self.seconds,
            'wanted_s': self.wanted_s,
            'motion_m': self.motion_m,
            'coverage': self.coverage,
            'room_area_m2': self.room.area_m2,
            'room_length_m': length,
            'room_width_m': width,
            'expected_sigma_rotation_deg': self.expected.sigma_deg,
            'expected_sigma_position_m': self.expected.sigma_m,
        }

    def _names_camera(self, text: str) -> bool:
        """Whether the sentence begins with a camera's name, which keeps its spelling."""
        return any(text.startswith(f'{image.camera} ') for image in self.images)
