"""Numbers as the command line writes them."""

from __future__ import annotations

MINUS = "\N{MINUS SIGN}"
SPEED_OF_LIGHT_MPS = 299_792_458.0


def signed(value: float, digits: int) -> str:
    """``+14.28`` or, with a real minus sign, ``−0.12``."""
    return f"{value:+.{digits}f}".replace("-", MINUS)


def plain(value: float, digits: int) -> str:
    """A number with a real minus sign."""
    return f"{value:.{digits}f}".replace("-", MINUS)


def rate(rate_hz: float) -> str:
    """``19.2 Msps``."""
    return f"{rate_hz / 1e6:g} Msps"


def megahertz(frequency_hz: float) -> str:
    """``1815.3 MHz``."""
    return f"{frequency_hz / 1e6:.10g} MHz"


def duration(time_s: float) -> str:
    """``80 ms`` or ``1.25 s``."""
    return f"{time_s:.4g} s" if time_s >= 1.0 else f"{1e3 * time_s:.4g} ms"


def frequency_offset(offset_hz: float) -> str:
    """``+14.28 kHz``, below 1 kHz ``+14.3 Hz``."""
    return f"{signed(offset_hz / 1e3, 2)} kHz" if abs(offset_hz) >= 1e3 else f"{signed(offset_hz, 1)} Hz"


def milliseconds(time_s: float) -> str:
    """Milliseconds to the nanosecond, in groups of three: ``4.043 217 ms``."""
    text = f"{1e3 * time_s:.6f}"
    return f"{text[:-3]} {text[-3:]} ms"


def metres(length_m: float) -> str:
    """A length with two figures that mean something: ``0.09 m``, ``3.1 m``, ``41 m``."""
    if length_m < 1.0:
        return f"{length_m:.2f} m" if length_m >= 0.01 else f"{1e3 * length_m:.1f} mm"
    return f"{length_m:.1f} m" if length_m < 10.0 else f"{length_m:.0f} m"


def nanoseconds(time_s: float, *, sign: bool = False) -> str:
    """``−412.7 ns``, above a millisecond ``4.120 413 ms``."""
    if abs(time_s) >= 1e-3:
        return ("+" if sign and time_s > 0 else "") + milliseconds(time_s).replace("-", MINUS)
    value = signed(1e9 * time_s, 1) if sign else plain(1e9 * time_s, 1)
    return f"{value} ns"


def listing(items: list[str]) -> str:
    """``a``, ``a and b``, ``a, b and c``."""
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} and {items[-1]}"
