"""Keys of results in words: `magnitude_mae_n` is read as `magnitude mean error, N`."""

from __future__ import annotations

import re

_UNITS = {
    "n_m_rad": "N·m/rad",
    "n_m_s": "N·m·s",
    "n_m": "N·m",
    "m_s2": "m/s²",
    "n_s": "N·s",
    "rad_s": "rad/s",
    "deg_s": "°/s",
    "bit_s": "bit/s",
    "n2": "N²",
    "n": "N",
    "mm": "mm",
    "m": "m",
    "deg": "°",
    "rad": "rad",
    "kg": "kg",
    "hz": "Hz",
    "s": "s",
    "ms": "ms",
    "us": "µs",
    "bytes": "bytes",
}
_STIFFNESS = "N/m"
"""Of `stiffness_n_m`, where the same letters mean newtons by metres."""
_WORDS = {
    "mae": "mean error",
    "rmse": "rms error",
    "ci95": "95 % interval",
    "coverage95": "within 95 % intervals",
    "quantile95": "95 % are below",
    "std": "deviation",
    "f1": "F1",
    "sha256": "SHA-256",
    "onnx": "ONNX",
    "id": "identity",
}


def worded(key: str) -> str:
    """A key with its unit as words and the unit's sign; text that is no key stays as it is."""
    if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)+", key) or re.search(r"_\d+(_|$)", key):
        return _WORDS.get(key, key)
    quantity, unit = key, ""
    for ending, sign in _UNITS.items():
        if key.endswith(f"_{ending}"):
            quantity = key.removesuffix(f"_{ending}")
            unit = _STIFFNESS if quantity.endswith("stiffness") and ending == "n_m" else sign
            break
    words = " ".join(_WORDS.get(word, word) for word in quantity.split("_"))
    return f"{words}, {unit}" if unit else words
