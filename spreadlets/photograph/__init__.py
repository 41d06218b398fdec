"""Depth of field for photographs with a depth map."""
