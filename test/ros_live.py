# SPDX-License-Identifier: Apache-2.0
"""The real node as a process of its own, and a peer that plays to it over DDS."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geometry_msgs.msg import TransformStamped
from harness import Child, ros_environment, running
from ros_scene import Scene
from scenes import errors
from std_msgs.msg import String
from std_srvs.srv import Trigger

from rpgd_ros.core import RigidTransform
from rpgd_ros.io.rig import read_rig
from rpgd_ros.ros.client import NODE, CalibratorClient
from rpgd_ros.ros.domain import free_domain
from rpgd_ros.ros.player import Peer, Timed

CALIBRATOR = ['-m', 'rpgd_ros.apps.calibrator']
WAIT_S = 20.0  # of a machine that does other things too
MINUTES = 100_000  # steps: at 1 to 2 ms each


@dataclass(frozen=True)
class Live:
    """A running node and its peer."""

    child: Child
    peer: Peer
    client: CalibratorClient

    def wait_until(self, what: str, condition: Any, *, seconds: float = WAIT_S) -> None:
        """Wait for a condition; fail with what was waited for and what the node said."""
        assert self.peer.wait_until(condition, seconds=seconds), f'{what}:\n{self.child.output}'

    def play(self, scene: Scene, *, rate: float = 8.0, is_reliable: bool = True) -> dict[str, int]:
        """Play a scene and return how many messages of each topic were sent."""
        self.advertise(scene.topics, is_reliable=is_reliable)
        return self.send(scene.messages, rate=rate)

    def advertise(self, topics: Mapping[str, str], *, is_reliable: bool = True) -> None:
        """Open publishers and wait until the node listens to each."""
        self.peer.advertise(topics, is_reliable=is_reliable)
        self.wait_until('no subscriber', lambda: not self.peer.without_subscriber())

    def send(self, messages: Iterable[Timed], *, rate: float = 8.0) -> dict[str, int]:
        """Play messages and wait until the node has counted them all."""
        sent = self.peer.play(messages, rate=rate)
        self.wait_until('not counted', lambda: self.received() == sent)
        return sent

    def received(self) -> dict[str, int]:
        """Return how many messages of each topic the node has counted."""
        return self.client.received()

    def calibrate(self) -> tuple[bool, dict[str, Any]]:
        """Call ~/calibrate and return its success and its answer."""
        called = self.client.calibrate(seconds=WAIT_S)
        assert called is not None, self.child.output
        return called

    def call(self, service: str) -> Trigger.Response:
        """Call another Trigger service of the node and return its answer."""
        answer = self.peer.call(f'{NODE}/{service}', seconds=WAIT_S)
        assert answer is not None, self.child.output
        return answer

    def sentence(self) -> str:
        """Return what ~/status says now."""
        return str(self.latched('status', String).data)

    def latched(self, topic: str, msg_type: type) -> Any:
        """Return the newest message of a latched topic of the node."""
        name = f'{NODE}/{topic}'
        if self.peer.newest(name) is None:
            self.peer.listen(name, msg_type)
            self.wait_until(f'no {topic}', lambda: self.peer.newest(name) is not None)
        return self.peer.newest(name)


def slow(n_steps: int = MINUTES) -> tuple[str, ...]:
    """Return parameters of a solve that takes 1 ms or more for each of so many steps.

    The published descent stops nowhere before the last. Where clocks or joint offsets are
    estimated, it has no part in the solve.
    """
    return (
        'sync.estimate_offset:=off',
        'refine.joint_offsets:=false',
        'refine.method:=adam',
        f'refine.iterations:={n_steps}',
    )


@contextmanager
def live(
    rig: Path,
    *parameters: str,
    namespace: str = '',
    remaps: Sequence[str] = (),
    program: Sequence[str] = CALIBRATOR,
    domain: int | None = None,
) -> Iterator[Live]:
    """Run the node with a rig file; its result file is `result.yaml` beside that.

    Args:
        rig: Rig file.
        parameters: As `name:=value`; automatic calibration is off unless they say otherwise.
        namespace: Of the node and its peer.
        remaps: As `from:=to`.
        program: What to run, before the arguments of ROS.
        domain: Of the node and its peer; None = a free one.

    """
    domain = free_domain() if domain is None else domain
    given = (
        f'rig_file:={rig}',
        f'result_file:={rig.parent / "result.yaml"}',
        'auto.enabled:=false',
        'diagnostics_period:=0.1',
        'tf_mode:=none',
        *parameters,
    )
    arguments = [*program, '--ros-args', *(word for p in given for word in ('-p', p))]
    if namespace:
        arguments += ['-r', f'__ns:={namespace}']
    arguments += [word for remap in remaps for word in ('-r', remap)]
    with (
        running(arguments, ros_environment(domain)) as child,
        Peer('peer', domain_id=domain, namespace=namespace) as peer,
    ):
        yield Live(child, peer, CalibratorClient(peer, read_rig(rig)))


def bits(message: TransformStamped) -> list[str]:
    """Return every bit of a transform message."""
    t, q = message.transform.translation, message.transform.rotation
    return [value.hex() for value in (t.x, t.y, t.z, q.x, q.y, q.z, q.w)]


def answered_bits(answer: dict[str, Any]) -> list[str]:
    """Return every bit of the transform in the answer of ~/calibrate."""
    return [float(value).hex() for value in (*answer['xyz'], *answer['quat_xyzw'])]


def assert_close(found: RigidTransform, scene: Scene) -> None:
    """Compare with the truth; eight seconds of walk give 0.01 deg and 0.3 mm."""
    error_deg, error_m = errors(found, scene.world_T_mocap, scene.recording.observations())
    assert error_deg < 0.1
    assert error_m < 0.005
