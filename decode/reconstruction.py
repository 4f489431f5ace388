"""Result of decoding: heights with their uncertainty, and why each rejected pixel is rejected."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import PositiveFloat, TypeAdapter, ValidationError

from decode.reason import Reason
from scenes.acquisition.patterns import Axis
from scenes.files import exr
from scenes.rig.calibration import Calibration
from scenes.support.errors import DecodeError, FileError
from scenes.support.notebook import Displayed, PreviewPlane
from scenes.support.validation_words import in_words

KIND = "reconstruction"
# What is known of the fringe order: the value of settings["resolved"]["order"].
ORDER_ABSOLUTE, ORDER_UP_TO_TURNS = "absolute", "known only up to whole turns"
Image = NDArray[np.float32]
# Of `Reconstruction.cause_sigma_mm`.
CAUSES = ("mixed", "stray", "blur")


@dataclass(frozen=True, eq=False)
class AxisPhase:
    """Absolute phase of the finest fringes along one projector axis, as order and wrapped phase.

    Kept apart because float32 cannot hold their sum: it loses 1e-5 rad above some 16 fringes.
    """

    period_px: float
    wrapped_rad: Image
    """Phase in [-pi, pi), (row, col)."""
    order: NDArray[np.int32]
    """Fringe order, (row, col)."""

    @property
    def phase_rad(self) -> NDArray[np.float64]:
        """Absolute phase ``2 pi order + wrapped``, (row, col)."""
        return np.asarray(2.0 * np.pi * self.order + self.wrapped_rad, dtype=np.float64)

    @property
    def coordinate_px(self) -> NDArray[np.float64]:
        """Projector coordinate, continuous with pixel centres at + 0.5, (row, col)."""
        return self.phase_rad * (self.period_px / (2.0 * np.pi))


@dataclass(frozen=True, eq=False, repr=False)
class Reconstruction(Displayed):
    """Heights and what is known of each pixel; every array is (row, col).

    Numbers are kept wherever they could be computed, also where `valid` is False: a rejected pixel keeps its height.
    Outside the region of interest, and where there is no number, floats are NaN.
    """

    height_mm: Image
    """World z; of several projectors, that of all whose height is valid."""
    sigma_mm: Image
    """Predicted standard deviation of the height from sensor noise and rounding."""
    modulation_dn: Image
    """Fringe amplitude B of the finest set, of the exposure used."""
    offset_dn: Image
    """Offset A, black level included, of the exposure used."""
    reason: NDArray[np.uint8]
    """`Reason` code; 0 is valid."""
    exposure: NDArray[np.uint8]
    """Index of the exposure used; 255 where several were merged or none was."""
    cause_sigma_mm: Mapping[str, Image] = field(default_factory=dict)
    """Predicted standard deviation from each other cause, with ``uncertainty="by-cause"``; 0 where there is no sign of it."""
    axis: Axis = "column"
    """Projector axis that measured the height."""
    projector: NDArray[np.uint8] | None = None
    """Index of the projector that each pixel's numbers other than height and sigmas come from: of the valid ones, the one with the
    smallest total sigma; (row, col); 255 or None: unknown."""
    phases: Mapping[Axis, AxisPhase] = field(default_factory=dict)
    """Absolute phase by projector axis."""
    calibration: Calibration | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    """How it was decoded, in JSON's types; "resolved" holds what was chosen where the options left it open."""
    scene: str = ""
    """TOML of the scene that the stack was made from; empty for real captures."""
    identity: exr.Identity = field(default_factory=dict)
    """Digests of the scene and rig that the stack was made from, see `scenes.scene_identity`; empty: not known."""
    slope: Image | None = None
    """(2, row, col) slopes dz/dx and dz/dy of the surface in the world, measured by deflectometry; None: not measured."""
    slope_sigma: Image | None = None
    """(2, row, col) their predicted standard deviations."""

    def _facts(self) -> dict[str, str]:
        rows, columns = self.reason.shape
        shares = {name: f"{share:.1%}" for name, share in self.reason_fractions().items()}
        valid = shares.pop("ok")
        rejected = " ".join(f"{name} {share}" for name, share in shares.items()) or "none"
        facts = {"size": f"{columns} x {rows} px", "valid": valid, "rejected": rejected}
        return facts if self.order_known else facts | {"order": ORDER_UP_TO_TURNS}

    def _planes(self) -> list[PreviewPlane]:
        planes = [
            PreviewPlane("Height", "mm", np.where(self.valid, self.height_mm, np.nan)),
            PreviewPlane("Modulation", "DN", self.modulation_dn),
            PreviewPlane("Predicted sigma", "mm", np.where(self.valid, self.sigma_mm, np.nan)),
        ]
        if self.slope is not None:
            planes += [
                PreviewPlane(f"Slope dz/d{axis}", "rad", np.where(self.valid, values, np.nan))
                for axis, values in zip("xy", self.slope, strict=True)
            ]
        return [plane for plane in planes if np.isfinite(plane.values).any()] or planes[:1]

    @classmethod
    def of_heights(
        cls,
        height_mm: ArrayLike,
        valid: ArrayLike | None = None,
        calibration: Calibration | None = None,
    ) -> Self:
        """Heights of another decoder, so that they can be scored and written.

        Parameters
        ----------
        height_mm
            World z (row, col), mm; NaN where there is none.
        valid
            Which heights to trust, (row, col); None: all that are finite.
        calibration
            Camera and projectors, for points; None: heights only.

        Returns
        -------
        Reconstruction
            Without phases and predicted sigma.

        Raises
        ------
        DecodeError
            The heights are no image, or no pixel is valid.
        """
        height = np.asarray(height_mm, dtype=np.float32)
        if height.ndim != 2 or height.size == 0:
            raise DecodeError(f"heights have shape {height.shape}: expected (row, col)")
        good = np.isfinite(height)
        if valid is not None:
            if np.shape(valid) != height.shape:
                raise DecodeError(
                    f"valid has shape {np.shape(valid)}: expected the heights' {height.shape}"
                )
            good &= np.asarray(valid, dtype=bool)
        if not good.any():
            raise DecodeError("no height is finite and valid: there is nothing to score")
        unknown = np.full_like(height, np.nan)
        reason = np.where(good, Reason.OK, Reason.NO_HEIGHT).astype(np.uint8)
        unset = np.full(height.shape, 255, np.uint8)
        return cls(height, unknown, unknown, unknown, reason, unset, calibration=calibration)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Where the height is to be trusted."""
        return np.asarray(self.reason == Reason.OK)

    @property
    def total_sigma_mm(self) -> Image:
        """Predicted standard deviation from the sensor and all other causes that were looked for, (row, col)."""
        total = self.sigma_mm
        for sigma in self.cause_sigma_mm.values():
            total = np.hypot(total, sigma)
        return total

    @property
    def order_known(self) -> bool:
        """Whether something measured fixes the fringe order; else phases and heights may be off by whole fringes."""
        resolved = self.settings.get("resolved", {})
        return bool(resolved.get("order") != ORDER_UP_TO_TURNS)

    @property
    def order_note(self) -> str:
        """A sentence for pictures and tables of heights whose fringe order is not known; empty if it is."""
        said = f"The fringe order is {ORDER_UP_TO_TURNS}: parts may be off by whole fringes, beyond the predicted deviation."
        return "" if self.order_known else said

    @property
    def wrapped_rad(self) -> Image:
        """Wrapped phase of the measuring axis, in [-pi, pi)."""
        return self._measured.wrapped_rad

    @property
    def fringe_order(self) -> NDArray[np.int32]:
        """Fringe order of the measuring axis."""
        return self._measured.order

    @property
    def phase_rad(self) -> NDArray[np.float64]:
        """Absolute phase of the measuring axis."""
        return self._measured.phase_rad

    @property
    def column_px(self) -> NDArray[np.float64] | None:
        """Projector column that lights each pixel; None if the columns were not decoded."""
        return self.phases["column"].coordinate_px if "column" in self.phases else None

    @property
    def row_px(self) -> NDArray[np.float64] | None:
        """Projector row that lights each pixel; None if the rows were not decoded."""
        return self.phases["row"].coordinate_px if "row" in self.phases else None

    @property
    def _measured(self) -> AxisPhase:
        if self.axis not in self.phases:
            raise DecodeError("this reconstruction holds heights only, no phase")
        return self.phases[self.axis]

    @cached_property
    def xyz_mm(self) -> NDArray[np.float32]:
        """World points (row, col, 3): on each camera ray, the point of that height. Raises `DecodeError` uncalibrated."""
        if self.calibration is None:
            raise DecodeError("points need a calibration: this reconstruction has heights only")
        camera = self.calibration.camera.projection()
        camera.require_shape(self.height_mm.shape, "the heights", DecodeError)
        points = camera.points_at(self.height_mm).astype(np.float32)
        points[..., 2] = self.height_mm  # Not to the last bit otherwise.
        return points

    def reason_fractions(self) -> dict[str, float]:
        """Fraction of the pixels asked for under each reason that occurs; ``ok`` is always present.

        >>> Reconstruction.of_heights([[0.0, float("nan")]]).reason_fractions()
        {'ok': 0.5, 'no-height': 0.5}
        """
        asked = self.reason[self.reason != Reason.OUTSIDE_ROI]
        counts = np.bincount(asked, minlength=len(Reason))
        return {
            reason.label: float(counts[reason] / asked.size)
            for reason in Reason
            if counts[reason] or reason is Reason.OK
        }

    def write(self, path: str | Path) -> None:
        """Write as EXR: one channel a field, ``<axis>.wrapped_rad`` and ``<axis>.order`` for each axis."""
        channels: dict[str, NDArray[Any]] = {
            "height_mm": self.height_mm,
            "sigma_mm": self.sigma_mm,
            "modulation_dn": self.modulation_dn,
            "offset_dn": self.offset_dn,
            # Whole numbers below 2048 are exact in half.
            "reason": self.reason.astype(np.float16),
            "exposure": self.exposure.astype(np.float16),
        }
        for cause, sigma in self.cause_sigma_mm.items():
            channels[f"{cause}.sigma_mm"] = sigma
        if self.projector is not None:
            channels["projector"] = self.projector.astype(np.float16)
        for axis, phase in self.phases.items():
            channels[f"{axis}.wrapped_rad"] = phase.wrapped_rad
            channels[f"{axis}.order"] = phase.order.astype(np.float32)
        for name, slopes in (("slope", self.slope), ("slope_sigma", self.slope_sigma)):
            if slopes is not None:
                channels |= {
                    f"{name}.{axis}": plane for axis, plane in zip("xy", slopes, strict=True)
                }
        meta = {
            "axis": self.axis,
            "period_px": {axis: phase.period_px for axis, phase in self.phases.items()},
            "reasons": {reason.label: int(reason) for reason in Reason},
            "calibration": self.calibration and self.calibration.model_dump(mode="json"),
            "settings": dict(self.settings),
            "scene": self.scene,
            "identity": dict(self.identity),
        }
        exr.write(path, KIND, channels, meta)

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """Read a reconstruction; raises `FileError` on anything but a whole reconstruction file of this version."""
        channels, meta = exr.read(path, KIND)
        try:
            phases: dict[Axis, AxisPhase] = {
                axis: AxisPhase(
                    float(period),
                    channels[f"{axis}.wrapped_rad"],
                    _orders(channels[f"{axis}.order"]),
                )
                for axis, period in TypeAdapter(dict[Axis, PositiveFloat])
                .validate_python(meta["period_px"])
                .items()
            }
            calibration = meta["calibration"]
            return cls(
                height_mm=channels["height_mm"],
                sigma_mm=channels["sigma_mm"],
                modulation_dn=channels["modulation_dn"],
                offset_dn=channels["offset_dn"],
                reason=_reasons(channels["reason"]),
                exposure=exr.whole(channels["exposure"], np.uint8),
                cause_sigma_mm={
                    cause: channels[f"{cause}.sigma_mm"]
                    for cause in CAUSES
                    if f"{cause}.sigma_mm" in channels
                },
                axis=TypeAdapter(Axis).validate_python(meta["axis"]),
                projector=exr.whole(channels["projector"], np.uint8)
                if "projector" in channels
                else None,
                phases=phases,
                calibration=None
                if calibration is None
                else Calibration.model_validate(calibration),
                settings=dict(meta["settings"]),
                # Files of version 0.1 do not name their scene.
                scene=str(meta.get("scene", "")),
                identity=exr.identity_of(meta),
                slope=_pair(channels, "slope"),
                slope_sigma=_pair(channels, "slope_sigma"),
            )
        except (KeyError, TypeError, ValueError, AttributeError, ValidationError) as error:
            raise FileError(
                f"'{path}': its reconstruction header or channels are damaged: {in_words(error)}"
            ) from error


def _pair(channels: Mapping[str, NDArray[Any]], name: str) -> Image | None:
    """A quantity along x and y, (2, row, col); None if the file has none."""
    if f"{name}.x" not in channels:
        return None
    return np.stack([channels[f"{name}.{axis}"] for axis in "xy"])


def _orders(plane: Image) -> NDArray[np.int32]:
    if not np.isfinite(plane).all():
        raise ValueError("a fringe order is NaN or infinite")
    with np.errstate(invalid="ignore"):
        # int32's largest number is no float32, and may be where nothing was decoded.
        return plane.astype(np.int32)


def _reasons(plane: NDArray[np.float16]) -> NDArray[np.uint8]:
    codes: NDArray[np.uint8] = exr.whole(plane, np.uint8)
    if codes.max() >= len(Reason):
        raise ValueError(f"reason {codes.max()} has no meaning: they go to {len(Reason) - 1}")
    return codes
