"""Runs migrations on the connection that `soopnav_cpp.sopdb.database` gives: read by Alembic, not imported."""

from __future__ import annotations

from alembic import context

from soopnav_cpp.sopdb.schema import Base

context.configure(connection=context.config.attributes["connection"], target_metadata=Base.metadata)
with context.begin_transaction():
    context.run_migrations()
