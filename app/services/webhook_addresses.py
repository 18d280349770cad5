"""Where webhooks may lead: not into the service's own network, unless the operator says so."""

from __future__ import annotations

from ipaddress import IPv4Address, IPv6Address, IPv6Network, ip_address
from urllib.parse import urlsplit

from app.services.errors import InvalidError

MAX_URL = 2000
_WITH_IPV4 = (IPv6Network("64:ff9b::/96"), IPv6Network("::/96"))
"""NAT64 and IPv4-compatible addresses: an IPv4 address in the last 32 bits."""
_SETTING = "or let the operator set ISODYN_WEBHOOK_PRIVATE_NETWORKS"


def check_url(url: str, *, private_networks: bool) -> str:
    """Return the address if messages may be sent there, as far as can be seen without asking for its name.

    InvalidError otherwise. Names are looked up each time something is sent, for they may come to mean something else.
    """
    try:
        parts = urlsplit(url)
        host, _ = parts.hostname, parts.port
    except ValueError as error:
        raise InvalidError("url", f"is not a URL: {error}", "send an absolute https URL") from error
    if len(url) > MAX_URL or not url.isascii() or not url.isprintable() or " " in url:
        raise InvalidError("url", "is too long or holds characters that URLs do not", f"encode it, {MAX_URL} at most")
    if parts.scheme not in ("https", "http") or not host:
        raise InvalidError("url", "is not an absolute http or https URL", "send one like https://example.org/hook")
    if parts.username is not None or parts.password is not None:
        raise InvalidError("url", "holds a user name or a password", "check the signature of messages instead")
    if private_networks:
        return url
    if parts.scheme != "https":
        raise InvalidError("url", "is not https", f"send an https URL, {_SETTING}")
    if host == "localhost" or host.endswith(".localhost") or _is_inside(host):
        raise InvalidError(
            "url", f"leads to {host}, inside the service's own network", f"send a public one, {_SETTING}"
        )
    return url


def is_public(address: str) -> bool:
    """Whether an IP address is one of the public internet: not loopback, private, link-local, shared or multicast.

    Of addresses that carry an IPv4 address within, that one counts too.
    """
    found = ip_address(address.partition("%")[0])
    if isinstance(found, IPv6Address) and found.is_site_local:  # deprecated, and still nobody's but the own network's
        return False
    return all(one.is_global and not one.is_multicast and not one.is_reserved for one in (found, *_within(found)))


def _within(address: IPv4Address | IPv6Address) -> list[IPv4Address]:
    if isinstance(address, IPv4Address):
        return []
    carried = [address.ipv4_mapped, address.sixtofour, *(address.teredo or ())]
    if any(address in network for network in _WITH_IPV4):
        carried.append(IPv4Address(int(address) & 0xFFFFFFFF))
    return [one for one in carried if one is not None]


def _is_inside(host: str) -> bool:
    try:
        return not is_public(host)
    except ValueError:  # a name
        return False
