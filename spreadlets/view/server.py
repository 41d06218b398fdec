"""The page's server: on this machine only, for whoever knows the token in the address."""

from __future__ import annotations

import asyncio
import hashlib
import json
import math
import os
import socket
import struct
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from spreadlets.errors import InvalidParameterError, SpreadletsError, options_spelled
from spreadlets.files.images import write_image
from spreadlets.packages import optional_package
from spreadlets.serve.local import HOST, is_token, new_token
from spreadlets.view import picture
from spreadlets.view.keys import camera_files
from spreadlets.view.session import Request, Studio, Superseded, Worker
from spreadlets.view.settings import Settings, checked, spelled

PAGE = Path(__file__).parent / "page"
TYPES = {".html": "text/html", ".js": "text/javascript", ".css": "text/css"}
MOST_MESSAGE_BYTES = 1 << 16
MOST_KERNEL_BYTES = 1 << 22
"""Largest message of a page, and largest image of a PSF."""
REFUSED = 1008
"""Status with which a connection is closed that must not be: a violation of policy."""
HEADERS = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Content-Security-Policy": (
        "default-src 'self'; script-src 'self' 'unsafe-eval'; img-src 'self' data: blob:; frame-ancestors 'none'"
    ),
}
"""The page loads nothing from elsewhere, tells nobody its address, and is shown in no frame. It evaluates nothing
itself; programs that drive a browser do."""


class Server:
    """Serves a studio.

    Parameters
    ----------
    studio : Studio
    port : int
        0 for any that is free.

    Raises
    ------
    InvalidParameterError
        If the port is taken.
    MissingPackageError
        If the packages of the extra ``view`` are missing.
    """

    def __init__(self, studio: Studio, port: int = 0) -> None:
        self._uvicorn = optional_package("uvicorn", "view", "the page")
        optional_package("starlette", "view", "the page")
        optional_package("websockets", "view", "the page")
        self.studio, self.token = studio, new_token()
        self._socket = _listening(port)
        self.port = int(self._socket.getsockname()[1])
        self._folder = tempfile.TemporaryDirectory(prefix="spreadlets-view-")
        config = self._uvicorn.Config(
            self._application(),
            log_level="error",
            lifespan="off",
            ws="websockets-sansio",
            ws_max_size=MOST_MESSAGE_BYTES,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=1,
        )
        self._server = self._uvicorn.Server(config)

    @property
    def url(self) -> str:
        """The page's address."""
        return f"http://{HOST}:{self.port}/?token={self.token}"

    def run(self) -> None:
        """Serve until it is interrupted or stopped."""
        try:
            self._server.run(sockets=[self._socket])
        finally:
            self._socket.close()
            self._folder.cleanup()
            self.studio.close()

    def stop(self) -> None:
        """Let `run` return."""
        self._server.should_exit = True

    def _application(self) -> Any:
        from starlette.applications import Starlette
        from starlette.routing import Route, WebSocketRoute

        return Starlette(
            routes=[
                Route("/", self._page),
                Route("/page.js", self._page),
                Route("/page.css", self._page),
                Route("/save.exr", self._save),
                Route("/cameras.zip", self._cameras, methods=["POST"]),
                Route("/kernel", self._kernel, methods=["POST"]),
                WebSocketRoute("/live", self._live),
            ]
        )

    # --- Who may ask -----------------------------------------------------------------------------------------------

    def _is_allowed(self, request: Any) -> bool:
        """Tell whether a request knows the token, is for this address, and comes from the page itself."""
        given = request.query_params.get("token", "")
        here = {f"{name}:{self.port}" for name in (HOST, "localhost")}
        origin = request.headers.get("origin")
        return (
            is_token(given, self.token)
            and request.headers.get("host") in here
            and (origin is None or origin in {f"http://{each}" for each in here})
        )

    def _refusal(self) -> Any:
        from starlette.responses import PlainTextResponse

        return PlainTextResponse("The address lacks its token, or the request comes from elsewhere.\n", 403, HEADERS)

    # --- Files -----------------------------------------------------------------------------------------------------

    async def _page(self, request: Any) -> Any:
        """Return a file of the page; the addresses in it carry the token, too."""
        from starlette.responses import Response

        if not self._is_allowed(request):
            return self._refusal()
        file = PAGE / (request.url.path.lstrip("/") or "index.html")
        text = file.read_text(encoding="utf-8")
        if file.suffix == ".html":
            text = text.replace("TOKEN", self.token)
        return Response(text, headers=HEADERS, media_type=TYPES[file.suffix])

    async def _save(self, request: Any) -> Any:
        """Return the last whole picture as OpenEXR."""
        from starlette.responses import PlainTextResponse, Response

        if not self._is_allowed(request):
            return self._refusal()
        if self.studio.latest is None:
            return PlainTextResponse("There is no whole picture yet.\n", 409, HEADERS)
        path = Path(self._folder.name) / "save.exr"
        write_image(path, self.studio.latest, raster=self.studio.scene.frame.raster)
        return Response(path.read_bytes(), headers=_download("out.exr"), media_type="image/x-exr")

    async def _cameras(self, request: Any) -> Any:
        """Return the cameras of a sequence with focus keys."""
        from starlette.responses import PlainTextResponse, Response

        if not self._is_allowed(request):
            return self._refusal()
        try:
            message = _object(await _body(request, MOST_MESSAGE_BYTES))
            with options_spelled(spelled):
                settings = self._settings(message)
                files = camera_files(settings.camera(self.studio.scene.camera), message.get("keys"))
        except SpreadletsError as error:
            return PlainTextResponse(f"{error}\n", 400, HEADERS)
        packed = BytesIO()
        with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, text in files.items():
                archive.writestr(name, text)
        return Response(packed.getvalue(), headers=_download("cameras.zip"), media_type="application/zip")

    async def _kernel(self, request: Any) -> Any:
        """Take an image of a PSF, and return the name by which it is chosen."""
        from starlette.responses import JSONResponse, PlainTextResponse

        from spreadlets.models import Stylized
        from spreadlets.precompute.models.grids import model_settings

        if not self._is_allowed(request):
            return self._refusal()
        try:
            data = await _body(request, MOST_KERNEL_BYTES)
            name = hashlib.sha256(data).hexdigest()[:16]
            path = Path(self._folder.name) / f"{name}.png"
            path.write_bytes(data)
            model_settings(Stylized.name, {"image": str(path)})
        except SpreadletsError as error:
            return PlainTextResponse(f"{error}\n".replace(str(path), "the image"), 400, HEADERS)
        self.studio.kernels[name] = str(path)
        return JSONResponse({"kernel": name}, headers=HEADERS)

    # --- The live connection ---------------------------------------------------------------------------------------

    async def _live(self, connection: Any) -> None:
        """Answer a page until it is closed; its thread ends with it."""
        from starlette.websockets import WebSocketDisconnect

        if not self._is_allowed(connection) or "origin" not in connection.headers:
            await connection.close(REFUSED)
            return
        await connection.accept()
        loop = asyncio.get_running_loop()

        def send(message: dict[str, Any], data: bytes) -> None:
            try:
                asyncio.run_coroutine_threadsafe(connection.send_bytes(packed(message, data)), loop).result()
            except Exception as error:
                raise Superseded from error

        worker = Worker(self.studio, send)
        try:
            for message, data in self._greeting():
                await connection.send_bytes(packed(message, data))
            worker.start()
            while True:
                answer = self._answer(await connection.receive(), worker)
                if answer is not None:
                    await connection.send_bytes(packed(answer))
        except (WebSocketDisconnect, RuntimeError):
            # The page is closed, or was while something was sent to it.
            pass
        finally:
            worker.close()
            while worker.is_alive():
                await asyncio.sleep(0.01)

    def _greeting(self) -> list[tuple[dict[str, Any], bytes]]:
        """Return what a page is told first: what there is, and the pictures that do not change."""
        scene, raster = self.studio.scene, self.studio.scene.frame.raster
        depth = self.studio.plain.depth
        finite = depth[depth < 1e8]
        images = {"pinhole": self.studio.pinhole(), "reference": self.studio.placed_reference()}
        height, width = scene.frame.shape
        hello = {
            "type": "hello",
            "width": width,
            "height": height,
            "aspect": raster.pixel_aspect,
            "left": raster.data.left,
            "top": raster.data.top,
            "names": [os.path.basename(each) for each in scene.frames],
            "settings": vars(Settings.of_camera(scene.camera)),
            "nearest": float(finite.min()) if finite.size else 1.0,
            "farthest": float(finite.max()) if finite.size else 10.0,
            "reference": scene.reference is not None,
            "layered": len(scene.frame.layers) > 1,
        }
        known = [(name, image) for name, image in images.items() if image is not None]
        return [
            (hello, b""),
            *(
                (
                    {"type": name, "width": width, "height": height, "exposure": 0.0},
                    picture.shown(image, 0.0).tobytes(),
                )
                for name, image in known
            ),
        ]

    def _answer(self, received: Mapping[str, Any], worker: Worker) -> dict[str, Any] | None:
        """Do what a message asks for, and return what is to be said at once.

        Raises
        ------
        WebSocketDisconnect
            If the page is closed.
        """
        from starlette.websockets import WebSocketDisconnect

        if received["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(received.get("code", 1000))
        try:
            message = _object(received.get("text") or b"")
            answer = ANSWERS.get(str(message.get("type")))
            if answer is None:
                raise InvalidParameterError(f"there is no message of the type {message.get('type')!r}")
            with options_spelled(spelled):
                return answer(self, message, worker)
        except SpreadletsError as error:
            return {"type": "error", "text": str(error)}

    def _settings(self, message: Mapping[str, Any]) -> Settings:
        """Return the settings of a message."""
        given = message.get("settings")
        if not isinstance(given, dict):
            raise InvalidParameterError("a message lacks its settings")
        given = dict(given)
        kernel = given.pop("kernel", "")
        if kernel and kernel not in self.studio.kernels:
            raise InvalidParameterError(f"there is no image of a PSF {kernel!r}")
        settings = Settings.of_camera(self.studio.scene.camera).changed(given)
        return settings if not kernel else settings.with_kernel(self.studio.kernels[kernel])

    def _render(self, message: Mapping[str, Any], worker: Worker) -> None:
        number = int(checked("number", message.get("number"), 0, 1e15))
        settings = self._settings(message)
        settings.camera(self.studio.scene.camera)
        worker.ask(Request(number, settings, message.get("dragging") is True, message.get("judging") is True))

    def _focus(self, message: Mapping[str, Any], worker: Worker) -> dict[str, Any]:
        x, y = self._place(message)
        return {
            "type": "focus",
            "x": x,
            "y": y,
            "focus": self.studio.focus_at(x, y),
            "keep": message.get("keep") is True,
        }

    def _probe(self, message: Mapping[str, Any], worker: Worker) -> dict[str, Any]:
        """Return what is known of a pixel."""
        x, y = self._place(message)
        raster = self.studio.scene.frame.raster
        row, col = int(y) - raster.data.top, int(x) - raster.data.left
        depth = float(self.studio.plain.depth[row, col])
        image = worker.full[1] if worker.full is not None else None
        camera = self._settings(message).camera(self.studio.scene.camera)
        coc = float(
            self.studio.plain.coc(camera, region=(int(x), int(y), 1, 1), **self._settings(message).options())[0, 0]
        )
        return {
            "type": "probe",
            "x": int(x),
            "y": int(y),
            "depth": depth if depth < 1e30 else None,
            "coc": coc,
            "motion": self.studio.plain.motion_at(camera, int(x), int(y)),
            "colour": None if image is None else [float(each) for each in image[row, col, :3]],
        }

    def _place(self, message: Mapping[str, Any]) -> tuple[float, float]:
        left, top, width, height = self.studio.scene.frame.raster.data
        x = checked("x", message.get("x"), left, left + width - 1)
        return x, checked("y", message.get("y"), top, top + height - 1)


ANSWERS: dict[str, Callable[[Server, Mapping[str, Any], Worker], dict[str, Any] | None]] = {
    "render": Server._render,
    "focus": Server._focus,
    "probe": Server._probe,
}
"""What is done with a message, by its type."""


def packed(message: Mapping[str, Any], data: bytes = b"") -> bytes:
    """Return a message as it is sent: the length of its JSON, that, and the bytes that go with it."""
    text = json.dumps(_finite(dict(message)), allow_nan=False).encode()
    # The bytes begin at a multiple of four, as the page's arrays do.
    text += b" " * (-len(text) % 4)
    return struct.pack("<I", len(text)) + text + data


def _finite(value: Any) -> Any:
    """Return a value with null for what JSON cannot say, such as the PSNR of equal images."""
    if isinstance(value, Mapping):
        return {name: _finite(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(each) for each in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _object(data: str | bytes) -> dict[str, Any]:
    """Return the JSON object of a message.

    Raises
    ------
    InvalidParameterError
        If it is none.
    """
    try:
        message = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InvalidParameterError(f"a message is no JSON: {error}") from error
    if not isinstance(message, dict):
        raise InvalidParameterError("a message is no JSON object")
    return message


async def _body(request: Any, most: int) -> bytes:
    """Return the bytes that a request brings, if they are not too many."""
    data = b""
    async for chunk in request.stream():
        data += chunk
        if len(data) > most:
            raise InvalidParameterError(f"the request brings more than {most} bytes")
    return data


def _download(name: str) -> dict[str, str]:
    return {**HEADERS, "Content-Disposition": f'attachment; filename="{name}"'}


def _listening(port: int) -> socket.socket:
    """Return a socket of this machine alone, that listens."""
    listening = socket.socket()
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((HOST, port))
        listening.listen()
    except OSError as error:
        listening.close()
        raise InvalidParameterError(f"port {port} cannot be used: {error.strerror}") from error
    return listening
