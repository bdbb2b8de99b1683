# SPDX-License-Identifier: Apache-2.0
"""The live node: a thin shell around `rpgd_ros.session`.

All callbacks run in one thread, because the multi-threaded executor of Jazzy's rclpy loses data;
the solve and the writing of files run in one worker thread, on a snapshot of data and settings.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup, ReentrantCallbackGroup
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import PublisherEventCallbacks
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.timer import Timer
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger

from rpgd_ros.io.rig import Rig
from rpgd_ros.ros import health
from rpgd_ros.ros.camera_inputs import CameraInputs
from rpgd_ros.ros.declare import LiveParameters, declare, given_values
from rpgd_ros.ros.engine import Engine
from rpgd_ros.ros.inputs import LOG_SECONDS, JointInput, health_by_stream
from rpgd_ros.ros.intake import Intake
from rpgd_ros.ros.job import answer
from rpgd_ros.ros.overlays import Overlays
from rpgd_ros.ros.replies import Replies
from rpgd_ros.ros.results import ReportWriter, Results
from rpgd_ros.ros.settings import NodeConfig
from rpgd_ros.ros.setup import read_setup
from rpgd_ros.ros.transforms import LATCHED, TransformOutput
from rpgd_ros.session import MOCAP, Session
from rpgd_ros.session.monitor import Monitor

NODE_NAME = 'rpgd_calibrator'
# A poll keeps messages waiting, so polls take turns: at one what came is handed on, at the next it
# is looked at. A publisher is found and a signal heeded within two.
POLL_SECONDS = 0.05
FOLLOW_TURNS = 10  # until an input that is heard has been compared with its publishers again


class CalibratorNode(Node):
    """Calibrates from the topics of a rig file and publishes the transform."""

    def __init__(self, name: str = NODE_NAME, *, report: ReportWriter | None = None) -> None:
        """Read rig file and parameters, publish a kept result, subscribe.

        Args:
            name: Of the node.
            report: Writes a page beside the result when asked to save.

        Raises:
            InputError: Rig file or parameters that cannot be used.

        """
        self._replies = Replies()  # before the services of parameters, which are rclpy's own
        super().__init__(name)
        rig, config = read_setup(given_values(self))
        cameras = tuple(config.cameras)
        declare(self, config, cameras)
        self._mocap_offset_s = rig.mocap.time_offset_s
        self._is_enabled = True
        self._n_at_last_run = 0
        self._n_polls = 0
        output = TransformOutput(self, with_tf=config.node.tf_mode == 'static')
        results = Results(self, output, rig.world_frame, config.node.result_file)
        results.report = report
        session = Session(rig, config.session())
        self._intake = Intake(session)
        self._monitor = Monitor(session, max_age_s=config.buffer.max_age_s)
        self._engine = Engine(self, session, results, monitor=self._monitor, flush=self._flush)
        stored = results.load_at_start() if config.node.load_on_start else None
        if stored is not None:
            self._engine.watch_stored(stored)
        self._overlays = Overlays(self, rig, self._monitor)
        self._joints = self._open_joints(rig)
        self._cameras = CameraInputs(
            self, session, rig, self._joints, with_tf=config.node.tf_mode == 'static'
        )
        self._status = self.create_publisher(String, '~/status', LATCHED)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self._open_services()
        self._auto_timer = self._open_timers(config)
        self._live = LiveParameters(
            self, config, cameras, on_change=self._engine.guarded(self._on_config)
        )

    @property
    def is_busy(self) -> bool:
        """Whether a job is running."""
        return self._engine.is_busy

    def request_stop(self) -> None:
        """Ask a running job to end; no other one is begun."""
        self._engine.request_stop()

    def join(self) -> None:
        """Wait for a file that is being written."""
        self._engine.join()

    def _open_joints(self, rig: Rig) -> list[JointInput]:
        take = self._engine.guarded(self._on_joints)
        topics = self._engine.session.topics().items()
        skeletons = [(t, s) for t, s in topics if s.partition('/')[0] == MOCAP]
        joints = [JointInput(self, s, t, rig.mocap.type, take) for t, s in skeletons]
        return joints + [
            JointInput(self, c.name, c.keypoints_topic, c.type, take) for c in rig.cameras
        ]

    def _open_services(self) -> None:
        # Reentrant, for a second caller to hear 'busy' at once instead of waiting its turn.
        group = ReentrantCallbackGroup()
        engine = self._engine
        for name, kind, serve in (
            ('calibrate', Trigger, self._on_calibrate),
            ('save', Trigger, lambda _: engine.save()),
            ('revert', Trigger, lambda _: engine.revert()),
            ('load', Trigger, lambda _: engine.load()),
            ('reset', Trigger, self._on_reset),
            ('set_enabled', SetBool, self._on_set_enabled),
        ):
            call = engine.service(serve)
            self.create_service(kind, f'~/{name}', call, callback_group=group)

    def _open_timers(self, config: NodeConfig) -> Timer:
        # Of the steady clock: the node has to stay awake where a simulation stands still.
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        guarded = self._engine.guarded
        self.create_timer(POLL_SECONDS, guarded(self._on_poll), clock=clock)
        period_s = config.node.diagnostics_period
        self.create_timer(period_s, guarded(self._on_diagnostics), clock=clock)
        return self.create_timer(
            config.auto.period_s,
            self._engine.guarded_to_end(self._on_auto),
            callback_group=MutuallyExclusiveCallbackGroup(),
            clock=clock,
        )

    def create_publisher(self, *args: Any, **keywords: Any) -> Publisher:
        """Create a publisher that hears of no events; arguments as for rclpy.

        rclpy asks every handler of an event at each wake, whatever woke it: with 14 cameras they
        took more time than the messages. They would tell of listeners whose QoS do not match;
        ours are reliable, which suits all.
        """
        silent = PublisherEventCallbacks(use_default_callbacks=False)
        return super().create_publisher(*args, event_callbacks=silent, **keywords)

    def create_service(self, *args: Any, **keywords: Any) -> Service:
        """Create a service whose answers reach new clients too; arguments as for rclpy."""
        return self._replies.keep(super().create_service(*args, **keywords))

    def _on_config(self, config: NodeConfig) -> None:
        session = self._engine.session
        session.update_config(config.session())
        self._monitor.resize(max_age_s=config.buffer.max_age_s)
        # The session counts a camera's offset against the MoCap's of its start.
        late_s = config.mocap.time_offset - self._mocap_offset_s
        for name, camera in config.cameras.items():
            if name in session.streams:
                session.update_camera(
                    name,
                    time_offset_s=camera.time_offset - late_s,
                    min_confidence=camera.min_confidence,
                )
        self._auto_timer.timer_period_ns = int(config.auto.period_s * 1e9)

    def _on_poll(self) -> None:
        self._n_polls += 1
        if self._n_polls % 2:
            self._follow()
        else:
            self._look()
        lost = self._replies.send_due()
        if lost:
            services = ', '.join(sorted(set(lost)))
            message = f'an answer of {services} was not sent: its caller was not found'
            Node.get_logger(self).warning(message, throttle_duration_sec=LOG_SECONDS)

    def _follow(self) -> None:
        """Follow the graph and hand on what has come."""
        for turn, joints in enumerate(self._joints):
            if not joints.is_subscribed or (self._n_polls // 2 + turn) % FOLLOW_TURNS == 0:
                joints.poll()
        self._cameras.poll()
        self._flush()

    def _look(self) -> None:
        # Whoever looks at the overlays wants all cameras at once; else they take turns.
        pairs = self._monitor.look(at_all=self._overlays.is_wanted)
        results = self._engine.results
        self._overlays.publish(pairs, results.published, results.accepted)

    def _flush(self) -> None:
        self._cameras.flush()
        for joints in self._joints:
            joints.flush()

    def _on_joints(
        self, stream: str, msg_type: str, payloads: Sequence[bytes], receive_ns: Sequence[int]
    ) -> None:
        if not self._is_enabled:
            return
        session = self._engine.session
        n_epochs = session.n_epochs
        session.add(stream, msg_type, payloads, receive_ns)
        if session.n_epochs != n_epochs:
            message = f'the clock of {stream} jumped back: all streams start over'
            Node.get_logger(self).warning(message, throttle_duration_sec=LOG_SECONDS)

    async def _on_auto(self) -> None:
        config = self._live.config
        if not config.auto.enabled or not self._is_enabled or self.is_busy:
            return
        self._flush()
        # Stored, not received: of dropped messages a run would calibrate the same data again.
        n_stored = self._intake.n_stored()
        if n_stored == self._n_at_last_run:
            return
        self._n_at_last_run = n_stored
        if self._engine.session.motion_m() >= config.buffer.min_motion:
            await self._engine.calibrate(is_automatic=True)

    async def _on_calibrate(self, _request: Trigger.Request) -> tuple[bool, str]:
        outcome = await self._engine.calibrate(is_automatic=False)
        return outcome.is_accepted, answer(outcome)

    async def _on_reset(self, _request: Trigger.Request) -> tuple[bool, str]:
        self._flush()
        self._engine.session.reset()
        self._monitor.clear()
        self._overlays.clear()
        return True, 'the buffers are empty; the published transform stays'

    async def _on_set_enabled(self, request: SetBool.Request) -> tuple[bool, str]:
        self._flush()
        self._is_enabled = bool(request.data)
        return True, 'collecting' if self._is_enabled else 'not collecting'

    def _on_diagnostics(self) -> None:
        self._flush()
        engine = self._engine
        inputs = self._intake.judged(
            health_by_stream(self._joints),
            is_collecting=self._is_enabled,
            now_s=time.monotonic(),
        )
        age_s = engine.results.age_s
        config = self._live.config
        guidance = self._monitor.guidance(config.accept, config.buffer.min_motion)
        complaint = self._monitor.watch.complaint()
        statuses = [
            health.calibration_status(
                engine.last,
                engine.results.accepted,
                age_s=age_s,
                n_errors=engine.n_errors,
                guidance=guidance,
                complaint=complaint,
            ),
            *health.input_statuses(
                engine.session, inputs, self._monitor, is_collecting=self._is_enabled
            ),
        ]
        array = DiagnosticArray(status=health.sign(statuses, self.get_namespace()))
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)
        sentence = health.sentence(
            list(inputs.values()),
            engine.last,
            engine.results.accepted,
            running=engine.running,
            guidance=guidance,
            complaint=complaint,
            age_s=age_s,
            is_collecting=self._is_enabled,
        )
        self._overlays.advice = sentence
        self._status.publish(String(data=sentence))
