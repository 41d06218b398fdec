"""The ``spreadlets`` command."""
