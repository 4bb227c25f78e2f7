"""Every fault that this program reports, as one tree.

::

    AvatarError                     anything we raise on purpose
    +-- UsageError                  the caller asked for something impossible      exit 2, HTTP 422
    +-- UnreadableInput             the bytes are not a photo that we accept       exit 4
    |   +-- EmptyFile               zero bytes                                     HTTP 422
    |   +-- UnsupportedFormat       not JPEG, PNG or WebP                          HTTP 415
    |   +-- CorruptImage            cut off, flipped bits, decoder gave up         HTTP 422
    |   +-- TooManyBytes            over the byte limit                            HTTP 413
    |   +-- TooManyPixels           over the pixel or side limit                   HTTP 422
    |   +-- TooSmallImage           a side below the limit                         HTTP 422
    |   +-- BadAspect               one side many times the other                  HTTP 422
    |   +-- AnimatedImage           more than one frame                            HTTP 422
    |   +-- TooComplex              decoding ran out of its time or memory         HTTP 422
    |   +-- BadArchive              not an archive of an avatar, or one that lacks something  HTTP 422
    |   +-- BadMesh                 not a mesh that we can use                     HTTP 422
    +-- NoUsableFace                a photo, but not one that we can fit           exit 3, HTTP 422
    |   +-- NoFace
    |   +-- MultipleFaces           carries the boxes; ask for one by index
    |   +-- FaceTooSmall
    |   +-- FaceCutOff
    |   +-- FitFailed               landmarks and head do not agree at all
    |   +-- Strangers               several photos, not all of one person; carries their numbers
    +-- ModelFault                  a data file of ours is missing or changed      exit 1, HTTP 500
    +-- NumericFault                NaN or Inf would have left a stage             exit 1, HTTP 500
    +-- OutputFault                 the result could not be written                exit 1, HTTP 507
    +-- JobFault                    the process of a job ended without an answer   exit 1, HTTP 500
        +-- Crashed                 it crashed, time after time
        +-- OutOfMemory             it needed more memory than is allowed or there
        +-- OutOfTime               it took longer than is allowed

``code`` is stable and meant for machines; the message names the value that was wrong and what would be right.
"""

from __future__ import annotations

from functools import partial
from typing import Any, ClassVar


class AvatarError(Exception):
    """Base of all faults raised on purpose.

    ``extra`` holds machine-readable facts (for example face boxes) and must be JSON-serialisable.
    """

    code: ClassVar[str] = "error"
    exit_status: ClassVar[int] = 1
    http_status: ClassVar[int] = 500

    def __init__(self, message: str, **extra: Any) -> None:
        super().__init__(message)
        self.message = message
        self.extra = extra

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), self.message, **self.extra), ()


def as_facts(error: BaseException) -> dict[str, Any]:
    """What a process says of its fault: ``code``, ``message``, ``status`` of HTTP, and what else machines may know."""
    if isinstance(error, AvatarError):
        return {**error.extra, "code": error.code, "message": error.message, "status": error.http_status}
    return {"code": "internal", "message": f"{type(error).__name__}: {error}", "status": 500}


class UsageError(AvatarError):
    code = "usage"
    exit_status = 2
    http_status = 422


class UnreadableInput(AvatarError):
    code = "unreadable-input"
    exit_status = 4
    http_status = 422


class EmptyFile(UnreadableInput):
    code = "empty-file"


class UnsupportedFormat(UnreadableInput):
    code = "unsupported-format"
    http_status = 415


class CorruptImage(UnreadableInput):
    code = "corrupt-image"


class TooManyBytes(UnreadableInput):
    code = "too-large"
    http_status = 413


class TooManyPixels(UnreadableInput):
    code = "too-many-pixels"


class TooSmallImage(UnreadableInput):
    code = "too-small"


class BadAspect(UnreadableInput):
    code = "bad-aspect"


class AnimatedImage(UnreadableInput):
    code = "animated"


class TooComplex(UnreadableInput):
    code = "too-complex"


class BadArchive(UnreadableInput):
    code = "bad-archive"


class BadMesh(UnreadableInput):
    code = "bad-mesh"


class NoUsableFace(AvatarError):
    code = "no-usable-face"
    exit_status = 3
    http_status = 422


class NoFace(NoUsableFace):
    code = "no-face"


class MultipleFaces(NoUsableFace):
    code = "multiple-faces"


class FaceTooSmall(NoUsableFace):
    code = "face-too-small"


class FaceCutOff(NoUsableFace):
    code = "face-cut-off"


class FitFailed(NoUsableFace):
    code = "fit-failed"


class Strangers(NoUsableFace):
    code = "strangers"


class ModelFault(AvatarError):
    code = "model-corrupt"


class NumericFault(AvatarError):
    code = "numeric-error"


class OutputFault(AvatarError):
    code = "output"
    http_status = 507


class JobFault(AvatarError):
    code = "job"


class Crashed(JobFault):
    code = "crashed"


class OutOfMemory(JobFault):
    code = "out-of-memory"


class OutOfTime(JobFault):
    code = "out-of-time"
