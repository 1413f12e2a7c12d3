"""``rosplc web``: a page that shows this machine's channels in a browser.

rosplc web  —  start the server; then open the printed address on this machine

ssh -t -L 8480:localhost:8480 MACHINE rosplc web  —  view another machine at the same local address

rosplc web --config cell.yaml  —  apply the settings of a configuration, and include its classic topics

rosplc web --allow-write  —  allow anyone who has the printed token to write test messages

rosplc web --bind 192.168.1.5 --token-file web.token  —  reachable from the network, with your own token

The command requires only read access (no configuration, no ROS) and affects no other program. Anyone who can
open the page sees every message that the user who started the server may read. Nothing is encrypted: do not
use --bind on an untrusted network. To install: `pip install 'rosplc[views]'`.
"""

from __future__ import annotations

import logging
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from rosplc.cli.options import Configs, Directory, Prefix, StaleAfter, need_extra, open_watch
from rosplc.cli.text import print_json, say, warn
from rosplc.cli.verb import Between, verb
from rosplc.errors import WebError
from rosplc.harmless import log_to_stderr

if TYPE_CHECKING:
    from rosplc.web import Settings


@verb
def command(
    *,
    prefix: Prefix = None,
    config: Configs = None,
    stale_after: StaleAfter = "1s",
    port: Annotated[int, Between(0, 65535)] = 8480,
    bind: str = "127.0.0.1",
    name: list[str] | None = None,
    allow_write: bool = False,
    token_file: Path | None = None,
    token_to_view: bool = False,
    directory: Directory = "/dev/shm",
    as_json: bool = False,
) -> None:
    """Show this machine's channels in a browser, live, until Ctrl-C.

    Options:
        port: The port; 0 for any free port.
        bind ADDRESS: The address to listen on; `0.0.0.0` for all networks.
        name HOST: A host name that browsers use for this server; may be repeated.
        allow_write: Let users with the token write test messages.
        token_file FILE: A file that contains the token; by default, a new token is printed.
        token_to_view: Require the token to view anything, even on loopback.
        as_json: Print address and token as JSON.
    """
    need_extra("aiohttp", "views", "web")
    from rosplc.web import Settings, is_loopback, new_token, read_token, serve

    beyond = not is_loopback(bind)
    needed = allow_write or token_to_view or beyond
    if needed and token_file is None and _to_journal():
        raise WebError(
            "WEB002",
            "the token would be printed to the system journal, where others may read it",
            remedy="Write a token to a file that only this service's user can read, and use --token-file.",
        )
    watch = open_watch(prefix, config, stale_after, directory)
    settings = Settings(
        prefix=prefix,
        directory=directory,
        names=tuple(name or ()),
        allow_write=allow_write,
        token=(read_token(token_file) if token_file else new_token()) if needed else "",
        token_to_view=token_to_view or beyond,
    )

    def ready(address: str, chosen: int) -> None:
        host = "localhost" if address in ("0.0.0.0", "::", "127.0.0.1", "::1") else address
        url = f"http://[{host}]:{chosen}/" if ":" in host else f"http://{host}:{chosen}/"
        if as_json:
            token = "" if token_file else settings.token
            facts = {"url": url, "token": token, "allow_write": allow_write}
            print_json(facts | {"token_to_view": settings.token_to_view}, one_line=True)
        else:
            _introduce(settings, url, from_file=token_file)
        sys.stdout.flush()
        if beyond:
            warn(
                f"rosplc: warning: listening on {address}, which other machines can reach. Nothing is "
                "encrypted: anyone who can capture the network's traffic can read the messages and the token."
            )

    log_to_stderr(logging.INFO)
    serve(settings, watch, bind=bind, port=port, ready=ready)


def _to_journal() -> bool:
    """Return whether systemd keeps what this process prints (systemd.exec(5), JOURNAL_STREAM)."""
    try:
        status = os.fstat(sys.stdout.fileno())
    except (OSError, ValueError):
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{status.st_dev}:{status.st_ino}"


def _introduce(settings: Settings, url: str, *, from_file: Path | None) -> None:
    if settings.token and from_file is None:
        # What stands after # never leaves the browser.
        url += f"#token={settings.token}"
    say(f"The page is at {url}")
    if settings.token:
        what = "view" if not settings.allow_write else "view and write" if settings.token_to_view else "write"
        place = "is part of the address" if from_file is None else f"is in {from_file}"
        say(f"The token is required to {what}; it {place}.")
    say("Stop with Ctrl-C.")
