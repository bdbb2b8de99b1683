# SPDX-License-Identifier: Apache-2.0
"""A tree of coordinate frames, from what /tf_static and /tf say."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, NamedTuple

from rpgd_ros.core.geometry import RigidTransform
from rpgd_ros.messages.tf import Link

# Of each kind, static and moving: the largest robots have some hundred. Trackers that call every
# passing body by a new name reach it; then what was told longest ago gives way.
MAX_FRAMES: Final = 4096


class Path(NamedTuple):
    """How one frame lies in another.

    Attributes:
        pose: `target_T_source`.
        is_static: Whether all of it stood on /tf_static.

    """

    pose: RigidTransform
    is_static: bool


class FrameTree:
    """The newest transform to each frame from its parent.

    As in tf2, a frame has one parent: a message with another one moves the frame there. What is
    static stays so: a transform of /tf does not replace one of /tf_static.
    """

    def __init__(self) -> None:
        """Start empty."""
        # By child, those told longest ago first.
        self._static: dict[str, Link] = {}
        self._moving: dict[str, Link] = {}

    def __len__(self) -> int:
        """Return the number of frames that have a parent."""
        return len(self._static) + len(self._moving)

    def add(self, links: Iterable[Link], *, is_static: bool) -> None:
        """Take transforms in the order in which they were sent.

        Args:
            links: Edges.
            is_static: Whether they come from /tf_static.

        """
        for link in links:
            if not is_static and link.child in self._static:
                continue
            self._moving.pop(link.child, None)
            edges = self._static if is_static else self._moving
            edges.pop(link.child, None)
            edges[link.child] = link
            if len(edges) > MAX_FRAMES:
                del edges[next(iter(edges))]

    def parent(self, frame: str) -> str:
        """Return the parent of a frame, '' where none is known."""
        link = self._link(_plain(frame))
        return link.parent if link else ''

    def path(self, target: str, source: str) -> Path | None:
        """Compose the transform from one frame to another.

        Args:
            target: Frame to express points in.
            source: Frame of the points.

        Returns:
            `target_T_source`; None where the two are not connected.

        """
        up = self._ancestors(_plain(source))
        down = self._ancestors(_plain(target))
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            return None
        common_T_source, common_T_target = up[common], down[common]
        return Path(
            common_T_target.pose.inverse() @ common_T_source.pose,
            common_T_source.is_static and common_T_target.is_static,
        )

    def _ancestors(self, frame: str) -> dict[str, Path]:
        """Return `ancestor_T_frame` of a frame and all above it, nearest first."""
        found = {frame: Path(RigidTransform.identity(), is_static=True)}
        pose, is_static = found[frame]
        link = self._link(frame)
        while link is not None and link.parent not in found:  # a loop is no tree: stop there
            pose = link.parent_T_child @ pose
            is_static = is_static and link.child in self._static
            found[link.parent] = Path(pose, is_static)
            link = self._link(link.parent)
        return found

    def _link(self, frame: str) -> Link | None:
        return self._static.get(frame) or self._moving.get(frame)


def _plain(frame: str) -> str:
    return frame.removeprefix('/')
