"""delta: texture without its light (AvatarMe, section 4.3).

What light the photo was taken in is seen from the whole head, not from a tile. A small network therefore looks at the
whole chart once and leaves its findings as coarse planes that every tile reads.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from service.reflectance.planes import Codes, from_codes, to_codes
from service.reflectance.translate import Job, translate
from service.runtime.networks import describe, open_network
from service.runtime.tiles import run_whole

NAME, CONTEXT = "delta", "delta_context"
PREFIX = "context_"


def needs_context(job: Job) -> bool:
    """Whether the network reads planes of the context network."""
    return any(channel.startswith(PREFIX) for channel in describe(NAME, job.engine.folder).channels)


def diffuse_albedo(texture: Codes, job: Job) -> Codes:
    """(H, W, 3) sRGB codes of the albedo of a texture (H, W, 3), which is among the job's planes as ``texture_*``.

    Eyes, teeth, tongue, lashes and the inside of the mouth keep the texture's colours: the network has seen skin only.

    Raises:
        ModelFault: a network is missing, changed, or does not fit.
    """
    if needs_context(job):
        with open_network(CONTEXT, job.engine) as network:
            what = network.description
            size = what.whole or job.planes.size
            context = run_whole(network, job.planes.shrunk(what.channels, size))
        job.planes.add_coarse(what.planes(len(context)), context)
    result = np.zeros_like(texture)

    def keep(place: tuple[slice, slice], values: npt.NDArray[np.float32], skin: npt.NDArray[np.float32]) -> None:
        albedo = np.moveaxis(np.clip(values, -1, 1), 0, 2)
        if skin.min() < 1:
            kept = from_codes(texture[place])
            albedo = kept + skin[..., None] * (albedo - kept)
        result[place] = to_codes(albedo)

    translate(NAME, job, 3, keep)
    return result
