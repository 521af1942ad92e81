"""Sources, contributions, what they say together, tokens, audit trail."""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

_KEY = sa.BigInteger().with_variant(sa.Integer, "sqlite")


def upgrade() -> None:
    """Make the tables."""
    op.create_table(
        "meta", sa.Column("name", sa.String(40), primary_key=True), sa.Column("value", sa.BigInteger, nullable=False)
    )
    op.execute("INSERT INTO meta (name, value) VALUES ('version', 0)")
    op.create_table(
        "sources",
        sa.Column("id", _KEY, primary_key=True),
        sa.Column("kind", sa.String(20), nullable=False),
        sa.Column("name", sa.String(100), nullable=False),
        sa.Column("carrier_hz", sa.Double, nullable=False),
        sa.Column("created_us", sa.BigInteger, nullable=False),
    )
    op.create_index("ix_sources_kind_carrier", "sources", ["kind", "carrier_hz"])
    op.create_table(
        "aliases",
        sa.Column("source_id", _KEY, sa.ForeignKey("sources.id"), primary_key=True),
        sa.Column("name_key", sa.String(400), primary_key=True),
    )
    op.create_index("ix_aliases_name_key", "aliases", ["name_key"])
    op.create_table(
        "contributions",
        sa.Column("id", _KEY, primary_key=True),
        sa.Column("source_id", _KEY, sa.ForeignKey("sources.id"), nullable=False),
        sa.Column("received_us", sa.BigInteger, nullable=False),
        sa.Column("token_id", sa.String(40)),
        sa.Column("body", sa.Text, nullable=False),
        sa.Column("body_hash", sa.LargeBinary(32), nullable=False),
        sa.Column("receiver", sa.String(100), nullable=False),
        sa.Column("method", sa.String(40), nullable=False),
        sa.Column("independent", sa.Boolean, nullable=False),
        sa.Column("duration_s", sa.Double, nullable=False),
        sa.Column("time_us", sa.BigInteger, nullable=False),
        *(sa.Column(name, sa.Double) for name in ("bias_s", "drift", "x_m", "y_m", "z_m", "h0_s", "h_minus2_per_s")),
    )
    op.create_index("ix_contributions_source", "contributions", ["source_id", "time_us"])
    op.create_index("ix_contributions_body_hash", "contributions", ["body_hash"])
    op.create_table(
        "verdicts",
        sa.Column("contribution_id", _KEY, sa.ForeignKey("contributions.id"), primary_key=True),
        sa.Column("status", sa.String(20), nullable=False),
        sa.Column("reasons", sa.Text, nullable=False),
        sa.Column("decided_by", sa.String(40), nullable=False),
        sa.Column("decided_us", sa.BigInteger, nullable=False),
    )
    op.create_index("ix_verdicts_status", "verdicts", ["status", "contribution_id"])
    op.create_table(
        "fused",
        sa.Column("source_id", _KEY, sa.ForeignKey("sources.id"), primary_key=True),
        sa.Column("version", sa.BigInteger, nullable=False),
        sa.Column("kind", sa.String(20), nullable=False),
        sa.Column("carrier_hz", sa.Double, nullable=False),
        sa.Column("latitude_deg", sa.Double),
        sa.Column("longitude_deg", sa.Double),
        sa.Column("state", sa.Text, nullable=False),
    )
    op.create_index("ix_fused_place", "fused", ["latitude_deg", "longitude_deg"])
    op.create_index("ix_fused_kind", "fused", ["kind", "source_id"])
    op.create_index("ix_fused_version", "fused", ["version"])
    op.create_table(
        "tokens",
        sa.Column("id", sa.String(40), primary_key=True),
        sa.Column("name", sa.String(100), nullable=False),
        sa.Column("role", sa.String(20), nullable=False),
        sa.Column("secret_hash", sa.LargeBinary(32), nullable=False),
        sa.Column("created_us", sa.BigInteger, nullable=False),
        sa.Column("created_by", sa.String(40), nullable=False),
        sa.Column("expires_us", sa.BigInteger),
        sa.Column("revoked_us", sa.BigInteger),
    )
    op.create_table(
        "audit",
        sa.Column("id", _KEY, primary_key=True),
        sa.Column("at_us", sa.BigInteger, nullable=False),
        sa.Column("actor", sa.String(40), nullable=False),
        sa.Column("address", sa.String(64), nullable=False),
        sa.Column("action", sa.String(40), nullable=False),
        sa.Column("target", sa.String(100), nullable=False),
        sa.Column("outcome", sa.String(200), nullable=False),
    )
    op.create_table(
        "idempotency_keys",
        sa.Column("token_id", sa.String(40), primary_key=True),
        sa.Column("key", sa.String(200), primary_key=True),
        sa.Column("body_hash", sa.LargeBinary(32), nullable=False),
        sa.Column("contribution_id", _KEY, sa.ForeignKey("contributions.id"), nullable=False),
        sa.Column("answer", sa.Text, nullable=False),
        sa.Column("created_us", sa.BigInteger, nullable=False),
    )
    op.create_index("ix_idempotency_created", "idempotency_keys", ["created_us"])


def downgrade() -> None:
    """Drop the tables, the newest first."""
    for name in (
        "idempotency_keys", "audit", "tokens", "fused", "verdicts", "contributions", "aliases", "sources", "meta"
    ):  # fmt: skip
        op.drop_table(name)
