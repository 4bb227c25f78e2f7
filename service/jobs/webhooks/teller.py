"""Webhooks sent beside the work of a worker: whoever is told may take its time."""

from __future__ import annotations

import logging
import threading

import sqlalchemy as sa

from service.jobs.settings import Settings

log = logging.getLogger(__name__)


class Teller:
    """Sends what waits, in one thread at a time.

    Args:
        engine: of the database.
        settings: of the worker.
    """

    def __init__(self, engine: sa.Engine, settings: Settings) -> None:
        self._engine, self._settings = engine, settings
        self._thread: threading.Thread | None = None

    def tell(self) -> None:
        """Send what is due, unless that is being done."""
        if self._settings.webhook_hosts and (self._thread is None or not self._thread.is_alive()):
            self._thread = threading.Thread(target=self._send, name="webhooks", daemon=True)
            self._thread.start()

    def _send(self) -> None:
        from service.jobs.webhooks.deliver import deliver

        try:
            deliver(self._engine, self._settings)
        except (sa.exc.SQLAlchemyError, OSError) as error:
            log.warning("webhooks cannot be sent: %s", error)
