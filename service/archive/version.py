"""The name under which files say who wrote them."""

from service import __version__

PROGRAM = "avatarme"
GENERATOR = f"{PROGRAM} {__version__}"
