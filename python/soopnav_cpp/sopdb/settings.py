"""What the operator of the service decides."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["Rate", "ServiceSettings"]


@dataclass(frozen=True)
class Rate:
    """A token bucket: `per_s` requests in the long run, `burst` at once.

    Raises
    ------
    ValueError
        Unless `per_s` is finite and above zero and `burst` at least one.
    """

    per_s: float
    burst: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.per_s) and self.per_s > 0.0):
            raise ValueError(f"per_s is {self.per_s}; it must be finite and above zero")
        if not (math.isfinite(self.burst) and self.burst >= 1.0):
            raise ValueError(f"burst is {self.burst}; it must be at least one")


@dataclass(frozen=True)
class ServiceSettings:
    """Limits and rights of a service.

    Attributes
    ----------
    public_read : bool
        Anybody may read. Otherwise reading needs a token of any role; the page itself is always given, its data not.
    reads, writes : Rate
        Of one token, or of one address where a request has none.
    addresses : Rate
        Of one address (an IPv6 address counts by its /64), whatever its tokens.
    failures : Rate
        Refused tokens of one address; past it, every request that brings a token from there waits.
    limited_keys : int
        Buckets remembered; the one not used for longest is forgotten first.
    max_body_bytes : int
        Of a request's body; more is refused while it is read.
    max_depth : int
        Of nested arrays and objects in a body.
    body_timeout_s : float
        A body must have arrived by then.
    page_size, max_page_size : int
        Of lists, without and with ``limit``.
    max_ahead_s : float
        How far in the future ``at`` may lie.
    fresh_s : float
        Other processes' writes are seen after this long at the latest; writes of this process at once.
    idempotency_s : float
        How long the answer to an ``Idempotency-Key`` is kept; up to an hour longer.
    https : bool
        Reached by HTTPS only (a proxy in front): browsers are told to insist (HSTS).

    Raises
    ------
    ValueError
        Naming the setting, its value and the rule.
    """

    public_read: bool = False
    reads: Rate = Rate(100.0, 400.0)
    writes: Rate = Rate(5.0, 60.0)
    addresses: Rate = Rate(400.0, 1200.0)
    failures: Rate = Rate(0.2, 20.0)
    limited_keys: int = 20_000
    max_body_bytes: int = 65_536
    max_depth: int = 12
    body_timeout_s: float = 20.0
    page_size: int = 50
    max_page_size: int = 500
    max_ahead_s: float = 366.0 * 86400.0
    fresh_s: float = 0.0
    idempotency_s: float = 7.0 * 86400.0
    https: bool = False

    def __post_init__(self) -> None:
        for name in ("limited_keys", "max_body_bytes", "max_depth", "page_size", "max_page_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} is {getattr(self, name)}; it must be at least one")
        for name in ("body_timeout_s", "idempotency_s"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0.0):
                raise ValueError(f"{name} is {getattr(self, name)}; it must be finite and above zero")
        for name in ("max_ahead_s", "fresh_s"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise ValueError(f"{name} is {getattr(self, name)}; it must be finite and not negative")
        if self.page_size > self.max_page_size:
            raise ValueError(
                f"page_size is {self.page_size}; it must not be above max_page_size = {self.max_page_size}"
            )
