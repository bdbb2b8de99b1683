# SPDX-License-Identifier: Apache-2.0
"""XML without its traps, and the XML dress of OpenCV's FileStorage."""

from __future__ import annotations

import re
from xml.etree import ElementTree as ET

from rpgd_ros.core.errors import InputError, Reason
from rpgd_ros.io.strict import Node


def parse_xml(text: str, source: str) -> ET.Element:
    """Parse XML text without entities, which can grow without bound.

    Raises:
        InputError: BAD_INPUT.

    """
    if re.search('<!(DOCTYPE|ENTITY)', text, re.IGNORECASE):
        msg = f'{source}: XML with a DOCTYPE is not taken: remove it'
        raise InputError(Reason.BAD_INPUT, msg)
    try:
        return ET.fromstring(text.lstrip('\ufeff').encode())  # noqa: S314 (checked above)
    except (ET.ParseError, ValueError, LookupError) as error:
        msg = f'{source} is not XML: {str(error)[:200]}'
        raise InputError(Reason.BAD_INPUT, msg) from error


def opencv_node(root: ET.Element, source: str) -> Node:
    """Return an <opencv_storage> as its YAML would give it: numbers, texts and matrices."""
    values = {element.tag: _value(element) for element in root}
    return Node(values, source, Reason.BAD_INPUT)


def _value(element: ET.Element) -> object:
    if element.get('type_id') in {'opencv-matrix', 'opencv-nd-matrix'}:
        parts: dict[str, object] = {part.tag: _scalar(part.text) for part in element}
        data = element.findtext('data') or ''
        return {**parts, 'data': [_scalar(word) for word in data.split()]}
    return _scalar(element.text)


def _scalar(text: str | None) -> object:
    word = (text or '').strip()
    return int(word) if re.fullmatch(r'[-+]?\d{1,18}', word) else word.strip('"')
