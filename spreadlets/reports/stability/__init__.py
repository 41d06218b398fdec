"""The stiff and extreme cases."""
