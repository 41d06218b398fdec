"""A page on this machine to look while choosing focus, lens and bokeh."""
