"""Who may ask a server of this machine: it listens here only, and answers who knows its token."""

from __future__ import annotations

import secrets

HOST = "127.0.0.1"
"""Where servers listen: other machines cannot reach it."""
TOKEN_BYTES = 24
"""Random bytes of a token: more than can be guessed."""


def new_token() -> str:
    """Return a token that nobody can guess; it can stand in an address.

    Examples
    --------
    >>> from spreadlets.serve.local import new_token
    >>> len(new_token()), new_token() == new_token()
    (32, False)
    """
    return secrets.token_urlsafe(TOKEN_BYTES)


def is_token(given: str, token: str) -> bool:
    """Tell whether a token is the right one, in a time that does not tell how much of it is right.

    Parameters
    ----------
    given : str
        What a request says; any text.
    token : str
        What it must say.

    Examples
    --------
    >>> from spreadlets.serve.local import is_token
    >>> is_token("secret", "secret"), is_token("ß", "secret"), is_token("", "secret")
    (True, False, False)
    """
    return secrets.compare_digest(given.encode(), token.encode())
