"""What a host may do, by role: one table, from which the router's access rules and each host's own check derive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from zsight.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from zsight.keys.identity import Identity

__all__ = ["ROLES", "Grants", "access_rules", "grants_of", "require_roles"]

_EVERYTHING = "**"  # all data; not the housekeeping, whose chunks begin with '@'


@dataclass(frozen=True)
class Grants:
    """Keys behind the namespace that may be published, read, served and asked, and tokens held and watched."""

    publish: tuple[str, ...] = ()
    read: tuple[str, ...] = ()
    serve: tuple[str, ...] = ()
    ask: tuple[str, ...] = ()
    hold: tuple[str, ...] = ()
    watch: tuple[str, ...] = ()

    def __or__(self, other: Grants) -> Grants:
        """What either allows."""
        return Grants(
            *(tuple({**dict.fromkeys(a), **dict.fromkeys(b)}) for a, b in zip(self._all, other._all, strict=True))
        )

    @property
    def _all(self) -> tuple[tuple[str, ...], ...]:
        return (self.publish, self.read, self.serve, self.ask, self.hold, self.watch)

    def of(self, action: str) -> tuple[str, ...]:
        """Keys of one action: publish, read, serve, ask, hold or watch."""
        keys: tuple[str, ...] = getattr(self, action)
        return keys


_GOALS = ("find_object/*", "find_object/*/cancel", "find_object/*/result")
_SOURCE = ("*/points", "*/camera_info", "tf", "tf_static")
_CLIENT = Grants(publish=("*/selected_points",), read=(_EVERYTHING,), ask=(*_GOALS, "catalog/*"))
_STATES = ("@recorder/*/status", "@player/*/status")
_OPERATOR = _CLIENT | Grants(ask=("param/*/*", "@recorder/*", "@player/*"), read=_STATES)

ROLES: dict[str, Grants] = {
    "camera": Grants(publish=_SOURCE),
    "voxel": Grants(publish=("*/points/voxel",), read=("*/points",)),
    "planes": Grants(publish=("*/plane", "*/plane/points", "*/plane/above"), read=("*/points", "*/selected_points")),
    "finder": Grants(
        publish=(
            "find_object/*/status",
            "find_object/*/feedback",
            "find_object/*/goal",
            "find_object/*/catalogue",
            "*/scene",
        ),
        read=("*/points", "tf", "tf_static"),
        serve=(*_GOALS, "catalog/*"),
    ),
    "recorder": Grants(publish=("@recorder/*/status",), read=(_EVERYTHING,), serve=("@recorder/*",)),
    "player": Grants(publish=(_EVERYTHING, "clock", "@player/*/status"), serve=("@player/*",)),
    "viewer": _OPERATOR,
    "client": _CLIENT,
    "operator": _OPERATOR,
    "router": Grants(),
}
"""Roles of hosts: a service's name, or client (asks) or operator (asks, and sets parameters)."""


def require_roles(names: Iterable[str]) -> tuple[str, ...]:
    """The roles, where all of them are known.

    Raises:
        UsageError: one is not, or there is none.
    """
    given = tuple(dict.fromkeys(names))
    unknown = [name for name in given if name not in ROLES]
    if unknown or not given:
        raise UsageError(f"roles are {', '.join(given) or 'none'}; expected some of {', '.join(ROLES)}")
    return given


def grants_of(identity: Identity) -> Grants:
    """What a host may do: what its roles allow, and tell of its own processes and ask for those of others."""
    host = identity.host
    granted = Grants(
        publish=(f"@health/{host}/*", f"@log/{host}/*"),
        serve=(f"@health/{host}/*", f"param/{host}/*", f"@log/{host}/*", f"@host/{host}"),
        ask=("@health/*/*", "@log/*/*", "@host/*"),
        hold=(f"@alive/{host}/*",),
        watch=("@alive/*/*",),
        read=("@health/*/*", "@log/*/*"),
    )
    for role in identity.roles:
        granted |= ROLES[role]
    return granted


# What each action takes on the wire, as the router sees it: what comes from the host on its keys, and what goes to it.
_WIRE: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "publish": (("put", "delete", "reply"), ()),
    "read": (("declare_subscriber",), ("put", "delete", "reply")),
    "serve": (("declare_queryable", "reply"), ()),
    "ask": (("query",), ("reply", "declare_queryable")),
    "hold": (("liveliness_token",), ()),
    "watch": (("declare_liveliness_subscriber", "liveliness_query"), ("liveliness_token",)),
}
# A latched value lies with its writer, is asked for on keys below its own, and comes as a reply on its own.
_BESIDE: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "publish": (("declare_queryable", "liveliness_token", "reply"), ()),
    "read": (
        ("query", "declare_liveliness_subscriber", "liveliness_query"),
        ("declare_queryable", "liveliness_token", "reply"),
    ),
}
# What others want of a host may reach it whatever the keys (theirs may hold wildcards): it answers with granted ones.
_WISHES = ("declare_subscriber", "query", "declare_liveliness_subscriber", "liveliness_query")
_ANYWHERE = ("**", "**/@adv/**", "@health/**", "@alive/**", "@log/**", "@host/**", "@recorder/**", "@player/**")


def access_rules(hosts: Iterable[Identity]) -> dict[str, Any]:
    """The router's access control: what is not granted to a host by its roles does not pass."""
    rules, subjects, policies = [], [], []
    for identity in hosts:
        own = [
            {**rule, "id": f"{identity.host}-{number}", "permission": "allow"}
            for number, rule in enumerate(_rules_of(identity))
        ]
        rules += own
        subjects.append({"id": identity.host, "cert_common_names": [identity.host]})
        policies.append({"rules": [rule["id"] for rule in own], "subjects": [identity.host]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }


def _rules_of(identity: Identity) -> list[dict[str, Any]]:
    granted = grants_of(identity)
    found = [_rule("egress", _WISHES, [f"{cell}/{key}" for cell in identity.cells for key in _ANYWHERE])]
    for action, (sent, received) in _WIRE.items():
        keys = [f"{cell}/{key}" for cell in identity.cells for key in granted.of(action)]
        found += [_rule("ingress", sent, keys), _rule("egress", received, keys)]
    for action, (sent, received) in _BESIDE.items():
        keys = [f"{cell}/{key}/@adv/**" for cell in identity.cells for key in granted.of(action)]
        found += [_rule("ingress", sent, keys), _rule("egress", received, keys)]
    return [rule for rule in found if rule["messages"] and rule["key_exprs"]]


def _rule(flow: str, messages: tuple[str, ...], keys: list[str]) -> dict[str, Any]:
    return {"messages": [*messages], "flows": [flow], "key_exprs": keys}
