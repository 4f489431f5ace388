"""Stack to reconstruction: which way of decoding a stack needs."""

from dataclasses import replace

from decode.deflectometry import decode_mirror, require_projectors
from decode.fusion.interface import FusionRule
from decode.one_camera import decode_fringes
from decode.options import (
    Anchor,
    Backend,
    Gamma,
    Height,
    Matcher,
    Options,
    Roi,
    Saturation,
    Uncertainty,
    Unwrap,
    known_options,
)
from decode.reconstruction import Reconstruction
from decode.stereo_phase import stereo
from decode.stereo_texture.matching import match
from scenes.acquisition.fringe_fit import STRAY_FRACTION
from scenes.acquisition.patterns import Axis
from scenes.files.stack import Stack
from scenes.rig.devices import Pinhole
from scenes.support.errors import DecodeError

# Frames that give a pixel no projector coordinate.
UNCODED = ("dots", "white", "black")
# Options that make no sense with two cameras, those of their phases alone, and others that stereo by phase takes.
NOT_OF_PAIRS = (
    "c_px_per_mm",
    "known_point",
    "reference",
    "axis",
    "projector",
    "height",
    "uncertainty",
)
OF_PHASES = ("unwrap", "anchor", "gamma", "min_modulation_dn")
SHARED = ("fusion", "exposure", "saturation", "roi", "min_relative_modulation", "max_order_residual", "backend")  # fmt: skip


@known_options
def reconstruct(
    stack: Stack,
    *,
    fusion: str | FusionRule = "max-modulation",
    exposure: int | None = None,
    saturation: Saturation = "reject",
    unwrap: Unwrap | None = None,
    anchor: Anchor | None = None,
    gamma: Gamma | None = None,
    height: Height | None = None,
    c_px_per_mm: float | None = None,
    known_point: tuple[int, int, float] | None = None,
    reference: Stack | Reconstruction | None = None,
    height_range_mm: tuple[float, float] | None = None,
    axis: Axis | None = None,
    projector: int | None = None,
    roi: Roi | None = None,
    min_modulation_dn: float | None = None,
    min_relative_modulation: float = STRAY_FRACTION,
    max_order_residual: float = 0.25,
    uncertainty: Uncertainty = "sensor",
    matcher: Matcher | None = None,
    backend: Backend | None = None,
) -> Reconstruction:
    """Decode a stack into heights.

    Parameters
    ----------
    stack
        Frames (exposure, frame, row, col) in digital numbers, their patterns and the sensor; with a calibration,
        heights are triangulated. Stacks of two cameras are decoded as stereo: by phase, or without fringes by texture.
    fusion
        How several exposures become one phase: a name from `decode.rules`, or a `FusionRule`.
    exposure
        With ``fusion="single"``: index of the exposure. None: `middle_exposure`.
    saturation
        ``"ignore"`` treats clipped samples as good, so that saturation biases silently, as with a modulation mask alone.
    unwrap
        ``"temporal"``, ``"row-scan"`` or ``"quality-guided"``. None: temporal where possible, else quality-guided.
    anchor
        What fixes the coarsest fringe order in temporal unwrapping: ``"gray"`` (Gray code), ``"volume"`` (height range),
        ``"field"`` (the projector's size) or ``"spatial"`` (a row scan). None: the first that is unambiguous.
    gamma
        Gamma of the response, whose effect on the phase is removed, 0.2 to 5; ``"estimate"``: from the harmonics. None:
        the stack's.
    height
        ``"triangulation"``, ``"reference-plane"``, ``"linear"``, or ``"phase"`` for phases alone. None: triangulation
        with a calibration, else linear with `c_px_per_mm`. With a screen ``"two-positions"`` or ``"integration"``.
    c_px_per_mm
        Fringe shift in projector px per mm of height, for an uncalibrated linear or reference-plane model.
    known_point
        Row and column of a pixel and the height of its point, mm, from which slopes measured with one position of a screen
        are integrated.
    reference
        Measured plane z = 0 for the reference-plane model, under the same patterns.
    height_range_mm
        Lowest and highest height of the working volume, mm. None: the calibration's.
    axis
        Projector axis that measures height. None: the more sensitive one; column when uncalibrated.
    projector
        Index of the projector. None: all, and of each pixel one height of the valid ones, their mean where they agree.
    roi
        (row0, row1, col0, col1) in px, ends exclusive, or a boolean mask (row, col).
    min_modulation_dn
        Modulation in DN below which a pixel is dark. None: eight standard deviations of its noise (1/8 rad).
    min_relative_modulation
        Modulation per exposure time, as a fraction of the image's median, 0 to 1, below which light is taken for stray
        light in a shadow. 0: never.
    max_order_residual
        Largest distance, in periods, of a predicted fringe order from a whole number, above 0, up to 0.5 (accepts all).
    uncertainty
        ``"by-cause"``: also predict blur, mixed pixels and indirect light, reject what they spoil (`mixed`, `stray`), and
        predict their share in `Reconstruction.total_sigma_mm`.
    matcher
        ``"sgbm"`` or ``"bm"``, for two cameras without fringes: semi-global or plain block matching. None: sgbm.
    backend
        ``"llvm"`` or ``"cuda"``. None: CUDA where there is a device.

    Returns
    -------
    Reconstruction
        Heights in mm, their predicted standard deviation, phases, and a reason for each rejected pixel; images are
        (row, col).

    Raises
    ------
    DecodeError
        A choice that is impossible for this stack, or no pixel can be decoded; the message names the cause.
    TooLargeError
        More pixels than memory holds.

    Warns
    -----
    FringebenchWarning
        With ``uncertainty="by-cause"``, when whole surfaces lose modulation as no opaque one does.

    Notes
    -----
    ``I_k = A + B cos(phi + 2 pi k / N)``; phase by least squares, order by temporal unwrapping (Huntley & Saldner 1993),
    height where the camera's ray meets the projector's fringe. Every choice is documented in `Options`.

    Examples
    --------
    >>> rec = reconstruct(stack, fusion="max-modulation", roi=(0, 100, 0, 200))  # doctest: +SKIP
    >>> rec.height_mm.shape == stack.frames.shape[2:]  # doctest: +SKIP
    True
    """
    return reconstruct_with(
        stack,
        Options(
            fusion=fusion,
            exposure=exposure,
            saturation=saturation,
            unwrap=unwrap,
            anchor=anchor,
            gamma=gamma,
            height=height,
            c_px_per_mm=c_px_per_mm,
            known_point=known_point,
            reference=reference,
            height_range_mm=height_range_mm,
            axis=axis,
            projector=projector,
            roi=roi,
            min_modulation_dn=min_modulation_dn,
            min_relative_modulation=min_relative_modulation,
            max_order_residual=max_order_residual,
            uncertainty=uncertainty,
            matcher=matcher,
            backend=backend,
        ),
    )


def reconstruct_with(stack: Stack, options: Options) -> Reconstruction:
    """As `reconstruct`, with the choices as one object.

    Parameters
    ----------
    stack
        Frames (exposure, frame, row, col) in DN.
    options
        Every choice.

    Returns
    -------
    Reconstruction
        Images (row, col); heights in mm.
    """
    if any(frame.camera for frame in stack.patterns):
        return _pair(stack, options)
    if all(frame.kind in UNCODED for frame in stack.patterns):
        raise DecodeError(
            f"the frames are {stack.patterns[0].kind}, which give no height with one camera: add a second_camera, or project fringes"
        )
    if stack.calibration is not None and stack.calibration.screens:
        return decode_mirror(stack, options)
    if options.matcher is not None:
        raise DecodeError("matcher is for stacks of two cameras without fringes: leave it out")
    require_projectors(options)
    return decode_fringes(stack, options)


def _pair(stack: Stack, options: Options) -> Reconstruction:
    """Stereo, by phase where there are fringes or Gray code, else by texture."""
    rig = stack.calibration
    if rig is None or rig.second_camera is None or not isinstance(rig.camera, Pinhole):
        raise DecodeError(
            "the frames are of two cameras, but the calibration is not: give one with a second_camera, both of model 'pinhole'"
        )
    heights = options.height_range_mm or rig.height_range_mm
    cameras = rig.camera, rig.second_camera
    left, right = (camera_view(stack, camera) for camera in (0, 1))
    plain = all(frame.kind in UNCODED for frame in left.patterns)
    for name in (*NOT_OF_PAIRS, *(OF_PHASES if plain else ("matcher",))):
        value = getattr(options, name)
        if value not in (None, "sensor") and (name, value) != ("height", "triangulation"):
            what = "two cameras" + (" without fringes" if plain else " with fringes")
            raise DecodeError(f"{name} does not apply to stacks of {what}: leave it out")
    if plain:
        found = match(left, right, cameras, heights, options)
    else:
        choices = {name: getattr(options, name) for name in (*OF_PHASES, *SHARED)}
        found = stereo(left, right, cameras, heights, **choices)
    return replace(found, calibration=rig)


def camera_view(stack: Stack, camera: int) -> Stack:
    """The frames of one camera of a pair, 0 or 1; `DecodeError` if they are missing."""
    at = [i for i, frame in enumerate(stack.patterns) if frame.camera == camera]
    if not at or at != list(range(at[0], at[-1] + 1)):
        raise DecodeError(
            f"frames of camera {camera} are missing or scattered: a stack holds those of one camera after the other's"
        )
    own = tuple(replace(stack.patterns[i], camera=0) for i in at)
    return replace(
        stack,
        frames=stack.frames[:, at[0] : at[-1] + 1],
        patterns=own,
        calibration=None,
        projector_resolution=stack.projector_size(),
    )
