"""Fit the head model to photos of one person and what was found in them.

Stage B refines the landmark fit by what the photos show at their pixels. Poses, expressions, identity and free form are
solved together, on landmarks, outline and, where a photo was read, places, normals and the end of the skull; every
round weighs them anew at the state that the round before has found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from service.arrays import Float32, Float64
from service.errors import FitFailed
from service.face.features.eye_colours import cheek_colour, eye_colours, light_from_sclera_and_teeth
from service.face.features.eyes import SeenRims, eyes_at_rest, eyes_on_rims, find_gaze, lids_on_rims, with_gaze
from service.face.features.mouth import lips_on_rim, measure_teeth
from service.face.features.rims import RIMS
from service.face.fit.dense import Correspondences, DenseTerms, NormalTerm, correspondences, reading_agreement
from service.face.fit.fit import Fit, FitSettings
from service.face.fit.landmark_fit import (
    ANNEAL,
    LandmarkFit,
    LandmarkModel,
    Observed,
    bounds,
    extended,
    fit_landmarks,
    identity_of,
    landmark_fit,
    once,
    weigh_landmarks,
)
from service.face.fit.outline import OutlineFinder, Softened, light_on_face
from service.face.fit.solver import POSE, Damping, NormalPrior, PointTerm, Prior, State, Term, linear, minimise
from service.face.fit.stereo import Picture, stereo_terms
from service.face.reading.openings import Scores, with_openings
from service.face.reading.reader import View
from service.geometry.camera import Camera
from service.head.model import HeadModel
from service.head.regions import SIDES, inter_ocular_m
from service.photo.photo import Photo
from service.robust import smoothstep
from service.words import WarningCode

REACH_M = (0.008, 0.004)
"""Half length of the outline's search lines in each round, metres on the face."""
STEPS = 4
"""Solver steps of each round."""
SKULL_SIGMA_M = 0.008
"""Standard deviation among people of the crown's height above the face, metres; 0.0078 among ICT-FaceKit's."""
HARDLY = 0.02
"""Least weight of what is still followed."""
SQUARELY_DEG = (52.0, 68.0)
"""Yaw up to which landmarks and the normals that were read are followed where places were read, and from which on they
are not: both turn profiles some degrees to the camera."""
BESIDE_SPOTS = 0.25
"""Weight of the places that were read in a photo that shares spots with others: the reader errs alike in all photos."""
MORE_FORM = 2
"""Modes of free form where there are several photos, over those of one: what they have in common tells more of them."""


@dataclass(frozen=True)
class ObservedPhoto:
    """One photo as the fit sees it.

    Attributes:
        view: the photo; the principal point is its middle.
        observed: the landmarks.
        prior: of the plain head's fit.
        initial: the landmark fit of the plain head.
        found: places of the head that were read off the photo; None: they were not.
    """

    view: View
    observed: Observed
    prior: Prior
    initial: LandmarkFit
    found: Correspondences | None


def middle_of(photo: Photo) -> Float64:
    """(2,) the principal point of a photo, pixels."""
    return np.array(photo.size) / 2


def skull_height(head: HeadModel, model: LandmarkModel) -> NormalPrior:
    """The crown's height above the middle of all landmarks, which people have alike within some millimetres.

    The coefficients' own prior allows it twice that, a face seen from the front says nothing of it, and what is learnt
    of the forehead would be carried on to a pointed skull.
    """
    up = head.identity[:, :, 1].astype(np.float64)
    crown = up[:, int(head.mean[:, 1].argmax())]
    middle = model.at_yaw(0.0).modes[:, 1, : len(up)].mean(0)
    return NormalPrior((crown - middle) / SKULL_SIGMA_M)


def placing(term: Term, state: State, identities: int) -> Term:
    """A term that knows the first coefficients as they are at a state and moves them no more."""
    if not isinstance(term, PointTerm | NormalTerm):
        return term
    modes = term.modes.copy()
    modes[..., :identities] = 0.0
    if isinstance(term, NormalTerm):
        return replace(term, modes=modes)
    known = linear(term.mean, term.modes[..., :identities], state.coefficients[:identities])
    return replace(term, mean=known, modes=modes)


def _refined(
    sights: Sequence[ObservedPhoto], head: HeadModel, model: LandmarkModel, components: int, *, normals: bool
) -> list[tuple[LandmarkFit, Float64 | None]]:
    """For each photo the refined fit, its coefficients those of the extended head, and the light on the face there.

    Args:
        sights: the photos, all of one identity.
        head: the extended head (:func:`extended`).
        model: its landmarks.
        components: how many of its components of identity are the plain head's.
        normals: whether the normals that were read are followed, too.
    """

    def widened(coefficients: Float64, beyond: float) -> Float64:
        """Values (K + E,) of the plain head's coefficients with one for each mode beyond its components."""
        identity, expression = np.split(coefficients, [components])
        return np.concatenate([identity, np.full(len(head.identity) - components, beyond), expression])

    def vertices_at(state: State) -> Float64:
        return head.shape(*np.split(state.coefficients, [len(head.identity)])).astype(np.float64)

    states = [replace(one.initial.state, coefficients=widened(one.initial.state.coefficients, 0.0)) for one in sights]
    priors = once([
        replace(one.prior, shape_precision=widened(one.prior.shape_precision, 1.0),
                shape_mean=widened(one.prior.shape_mean, 0.0)) for one in sights
    ], model.identity_count)  # fmt: skip
    photos = [(sight.view.photo.pixels, middle_of(sight.view.photo)) for sight in sights]
    dense = [None if sight.found is None else DenseTerms(head, sight.found) for sight in sights]
    soft = [Softened.around(*photo, state, vertices_at(state)) for photo, state in zip(photos, states, strict=True)]
    contour, (lower, upper) = OutlineFinder(head), bounds(model)
    skull = OutlineFinder(head, "scalp") if "scalp" in head.region_names else None
    plain = np.arange(model.shape_count) < components
    height = skull_height(head, model)
    damping = Damping()
    # Further rounds, of several photos, with the spots that these have in common.
    # Spots move the head further than a second round does: the outline is searched as far as in the first.
    rounds = REACH_M if len(sights) == 1 else (*REACH_M, *(REACH_M[:1] * 5))
    for round_, reach in enumerate(rounds):
        shapes = [vertices_at(state) for state in states]
        spots: list[list[PointTerm]] = [[] for _ in sights]
        if round_ >= len(REACH_M):
            seen = zip(photos, states, shapes, strict=True)
            spots = stereo_terms(head, [Picture.of(*photo, head, state, shape) for photo, state, shape in seen])
        terms: list[list[Term]] = []
        for k, (sight, state, shape, read) in enumerate(zip(sights, states, shapes, dense, strict=True)):
            # Beside photos that share spots, one that shares none is only placed: what it says of the shape is worse.
            heard = bool(spots[k]) or not any(spots)
            points = weigh_landmarks(state, model.at_yaw(state.yaw_deg), sight.observed, ANNEAL[-1])[1]
            own: list[Term] = [points, priors[k], *([height] if k == 0 else [])]
            if read is not None:
                # The landmark network draws the hidden half of profiles. Places in profile are off by more than the
                # other photos are.
                squarely = max(float(smoothstep(np.array(abs(state.yaw_deg)), *SQUARELY_DEG[::-1])), HARDLY)
                # A photo alone and from the front is told by its landmarks more, and less by the prior of identity.
                frontal = float(smoothstep(np.array(abs(state.yaw_deg)), 25.0, 12.0)) * (len(sights) == 1)
                own[0] = replace(points, precision=points.precision * squarely * (1.0 + frontal))
                own[1] = replace(priors[k], shape_precision=priors[k].shape_precision * (1.0 - 0.7 * frontal * plain))
                places = read.points(state)
                if len(sights) > 1 and heard:
                    say = squarely * (BESIDE_SPOTS if spots[k] else 1.0)
                    places = replace(places, precision=places.precision * say)
                own.append(places)
                own += [read.normals(state, shape)] if normals and squarely > HARDLY else []
            view = sight.view if len(sights) > 1 else None
            outline = contour.term(soft[k], photos[k][1], state, shape, reach, view)
            end = None
            if read is not None and skull is not None and sight.view.reading is not None:
                end = skull.crown_term(sight.view.reading, sight.view.photo.size, state, shape)
            own += [term for term in (outline, end) if term is not None]
            terms.append([*own, *spots[k]] if heard else [placing(one, state, model.identity_count) for one in own])
        states = minimise(
            states, terms, shared=identity_of(model), lower=lower, upper=upper, damping=damping, steps=STEPS,
            active=np.ones(POSE + model.shape_count, bool),
        )  # fmt: skip
    return [
        (landmark_fit(model, state, sight.observed), light_on_face(head, state, vertices_at(state), *photo))
        for sight, state, photo in zip(sights, states, photos, strict=True)
    ]


UNKNOWN_FOCAL_SIGMA, UNKNOWN_FOCAL_DISTANCE_SIGMA = 1.0, 0.35
"""Standard deviations of the logarithms of focal length and distance without EXIF; the distance is known better."""
EXIF_FOCAL_SIGMA, EXIF_DISTANCE_SIGMA = 0.1, 0.8
"""The same with EXIF: crops and digital zoom change the effective focal length, so it is trusted to about 10 %."""
FAIL_RMS = 0.25
"""Landmark rms over the inter-ocular distance above which the fit fails."""
WIDE_YAW_DEG = 60.0
"""Yaw in degrees above which a fit gets the warning ``extreme-pose``."""
FEWEST_LANDMARKS = 30
"""Fewest finite landmarks that a fit needs."""


def prior_for(photo: Photo, model: LandmarkModel, settings: FitSettings, scores: Scores | None = None) -> Prior:
    """The fit's prior: portrait distance (1.2 m), focal length from EXIF where there is one, Gaussian coefficients.

    Units of the expression have the mean that their scores say. Less scatter about it than without scores made the
    shape of rendered heads at rest worse: the scores are seldom 0 on a face at rest.
    """
    # Mean of the prior on the focal length without EXIF, over the photo's longer side: between phone and portrait crop.
    focal = 1.2 * max(photo.size)
    focal_sigma, distance_sigma = UNKNOWN_FOCAL_SIGMA, UNKNOWN_FOCAL_DISTANCE_SIGMA
    if photo.focal_35mm:
        # Diagonal of the 35 mm frame to which EXIF's equivalent focal length refers.
        focal = photo.focal_35mm * float(np.hypot(*photo.size)) / 43.27
        focal_sigma, distance_sigma = EXIF_FOCAL_SIGMA, EXIF_DISTANCE_SIGMA
    precision = np.full(model.shape_count, settings.identity_prior)
    # One over the variance of an expression unit about its score, or about 0 without one.
    precision[model.identity_count :] = 4.0
    mean = np.zeros(model.shape_count)
    for k, name in enumerate(model.expression_names, model.identity_count):
        mean[k] = (scores or {}).get(name, 0.0)
    return Prior(float(np.log(1.2)), distance_sigma, float(np.log(focal)), focal_sigma, precision, mean)


def fit_views(views: Sequence[View], head: HeadModel, settings: FitSettings | None = None) -> list[Fit]:
    """Place the head model in photos of one person.

    Identity and free form are the same in all; pose, focal length, expression and light are each photo's own. Photos of
    one camera, by what their files say, have one focal length.

    Args:
        views: one or more. The scores of a reading are the prior of the expression, its openings place lids and lips;
            what is missing comes from the landmarks. Without places of pixels, or where these and the landmarks see
            different faces, the silhouette alone refines the landmark fit.
        head: any head model with the 468-landmark embedding.
        settings: iterations, size of the basis, weights of the prior.

    Returns:
        A finite fit for each; ``low-confidence`` among its warnings where it is not to be trusted, ``not-read`` where
        no reading was followed though the settings ask for it.

    Raises:
        FitFailed: fewer than 30 landmarks of a photo are finite, or their error stays above ``FAIL_RMS``;
            ``extra["view"]`` is its index.
    """
    settings = settings or FitSettings()
    model = LandmarkModel(head, settings.identity_components)
    observed, priors = [], []
    for index, view in enumerate(views):
        finite = int(np.isfinite(view.face.landmarks).all(1).sum())
        if finite < FEWEST_LANDMARKS:
            raise FitFailed(
                f"only {finite} of {len(view.face.landmarks)} landmarks are finite; at least {FEWEST_LANDMARKS} are "
                "needed", view=index,
            )  # fmt: skip
        scores = None if view.reading is None else view.reading.scores
        observed.append(Observed.of(view.face.landmarks, middle_of(view.photo)))
        priors.append(prior_for(view.photo, model, settings, scores))
    initial = fit_landmarks(model, observed, priors, settings)
    if settings.refine == "landmarks":
        return _results(views, head, model, initial)
    own = _of_one_camera(views, priors, initial)
    sights = [
        ObservedPhoto(view, seen, prior, start, _understood(head, model, view, start))
        for view, seen, prior, start in zip(views, observed, own, initial, strict=True)
    ]
    found = [sight.found is not None for sight in sights]
    beyond = settings.beyond * (1 if len(views) == 1 else MORE_FORM)
    wide = extended(head, model.identity_count, beyond if any(found) and settings.refine == "full" else 0)
    wide_model = LandmarkModel(wide, len(wide.identity))
    refined = _refined(sights, wide, wide_model, model.identity_count, normals=settings.normals)
    fits = _results(views, wide, wide_model, [one for one, _ in refined])
    return [
        replace(
            fit, identity=fit.identity[: model.identity_count], light=light,
            warnings=(*fit.warnings, *(() if read else ("not-read",)), *(("no-light",) if light is None else ())),
        )
        for fit, (_, light), read in zip(fits, refined, found, strict=True)
    ]  # fmt: skip


def _of_one_camera(views: Sequence[View], priors: Sequence[Prior], fits: Sequence[LandmarkFit]) -> list[Prior]:
    """The priors, those of photos of one camera with the mean of its focal lengths, each known by itself so far."""
    own = list(priors)
    cameras = [camera_of(view.photo) for view in views]
    for camera in set(cameras) - {None}:
        members = [index for index, one in enumerate(cameras) if one == camera]
        if len(members) > 1:
            states = [fits[index].state for index in members]
            mean = float(np.mean([state.log_scale + state.log_distance for state in states]))
            for index in members:
                # The same where several photos have one camera, about their mean.
                own[index] = replace(own[index], log_focal=mean, log_focal_sigma=0.02)
    return own


def camera_of(photo: Photo) -> tuple[float, int, int] | None:
    """What photos of one camera have in common, by their files: focal length and size; None where it is not known."""
    return None if photo.focal_35mm is None else (photo.focal_35mm, min(photo.size), max(photo.size))


def _understood(head: HeadModel, model: LandmarkModel, view: View, initial: LandmarkFit) -> Correspondences | None:
    """Places of the head that were read, None where there are few or the landmarks show another face."""
    if view.reading is None:
        return None
    found = correspondences(head, view.reading, initial.state, middle_of(view.photo))
    vertices = head.shape(*np.split(initial.state.coefficients, [model.identity_count]))
    # 150: fewest cells with a place on the head from which a reading is followed.
    # 0.3: least share of them that has to agree with the landmark fit: below it, reader and landmarks see different
    # faces.
    agrees = len(found.pixels) >= 150 and reading_agreement(found, initial.state, vertices) >= 0.3
    return found if agrees else None


def _results(views: Sequence[View], head: HeadModel, model: LandmarkModel, found: Sequence[LandmarkFit]) -> list[Fit]:
    """The finished fits: eyes on their rims in one place for all photos, then what moves in each."""
    neutral = head.shape(found[0].state.coefficients[: model.identity_count])
    if not np.isfinite(neutral).all():
        raise FitFailed("the fitted head is not finite", view=0)
    rims = []
    for view, one in zip(views, found, strict=True):
        openings = {} if view.reading is None else view.reading.openings
        camera, expression = one.state.camera(*view.photo.size), one.state.coefficients[model.identity_count :]
        read = frozenset(openings) - frozenset(SIDES if "eyes-covered" in view.face.warnings else ())
        rims.append(SeenRims(expression, camera, with_openings(view.face.landmarks, openings), read))
    neutral = eyes_on_rims(head, neutral, rims)
    return [
        _result(index, view, head, neutral, one, seen)
        for index, (view, one, seen) in enumerate(zip(views, found, rims, strict=True))
    ]


def as_seen_side(head: HeadModel, expression: Float64, camera: Camera) -> Float64:
    """(E,) the expression; in a profile the hidden half does what the seen half does, as nothing is known of it."""
    if abs(camera.yaw_pitch_roll_deg()[0]) < WIDE_YAW_DEG:
        return expression
    hidden, seen = ("Left", "Right") if camera.rotation[2, 0] > 0 else ("Right", "Left")
    out, place = expression.copy(), {name: k for k, name in enumerate(head.expression_names)}
    for name, index in place.items():
        if name.endswith(hidden) and not name.startswith("eyeLook"):
            out[index] = out[place.get(name.removesuffix(hidden) + seen, index)]
    return out


def _result(index: int, view: View, head: HeadModel, neutral: Float32, found: LandmarkFit, seen: SeenRims) -> Fit:
    face, photo, basis, weight = view.face, view.photo, found.basis, found.weight
    camera, rims, expression = seen.camera, seen.landmarks, seen.expression
    identity = found.state.coefficients[: len(found.state.coefficients) - len(expression)]
    neutral = neutral.copy()
    gaze = find_gaze(photo.pixels, rims, head, neutral, camera)
    hidden = "eyes-covered" in face.warnings
    if hidden:
        expression = eyes_at_rest(head, expression)
    elif gaze is not None:
        expression = with_gaze(head, neutral, expression, gaze)
    # The landmark error is measured before lids and lips are moved: the embedding was calibrated on rendered heads, so
    # it already allows for where the network puts their landmarks.
    coefficients = np.concatenate([identity, expression])
    if not hidden:
        expression = lids_on_rims(head, neutral, replace(seen, expression=expression))
    mouth_rim = rims[list(RIMS["mouth"]), :2]
    inter_ocular = inter_ocular_m(head, neutral) * camera.focal_px / camera.translation[2]
    skin = cheek_colour(photo.pixels, face.landmarks, float(inter_ocular))
    tooth = None if skin is None else measure_teeth(photo.pixels, mouth_rim, skin)
    teeth_seen = skin is None or tooth is not None
    expression = lips_on_rim(head, neutral, replace(seen, expression=expression), teeth_seen)
    expression = as_seen_side(head, expression, camera)
    vertices = head.expressed(neutral, expression)
    distance = np.linalg.norm(camera.project(basis.points(coefficients)) - face.landmarks[:, :2], axis=1)
    shown = (weight > 0) & np.isfinite(distance)
    inlier = weight[shown] > 0.05
    trusted = distance[shown][inlier] if inlier.any() else distance[np.isfinite(distance)]
    rms = float(np.sqrt(np.mean(trusted**2))) if trusted.size else float("inf")
    if not np.isfinite(rms) or not np.isfinite(vertices).all() or rms > FAIL_RMS * inter_ocular:
        raise FitFailed(
            f"the head does not fit the landmarks: rms {rms:.1f} px with eyes {inter_ocular:.1f} px apart; "
            f"at most {FAIL_RMS * inter_ocular:.1f} px are accepted", view=index,
        )  # fmt: skip
    warnings: list[WarningCode] = []
    yaw = abs(camera.yaw_pitch_roll_deg()[0])
    if yaw > WIDE_YAW_DEG:
        warnings.append("extreme-pose")
    # Landmark rms over the inter-ocular distance above which a fit gets the warning ``low-confidence``.
    doubted = rms > 0.06 * inter_ocular or float((weight > 0.05).mean()) < 0.3
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
