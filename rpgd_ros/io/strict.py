# SPDX-License-Identifier: Apache-2.0
"""Strict reading of YAML: nothing is guessed, and each complaint names file and key."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NoReturn

import yaml

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.skeletons import hint

MAX_BYTES = 2**20  # 14 cameras take 10 KiB
MAX_EVENTS = 50_000  # 14 cameras take 2000; a second without libyaml
MAX_DEPTH = 32
MAX_SCALAR = 4096
MAX_SHOWN = 80  # characters of a foreign string in a message

# libyaml where PyYAML was built with it: 20 times faster.
_BASE: type[yaml.SafeLoader] = getattr(yaml, 'CSafeLoader', yaml.SafeLoader)
# What some libraries write before each quoted text, and what parameter files of ROS may have.
TEXT_TAGS: Final = (None, '!', 'tag:yaml.org,2002:str')


class _Loader(_BASE):  # type: ignore[misc, valid-type]
    """Safe loader that refuses a key given twice instead of taking the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:  # noqa: FBT001, FBT002
        seen: set[object] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, Hashable) and key in seen:
                msg = f'key {shown(key)} is given twice'
                raise yaml.constructor.ConstructorError(None, None, msg, key_node.start_mark)
            if isinstance(key, Hashable):
                seen.add(key)
        mapping: dict[Hashable, Any] = super().construct_mapping(node, deep=deep)
        return mapping


def shown(value: object) -> str:
    """Return a foreign value as it may stand in a message: quoted, and not too long."""
    try:
        text = repr(value)
    except RecursionError:  # of dotted keys of TOML, which nest without brackets
        return f'a {type(value).__name__} that is nested too deeply'
    return text if len(text) <= MAX_SHOWN else f'{text[: MAX_SHOWN - 3]}...'


@dataclass(frozen=True, slots=True)
class Node:
    """A value of a YAML file with the place where it stands.

    Attributes:
        value: As YAML gives it.
        source: File, for messages.
        reason: Code of the errors.
        path: Key path from the root, '' at the root.

    """

    value: Any
    source: str
    reason: Reason
    path: str = ''

    def refuse(self, message: str) -> NoReturn:
        """Raise an error about this value.

        Raises:
            InputError: Always, naming file and key.

        """
        where = f'{self.source}: {self.path}' if self.path else self.source
        raise InputError(self.reason, f'{where}: {message}')

    def mapping(
        self, required: Collection[str], optional: Collection[str] = ()
    ) -> Mapping[str, Node]:
        """Return the entries of a mapping by key.

        Raises:
            InputError: No mapping, an unknown key, or a required one missing.

        """
        if not isinstance(self.value, Mapping):
            self.refuse(f'need a mapping, got {shown(self.value)}')
        known = [*required, *optional]
        for key in self.value:
            if key not in known:
                self.refuse(f'unknown key {shown(key)}, {hint(key, known)}')
        for key in required:
            if key not in self.value:
                self.refuse(f'{key} is missing')
        return {key: self._child(f'.{key}', value) for key, value in self.value.items()}

    def items(self) -> Iterator[tuple[str, Node]]:
        """Yield the entries of a mapping whose keys are free text."""
        if not isinstance(self.value, Mapping):
            self.refuse(f'need a mapping, got {shown(self.value)}')
        for key, value in self.value.items():
            if not isinstance(key, str):
                self.refuse(f'key {shown(key)} is no text: put it in quotes')
            yield key, self._child(f'.{key}', value)

    def sequence(self) -> list[Node]:
        """Return the entries of a list."""
        if not isinstance(self.value, list):
            self.refuse(f'need a list, got {shown(self.value)}')
        return [self._child(f'[{i}]', value) for i, value in enumerate(self.value)]

    def text(self) -> str:
        """Return a text that is not empty."""
        if not isinstance(self.value, str) or not self.value.strip():
            self.refuse(f'need a text, got {shown(self.value)}')
        return self.value

    def choice(self, known: Collection[str]) -> str:
        """Return a text that is one of those known."""
        if not isinstance(self.value, str) or self.value not in known:
            self.refuse(f'{shown(self.value)} is unknown, {hint(self.value, known)}')
        return self.value

    def flag(self) -> bool:
        """Return true or false."""
        if not isinstance(self.value, bool):
            self.refuse(f'need true or false, got {shown(self.value)}')
        return self.value

    def number(self, low: float = -math.inf, high: float = math.inf) -> float:
        """Return a finite number within bounds."""
        value = self.value
        if isinstance(value, str):
            # YAML 1.1 takes 1e-5 for a text.
            self.refuse(f'need a number, got the text {shown(value)} (write 1.0e-5 for 1e-5)')
        if not isinstance(value, int | float) or isinstance(value, bool):
            self.refuse(f'need a number, got {shown(value)}')
        if not abs(value) <= 1e300:  # nor NaN, nor an integer beyond any float
            self.refuse('need a finite number')
        if not low <= value <= high:
            self.refuse(f'{value:g} is outside {low:g} to {high:g}')
        return float(value)

    def integer(self, low: int, high: int) -> int:
        """Return an integer within bounds."""
        if not isinstance(self.value, int) or isinstance(self.value, bool):
            self.refuse(f'need an integer, got {shown(self.value)}')
        if not low <= self.value <= high:
            self.refuse(f'need an integer from {low} to {high}')
        return self.value

    def numbers(self, *lengths: int) -> list[float]:
        """Return a list of finite numbers of one of the given lengths."""
        values = [node.number() for node in self.sequence()]
        if len(values) not in lengths:
            wanted = ' or '.join(str(n) for n in lengths)
            self.refuse(f'need {wanted} numbers, got {len(values)}')
        return values

    def _child(self, step: str, value: object) -> Node:
        return Node(value, self.source, self.reason, f'{self.path}{step}'.removeprefix('.'))


def read_yaml(path: Path | str, reason: Reason, *, max_scalar: int = MAX_SCALAR) -> Node:
    """Read a YAML file.

    Args:
        path: The file.
        reason: Code of the errors.
        max_scalar: Longest text in it.

    Raises:
        InputError: `reason`. Not to be read, larger than 1 MiB, not UTF-8, or as `parse_yaml`.

    """
    try:
        with Path(path).open('rb') as file:
            data = file.read(MAX_BYTES + 1)
        text = data.decode()
    except OSError as error:
        msg = f'{path} cannot be read: {error.strerror or error}'
        raise InputError(reason, msg) from error
    except UnicodeDecodeError as error:
        msg = f'{path} is not UTF-8 text (byte {error.start})'
        raise InputError(reason, msg) from error
    return parse_yaml(text, str(path), reason, max_scalar=max_scalar)


def parse_yaml(text: str, source: str, reason: Reason, *, max_scalar: int = MAX_SCALAR) -> Node:
    """Parse YAML text without running into its traps.

    Raises:
        InputError: `reason`. Not YAML, empty, a key given twice, an alias, a tag, or absurdly
            large.

    """
    if len(text) > MAX_BYTES:
        msg = f'{source}: more than {MAX_BYTES} bytes'
        raise InputError(reason, msg)
    try:
        _check_events(text, lambda what: InputError(reason, f'{source}: {what}'), max_scalar)
        value = yaml.load(text, _Loader)  # noqa: S506 (derived from the safe loader)
    except yaml.YAMLError as error:
        msg = f'{source} is not YAML: {_one_line(error)}'
        raise InputError(reason, msg) from error
    except (ValueError, OverflowError) as error:  # dates such as 2024-99-99
        msg = f'{source} holds an impossible value: {shown(str(error))}'
        raise InputError(reason, msg) from error
    if value is None:
        msg = f'{source} is empty'
        raise InputError(reason, msg)
    return Node(value, source, reason)


def _check_events(text: str, refusal: Callable[[str], InputError], max_scalar: int) -> None:
    """Refuse what grows or nests without bound before anything is built from it.

    Tags go the same way: PyYAML ends in an IndexError on `!!int ""`, in others on other ones.
    """
    depth = 0
    for n, event in enumerate(yaml.parse(text, _Loader)):
        line = event.start_mark.line + 1 if event.start_mark else 0
        if isinstance(event, yaml.AliasEvent):
            msg = f'line {line}: aliases (*{event.anchor}) are not taken: write the value out'
            raise refusal(msg)
        tag = getattr(event, 'tag', None)
        if tag not in TEXT_TAGS:
            msg = f'line {line}: tags ({shown(tag)}) are not taken: write the plain value'
            raise refusal(msg)
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        is_long = isinstance(event, yaml.ScalarEvent) and len(event.value) > max_scalar
        if depth > MAX_DEPTH or n > MAX_EVENTS or is_long:
            msg = f'line {line}: nested too deeply, or too large'
            raise refusal(msg)


def _one_line(error: yaml.YAMLError) -> str:
    problem = ' '.join(str(getattr(error, 'problem', None) or error).split())
    mark = getattr(error, 'problem_mark', None)
    where = f'line {mark.line + 1}, column {mark.column + 1}: ' if mark else ''
    return f'{where}{problem[:200]}'
