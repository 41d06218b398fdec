"""Build: a database, by workers, resumable and extendable."""
