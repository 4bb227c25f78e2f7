"""Name and version of the program as written into files."""

from service import __version__

PROGRAM = "avatarme"
GENERATOR = f"{PROGRAM} {__version__}"
