"""The page's server in this process."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from rosplc.monitor import Watch
from rosplc.shm import Namespace
from tests.web.peers import WATCHDOG


@pytest.fixture
def serving(shm_namespace: Namespace) -> Callable[..., None]:
    """Give a function that serves the page of the test's channels and runs a coroutine with a client."""
    from aiohttp.test_utils import TestClient, TestServer

    from rosplc.web import Settings
    from rosplc.web.server import make_application

    def serve(talk: Callable[[Any], Awaitable[None]], **settings: Any) -> None:
        async def run() -> None:
            chosen = Settings(prefix=shm_namespace.prefix, **settings)
            with Watch(shm_namespace.prefix) as watch:
                application = make_application(chosen, watch, "machine")
                async with TestClient(TestServer(application, host="127.0.0.1")) as client:
                    await asyncio.wait_for(talk(client), WATCHDOG)

        asyncio.run(run())

    return serve
