# SPDX-License-Identifier: Apache-2.0
"""Writes rosbag2 recordings of Jazzy's format."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Literal, Self

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.messages.definitions import DEFINITIONS

METADATA_VERSION: Final = 9  # Jazzy's
Storage = Literal['mcap', 'sqlite3']
Compression = Literal['none', 'message', 'file', 'chunk']
_STORAGES: Final = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}
_MODES: Final = {
    'none': CompressionMode.NONE,
    'message': CompressionMode.MESSAGE,
    'file': CompressionMode.FILE,
    'chunk': CompressionMode.STORAGE,
}
_FAILURES: Final = (OSError, sqlite3.Error)
_EVER: Final = QosTime(9223372036, 854775807)
LATCHED: Final = Qos(
    QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, _EVER, _EVER,
    QosLiveliness.AUTOMATIC, _EVER, avoid_ros_namespace_conventions=False,
)  # fmt: skip


class BagWriter:
    """Writes a recording, as a context manager; nothing stands at `path` before all is written.

    Topics come into being with their first message.
    """

    def __init__(
        self,
        path: Path | str,
        *,
        storage: Storage = 'mcap',
        compression: Compression = 'none',
        asked: Path | None = None,
    ) -> None:
        """Say what to write; the files are opened on entering the context.

        Args:
            path: Folder that must not exist yet.
            storage: As `ros2 bag record --storage`.
            compression: With zstd: of each `message`, of the `file`, or of `chunk`s (mcap only).
            asked: What a person asked for, where `path` is on the way to it: for messages.

        Raises:
            InputError: Something is there already.

        """
        self.path = Path(path)
        self._asked = asked or self.path
        if compression == 'chunk' and storage != 'mcap':
            msg = f'chunks are a matter of mcap, not of {storage}: compress messages or the file'
            raise InputError(Reason.BAD_PARAMETER, msg)
        try:
            is_there = self.path.exists() or self.path.is_symlink()
        except OSError as error:
            raise self._not_writable(error) from error
        if is_there:
            msg = f'{self.path} exists already: remove it, or choose another place'
            raise InputError(Reason.NOT_WRITABLE, msg)
        self._storage = _STORAGES[storage]
        self._mode = _MODES[compression]
        self._connections: dict[str, Connection] = {}
        self._folder: Path
        self._writer: Writer

    def write(self, topic: str, msgtype: str, receive_ns: int, payload: bytes) -> None:
        """Append a message.

        Args:
            topic: Absolute name.
            msgtype: Its type, one of the common interfaces or of `DEFINITIONS`.
            receive_ns: Arrival.
            payload: Serialised message.

        Raises:
            InputError: The disk is full, or gone.

        """
        try:
            connection = self._connections.get(topic) or self._connect(topic, msgtype, _types())
            self._writer.write(connection, int(receive_ns), payload)
        except _FAILURES as error:
            raise self._not_writable(error) from error

    def declare(
        self, topic: str, msgtype: str, definition: str = '', *, is_latched: bool = False
    ) -> None:
        """Announce a topic before its first message; once.

        Args:
            topic: Absolute name.
            msgtype: Its type.
            definition: Of the type, where it is none that `write` knows.
            is_latched: Whether a player is to keep its last message for who comes late.

        Raises:
            InputError: BAD_BAG. The type is not known, and the definition does not tell it.

        """
        types = _types()
        try:
            if msgtype not in types.fielddefs and definition:
                types = get_typestore(Stores.ROS2_JAZZY)
                types.register({
                    name: fields
                    for name, fields in get_types_from_msg(definition, msgtype).items()
                    if name not in types.fielddefs
                })  # fmt: skip
            self._connect(topic, msgtype, types, (LATCHED,) if is_latched else ())
        except (KeyError, TypesysError, RecursionError, SyntaxError) as error:
            # The last two of types that hold themselves, and of names that Python cannot have.
            msg = f'topic {topic[:80]!r} has type {msgtype[:80]!r}, whose definition is not known'
            raise InputError(Reason.BAD_BAG, msg) from error

    def _connect(
        self, topic: str, msgtype: str, types: Typestore, qos: tuple[Qos, ...] = ()
    ) -> Connection:
        connection = self._writer.add_connection(
            topic, msgtype, typestore=types, offered_qos_profiles=qos
        )
        self._connections[topic] = connection
        return connection

    def __enter__(self) -> Self:
        """Open the files, in a hidden folder beside the later place.

        Raises:
            InputError: The place cannot be written to.

        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._folder = Path(
                tempfile.mkdtemp(prefix=f'.{self.path.name}.', dir=self.path.parent)
            )
        except OSError as error:
            raise self._not_writable(error) from error
        try:
            self._writer = Writer(
                self._folder / self.path.name,
                version=METADATA_VERSION,
                storage_plugin=self._storage,
            )
            self._writer.set_compression(self._mode, CompressionFormat.ZSTD)
            self._writer.open()
        except BaseException as error:
            self._remove()
            if isinstance(error, _FAILURES):
                raise self._not_writable(error) from error
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Put the recording in its place, or remove what there is of it after an error."""
        try:
            self._writer.__exit__(kind, error, traceback)
            if error is None:
                self._writer.path.rename(self.path)
        except _FAILURES as failure:
            raise self._not_writable(failure) from failure
        finally:
            self._remove()

    def _remove(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)

    def _not_writable(self, error: Exception) -> InputError:
        what = getattr(error, 'strerror', None) or error
        return InputError(Reason.NOT_WRITABLE, f'{self._asked} cannot be written: {what}')


@lru_cache(maxsize=1)
def _types() -> Typestore:
    types = get_typestore(Stores.ROS2_JAZZY)
    found: dict[str, Any] = {}
    for name, text in DEFINITIONS.items():
        found |= get_types_from_msg(text, name)
    types.register(found)
    return types
