"""The command for photographs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click
import cloup

from spreadlets.cli.controls import Numbers, bokeh_options, take_bokeh
from spreadlets.cli.options import bit_depth_option, json_option
from spreadlets.cli.show import print_figures, progress_bar

if TYPE_CHECKING:
    from spreadlets.arrays import FloatArray


class PointOrBox(click.ParamType[Any]):
    """Two numbers, a point, or four, a box."""

    name = "X,Y or LEFT,TOP,RIGHT,BOTTOM"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the numbers, or fail with what is needed."""
        form = "X,Y" if str(value).count(",") < 2 else "LEFT,TOP,RIGHT,BOTTOM"
        return Numbers(form).convert(value, param, ctx)


@cloup.command()
@cloup.argument("image", type=click.Path(dir_okay=False))
@cloup.argument("depth", type=click.Path(dir_okay=False))
@cloup.option(
    "-o", "--output", required=True, type=click.Path(dir_okay=False), help="The image: .png, .jpg, .tif or .exr."
)
@bit_depth_option
@cloup.option(
    "--depth-kind",
    type=click.Choice(["inverse", "metric", "disparity"]),
    default="inverse",
    show_default=True,
    help="inverse (larger is nearer, any scale and offset), disparity (the same), or metric (metres).",
)
@cloup.option("--focus", required=True, type=PointOrBox(), help="What is to be sharp: a point or a box, px.")
@cloup.option("--blur", type=float, metavar="PX", help="Radius of the blur at the far end (25).")
@cloup.option("--f-number", type=float, metavar="N", help="Of a full-frame camera, for metric depth.")
@cloup.option("--focal-length", type=float, metavar="MM", help="For a film 36 mm wide (default: what EXIF says).")
@cloup.option(
    "--highlights",
    type=Numbers("GAIN,THRESHOLD"),
    metavar="GAIN,THRESHOLD",
    help="Multiply blurred light above the threshold, of linear light from 0 to 1: what was clipped shines again.",
)
@cloup.option("--max-coc", type=float, metavar="PX", help="Largest radius of the blur.")
@cloup.option("--mask", type=click.Path(dir_okay=False), metavar="FILE", help="Keep sharp what is white in this image.")
@cloup.option("--input-space", metavar="NAME", help="Colour space of the image, by OpenColorIO's name (its profile).")
@cloup.option("--output-space", metavar="NAME", help="Colour space of the output (sRGB; linear in OpenEXR).")
@cloup.option("--no-refine", "refine", is_flag=True, flag_value=False, default=True, help="Take the depth as it is.")
@cloup.option("--grain", is_flag=True, help="Give what is blurred the grain of the photograph.")
@cloup.option("--layers", type=click.IntRange(min=1), help="Depth layers, at most.")
@bokeh_options
@json_option
def photo(
    image: str,
    depth: str,
    output: str,
    bit_depth: int | None,
    focal_length: float | None,
    f_number: float | None,
    mask: str | None,
    input_space: str | None,
    output_space: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Give a photograph with a depth map the depth of field of another lens.

    IMAGE is a picture (PNG, JPEG, TIFF, WebP, HEIC with the extra "photo", NPY or OpenEXR), taken as its colour profile
    says; DEPTH is one value for each pixel (PNG of 8 or 16 bits, TIFF, NPY, PFM or OpenEXR). Pictures are turned
    upright as EXIF says.

    Example: spreadlets photo dog.jpg dog_depth.png -o out.jpg --focus 820,640 --blur 30
    """
    from spreadlets.ahead import compiled_ahead
    from spreadlets.bokeh import bokeh_model
    from spreadlets.files.colour_spaces import check_space
    from spreadlets.files.images import check_bit_depth, write_image
    from spreadlets.files.outputs import check_outputs
    from spreadlets.files.pictures import read_picture, read_plane
    from spreadlets.photograph.photograph import photo as make
    from spreadlets.runtime.clock import Clock

    # Check what is written before anything is read.
    check_bit_depth(output, bit_depth)
    if output_space:
        check_space(output_space)
    shape = take_bokeh(options, None)
    check_outputs([output], [each for each in (image, depth, mask, shape.get("kernel")) if each])
    # Read the picture and its depth.
    clock = Clock()
    with clock.step("read"):
        picture = read_picture(image, input_space)
        values = read_plane(depth, in_metres=options["depth_kind"] == "metric")
        held = None if mask is None else read_plane(mask)
    # Blur and write it.
    with compiled_ahead("synthesize"), progress_bar("building", quiet=as_json) as progress:
        result = make(
            picture.radiance,
            values,
            f_number=f_number,
            focal_length=picture.focal_length_35mm if focal_length is None and f_number is not None else focal_length,
            mask=held,
            database=bokeh_model(moving=False, **shape) if shape else None,
            progress=progress,
            clock=clock,
            **options,
        )
    with clock.step("write"):
        if output_space:
            result = _in_space(result, output_space, output)
        write_image(output, result, bit_depth=bit_depth)
    height, width = result.shape[:2]
    print_figures({"output": output, "width": width, "height": height, "time_s": clock.times()}, as_json)


def _in_space(linear: FloatArray, space: str, path: str) -> FloatArray:
    """Return what a file has to be written from that shall hold the colours of a space."""
    from spreadlets.files.colour_spaces import from_linear
    from spreadlets.files.images import OPENEXR, image_extension
    from spreadlets.scene.display import display_decode

    values = from_linear(linear, space)
    # Pictures for viewing are encoded as they are written: of this, that leaves the values.
    return values if image_extension(path) == OPENEXR else display_decode(values.clip(0.0, 1.0))
