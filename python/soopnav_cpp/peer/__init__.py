"""Two receivers that talk to each other (mei: the four steps), over TCP or a Unix socket.

======================  ==================================================================
`peer.frames`           bytes of the connection: frames, checks, keys
`peer.messages`         what is said: messages and their MessagePack bodies
`peer.link`             one connection from hello to good-bye, without input or output
`peer.session`          an end at work: accept, connect, reconnect (asyncio)
`peer.sources`          samples of a recording or a stream, by the receiver's clock
`peer.scan`             bursts in them, and pieces of them
`peer.beacons`          which beacon a burst came from
`peer.snippets`         bursts in few bits, and what a link can pay for
`peer.ends`             what anchor and target have in common
`peer.roles`            `Anchor` and `Target` as state machines
`peer.track`            the target's track, kept over a restart
`peer.local`            both ends in one process
`peer.report`           table, track and figure
`peer.proxy`            a bad connection for trials
======================  ==================================================================

Needs the extra ``peer``. The command is ``soopnav peer``; the protocol is in ``docs/peer_protocol.md``.
"""
