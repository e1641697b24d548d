"""The panel in a browser, on 127.0.0.1 only.

Other users of the computer can reach a port on 127.0.0.1, and so can any page that is open in the browser. Therefore
the address has a secret, which becomes a cookie, and requests of other pages or by another name are refused.
"""

from __future__ import annotations

import secrets
from collections.abc import Awaitable, Callable
from http import HTTPStatus

from aiohttp import web
from textual_serve.server import Server

HOST = "127.0.0.1"
POLICY = (
    "default-src 'self'; script-src 'self' 'unsafe-inline'; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'"
)
"""Content security policy: nothing from elsewhere, and no page that shows the panel inside itself."""
Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class PanelServer(Server):
    """Runs one panel for each browser window. command : of a panel; say : where the address is written."""

    def __init__(self, command: str, port: int, say: Callable[[str], None]) -> None:
        super().__init__(command, host=HOST, port=port, title="hil panel")
        self._secret = secrets.token_urlsafe(16)
        self._cookie = f"hil_panel_{port}"
        self._say = say

    @property
    def address(self) -> str:
        """What to open in the browser."""
        return f"{self.public_url}/?key={self._secret}"

    async def _make_app(self) -> web.Application:
        app = await super()._make_app()
        app.middlewares.append(self._guard)
        return app

    def initialize_logging(self) -> None:
        """Nothing: the address is all that is written."""

    async def on_startup(self, app: web.Application) -> None:
        """Say where the panel is."""
        del app
        self._say(self.address)

    @web.middleware
    async def _guard(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Refuse what does not come from a window that was opened with the secret."""
        if request.host != f"{HOST}:{self.port}" or request.headers.get("Origin") not in (None, self.public_url):
            raise web.HTTPForbidden(text="another page or name")
        given = request.query.get("key", request.cookies.get(self._cookie, ""))
        if not secrets.compare_digest(given.encode(), self._secret.encode()):
            raise web.HTTPForbidden(text="open the address that hil panel --web has written")
        if "key" in request.query:
            answer: web.StreamResponse = web.Response(status=HTTPStatus.SEE_OTHER, headers={"Location": "/"})
            answer.set_cookie(self._cookie, self._secret, httponly=True, samesite="Strict")
            return answer
        answer = await handler(request)
        if not answer.prepared:
            answer.headers["Content-Security-Policy"] = POLICY
        return answer
