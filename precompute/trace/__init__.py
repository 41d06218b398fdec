"""Trace: dense, pre-filtered PSFs by light tracing."""
