"""Both ends in one process, message by message, without a connection between them."""

from __future__ import annotations

from collections import deque

from soopnav_cpp.peer import messages
from soopnav_cpp.peer.messages import Message
from soopnav_cpp.peer.roles import Anchor, Target
from soopnav_cpp.peer.session import PeerRefusedError

__all__ = ["run_together"]


def run_together(anchor: Anchor, target: Target) -> None:
    """Let an anchor and a target talk until the target is done. Messages go through their bytes, as on a connection.

    Raises
    ------
    PeerRefusedError
        When their recordings do not overlap.
    """
    refusal = anchor.attach(target.info()) or target.attach(anchor.info())
    if refusal:
        raise PeerRefusedError(refusal)
    to_anchor: deque[Message] = deque()
    to_target: deque[Message] = deque()
    while not target.finished:
        to_target.extend(anchor.step(0.0) or ())
        to_anchor.extend(target.step(0.0) or ())
        while to_anchor or to_target:
            if to_target:
                to_anchor.extend(target.handle(messages.unpack(*messages.pack(to_target.popleft())), 0.0))
            if to_anchor:
                to_target.extend(anchor.handle(messages.unpack(*messages.pack(to_anchor.popleft())), 0.0))
        anchor.handle(target.heartbeat(), 0.0)
        target.handle(anchor.heartbeat(), 0.0)
    target.detach()
    anchor.detach()
