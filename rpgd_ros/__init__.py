# SPDX-License-Identifier: Apache-2.0
"""Aligns a motion-capture system with RGB cameras from a person walking through the room."""

__version__ = '0.1.0'
