"""What a job can make: an avatar of a photo, or something of a finished avatar.

What is made of a finished avatar is *derived*: it has no photo, belongs to the avatar and goes with it, and is kept by
its content, so that the same request for the same result is computed once. A further kind needs an entry here
with its settings, a program that computes it, as :mod:`service.jobs.render_process` is, and its routes, on
:mod:`service.api.renders_and_exports`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

from service.jobs.settings import Settings


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One kind of job.

    Attributes:
        name: as it is stored, logged and counted.
        place: below ``/v1``, and the name of its queue: a picture of some seconds does not wait for a head of minutes.
        artifact: what its result is called in names of artifacts and in links.
        file: name of the result as its process writes it and as it is given out.
        program, seconds, at_a_time: names of the settings with the module that computes it, the longest time of one,
            and how many one worker computes at the same time (0: none).
        derived: made of a finished avatar.
        looks: how many times as long as into other queues a worker waits between two looks into this one.
        slow: of a derived kind, what to say where it took too long; ``{seconds}`` is filled in.
    """

    name: str
    place: str
    artifact: str
    file: str
    program: str
    seconds: str
    at_a_time: str
    derived: bool = True
    looks: float = 1.0
    slow: str = ""

    def limits(self, settings: Settings) -> Settings:
        """Settings of the process that computes one: those of a job's, with the kind's program and deadline."""
        program, seconds = getattr(settings, self.program), getattr(settings, self.seconds)
        return dataclasses.replace(settings, program=program, job_seconds=seconds)

    def most(self, settings: Settings) -> int:
        """How many one worker computes at the same time."""
        return int(getattr(settings, self.at_a_time))


AVATAR = Kind(
    name="avatar", place="avatars", artifact="archive", file="archive.zip", program="program", seconds="job_seconds",
    at_a_time="jobs", derived=False, looks=0.25,
)  # fmt: skip

RENDER = Kind(
    name="render", place="renders", artifact="picture", file="picture.png", program="render_program",
    seconds="render_seconds", at_a_time="renders",
    slow="rendering took more than {seconds:g} s; ask for a smaller picture",
)  # fmt: skip

EXPORT = Kind(
    name="export", place="exports", artifact="kit", file="kit.zip", program="export_program",
    seconds="export_seconds", at_a_time="exports", looks=2.5,
    slow="making the kit took more than {seconds:g} s; make the avatar with smaller maps",
)  # fmt: skip

KINDS = {kind.name: kind for kind in (AVATAR, RENDER, EXPORT)}
"""All kinds by name."""
