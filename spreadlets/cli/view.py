"""The command that shows a page to look while choosing."""

from __future__ import annotations

import webbrowser
from typing import TYPE_CHECKING, Any

import click
import cloup

from spreadlets.cli.options import camera_options, input_options, json_option, take_camera, take_reading
from spreadlets.cli.show import print_figures

if TYPE_CHECKING:
    from spreadlets.view.session import Studio


@cloup.command()
@cloup.argument("frames", nargs=-1, required=True, type=click.Path(dir_okay=False), metavar="FRAME.exr...")
@cloup.option("--reference", type=click.Path(dir_okay=False), help="An image to wipe and to compare with.")
@cloup.option("--db", "database", help="Database: a file or a shipped name.")
@cloup.option("--port", type=click.IntRange(0, 65535), default=0, help="Port of the page (default: one that is free).")
@cloup.option("--no-browser", is_flag=True, help="Open no browser; the address is printed.")
@camera_options
@input_options
@json_option
def view(
    frames: tuple[str, ...],
    reference: str | None,
    database: str | None,
    port: int,
    no_browser: bool,
    camera: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Look while you choose focus, lens and bokeh: a page in the browser, served from this machine only.

    Several frames are depth layers of one view, nearest first. The page's address holds a secret; it is served until
    this command is interrupted. Needs the extra "view".

    Example: spreadlets view frame.exr --camera camera.json --reference reference.exr
    """
    from spreadlets.ahead import compiled_ahead
    from spreadlets.files import exr_frames as exr
    from spreadlets.files.cameras import camera_of
    from spreadlets.files.exr_file import opened
    from spreadlets.files.recognise import ReadOptions
    from spreadlets.jobs.databases import kept_database
    from spreadlets.view.session import Scene, Studio

    reading = take_reading(options)
    with opened(frames) as files:
        lens = camera_of(camera, take_camera(options), files[0], reading.get("depth_scale", 1.0))
        chosen = ReadOptions(**reading, camera=lens)
        frame = exr.read_frame(files, options=chosen)
    lens = lens.fitted(frame.raster.display.shape, frame.raster.pixel_aspect)
    truth = exr.read_reference(reference, chosen) if reference else None
    scene = Scene(frame, lens, None if database is None else kept_database(database), truth, frames, camera)
    studio = Studio(scene)
    with compiled_ahead("synthesize"):
        studio.begin()
        try:
            serve(studio, port, as_json=as_json, in_browser=not no_browser and not as_json)
        finally:
            studio.close()


def serve(studio: Studio, port: int, *, as_json: bool, in_browser: bool) -> None:
    """Serve a page until it is interrupted; say where, and open it."""
    from spreadlets.view.server import Server

    server = Server(studio, port)
    if as_json:
        print_figures({"url": server.url}, as_json)
    else:
        click.echo(f"{server.url}\nInterrupt (Ctrl-C) to end.")
    if in_browser:
        webbrowser.open(server.url)
    server.run()
