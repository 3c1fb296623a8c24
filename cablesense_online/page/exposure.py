"""Whether an address to serve on is of this machine alone, and what is said where it is not."""

from __future__ import annotations

import ipaddress


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches `host`; a name other than localhost may lead anywhere."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def exposure_warning(host: str, port: int, controls: bool) -> str:
    """One line on who reaches a page that is served on `host`; empty if this machine alone."""
    if is_loopback(host):
        return ""
    what = "see and move the arm" if controls else "see the arm"
    return (
        f"the page is served on {host}, port {port}, without a password: everyone who reaches "
        f"this machine can {what}"
    )
