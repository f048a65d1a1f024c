"""Small things about viser's scene nodes."""

from __future__ import annotations

from typing import Any


def set_visible(handle: Any, visible: bool) -> None:
    """Show or hide a node; nothing is sent to the browsers where nothing changes."""
    if bool(handle.visible) != visible:
        handle.visible = visible
