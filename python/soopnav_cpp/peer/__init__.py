"""Two receivers that talk to each other (mei: the four steps), over TCP or a Unix socket.

======================  ==================================================================
`peer.frames`           bytes of the connection: frames, checks, keys
`peer.messages`         what is said: messages and their MessagePack bodies
`peer.snippets`         bursts in few bits, and what a link can pay for
======================  ==================================================================

Needs the extra ``peer``. The command is ``soopnav peer``; the protocol is in ``docs/peer_protocol.md``.
"""
