"""How a stack is decoded: every choice, validated."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from inspect import signature
from numbers import Integral, Real
from operator import index
from typing import Any, Literal, ParamSpec, TypeVar, get_args

import numpy as np
from numpy.typing import NDArray

from decode.fusion.interface import FusionRule, Single
from decode.fusion.registry import rule as rule_named
from decode.reconstruction import Reconstruction
from scenes.acquisition.fringe_fit import STRAY_FRACTION
from scenes.acquisition.patterns import Axis
from scenes.files.stack import Stack
from scenes.support.errors import DecodeError, nearest

Unwrap = Literal["temporal", "row-scan", "quality-guided"]
Anchor = Literal["gray", "volume", "field", "spatial"]
Height = Literal[
    "triangulation", "reference-plane", "linear", "phase", "two-positions", "integration"
]
Matcher = Literal["sgbm", "bm"]
Saturation = Literal["reject", "ignore"]
Gamma = float | Literal["estimate"]
Backend = Literal["llvm", "cuda"]
Uncertainty = Literal["sensor", "by-cause"]
Roi = tuple[int, int, int, int] | NDArray[np.bool_]

P = ParamSpec("P")
T = TypeVar("T")

# What options that are numbers may be, NumPy's own included.
TYPES: tuple[tuple[tuple[type, ...], tuple[str, ...], str], ...] = (
    ((Integral,), ("exposure", "projector"), "a whole number"),
    (
        (Real,),
        ("c_px_per_mm", "min_modulation_dn", "min_relative_modulation", "max_order_residual"),
        "a number",
    ),
    ((Real, str), ("gamma",), "a number, or 'estimate'"),
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Options:
    """Choices of `reconstruct`; None leaves a choice to what the stack offers."""

    fusion: str | FusionRule = "max-modulation"
    """Name of a fusion rule (see `decode.rules`), or a rule."""
    exposure: int | None = None
    """With ``fusion="single"``: the exposure's index. None: the middle one by time."""
    saturation: Saturation = "reject"
    """ignore: clipped samples count as good, so that saturation biases silently, as with a modulation mask alone."""
    unwrap: Unwrap | None = None
    """None: temporal where it is possible, else quality-guided."""
    anchor: Anchor | None = None
    """What fixes the coarsest order in temporal unwrapping. gray: the stack's Gray code; volume: the height range,
    through the height model (one period suffices if no two heights look alike); field: the period spans the projector's
    image; spatial: a row scan of the coarsest phase, as the textbook's. Periods too fine for gray, volume or field beat
    with each other (heterodyne). None: the first of these that is unambiguous."""
    gamma: Gamma | None = None
    """Gamma of the response, whose bending of the phase is taken out; estimate: from the fringes' harmonics. None: the
    stack's."""
    height: Height | None = None
    """phase: none, coordinates only. None: triangulation with a calibration, else linear with `c_px_per_mm`. With a screen:
    two-positions, or integration of slopes; None: two-positions where there are two."""
    known_point: tuple[int, int, float] | None = None
    """Row and column of a pixel and the height of its point, mm, from which the slopes of one screen position are integrated."""
    c_px_per_mm: float | None = None
    """Fringe shift per mm of height for an uncalibrated linear or reference-plane model."""
    reference: Stack | Reconstruction | None = None
    """Measured plane z = 0 for the reference-plane model, under the same patterns."""
    height_range_mm: tuple[float, float] | None = None
    """Working volume; None: the calibration's."""
    axis: Axis | None = None
    """Fringe direction that measures height. None: the more sensitive one, column when uncalibrated."""
    projector: int | None = None
    """None: all, and of each pixel one height of the valid ones."""
    roi: Roi | None = None
    """(row0, row1, col0, col1), ends exclusive, or a boolean mask (row, col)."""
    min_modulation_dn: float | None = None
    """Modulation below which a pixel is dark. None: eight standard deviations of its noise (1/8 rad)."""
    min_relative_modulation: float = STRAY_FRACTION
    """Modulation per exposure time, as a fraction of the image's median, below which light is taken for stray light in
    a shadow: black ink sends back 5 % or more of what its surroundings do. 0: never, and the borders of shadows are not searched either."""
    max_order_residual: float = 0.25
    """How far from a whole number, in periods, a predicted order may be; 0.5 accepts all."""
    uncertainty: Uncertainty = "sensor"
    """by-cause: also predict blur, mixed pixels and indirect light, reject what they spoil, and give a sigma for each; see
    `Reconstruction.total_sigma_mm`."""
    matcher: Matcher | None = None
    """For two cameras without fringes: semi-global or plain block matching. None: sgbm."""
    backend: Backend | None = None
    """None: CUDA where there is a device."""

    def __post_init__(self) -> None:
        for name, allowed in CHOICES.items():
            value = getattr(self, name)
            if value not in allowed:
                known = [a for a in allowed if a is not None]
                raise DecodeError(f"{name} is {value!r}: {nearest(str(value), known)}")
        self._require_types()
        if self.uncertainty == "by-cause" and self.height == "phase":
            raise DecodeError(
                "uncertainty='by-cause' compares heights, but height is 'phase': leave one of them out"
            )
        if self.exposure is not None and self.fusion != "single":
            raise DecodeError(
                f"exposure {self.exposure} is given, but fusion is {self.fusion!r}: use fusion='single'"
            )
        if not 0.0 < self.max_order_residual <= 0.5:
            raise DecodeError(
                f"max_order_residual is {self.max_order_residual}: use more than 0, at most 0.5 periods"
            )
        if self.min_modulation_dn is not None and not self.min_modulation_dn >= 0.0:
            raise DecodeError(f"min_modulation_dn is {self.min_modulation_dn}: use 0 or more")
        if not 0.0 <= self.min_relative_modulation < 1.0:
            raise DecodeError(
                f"min_relative_modulation is {self.min_relative_modulation}: use a fraction from 0 to less than 1"
            )
        if self.height_range_mm is not None and not (
            np.shape(self.height_range_mm) == (2,)
            and self.height_range_mm[0] < self.height_range_mm[1]
        ):
            raise DecodeError(
                f"height_range_mm is {self.height_range_mm}: give the lowest and the highest height, in that order"
            )
        if isinstance(self.gamma, str) and self.gamma != "estimate":
            raise DecodeError(f"gamma is {self.gamma!r}: give a number, or 'estimate'")
        if isinstance(self.gamma, Real) and not 0.2 <= self.gamma <= 5.0:
            raise DecodeError(f"gamma is {self.gamma}: use 0.2 to 5")
        if self.known_point is not None and (
            np.shape(self.known_point) != (3,) or not np.isfinite(self.known_point).all()
        ):
            raise DecodeError(
                f"known_point is {self.known_point}: give row, column and height in mm"
            )
        if self.reference is not None and self.height != "reference-plane":
            raise DecodeError("a reference is given: use height='reference-plane' with it")

    def _require_types(self) -> None:
        for allowed, names, wanted in TYPES:
            for name in names:
                value = getattr(self, name)
                if value is not None and not isinstance(value, allowed):
                    raise DecodeError(f"{name} is {value!r}: give {wanted}")

    @classmethod
    def of(cls, choices: dict[str, Any]) -> "Options":
        """Options from keywords. Raises `DecodeError` for one that does not exist."""
        return known_options(cls)(**choices)

    def rule(self) -> FusionRule:
        """The fusion rule, before it has seen the stack."""
        if self.fusion == "single":
            return Single(self.exposure)
        return rule_named(self.fusion) if isinstance(self.fusion, str) else self.fusion

    def summary(self) -> dict[str, Any]:
        """The choices that shape the numbers, in JSON's types."""
        named: tuple[str, ...] = (
            "saturation",
            "anchor",
            "gamma",
            "height",
            "c_px_per_mm",
            "projector",
            "exposure",
            "uncertainty",
        )
        if self.known_point is not None:
            named = (*named, "known_point")
        limits = (
            "height_range_mm",
            "min_modulation_dn",
            "min_relative_modulation",
            "max_order_residual",
        )
        rule = self.fusion if isinstance(self.fusion, str) else repr(self.fusion)
        return {"fusion": rule} | {name: getattr(self, name) for name in named + limits}

    def region(self, image: tuple[int, ...]) -> NDArray[np.bool_] | None:
        """The region of interest as a mask.

        Parameters
        ----------
        image
            (rows, columns) of the frames.

        Returns
        -------
        array of bool, or None
            (row, col); None: the whole image.

        Raises
        ------
        DecodeError
            The region is empty or not inside the image.
        """
        if self.roi is None:
            return None
        rows, columns = image
        if isinstance(self.roi, np.ndarray):
            if self.roi.shape != image or self.roi.dtype != np.bool_:
                raise DecodeError(
                    f"the roi mask is {self.roi.dtype} of shape {self.roi.shape}: give booleans of shape {image}"
                )
            if not self.roi.any():
                raise DecodeError("the roi mask is empty: set at least one pixel")
            return self.roi
        try:
            row0, row1, col0, col1 = (index(edge) for edge in self.roi)
        except (TypeError, ValueError) as error:
            raise DecodeError(
                f"roi is {self.roi!r}: give (row0, row1, col0, col1) in whole pixels, or a boolean mask"
            ) from error
        if not (0 <= row0 < row1 <= rows and 0 <= col0 < col1 <= columns):
            raise DecodeError(
                f"roi (row0, row1, col0, col1) = {row0, row1, col0, col1} is empty or leaves the image: "
                f"rows are 0 to {rows}, columns 0 to {columns}, ends exclusive"
            )
        inside = np.zeros((rows, columns), np.bool_)
        inside[row0:row1, col0:col1] = True
        return inside


def known_options(function: Callable[P, T]) -> Callable[P, T]:
    """The same function, which raises `DecodeError` with the nearest known name for an option that does not exist."""
    known = list(signature(function).parameters)

    @wraps(function)
    def checked(*args: P.args, **options: P.kwargs) -> T:
        for name in options:
            if name not in known:
                raise DecodeError(f"unknown option '{name}': {nearest(name, known)}")
        return function(*args, **options)

    return checked


CHOICES: dict[str, tuple[str | None, ...]] = {
    "saturation": get_args(Saturation),
    "unwrap": (None, *get_args(Unwrap)),
    "anchor": (None, *get_args(Anchor)),
    "height": (None, *get_args(Height)),
    "axis": (None, *get_args(Axis)),
    "uncertainty": get_args(Uncertainty),
    "matcher": (None, *get_args(Matcher)),
    "backend": (None, *get_args(Backend)),
}
