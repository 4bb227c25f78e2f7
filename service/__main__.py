"""``python -m service`` is the command ``avatarme``."""

from service.cli.app import run

if __name__ == "__main__":
    run()
