"""
Iridium: channels, bursts, their detection.
"""

from __future__ import annotations

__all__: list[str] = list()
