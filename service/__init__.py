"""Everything that runs when a photo arrives: command line, pipeline and the numpy core under it.

Never imports torch.
"""

__version__ = "0.1.0"

PROGRAM = "avatarme"
GENERATOR = f"{PROGRAM} {__version__}"
"""Name and version as written into files."""
