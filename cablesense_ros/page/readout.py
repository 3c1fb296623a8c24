"""The figures beside the scene, as HTML: status, forces, probabilities, errors, legends."""

from __future__ import annotations

from html import escape

from cablesense_ros.page.colours import (
    ESTIMATE_RGB,
    TRUE_RGB,
    css,
    segment_rgb,
    tension_gradient_css,
)
from cablesense_ros.page.score import Errors
from cablesense_ros.page.snapshot import Array, Contact, Level, Status

LEVEL_CSS = {
    Level.OK: "#00b280",
    Level.WARNING: "#f0a832",
    Level.ERROR: "#e8604c",
    Level.STALE: "#8a93a3",
}
_BOX = (
    "padding:2px 10px 10px 10px;font-size:13px;line-height:1.45;font-variant-numeric:tabular-nums"
)
_DIM = "color:#8a93a3"


def status_html(status: Status) -> str:
    """The estimator's state as a coloured badge with its notes."""
    colour = LEVEL_CSS[status.level]
    notes = "".join(f"<div style='{_DIM};font-size:12px'>{escape(n)}</div>" for n in status.notes)
    return (
        f"<div style='{_BOX};padding-top:8px'>"
        f"<span style='display:inline-block;width:10px;height:10px;border-radius:5px;"
        f"background:{colour};margin-right:8px'></span>"
        f"<b id='cablesense-status'>{escape(status.headline)}</b>{notes}</div>"
    )


def forces_html(true: Contact | None, estimate: Contact | None) -> str:
    """True and estimated contact, side by side, with units."""
    rows = _force_row("true", css(TRUE_RGB), true) + _force_row(
        "estimated", css(ESTIMATE_RGB), estimate
    )
    return (
        f"<div style='{_BOX}'><table style='width:100%;border-collapse:collapse'>"
        f"<tr style='{_DIM};font-size:11px;text-align:right'><td></td><td>segment</td>"
        f"<td>angle</td><td>force</td></tr>{rows}</table></div>"
    )


def _force_row(word: str, colour: str, contact: Contact | None) -> str:
    if contact is None:
        cells = f"<td>none</td><td style='{_DIM}'>–</td><td style='{_DIM}'>0.0 N</td>"
    else:
        cells = (
            f"<td>{contact.segment}</td><td>{contact.angle_deg:.1f}°</td>"
            f"<td>{contact.magnitude_n:.1f} N</td>"
        )
    return (
        f"<tr id='cablesense-{word}' style='text-align:right;font-size:15px'>"
        f"<td style='text-align:left;color:{colour};font-weight:600'>▶ {word}</td>{cells}</tr>"
    )


def probabilities_html(probabilities: Array | None, segment_count: int) -> str:
    """One bar for no contact and one for each segment."""
    bars = []
    for segment in range(segment_count + 1):
        share = 0.0 if probabilities is None else float(probabilities[segment])
        name = f"segment {segment}" if segment else "no contact"
        colour = css(segment_rgb(segment)) if segment else "#8a93a3"
        figure = "–" if probabilities is None else f"{100 * share:.1f} %"
        bars.append(
            f"<div style='display:flex;align-items:center;gap:8px;font-size:12px'>"
            f"<span style='width:74px'>{name}</span>"
            "<span style='flex:1;height:9px;background:#30353f;border-radius:3px;"
            "overflow:hidden'>"
            f"<span style='display:block;height:100%;width:{100 * share:.1f}%;"
            f"background:{colour}'>"
            f"</span></span><span style='width:52px;text-align:right'>{figure}</span></div>"
        )
    title = f"<div style='{_DIM};font-size:11px'>contact probability</div>"
    return f"<div style='{_BOX}'>{title}{''.join(bars)}</div>"


def errors_html(errors: Errors) -> str:
    """Error so far."""
    right = "–" if errors.segment_right is None else f"{100 * errors.segment_right:.1f} %"
    angle = "–" if errors.angle_mae_deg is None else f"{errors.angle_mae_deg:.2f}°"
    newtons = "–" if errors.magnitude_mae_n is None else f"{errors.magnitude_mae_n:.2f} N"
    cells = "".join(
        f"<div style='flex:1'><div style='{_DIM};font-size:11px'>{name}</div>"
        f"<div style='font-size:16px;font-weight:600'>{figure}</div></div>"
        for name, figure in (
            ("segment right", right),
            ("direction error", angle),
            ("force error", newtons),
        )
    )
    return (
        f"<div style='{_BOX}'><div style='display:flex;gap:6px'>{cells}</div>"
        f"<div style='{_DIM};font-size:11px'>mean so far, over {errors.count} steady moments</div>"
        "</div>"
    )


def legend_html(full_scale_n: float, tensions_n: Array | None) -> str:
    """The colours of the cables, from slack to full scale, with the range at this moment."""
    now = ""
    if tensions_n is not None:
        now = f"now {round(float(tensions_n.min()))} to {round(float(tensions_n.max()))} N"
    return (
        f"<div style='{_BOX};padding-bottom:2px'>"
        "<div style='display:flex;justify-content:space-between'>"
        f"<span>cable tension</span><span style='{_DIM}'>{now}</span></div>"
        f"<div style='height:10px;border-radius:3px;background:{tension_gradient_css()}'></div>"
        f"<div style='display:flex;justify-content:space-between;{_DIM};font-size:11px'>"
        f"<span>0 N (slack)</span><span>{full_scale_n / 2:.0f} N</span>"
        f"<span>{full_scale_n:.0f} N</span></div></div>"
    )


def traces_legend_html(segment_count: int) -> str:
    """Which line is which: a colour for each segment that a cable ends on."""
    marks = " ".join(
        "<span style='white-space:nowrap;margin-right:10px'>"
        f"<b style='color:{css(segment_rgb(n))}'>━</b> "
        f"ends on segment {n}</span>"
        for n in range(1, segment_count + 1)
    )
    return f"<div style='{_BOX};font-size:11px;{_DIM};padding-bottom:4px'>{marks}</div>"
