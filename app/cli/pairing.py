"""What a person with a phone is shown: an address that the phone can reach, and the same as a QR code."""

from __future__ import annotations

import io
import ipaddress
from urllib.parse import urlsplit


def address_for_phone(told: str, url: str) -> str:
    """A push address with the scheme, host and port under which this command reaches the service.

    The service knows only how it was asked last; behind a proxy that may be an inner name.
    """
    base = urlsplit(url.rstrip("/"))
    return f"{base.scheme}://{base.netloc}{base.path}{urlsplit(told).path}"


def qr_code(text: str) -> str:
    """A QR code of half blocks, for a terminal; dark on light, whatever the terminal's colours."""
    import segno

    out = io.StringIO()
    segno.make(text, error="m", micro=False).terminal(out=out, border=2, compact=True)
    return out.getvalue().rstrip("\n")


def is_loopback(url: str) -> bool:
    """Whether an address means the machine that it is used on."""
    host = urlsplit(url).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost" or host.endswith(".localhost")


def lan_addresses() -> list[str]:
    """IPv4 addresses of this machine that others in its network may reach, in no order that means anything."""
    import socket

    import psutil

    told = [one.address for links in psutil.net_if_addrs().values() for one in links if one.family == socket.AF_INET]
    return [one for one in told if not (ipaddress.ip_address(one).is_loopback or _self_given(one))]


def _self_given(address: str) -> bool:
    return ipaddress.ip_address(address).is_link_local


def reach_hint(url: str) -> str:
    """What to do about an address that no phone can reach; empty: nothing."""
    if not is_loopback(url):
        return ""
    parts = urlsplit(url)
    port = "" if parts.port is None else f":{parts.port}"
    others = " or ".join(f"{parts.scheme}://{address}{port}" for address in lan_addresses())
    instead = f"Say --phone-url {others}" if others else "Say --phone-url with an address that the phone can reach"
    return (
        f"{parts.hostname} is this machine: a phone cannot reach the service there. {instead}, and let the service "
        "listen there too (isodyn serve --host 0.0.0.0)."
    )
