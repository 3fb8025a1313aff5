"""`midspan access STORE`: who may do what."""

import json
from typing import Any

import click

from midspan.cli.console import Console, common_options

ACTIONS = ("add-user", "add-token", "set-password", "list", "remove")
NEEDS_SCOPE = ("add-user", "add-token")


@click.command("access")
@click.argument("store")
@click.argument("action", type=click.Choice(ACTIONS))
@click.argument("name", required=False)
@click.option("--scope", type=click.Choice(["read", "operate", "admin"]), help="What a new user or token may do.")
@common_options
def command(store: str, action: str, name: str | None, scope: str | None, quiet: bool, as_json: bool) -> None:
    """Add, list and remove users and tokens of a store's page.

    read: view everything. operate: also calibrate, accept, pause, acknowledge. admin: also change SITE.toml. A
    password or token is printed only once.
    """
    from midspan.errors import DataError
    from midspan.serve.access import ACCESS_FILE, Access
    from midspan.service.places import place_of
    from midspan.store.store import is_store

    console = Console(quiet, as_json)
    if (action == "list") != (name is None):
        raise click.UsageError(
            "NAME: must not be given with list." if action == "list" else f"NAME: is missing; {action} needs one."
        )
    if (action in NEEDS_SCOPE) != (scope is not None):
        needs = "is missing" if action in NEEDS_SCOPE else "must not be given"
        raise click.UsageError(f"--scope: {needs} with {action}.")
    folder = place_of(store)
    if not is_store(store) and not (folder / ACCESS_FILE).is_file():
        raise DataError(f"{store}: is not a store. `midspan run` and `midspan replay` create one.")
    access = Access(folder)
    if action == "list":
        logins = [{"name": one.name, "kind": one.kind, "scope": one.scope} for one in access.logins()]
        console.columns(("name", "kind", "scope"), [tuple(one.values()) for one in logins])
        console.document({"logins": logins})
        return
    assert name is not None
    console.document(_done(access, console, action, name, scope))


def announce_admin(where: str, console: Console, shard: str | None = None) -> None:
    """Make the user `admin` of a store that nobody has access to yet, and print its password, this once. shard: K/N
    where the store is that of one of several, which have users of their own.
    """
    from midspan.serve.access import Access, made_admin
    from midspan.service.places import place_of

    password = None if console.quiet else made_admin(Access(place_of(where)))
    if password is None:
        return
    of_shard = {} if shard is None else {"shard": shard}
    who = "" if shard is None else f"shard {shard}: "
    console.say(f"{who}admin: password: {password} (user admin; shown only once)")
    if console.as_json:
        click.echo(json.dumps({"name": "admin", "scope": "admin", "password": password, **of_shard}), err=True)


def _done(access: Any, console: Console, action: str, name: str, scope: str | None) -> dict[str, Any]:
    """Carry out an action; what it made."""
    if action == "remove":
        access.remove(name)
        console.say(f"{name}: access removed.")
        return {"name": name, "removed": True}
    if action == "add-token":
        made = {"token": access.add_token(name, scope)}
    else:
        made = {"password": access.add_user(name, scope) if action == "add-user" else access.set_password(name)}
    (kind, secret), *_ = made.items()
    console.say(f"{name}: {kind}: {secret}")
    console.say("It is shown only once.")
    scopes = {one.name: one.scope for one in access.logins()}
    return {"name": name, "scope": scopes[name], **made}
