"""Cinematic depth of field and motion blur by splatting sparse Laplacians of point spread functions.

Everything is loaded when it is first used, so that importing the package is fast and compiles nothing.
"""

from typing import TYPE_CHECKING

import lazy_loader

if TYPE_CHECKING:
    from spreadlets import errors as errors
    from spreadlets import metrics as metrics
    from spreadlets.api import build_database as build_database
    from spreadlets.api import reconstruct as reconstruct
    from spreadlets.api import synthesize as synthesize
    from spreadlets.camera import ThinLens as ThinLens
    from spreadlets.camera import read_camera as read_camera
    from spreadlets.database import Database as Database
    from spreadlets.database import open_database as open_database
    from spreadlets.deep import DeepImage as DeepImage
    from spreadlets.deep import write_deep as write_deep
    from spreadlets.exr import read_frame as read_frame
    from spreadlets.exr import read_image as read_image
    from spreadlets.exr import write_frame as write_frame
    from spreadlets.exr import write_image as write_image
    from spreadlets.exr import write_png as write_png
    from spreadlets.frame import Frame as Frame
    from spreadlets.sample_buffer import SampleBuffer as SampleBuffer
    from spreadlets.sample_files import read_samples as read_samples
    from spreadlets.sample_files import write_samples as write_samples
    from spreadlets.tlfr import write_tlfr as write_tlfr

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submodules=["errors", "metrics"],
    submod_attrs={
        "api": ["build_database", "reconstruct", "synthesize"],
        "camera": ["ThinLens", "read_camera"],
        "database": ["Database", "open_database"],
        "deep": ["DeepImage", "write_deep"],
        "exr": ["read_frame", "read_image", "write_frame", "write_image", "write_png"],
        "frame": ["Frame"],
        "sample_buffer": ["SampleBuffer"],
        "sample_files": ["read_samples", "write_samples"],
        "tlfr": ["write_tlfr"],
    },
)
