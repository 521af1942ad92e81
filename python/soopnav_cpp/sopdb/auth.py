"""Tokens: 256 random bits with a name, a role and an end; only their hash is kept.

A token reads ``sop_<id>_<secret>``: 10 characters that the database finds it by, and 43 of base64url. A secret of 256
random bits cannot be guessed, so one SHA-256 protects it as well as a slow hash protects a password.
"""

from __future__ import annotations

import base64
import hashlib
import hmac
import logging
import re
import secrets
from dataclasses import dataclass

__all__ = ["ROLES", "Grant", "HideTokens", "NewToken", "allows", "new_token", "parse_token", "secret_matches"]

#: Each may what those before it may.
ROLES = ("read", "contribute", "admin")
_TOKEN = re.compile(r"sop_([a-z2-7]{10})_([A-Za-z0-9_-]{43})")
_SHOWN = re.compile(r"(sop_[a-z2-7]{10})_[A-Za-z0-9_-]+|(?i:(bearer\s+))[^\s\"',%]+")


@dataclass(frozen=True)
class Grant:
    """What a token that was found allows.

    Attributes
    ----------
    token_id, name, role : str
    expires_us : int or None
        Microseconds since 1970; None: never.
    secret_hash : bytes
        SHA-256 of the secret.
    """

    token_id: str
    name: str
    role: str
    expires_us: int | None
    secret_hash: bytes


@dataclass(frozen=True)
class NewToken:
    """A token that was just made: the only moment its text exists."""

    id: str
    text: str
    secret_hash: bytes

    def __repr__(self) -> str:
        return f"NewToken(id={self.id!r})"


def _hash(secret: str) -> bytes:
    return hashlib.sha256(secret.encode("ascii")).digest()


def new_token() -> NewToken:
    """A token from the system's random source."""
    token_id = base64.b32encode(secrets.token_bytes(10)).decode("ascii").lower()[:10]
    secret = secrets.token_urlsafe(32)
    return NewToken(token_id, f"sop_{token_id}_{secret}", _hash(secret))


def parse_token(text: str) -> tuple[str, str] | None:
    """Id and secret of a token; None when the text is none."""
    match = _TOKEN.fullmatch(text) if len(text) < 100 else None
    return (match[1], match[2]) if match else None


def secret_matches(secret: str, secret_hash: bytes) -> bool:
    """Whether a secret is that of the hash, in a time that does not say how much of it is right."""
    return hmac.compare_digest(_hash(secret), secret_hash)


def allows(role: str, needed: str) -> bool:
    """Whether `role` may what `needed` may."""
    return ROLES.index(role) >= ROLES.index(needed)


class HideTokens(logging.Filter):
    """Takes secrets out of log lines: what reads like a token, and what follows ``Bearer``."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Change the record; keep every line."""
        record.msg = _hidden(record.msg)
        if isinstance(record.args, tuple):
            record.args = tuple(map(_hidden, record.args))
        return True


def _hidden(value: object) -> object:
    if not isinstance(value, str):
        return value
    return _SHOWN.sub(lambda match: f"{match[1]}_***" if match[1] else f"{match[2]}***", value)
