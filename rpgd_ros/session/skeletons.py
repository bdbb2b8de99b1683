# SPDX-License-Identifier: Apache-2.0
"""The stream of skeletons of a session: whole ones, or parts that are gathered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rpgd_ros.core.geometry import BoolArray
from rpgd_ros.core.observations import LARGEST_COORDINATE
from rpgd_ros.io.rig import METRES_PER, MocapSource
from rpgd_ros.messages import PARTIAL_TYPES, POSE_STAMPED, decode_parts
from rpgd_ros.messages.adapters import PartBatch
from rpgd_ros.messages.layout import Drop
from rpgd_ros.pairing import BufferConfig
from rpgd_ros.session.gather import GatheredStream
from rpgd_ros.session.inputs import StreamInput

MOTION_FRAMES = 200  # of which the way of the body is measured, spread over the recording


class MocapInput(StreamInput):
    """The skeletons, in metres."""

    def __init__(self, source: MocapSource, used: Sequence[int], buffer: BufferConfig) -> None:
        """Start empty; `used` are the joints that some camera sees."""
        super().__init__(
            joints=source.sent_names,
            used=used,
            n_values=3,
            buffer=buffer,
            scale=METRES_PER[source.units],
        )
        names = [source.sent_names[j] for j in used]
        self._gathered = GatheredStream(names, buffer, root=source.frame)

    def add(
        self,
        msgtype: str,
        payloads: Sequence[bytes],
        receive_ns: Sequence[int],
        *,
        zero_is_missing: bool,
        use_receive_time: bool,
        part: str = '',
    ) -> bool:
        """Take serialised messages; see `StreamInput.add`."""
        is_whole = not part and msgtype not in PARTIAL_TYPES
        if is_whole and self.store is not self._gathered:
            return super().add(
                msgtype,
                payloads,
                receive_ns,
                zero_is_missing=zero_is_missing,
                use_receive_time=use_receive_time,
            )
        self._n_received += len(payloads)
        # A pose says where a joint is, but not of which: that is the topic's to tell.
        if msgtype not in PARTIAL_TYPES or (msgtype == POSE_STAMPED) != bool(part):
            self._dropped[Drop.WRONG_TYPE] += len(payloads)
            return False
        batch, dropped = decode_parts(msgtype, payloads)
        self._dropped.update(dropped)
        stamp_ns = batch.stamp_ns
        if use_receive_time:
            stamp_ns = np.array([receive_ns[i] for i in batch.index], np.int64)
        self._clear_missing(batch, zero_is_missing=zero_is_missing and bool(part))
        names = (part,) * len(batch.names) if part else batch.names
        self.store = self._gathered
        went_back = self._gathered.add(
            PartBatch(batch.index, stamp_ns, names, batch.parents, batch.values)
        )
        self.frame_id = self._gathered.root or None
        return went_back

    def clear(self) -> None:
        """Forget the messages, their frame, and whether they are parts; the counts stay."""
        for store in (self._whole, self._gathered):
            store.clear()
        self.store, self.frame_id = self._whole, None

    def counts(self) -> dict[str, int]:
        """Return what became of the messages, before a change between whole ones and parts too."""
        counts = super().counts()
        before = self._whole if self.store is self._gathered else self._gathered
        for reason, n in before.counts.items():
            if n and reason not in {'received', 'kept'}:
                counts[reason] = counts.get(reason, 0) + n
        return counts

    def resize(self, buffer: BufferConfig) -> None:
        """Change the bounds of the stores."""
        super().resize(buffer)
        self._gathered.resize(buffer.max_frames, buffer.max_age_s)

    def _clear_missing(self, batch: PartBatch, *, zero_is_missing: bool) -> None:
        """Bring places to metres, and take out those that are none; count them."""
        places = batch.values[:, -3:]
        absent = np.isnan(places).any(1)
        with np.errstate(invalid='ignore'):
            absent |= ~(np.abs(places) <= LARGEST_COORDINATE).all(1)
        is_zero = ~places.any(1) & zero_is_missing
        for reason, where in (('nan', absent), ('zero', is_zero)):
            if n := int(np.count_nonzero(where)):
                self._joints[reason] += n
        places[absent | is_zero] = np.nan
        places *= self._scale

    def motion_m(self) -> float:
        """Return how far the body moved: diagonal of the box that holds its centre, metres."""
        x = self.store.arrays().values
        x = x[np.linspace(0, len(x) - 1, min(len(x), MOTION_FRAMES)).astype(np.int64)]
        there: BoolArray = np.isfinite(x.sum(-1))
        there &= there.sum(1, keepdims=True) >= 0.5 * there.sum(1).max(initial=0)
        x = x[there.any(1)][:, there.any(0)]
        if not len(x):
            return 0.0
        # Each joint from its own place: a joint that comes and goes does not move the centre.
        centres = np.nanmean(x - np.nanmedian(x, 0), 1)
        low, high = np.quantile(centres, [0.02, 0.98], axis=0)
        return float(np.linalg.norm(high - low))
