"""The panel in a browser: only a window that was opened with the secret gets it."""

from __future__ import annotations

import asyncio

from aiohttp import CookieJar
from aiohttp.test_utils import TestClient, TestServer, unused_port

from hil.panel.web_server import HOST, PanelServer


def test_only_the_address_with_its_secret_opens_the_panel() -> None:
    async def session() -> None:
        port = unused_port()
        addresses: list[str] = []
        panel = PanelServer("true", port, addresses.append)
        server = TestServer(await panel._make_app(), host=HOST, port=port)
        async with TestClient(server, cookie_jar=CookieJar(unsafe=True)) as browser:
            assert addresses == [panel.address]
            assert (await browser.get("/")).status == 403
            assert (await browser.get("/ws")).status == 403
            assert (await browser.get("/?key=guess")).status == 403
            opened = await browser.get(panel.address.removeprefix(panel.public_url))
            assert opened.status == 200
            assert "hil panel" in await opened.text()
            assert "frame-ancestors 'none'" in opened.headers["Content-Security-Policy"]
            assert (await browser.get("/", headers={"Origin": "http://elsewhere.example"})).status == 403
            assert (await browser.get("/", headers={"Host": f"elsewhere.example:{port}"})).status == 403

    asyncio.run(session())
