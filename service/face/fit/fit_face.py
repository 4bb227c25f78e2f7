"""Fit the head model to a photo and the landmarks found in it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from service.arrays import Float64
from service.errors import FitFailed
from service.face.face import Face
from service.face.features.eye_colours import eye_colours
from service.face.features.eyes import eyes_on_rims, find_gaze, lids_on_rims, with_gaze
from service.face.features.mouth import lips_on_rim
from service.face.features.rims import RIMS
from service.face.features.teeth import ROW as UPPER_ROW
from service.face.features.teeth import measure_teeth, teeth_drop
from service.face.features.white_reference import cheek_colour, light_from_sclera_and_teeth
from service.face.fit.basis import LandmarkModel
from service.face.fit.dense import Correspondences, correspondences, reading_agreement
from service.face.fit.landmark_fit import LandmarkFit, Observed, fit_landmarks
from service.face.fit.pixel_fit import PixelFit
from service.face.fit.result import Fit
from service.face.fit.settings import FitSettings
from service.face.fit.solver import Prior
from service.face.reading.openings import Openings, with_openings
from service.face.reading.reader import Reading
from service.face.reading.scores import Scores
from service.head.eyeball import inter_ocular_m
from service.head.model import HeadModel
from service.head.regions import part_vertices
from service.photo.photo import Photo

UNKNOWN_FOCAL = 1.2
"""Mean of the prior on the focal length without EXIF, over the photo's longer side: between phone and portrait crop."""
UNKNOWN_FOCAL_SIGMA, UNKNOWN_FOCAL_DISTANCE_SIGMA = 1.0, 0.35
"""Standard deviations of the logarithms of focal length and distance without EXIF; the distance is known better."""
EXIF_FOCAL_SIGMA, EXIF_DISTANCE_SIGMA = 0.1, 0.8
"""The same with EXIF: crops and digital zoom change the effective focal length, so it is trusted to about 10 %."""
FILM_DIAGONAL_MM = 43.27
"""Diagonal of the 35 mm frame to which EXIF's equivalent focal length refers."""
DISTRUST_RMS = 0.06
"""Landmark rms over the inter-ocular distance above which a fit gets the warning ``low-confidence``."""
FAIL_RMS = 0.25
"""Landmark rms over the inter-ocular distance above which the fit fails."""
WIDE_YAW_DEG = 60.0
"""Yaw in degrees above which a fit gets the warning ``extreme-pose``."""
FEWEST_LANDMARKS = 30
"""Fewest finite landmarks that a fit needs."""
FEWEST_CELLS = 150
"""Fewest cells with a place on the head from which a reading is followed."""
LEAST_AGREEMENT = 0.3
"""Least share of them that has to agree with the landmark fit: below it, reader and landmarks see different faces."""


def prior_for(photo: Photo, model: LandmarkModel, settings: FitSettings, scores: Scores | None = None) -> Prior:
    """The fit's prior: portrait distance, focal length from EXIF where there is one, Gaussian shape coefficients.

    Units of the expression have the mean that their scores say. Less scatter about it than without scores made the
    shape of rendered heads at rest worse: the scores are seldom 0 on a face at rest.
    """
    focal = UNKNOWN_FOCAL * max(photo.size)
    focal_sigma, distance_sigma = UNKNOWN_FOCAL_SIGMA, UNKNOWN_FOCAL_DISTANCE_SIGMA
    if photo.focal_35mm:
        focal = photo.focal_35mm * float(np.hypot(*photo.size)) / FILM_DIAGONAL_MM
        focal_sigma, distance_sigma = EXIF_FOCAL_SIGMA, EXIF_DISTANCE_SIGMA
    precision = np.full(model.shape_count, settings.identity_prior)
    precision[model.identity_count :] = settings.expression_prior**-2
    mean = np.zeros(model.shape_count)
    for k, name in enumerate(model.expression_names, model.identity_count):
        if scores is not None and name in scores.units:
            mean[k] = scores.units[name]
    return Prior(
        float(np.log(settings.distance_m)), distance_sigma, float(np.log(focal)), focal_sigma, precision, mean
    )


def fit_face(
    face: Face,
    photo: Photo,
    head: HeadModel,
    settings: FitSettings | None = None,
    reading: Reading | None = None,
) -> Fit:
    """Place the head model in the photo.

    Args:
        face: landmarks in photo pixels.
        photo: the photo they were found in.
        head: any head model with the 468-landmark embedding.
        settings: iterations, size of the basis, weights of the prior.
        reading: what was read off the photo (:func:`service.face.reading.read.read_face`). Its scores are the prior of
            the expression, its openings place lids and lips; what is missing comes from the landmarks. Without places
            of pixels, or where these and the landmarks see different faces, the silhouette alone refines the landmark
            fit.

    Returns:
        A finite fit; ``low-confidence`` among its warnings where it is not to be trusted, ``not-read`` where no reading
        was followed though the settings ask for it.

    Raises:
        FitFailed: fewer than 30 landmarks are finite, or the landmark error stays above ``FAIL_RMS``.
    """
    settings = settings or FitSettings()
    finite = int(np.isfinite(face.landmarks).all(1).sum())
    if finite < FEWEST_LANDMARKS:
        raise FitFailed(
            f"only {finite} of {len(face.landmarks)} landmarks are finite; at least {FEWEST_LANDMARKS} are needed"
        )
    width, height = photo.size
    middle = np.array([width / 2, height / 2])
    model = LandmarkModel(head, settings.identity_components)
    scores = reading.scores if reading is not None and settings.scores else None
    openings = {} if reading is None else reading.openings
    prior = prior_for(photo, model, settings, scores)
    observed = Observed.of(face.landmarks, middle)
    initial = fit_landmarks(model, observed, prior, settings)
    if settings.refine == "landmarks":
        return _result(face, photo, head, model, initial, openings)
    found = None if reading is None else _understood(head, model, reading, initial, middle)
    beyond = settings.beyond if found is not None and settings.refine == "full" else 0
    pixel_fit = PixelFit(head, settings.identity_components, beyond)
    refined, light = pixel_fit.refine(initial, observed, photo.pixels, prior, found, settings.normals)
    fit = _result(face, photo, pixel_fit.head, pixel_fit.model, refined, openings)
    doubts = {"not-read": found is None, "no-light": light is None}
    return replace(
        fit, identity=fit.identity[: model.identity_count], light=light,
        warnings=(*fit.warnings, *(code for code, true in doubts.items() if true)),
    )  # fmt: skip


def _understood(
    head: HeadModel, model: LandmarkModel, reading: Reading, initial: LandmarkFit, middle: Float64
) -> Correspondences | None:
    """Places of the head that were read, None where they are few or the landmarks show another face."""
    found = correspondences(head, reading, initial.state, middle)
    vertices = head.shape(*np.split(initial.state.coefficients, [model.identity_count]))
    agrees = len(found.pixels) >= FEWEST_CELLS and reading_agreement(found, initial.state, vertices) >= LEAST_AGREEMENT
    return found if agrees else None


def _result(
    face: Face, photo: Photo, head: HeadModel, model: LandmarkModel, found: LandmarkFit, openings: Openings
) -> Fit:
    rims = with_openings(face.landmarks, openings)
    state, basis, weight = found.state, found.basis, found.weight
    camera = state.camera(*photo.size)
    identity, expression = np.split(state.coefficients, [model.identity_count])
    neutral = head.shape(identity)
    if not np.isfinite(neutral).all():
        raise FitFailed("the fitted head is not finite")
    neutral = eyes_on_rims(head, neutral, expression, camera, rims, openings)
    gaze = find_gaze(photo.pixels, rims, head, neutral, camera)
    if gaze is not None:
        expression = with_gaze(head, neutral, expression, gaze)
    # The landmark error is measured before lids and lips are moved: the embedding was calibrated on rendered heads, so
    # it already allows for where the network puts their landmarks.
    coefficients = np.concatenate([identity, expression])
    expression = lids_on_rims(head, neutral, expression, camera, rims, openings)
    mouth_rim = rims[list(RIMS["mouth"]), :2]
    inter_ocular = inter_ocular_m(head, neutral) * camera.focal_px / camera.translation[2]
    skin = cheek_colour(photo.pixels, face.landmarks, float(inter_ocular))
    tooth = None if skin is None else measure_teeth(photo.pixels, mouth_rim, skin)
    teeth_seen = skin is None or tooth is not None
    expression = lips_on_rim(head, neutral, expression, camera, mouth_rim, teeth_seen, exact="mouth" in openings)
    vertices = head.expressed(neutral, expression)
    if skin is not None and (teeth := part_vertices(head, UPPER_ROW)).size:
        drop = teeth_drop(photo.pixels, vertices[teeth], camera, mouth_rim, skin)
        for shape in (vertices, neutral):
            shape[teeth, 1] -= np.float32(drop)
    distance = np.linalg.norm(camera.project(basis.points(coefficients)) - face.landmarks[:, :2], axis=1)
    seen = (weight > 0) & np.isfinite(distance)
    inlier = weight[seen] > 0.05
    trusted = distance[seen][inlier] if inlier.any() else distance[np.isfinite(distance)]
    rms = float(np.sqrt(np.mean(trusted**2))) if trusted.size else float("inf")
    if not np.isfinite(rms) or not np.isfinite(vertices).all() or rms > FAIL_RMS * inter_ocular:
        raise FitFailed(
            f"the head does not fit the landmarks: rms {rms:.1f} px with eyes {inter_ocular:.1f} px apart; "
            f"at most {FAIL_RMS * inter_ocular:.1f} px are accepted"
        )
    warnings = []
    yaw = abs(camera.yaw_pitch_roll_deg()[0])
    if yaw > WIDE_YAW_DEG:
        warnings.append("extreme-pose")
    doubted = rms > DISTRUST_RMS * inter_ocular or float((weight > 0.05).mean()) < 0.3
    if doubted or yaw > 75 or "landmarks-read" in face.warnings:
        warnings.append("low-confidence")
    if gaze is not None and not gaze.irises:
        warnings.append("gaze-not-seen")
    eye_light = light_from_sclera_and_teeth(photo.pixels, gaze, tooth, skin)
    sclera, iris = eye_colours(photo.pixels, () if gaze is None else gaze.irises)
    return Fit(
        camera=camera,
        identity=identity,
        expression=expression,
        vertices=vertices,
        neutral=neutral,
        light=None,
        landmark_rms_px=rms,
        inter_ocular_px=float(inter_ocular),
        warnings=tuple(warnings),
        gaze=gaze,
        eye_light=eye_light,
        cheek=skin,
        tooth=tooth,
        iris=iris,
        sclera=None if eye_light is None else sclera,
    )
